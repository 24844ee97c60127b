"""Binary glTF 2.0 out: body, skin, skeleton and animations in one file that any viewer, engine or Blender opens.

The frame of glTF is the one used inside: right-handed, y up, metres, a figure faces +z. The file is one scene of two
roots, the pelvis with its 23 descendants and the mesh. All primitives, one for each drawn part with a material of its
own, share the vertices of the body, so vertex k of the file is vertex k of the body. Each motion is one animation, a
take, with its rotations as quaternions and the path of the pelvis. What glTF has no field for stands in the ``extras``
of the animation: ``fps``, ``label``, and ``gender`` and ``betas`` of who performed it.

glTF promises four joints a vertex, and more are seldom drawn, so of more the four heaviest are kept: a vertex of the
free body then lies 0.03 mm off in the mean, and at an armpit up to 5 mm (light) or 11 mm (full). Pose correctives,
which an SMPL file may have and the free body has not, cannot be told in a file of this kind; they are left out.

The file is packed here, by ``struct`` and ``json``, as its layout is two chunks and a table of contents.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.gltf import BINARY_CHUNK, JSON_CHUNK, MAGIC, VERSION
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.outputs import replacing
from renderers.palette import PARTS, rgb
from renderers.rotations import continuous, matrix_to_quaternion
from renderers.shade import vertex_normals
from renderers.skeleton import DRAWN_PART_NAMES, JOINT_NAMES, PARENTS

INFLUENCES = 4
GENERATOR = "Refine"
FLOAT, BYTE, SHORT, INT = 5126, 5121, 5123, 5125  # glTF's names for float32, uint8, uint16, uint32
COMPONENTS = {np.dtype("<f4"): FLOAT, np.dtype("u1"): BYTE, np.dtype("<u2"): SHORT, np.dtype("<u4"): INT}
ARRAYS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963  # what a graphics card will use a view for


def write_glb(path: str | Path, motions: Motion | Sequence[Motion], body: Body) -> None:
    """Write motions of a body, each as a take that is named by its label; a second of a name is numbered.

    Raises:
        UserError: there is no motion, or the file cannot be written.
    """
    packed = glb_bytes([motions] if isinstance(motions, Motion) else motions, body)
    with replacing(path) as partial:
        partial.write_bytes(packed)


def glb_bytes(motions: Sequence[Motion], body: Body) -> bytes:
    """The file's bytes, see :func:`write_glb`."""
    if not motions:
        raise UserError("write_glb(motions)", "there is no motion to write", "give at least one")
    rest = body.rest_joints.detach().cpu().double()
    binary = _Binary()
    document = {
        "asset": {"version": "2.0", "generator": GENERATOR},
        "scene": 0,
        "scenes": [{"nodes": [0, len(JOINT_NAMES)]}],
        "nodes": [*_joints(rest), {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "body", "primitives": _primitives(body, binary)}],
        "materials": [_material(name, colour) for name, colour in zip(DRAWN_PART_NAMES, PARTS, strict=True)],
        "skins": [_skin(rest, binary)],
        "animations": [_animation(motion, name, binary) for motion, name in zip(motions, _takes(motions), strict=True)],
    }
    document |= {
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": len(binary.data)}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    chunks = _chunk(JSON_CHUNK, text, b" ") + _chunk(BINARY_CHUNK, bytes(binary.data), b"\0")
    return struct.pack("<4sII", MAGIC, VERSION, 12 + len(chunks)) + chunks


def heaviest(weights: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """The four heaviest of the joints that move each vertex, from skinning weights [V 24].

    Returns:
        joints [V 4] uint8, joint 0 where the weight is zero, and weights [V 4] float32, each row with sum 1.
    """
    share, joints = weights.detach().cpu().double().topk(INFLUENCES, dim=1)
    share = (share / share.sum(dim=1, keepdim=True)).numpy().astype("<f4")
    return np.where(share > 0, joints.numpy(), 0).astype("u1"), share


@dataclass
class _Binary:
    """The binary chunk while it is filled, and its table of contents: a view and an accessor for every array."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict] = field(default_factory=list)
    accessors: list[dict] = field(default_factory=list)

    def add(self, array: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """Put in an array [N] or [N k] of a type of ``COMPONENTS``; returns the number of its accessor."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.views.append(view | ({} if target is None else {"target": target}))
        self.data.extend(np.ascontiguousarray(array).tobytes())
        flat = array.reshape(len(array), -1)
        kind = {"componentType": COMPONENTS[array.dtype], "count": len(array), "type": ARRAYS[flat.shape[1]]}
        limits = {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()} if bounds else {}
        self.accessors.append({"bufferView": len(self.views) - 1, **kind, **limits})
        return len(self.accessors) - 1


def _chunk(kind: bytes, data: bytes, filler: bytes) -> bytes:
    data += filler * (-len(data) % 4)
    return struct.pack("<I4s", len(data), kind) + data


def _joints(rest: Tensor) -> list[dict]:
    nodes = []
    for joint, (name, parent) in enumerate(zip(JOINT_NAMES, PARENTS, strict=True)):
        offset = rest[joint] - rest[parent] if parent >= 0 else rest[joint]
        children = [child for child, owner in enumerate(PARENTS) if owner == joint]
        nodes.append({"name": name, "translation": offset.tolist(), **({"children": children} if children else {})})
    return nodes


def _primitives(body: Body, binary: _Binary) -> list[dict]:
    """One for each drawn part that has faces, all on the same vertices."""
    vertices, faces = body.rest_vertices.detach().cpu().float(), body.faces.cpu()
    normals = vertex_normals(vertices[None], faces)[0]
    normals[normals.norm(dim=-1) < 0.5] = torch.tensor([0.0, 1.0, 0.0])  # of a vertex that is in no face
    joints, weights = heaviest(body.weights)
    attributes = {
        "POSITION": binary.add(vertices.numpy(), VERTICES, bounds=True),
        "NORMAL": binary.add(normals.numpy(), VERTICES),
        "JOINTS_0": binary.add(joints, VERTICES),
        "WEIGHTS_0": binary.add(weights, VERTICES),
    }
    kind = "<u2" if len(vertices) < 2**16 - 1 else "<u4"
    parts = [(part, faces[body.face_parts.cpu() == part]) for part in range(len(DRAWN_PART_NAMES))]
    return [
        {
            "attributes": attributes,
            "indices": binary.add(triangles.flatten().numpy().astype(kind), INDICES),
            "material": part,
        }
        for part, triangles in parts
        if len(triangles)
    ]


def _material(name: str, colour: str) -> dict:
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in rgb(colour)]
    look = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return {"name": name, "pbrMetallicRoughness": look}


def _skin(rest: Tensor, binary: _Binary) -> dict:
    inverse = torch.eye(4).repeat(len(rest), 1, 1)
    inverse[:, :3, 3] = -rest.float()
    by_columns = inverse.mT.reshape(len(rest), 16).numpy()
    joints = list(range(len(rest)))
    return {"name": "skeleton", "skeleton": 0, "joints": joints, "inverseBindMatrices": binary.add(by_columns)}


def _takes(motions: Sequence[Motion]) -> list[str]:
    names: list[str] = []
    for motion in motions:
        name, number = motion.label or "motion", 1
        while name in names:
            number += 1
            name = f"{motion.label or 'motion'} {number}"
        names.append(name)
    return names


def _animation(motion: Motion, name: str, binary: _Binary) -> dict:
    times = (np.arange(len(motion)) / motion.fps).astype("<f4")
    quaternions = continuous(matrix_to_quaternion(motion.rotations.detach().cpu().double()))
    quaternions = quaternions.roll(-1, dims=-1).float().numpy()  # glTF has x, y, z, w
    clock = binary.add(times, bounds=True)
    outputs = [("rotation", joint, quaternions[:, joint]) for joint in range(len(JOINT_NAMES))]
    outputs.append(("translation", 0, motion.root.detach().cpu().float().numpy()))
    extras = {"fps": motion.fps, "label": motion.label, "gender": motion.gender}
    if motion.betas is not None:
        extras["betas"] = motion.betas.tolist()
    return {
        "name": name,
        "samplers": [{"input": clock, "output": binary.add(values)} for _, _, values in outputs],
        "channels": [
            {"sampler": sampler, "target": {"node": node, "path": path}}
            for sampler, (path, node, _) in enumerate(outputs)
        ],
        "extras": extras,
    }
