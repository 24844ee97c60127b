"""glTF read and packed with struct, json and NumPy alone: what the reader and the writer are judged by.

Straight from the specification, one frame and one vertex attribute at a time; nothing of the project is imported.
"""

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SIZES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
DTYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def pack(document: dict, binary: bytes = b"", version: int = 2) -> bytes:
    """A .glb of a table of contents and its bytes."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", version, 12 + len(body)) + body


def unpack(path: Path) -> tuple[dict, bytes]:
    raw = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", raw)
    assert (magic, version, length) == (b"glTF", 2, len(raw)) and length % 4 == 0
    size, kind = struct.unpack_from("<I4s", raw, 12)
    assert kind == b"JSON"
    binary_size, kind = struct.unpack_from("<I4s", raw, 20 + size)
    assert kind == b"BIN\0" and 28 + size + binary_size == length
    return json.loads(raw[20 : 20 + size]), raw[28 + size :]


@dataclass
class Builder:
    """Collects arrays for :func:`pack`."""

    data: bytearray = field(default_factory=bytearray)
    views: list = field(default_factory=list)
    accessors: list = field(default_factory=list)

    def add(self, values, kind: str = "SCALAR", component: int = 5126, **more) -> int:
        array = np.ascontiguousarray(np.asarray(values, DTYPES[component]))
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes})
        self.data += array.tobytes()
        accessor = {"bufferView": len(self.views) - 1, "componentType": component, "type": kind, **more}
        self.accessors.append(accessor | {"count": array.size // SIZES[kind]})
        return len(self.accessors) - 1

    def document(self, **more) -> dict:
        buffers = {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.data)}]}
        return {"asset": {"version": "2.0"}, **buffers, **more}

    def glb(self, **more) -> bytes:
        return pack(self.document(**more), bytes(self.data))


class Judge:
    """Poses a file's mesh from the file alone."""

    def __init__(self, path: Path):
        self.document, self.binary = unpack(path)
        self.nodes = self.document["nodes"]
        self.above = {child: index for index, node in enumerate(self.nodes) for child in node.get("children", [])}

    def array(self, index: int) -> np.ndarray:
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        width = SIZES[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        flat = np.frombuffer(self.binary, DTYPES[accessor["componentType"]], accessor["count"] * width, start)
        return flat.reshape(accessor["count"], width)

    def animation(self, number: int) -> dict[tuple[int, str], tuple[np.ndarray, np.ndarray]]:
        """(times, values) by node and path."""
        animation = self.document["animations"][number]
        found = {}
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            key = channel["target"]["node"], channel["target"]["path"]
            found[key] = self.array(sampler["input"])[:, 0], self.array(sampler["output"])
        return found

    def world(self, node: int, animation: dict, frame: int) -> np.ndarray:
        """[4 4] node to world at a key frame."""
        spec, local = self.nodes[node], np.eye(4)
        x, y, z, w = spec.get("rotation", (0, 0, 0, 1))
        place = spec.get("translation", (0, 0, 0))
        if (node, "rotation") in animation:
            x, y, z, w = animation[node, "rotation"][1][frame].astype(np.float64)
        if (node, "translation") in animation:
            place = animation[node, "translation"][1][frame]
        local[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        local[:3, 3] = place
        return self.world(self.above[node], animation, frame) @ local if node in self.above else local

    def posed(self, number: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Joints [J 3] and skinned vertices [V 3] in the world."""
        animation, skin = self.animation(number), self.document["skins"][0]
        attributes = self.document["meshes"][0]["primitives"][0]["attributes"]
        world = np.stack([self.world(joint, animation, frame) for joint in skin["joints"]])
        inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
        joints, weights = self.array(attributes["JOINTS_0"]), self.array(attributes["WEIGHTS_0"]).astype(np.float64)
        blended = np.einsum("vk,vkij->vij", weights, (world @ inverse)[joints])
        points = np.c_[self.array(attributes["POSITION"]), np.ones(len(weights))]
        return world[:, :3, 3], np.einsum("vij,vj->vi", blended, points)[:, :3]
