"""Small meshes for the renderer's tests: world vertices [V 3] in metres (y up), and faces [F 3]."""

from math import pi

import torch
from torch import Tensor

LIMBS = {  # start, end, radius: a figure of six capsules that overlap at the joints, as large as a person
    "torso": ((0.0, 0.85, 0.0), (0.0, 1.35, 0.0), 0.15),
    "head": ((0.0, 1.5, 0.0), (0.0, 1.6, 0.0), 0.1),
    "left_arm": ((0.15, 1.35, 0.0), (0.75, 1.35, 0.0), 0.05),
    "right_arm": ((-0.15, 1.35, 0.0), (-0.75, 1.35, 0.0), 0.05),
    "left_leg": ((0.1, 0.85, 0.0), (0.12, 0.08, 0.0), 0.08),
    "right_leg": ((-0.1, 0.85, 0.0), (-0.12, 0.08, 0.0), 0.08),
}


def sphere(rings: int = 6, segments: int = 8) -> tuple[Tensor, Tensor]:
    """A closed unit sphere with outward faces."""
    polar = torch.arange(1, rings, dtype=torch.float64)[:, None] * pi / rings
    around = torch.arange(segments, dtype=torch.float64) * 2 * pi / segments
    body = torch.stack(
        [polar.sin() * around.sin(), polar.cos().expand(-1, segments), polar.sin() * around.cos()], dim=-1
    )
    poles = torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], dtype=torch.float64)
    here = torch.arange((rings - 1) * segments).view(rings - 1, segments)
    beside = here.roll(-1, dims=1)
    north, south = torch.full_like(here[0], here.numel()), torch.full_like(here[0], here.numel() + 1)
    faces = [
        torch.stack([here[:-1], here[1:], beside[1:]], dim=-1).reshape(-1, 3),
        torch.stack([here[:-1], beside[1:], beside[:-1]], dim=-1).reshape(-1, 3),
        torch.stack([north, here[0], beside[0]], dim=-1),
        torch.stack([south, beside[-1], here[-1]], dim=-1),
    ]
    return torch.cat([body.reshape(-1, 3), poles]), torch.cat(faces)


def capsule(start, end, radius: float, rings: int, segments: int) -> tuple[Tensor, Tensor]:
    """A closed capsule from a sphere cut in half, its axis from ``start`` to ``end``."""
    vertices, faces = sphere(rings, segments)
    start, end = torch.tensor(start, dtype=torch.float64), torch.tensor(end, dtype=torch.float64)
    up = (end - start) / (end - start).norm()
    side = torch.linalg.cross(up, torch.eye(3, dtype=torch.float64)[up.abs().argmin()])
    side = side / side.norm()
    axes = torch.stack([side, up, torch.linalg.cross(side, up)])
    return torch.where(vertices[:, 1:2] > 0, end, start) + radius * vertices @ axes, faces


def figure(rings: int = 12, segments: int = 14) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices, faces and parts [F] of a figure of six closed capsules."""
    vertices, faces, parts, count = [], [], [], 0
    for part, (start, end, radius) in enumerate(LIMBS.values()):
        limb, limb_faces = capsule(start, end, radius, rings, segments)
        vertices.append(limb)
        faces.append(limb_faces + count)
        parts.append(torch.full((len(limb_faces),), part))
        count += len(limb)
    return torch.cat(vertices), torch.cat(faces), torch.cat(parts)


def swing(vertices: Tensor, angles: Tensor) -> Tensor:
    """The `figure` with each limb turned about the z axis at its start: angles [N 6] in radians -> [N V 3]."""
    limbs = vertices.view(len(LIMBS), -1, 3)
    start = torch.tensor([limb[0] for limb in LIMBS.values()], dtype=vertices.dtype)[:, None]
    cos, sin, zero = angles.cos(), angles.sin(), torch.zeros_like(angles)
    turn = torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], dim=-1).unflatten(-1, (3, 3))
    return (start + (limbs - start) @ turn.mT).flatten(1, 2)
