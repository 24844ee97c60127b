"""Bodies and motions as compact arrays: one run of little-endian bytes, and JSON that says where each array lies."""

import base64
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from refine.energies import energy_signal
from refine.motion import Motion
from renderers.body import Body
from renderers.rotations import continuous, matrix_to_quaternion
from renderers.skeleton import JOINT_NAMES, PARENTS, PARTS

TYPES = {"f4": "Float32Array", "i2": "Int16Array", "u2": "Uint16Array", "u4": "Uint32Array", "u1": "Uint8Array"}
GREATEST = 32767  # of an int16
INFLUENCES = 4  # joints that a vertex follows
CALM = 0.2  # seconds over which speeds are averaged, so that bars and colours do not flicker


class Packer:
    """Collects arrays; each starts at a multiple of four bytes, as typed arrays in a browser want it."""

    def __init__(self):
        self._chunks: list[bytes] = []
        self._size = 0

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Append an array; its place, type and shape as plain JSON values."""
        kind = f"{values.dtype.kind}{values.dtype.itemsize}"
        content = np.ascontiguousarray(values).astype(f"<{kind}").tobytes()
        entry = {"at": self._size, "type": TYPES[kind], "shape": list(values.shape)}
        padded = content + bytes(-len(content) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return entry

    def base64(self) -> str:
        return base64.b64encode(b"".join(self._chunks)).decode()


def pack_body(packer: Packer, body: Body) -> dict[str, Any]:
    """The mesh at rest, which joints each vertex follows, and the tree.

    Positions are int16 in units of ``scale`` metres (0.03 mm for a grown body); of a vertex's joints the four heaviest
    count, in 255ths that sum to 255. Pose correctives of SMPL's own files are left out.
    """
    vertices = body.rest_vertices.detach().cpu().double().numpy()
    scale = float(np.abs(vertices).max()) / GREATEST
    joints, weights = heaviest(body.weights.detach().cpu().double().numpy())
    faces = body.faces.detach().cpu().numpy()
    return {
        "scale": scale,
        "positions": packer.add(np.round(vertices / scale).astype(np.int16)),
        "faces": packer.add(faces.astype(np.uint16 if len(vertices) <= 65536 else np.uint32)),
        "joints": packer.add(joints),
        "weights": packer.add(weights),
        "rest": packer.add(body.rest_joints.detach().cpu().float().numpy()),
        "parents": list(PARENTS),
        "names": list(JOINT_NAMES),
        "parts": {part: list(of_part) for part, of_part in PARTS.items()},
    }


def heaviest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Skinning weights [V 24] -> each vertex's four heaviest joints [V 4] and their weights [V 4], which sum to 255."""
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    shares = np.take_along_axis(weights, joints, axis=1)
    shares = 255 * shares / shares.sum(1, keepdims=True)
    whole = np.floor(shares).astype(np.int64)
    left_over = 255 - whole.sum(1, keepdims=True)
    rank = np.argsort(np.argsort(whole - shares, axis=1, kind="stable"), axis=1)
    return joints.astype(np.uint8), (whole + (rank < left_over)).astype(np.uint8)


def pack_motion(packer: Packer, motion: Motion, rest_joints: Tensor) -> dict[str, Any]:
    """Rotations as quaternions (w, x, y, z) in int16, the pelvis's place in float32 metres, and how fast parts move."""
    motion = motion.to("cpu", torch.float64)
    rest_joints = rest_joints.detach().cpu().double()
    quaternions = continuous(matrix_to_quaternion(motion.rotations))
    speeds = part_speeds(motion, rest_joints)
    return {
        "label": motion.label,
        "fps": motion.fps,
        "frames": len(motion),
        "seconds": (len(motion) - 1) / motion.fps,
        "quaternions": packer.add((quaternions * GREATEST).round().numpy().astype(np.int16)),
        "root": packer.add(motion.root.float().numpy()),
        "speeds": packer.add(calmed(speeds, motion.fps).float().numpy()),
        "speed": [root_mean_square(column) for column in speeds.T],
    }


def part_speeds(motion: Motion, rest_joints: Tensor) -> Tensor:
    """[T-1 5] metres a second: root mean square speed of each part's joints relative to the pelvis, between frames.

    Its mean square over a clip is Eq. 2's energy times the frame rate squared.
    """
    signal = energy_signal(motion.rotations, motion.root, rest_joints)
    squared = signal.diff(dim=0).square().sum(-1)
    return torch.stack([squared[:, list(joints)].mean(-1) for joints in PARTS.values()], dim=1).sqrt() * motion.fps


def calmed(speeds: Tensor, fps: float) -> Tensor:
    """Speeds between frames [T-1 5] -> at frames [T 5], each the root of the mean square over `CALM` seconds."""
    if not len(speeds):
        return speeds.new_zeros(1, len(PARTS))
    half = max(1, round(CALM * fps / 2))
    total = torch.cat([speeds.new_zeros(1, len(PARTS)), speeds.square().cumsum(0)])
    at = torch.arange(len(speeds) + 1)
    low, high = (at - half).clamp(min=0), (at + half).clamp(max=len(speeds))
    return ((total[high] - total[low]).clamp(min=0) / (high - low)[:, None]).sqrt()


def root_mean_square(values: Tensor) -> float:
    return math.sqrt(float(values.square().mean())) if len(values) else 0.0
