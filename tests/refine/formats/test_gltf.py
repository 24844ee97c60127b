"""Damaged and hostile glTF: every claim is checked, and the answer is one line, soon, in little memory."""

import json
import struct
import time
import tracemalloc

import numpy as np
import pytest
import torch
from gltf_by_hand import pack, unpack

from refine.formats.glb import write_glb
from refine.formats.glb_read import read_glb, read_takes
from refine.formats.gltf import read_gltf
from refine.synthetic import draw, perform
from renderers.checks import UserError

ACCESSOR_OF_TIMES = -26  # 24 rotations and one path come behind it
MEGABYTE = 1 << 20


@pytest.fixture(scope="module")
def fine(free_body, rest_joints, tmp_path_factory):
    """Table of contents and bytes of a file that is in order."""
    path = tmp_path_factory.mktemp("fine") / "a.glb"
    write_glb(path, perform(draw("walk", torch.Generator().manual_seed(1)), 6, rest_joints), free_body)
    return unpack(path)


def times(document: dict) -> dict:
    return document["accessors"][ACCESSOR_OF_TIMES]


def view(document: dict) -> dict:
    """The bytes of the times."""
    return document["bufferViews"][times(document)["bufferView"]]


def animation(document: dict) -> dict:
    return document["animations"][0]


def chain(document: dict, length: int) -> None:
    """Hang the pelvis on a long chain of nodes."""
    start = len(document["nodes"])
    document["nodes"] += [{"children": [start + k + 1]} for k in range(length)]
    document["nodes"][-1] = {"children": [0]}


def crowd(document: dict, takes: int) -> None:
    document["animations"] = document["animations"] * takes


