"""GLB and glTF files that nest, refer to what is not theirs, or claim too much."""

import base64
import json
import struct
from pathlib import Path

import numpy as np
from gltf_by_hand import Builder, pack, unpack
from hostile_cases import hostile

TIMES, TURNS = [0.0, 1 / 30, 2 / 30], [[0, 0, 0, 1], [0, 0.1, 0, 0.99], [0, 0.2, 0, 0.98]]
BODY = unpack(Path(__file__).parent / "seeds" / "smpl.glb")[0]


def document(times=TIMES, turns=TURNS, **more) -> tuple[dict, bytes]:
    """SMPL's skeleton, whose hips turn."""
    made = Builder()
    sampler = {"input": made.add(times), "output": made.add(turns, "VEC4")}
    channel = {"sampler": 0, "target": {"node": 0, "path": "rotation"}}
    nodes = json.loads(json.dumps(BODY["nodes"]))
    whole = made.document(nodes=nodes, scenes=BODY["scenes"], skins=BODY["skins"])
    whole["animations"] = [{"name": "take", "samplers": [sampler], "channels": [channel]}]
    return whole | more, bytes(made.data)


def glb(**more) -> bytes:
    return pack(*document(**more))


def changed(list_name: str, index: int, **values) -> bytes:
    whole, binary = document()
    whole[list_name][index] |= values
    return pack(whole, binary)


def raw(text: bytes, claimed: int | None = None) -> bytes:
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(text) if claimed is None else claimed, b"JSON") + text
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


@hostile("claims four gigabytes of JSON", ".glb")
def json_length() -> bytes:
    return raw(b"{}", 0xFFFFFFF0)


@hostile("nests JSON 100,000 deep", ".glb")
def nested_json() -> bytes:
    return raw(b"[" * 100_000)


@hostile("has a million empty lists", ".glb")
def empty_lists() -> bytes:
    return raw(b'{"nodes":[' + b"[]," * 1_000_000 + b"[]]}")


@hostile("has numbers that are none in its JSON", ".glb")
def json_nan() -> bytes:
    return raw(b'{"asset":{"version":"2.0"},"nodes":[{"translation":[NaN,Infinity,0]}]}')


@hostile("has a node that is its own grandchild", ".glb")
def cycle() -> bytes:
    whole, binary = document()
    whole["nodes"][22]["children"] = [0]
    return pack(whole, binary)


@hostile("has two parents for a node", ".glb")
def two_parents() -> bytes:
    return changed("nodes", 0, children=[1, 2, 3, 3])


@hostile("has 100,000 nodes in a chain that ends where it begins", ".glb")
def long_chain() -> bytes:
    nodes = [{"children": [index + 1]} for index in range(99_999)] + [{"children": [0]}]
    return glb(nodes=nodes, scenes=[], skins=[{"joints": [0, 1, 2]}])


@hostile("has an array that reaches out of the file", ".glb")
def outside() -> bytes:
    return changed("accessors", 1, byteOffset=1 << 40)


@hostile("has an array of 10^12 zeros that need no bytes", ".glb")
def free_zeros() -> bytes:
    whole, binary = document()
    whole["accessors"] = [
        {"componentType": 5126, "type": "SCALAR", "count": 10**12},
        {"componentType": 5126, "type": "VEC4", "count": 10**12},
    ]
    return pack(whole, binary)


@hostile("has a sparse array of 10^10", ".glb")
def sparse_array() -> bytes:
    sparse = {"count": 10**10, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 1}}
    return changed("accessors", 1, count=10**10, sparse=sparse)


@hostile("has a negative number of elements", ".glb")
def negative_count() -> bytes:
    return changed("accessors", 0, count=-3)


@hostile("has fractions for indices", ".glb")
def fraction() -> bytes:
    return changed("accessors", 0, bufferView=0.5)


@hostile("reads /etc/passwd as its buffer", ".gltf")
def file_address() -> str:
    whole, _ = document()
    return json.dumps(whole | {"buffers": [{"byteLength": 100, "uri": "file:///etc/passwd"}]})


@hostile("reads a file of another folder as its buffer", ".gltf")
def folder_above() -> str:
    whole, _ = document()
    return json.dumps(whole | {"buffers": [{"byteLength": 100, "uri": "../../../etc/passwd"}]})


@hostile("fetches its buffer from the network", ".gltf")
def web_address() -> str:
    whole, _ = document()
    return json.dumps(whole | {"buffers": [{"byteLength": 100, "uri": "http://127.0.0.1:9/harmed"}]})


@hostile("has a buffer that is shorter than it claims", ".gltf")
def short_buffer() -> str:
    whole, binary = document()
    address = "data:application/octet-stream;base64," + base64.b64encode(binary[:40]).decode()
    return json.dumps(whole | {"buffers": [{"byteLength": len(binary), "uri": address}]})


@hostile("moves for a thousand million seconds", ".glb")
def long_take() -> bytes:
    return glb(times=[0.0, 1 / 30, 1e9])


@hostile("goes back in time", ".glb")
def backwards() -> bytes:
    return glb(times=[0.0, -1.0, 0.5])


@hostile("turns by NaN", ".glb")
def nan_turns() -> bytes:
    return glb(turns=np.full((3, 4), np.nan))


@hostile("turns by nothing", ".glb")
def no_turns() -> bytes:
    return glb(turns=np.zeros((3, 4)))


@hostile("says a frame rate that overflows", ".glb")
def large_rate() -> bytes:
    whole, binary = document()
    whole["animations"][0]["extras"] = {"fps": 10**400}
    return pack(whole, binary)


@hostile("has a take of half a million frames from two keys", ".glb")
def stretched_take() -> bytes:
    return glb(times=[0.0, 1 / 30, 16_000.0])


@hostile("has bones that overflow", ".glb")
def large_bones() -> bytes:
    return changed("nodes", 1, translation=[1e308, 1e308, 1e308])


@hostile("scales a bone to nothing", ".glb")
def no_scale() -> bytes:
    return changed("nodes", 0, scale=[0, 0, 0])


@hostile("has 2,000 animations", ".glb")
def many_takes() -> bytes:
    whole, binary = document()
    return pack(whole | {"animations": whole["animations"] * 2_000}, binary)


@hostile("has a million channels", ".glb")
def many_channels() -> bytes:
    whole, binary = document()
    whole["animations"][0]["channels"] *= 200_000
    return pack(whole, binary)


@hostile("has buffers that an extension unpacks to a gigabyte", ".glb")
def packed_buffers() -> bytes:
    packed = {"EXT_meshopt_compression": {"buffer": 0, "byteLength": 60, "byteStride": 4, "count": 1 << 28}}
    return changed("bufferViews", 0, extensions=packed)


@hostile("is of another version", ".glb")
def version() -> bytes:
    return pack(*document(), version=999)


@hostile("is cut", ".glb")
def cut_glb() -> bytes:
    return glb()[:-40]


@hostile("has words where lists belong", ".glb")
def words() -> bytes:
    return raw(b'{"asset":{"version":"2.0"},"nodes":"a","animations":{"a":1},"skins":[[]]}')