CLAIMS = {
    "no accessors": lambda d: d.pop("accessors"),
    "accessors that are no list": lambda d: d.update(accessors={"0": {}}),
    "nodes that are no objects": lambda d: d.update(nodes=[1, 2, 3]),
    "an accessor beyond the last": lambda d: animation(d)["samplers"][3].update(output=10**6),
    "an accessor below the first": lambda d: animation(d)["samplers"][3].update(output=-1),
    "an accessor called True": lambda d: animation(d)["samplers"][3].update(output=True),
    "an accessor by a list": lambda d: animation(d)["samplers"][3].update(input=[0]),
    "a count of billions": lambda d: times(d).update(count=2**40),
    "a count of billions without bytes": lambda d: (times(d).update(count=2**40), times(d).pop("bufferView")),
    "a count below zero": lambda d: times(d).update(count=-6),
    "a count of a fraction": lambda d: times(d).update(count=5.5),
    "a count that overflows": lambda d: times(d).update(count=2**63),
    "a digit too many in a count": lambda d: times(d).update(count=7),
    "an offset out of its view": lambda d: times(d).update(byteOffset=4),
    "an offset below zero": lambda d: times(d).update(byteOffset=-4),
    "a stride of nothing": lambda d: view(d).update(byteStride=0),
    "a stride out of the file": lambda d: view(d).update(byteStride=2**50),
    "a view out of its buffer": lambda d: view(d).update(byteOffset=10**7),
    "a view of another buffer": lambda d: view(d).update(buffer=1),
    "a view without a length": lambda d: view(d).pop("byteLength"),
    "an unknown component": lambda d: times(d).update(componentType=5130),
    "another type": lambda d: times(d).update(type="VEC3"),
    "a type of types": lambda d: times(d).update(type=["SCALAR"]),
    "sparse values beyond": lambda d: times(d).update(sparse={"count": 7, "indices": {}, "values": {}}),
    "sparse values nowhere": lambda d: times(d).update(sparse={"count": 1}),
    "packed bytes": lambda d: view(d).update(extensions={"EXT_meshopt_compression": 1}),
    "times that go back": lambda d: times(d).update(bufferView=d["accessors"][ACCESSOR_OF_TIMES + 1]["bufferView"]),
    "a sampler beyond the last": lambda d: animation(d)["channels"][3].update(sampler=99),
    "samplers that are no list": lambda d: animation(d).update(samplers=7),
    "channels that are no list": lambda d: animation(d).update(channels={"0": 1}),
    "a property moved twice": lambda d: animation(d)["channels"].append(animation(d)["channels"][0]),
    "a strange interpolation": lambda d: animation(d)["samplers"][0].update(interpolation="BEZIER"),
    "an interpolation that is a list": lambda d: animation(d)["samplers"][0].update(interpolation=["STEP"]),
    "a spline without tangents": lambda d: animation(d)["samplers"][0].update(interpolation="CUBICSPLINE"),
    "a frame rate of nothing": lambda d: animation(d)["extras"].update(fps=0),
    "a frame rate in words": lambda d: animation(d)["extras"].update(fps="thirty"),
    "a frame rate of millions": lambda d: animation(d)["extras"].update(fps=10**7),
    "no animation": lambda d: d.pop("animations"),
    "an animation of nothing": lambda d: animation(d).update(channels=[]),
    "a thousand and one takes": lambda d: crowd(d, 1001),
    "a node below itself": lambda d: d["nodes"][23].update(children=[0]),
    "a node below two": lambda d: d["nodes"][24].update(children=[5]),
    "a child that is not there": lambda d: d["nodes"][23].update(children=[99]),
    "a child by name": lambda d: d["nodes"][23].update(children=["head"]),
    "a chain of nodes": lambda d: chain(d, 50_000),
    "a joint that is not there": lambda d: d["skins"][0]["joints"].append(99),
    "a joint twice": lambda d: d["skins"][0]["joints"].append(3),
    "too few bind matrices": lambda d: d["accessors"][d["skins"][0]["inverseBindMatrices"]].update(count=23),
    "a node of three numbers": lambda d: d["nodes"][3].update(translation=[1, 2]),
    "a node of words": lambda d: d["nodes"][3].update(translation=["a", "b", "c"]),
    "a node without a rotation": lambda d: d["nodes"][3].update(rotation=[0, 0, 0, 0]),
    "a node far away": lambda d: d["nodes"][3].update(translation=[1e300, 0, 0]),
    "a flattened joint": lambda d: d["nodes"][3].update(scale=[1, 0, 1]),
    "a mirrored joint": lambda d: d["nodes"][3].update(scale=[1, -1, 1]),
    "a matrix of 15": lambda d: d["nodes"][3].update(matrix=[1.0] * 15),
    "glTF of another age": lambda d: d.update(asset={"version": "1.0"}),
    "no asset": lambda d: d.pop("asset"),
    "no buffers": lambda d: d.pop("buffers"),
    "a buffer without bytes": lambda d: d["buffers"][0].update(uri=None),
    "a buffer that is no base64": lambda d: d["buffers"][0].update(uri="data:x/y;base64,@@@@"),
}


# Of what else might be wrong with them too, this is said.
SAID = {
    "an accessor called True": "refers to number True of its",
    "an accessor below the first": "refers to number -1 of its",
    "a count of billions without bytes": "1 to 2000000 are read",
    "a digit too many in a count": "claims 28 bytes of a view of 24",
    "an offset out of its view": "claims 28 bytes of a view of 24",
    "a stride of nothing": "not given in whole bytes",
    "a view out of its buffer": "at 10000000 in a buffer of",
    "an unknown component": "unknown type 5130",
    "another type": "expected a SCALAR, got 'VEC3'",
    "sparse values beyond": "replaces 7 of 6 elements",
    "packed bytes": "compressed by meshopt",
    "times that go back": "go back in time",
    "a property moved twice": "moves the rotation of node 0 twice",
    "a spline without tangents": "6 values for 6 key frames",
    "a frame rate of millions": "is no number of frames per second",
    "a node below itself": "hangs on itself",
    "a node below two": "hangs on both",
    "a chain of nodes": "more than 2048 nodes",
    "a joint twice": "lists a joint twice",
    "too few bind matrices": "23 inverse bind matrices for 24 joints",
    "a node without a rotation": "quaternion is near zero",
    "a node far away": "numbers below 1e+09",
    "a flattened joint": "'spine1' is flattened or mirrored in frame 0",
    "a mirrored joint": "'spine1' is flattened or mirrored in frame 0",
    "a buffer that is no base64": "is not the base64",
}


def refused(path, rest_joints) -> str:
    """The message of the refusal, which came within a second and 200 MB."""
    tracemalloc.start()
    before = time.process_time()
    try:
        with pytest.raises(UserError) as caught:
            read_glb(path, rest_joints)
    finally:
        seconds, peak = time.process_time() - before, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    message = str(caught.value)
    assert seconds < 2 and peak < 200 * MEGABYTE, (seconds, peak)
    assert message.startswith(str(path.parent)) and message.isprintable() and len(message) < 400
    return message


@pytest.mark.parametrize("claim", CLAIMS)
def test_false_claims_are_refused(fine, rest_joints, tmp_path, claim):
    document = json.loads(json.dumps(fine[0]))
    CLAIMS[claim](document)
    path = tmp_path / "a.glb"
    path.write_bytes(pack(document, fine[1]))
    assert SAID.get(claim, "") in refused(path, rest_joints)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.glb"]


def header(
    *, length: int | None = None, size: int | None = None, kind: bytes = b"JSON", text: bytes = b"{}  "
) -> bytes:
    size = len(text) if size is None else size
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) if length is None else length, size, kind) + text


CONTAINERS = {
    "a magic alone": b"glTF",
    "binary glTF 1": struct.pack("<4sIIII", b"glTF", 1, 24, 0, 0) + b"{}  ",
    "a length beyond the file": header(length=10**6),
    "a length of four gigabytes": header(length=2**32 - 1, size=2**32 - 1),
    "JSON beyond the file": header(size=10**6),
    "a first chunk that is not JSON": header(kind=b"BIN\0"),
    "JSON that is none": header(text=b"{nope}  "),
    "JSON of a number": header(text=b"17  "),
    "JSON of a list": header(text=b"[[]]"),
    "JSON with a NaN": header(text=b'{"asset":{"version":"2.0"},"nodes":[NaN]}   '),
    "JSON in Latin-1": header(text=b'{"asset":{"version":"2.0","x":"\xe9"}}  '),
    "a second chunk beyond the file": header(length=60, text=b"{}  ") + struct.pack("<I4s", 999, b"BIN\0") + bytes(32),
    "a deep list": header(text=b"[" * 100_000 + b"]" * 100_000),
    "a deep object": header(text=b'{"a":' * 100_000 + b"1" + b"}" * 100_000),
    "a number of many digits": header(text=b'{"asset":' + b"9" * 100_000 + b"}" + b"  "),
    "millions of lists": header(text=b"[" + b"[]," * 2_000_000 + b"[]]"),
    "millions of numbers": header(text=b"[" + b"1," * 3_000_000 + b"1]  "),
    "a text of tens of megabytes": header(text=b'{"a":"' + b"x" * (1 << 26) + b'"}'),
    "text without an asset": b'{"nodes": [], "asset": 3}',
}


@pytest.mark.parametrize("kind", CONTAINERS)
def test_broken_containers_are_refused(rest_joints, tmp_path, kind):
    path = tmp_path / "a.glb"
    path.write_bytes(CONTAINERS[kind])
    refused(path, rest_joints)


def test_the_file_in_order_is_read(fine, rest_joints, tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(pack(*fine))
    assert len(read_glb(path, rest_joints)[0]) == 6


def test_a_file_cut_anywhere_is_refused(fine, rest_joints, tmp_path):
    whole = pack(*fine)
    for length in [*range(1, 40), *range(40, len(whole), len(whole) // 40)]:
        path = tmp_path / f"{length}.glb"
        path.write_bytes(whole[:length])
        with pytest.raises(UserError):
            read_glb(path, rest_joints)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38])
def test_numbers_that_are_none_are_refused(fine, rest_joints, tmp_path, value):
    document, binary = fine
    view = document["bufferViews"][document["accessors"][-1]["bufferView"]]
    raw = bytearray(binary)
    struct.pack_into("<f", raw, view["byteOffset"] + 16, value)
    path = tmp_path / "a.glb"
    path.write_bytes(pack(document, bytes(raw)))
    if np.isfinite(value):
        read_takes(path)  # large, but a place
    else:
        assert "element 1, component 1" in refused(path, rest_joints)


def test_frames_without_end_are_refused(fine, rest_joints, tmp_path):
    """Two key frames far apart cost nothing in the file, and would take all memory as frames."""
    document, binary = json.loads(json.dumps(fine[0])), bytearray(fine[1])
    view = document["bufferViews"][times(document)["bufferView"]]
    struct.pack_into("<f", binary, view["byteOffset"] + 20, 1e9)
    path = tmp_path / "a.glb"
    path.write_bytes(pack(document, bytes(binary)))
    assert "frames, more than" in refused(path, rest_joints)


def test_keys_that_are_told_again_and_again_are_refused(fine, rest_joints, tmp_path):
    """A thousand takes of a million keys each, all of them the same bytes."""
    document, binary = json.loads(json.dumps(fine[0])), fine[1]
    start, keys = len(binary), 80_000
    binary += np.arange(keys, dtype="<f4").tobytes() + np.full(4 * keys, 0.1, "<f4").tobytes()
    document["bufferViews"] += [
        {"buffer": 0, "byteOffset": start, "byteLength": 4 * keys},
        {"buffer": 0, "byteOffset": start + 4 * keys, "byteLength": 16 * keys},
    ]
    views = len(document["bufferViews"])
    for offset, kind in ((2, "SCALAR"), (1, "VEC3")):
        accessor = {"bufferView": views - offset, "componentType": 5126, "count": keys, "type": kind}
        document["accessors"].append(accessor)
    accessors = len(document["accessors"])
    sampler = {"input": accessors - 2, "output": accessors - 1}
    channels = [{"sampler": 0, "target": {"node": node, "path": "translation"}} for node in range(24)]
    document["animations"] = [{"samplers": [sampler], "channels": channels, "extras": {"fps": 1e-6}}] * 1000
    path = tmp_path / "a.glb"
    path.write_bytes(pack(document, binary))
    assert "elements, 1 to" in refused(path, rest_joints)


def test_random_bytes_never_crash(fine, rest_joints, tmp_path):
    """Any damage to a file in order is read or refused, never anything else."""
    rng, whole = np.random.default_rng(0), np.frombuffer(pack(*fine), np.uint8)
    table = whole[16:].tobytes().index(b"BIN\0") + 16
    read = 0
    for index in range(60):
        damaged = whole.copy()
        places = rng.integers(12, table if index % 2 else len(whole), size=rng.integers(1, 6))
        damaged[places] = rng.integers(32, 127, size=len(places)) if index % 2 else rng.integers(0, 256, len(places))
        path = tmp_path / "a.glb"
        path.write_bytes(damaged.tobytes())
        try:
            read += len(read_glb(path, rest_joints))
        except UserError as error:
            assert "\n" not in str(error)
    assert read > 2


def test_what_is_listed_is_looked_up_once(fine, tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(pack(*fine))
    file = read_gltf(path)
    assert file.entries("nodes") is file.entries("nodes")
    assert file.entry("nodes", 3)["name"] == "spine1"
    assert file.numbers(0, "VEC3", 10**6).shape == (1800, 3)
    with pytest.raises(UserError, match="1 to 1799 are read"):
        file.numbers(0, "VEC3", 1799)
