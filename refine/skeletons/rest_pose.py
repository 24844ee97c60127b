"""How a skeleton stands: which way is up and ahead, and whether its zero pose is a pose of a body.

What a body is told by is its joints: two hips, knees, ankles, shoulders, elbows and wrists. The trunk runs from between
the hips to between the shoulders, left is where the left ones are, forward is across both. Arrays of poses are
[... J 3] world joints and [... J 3 3] world rotations in the file's axes; ``joints`` maps SMPL's names to indices.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh, world
from refine.skeletons.known import SIDES

Joints = Mapping[str, int]

AXES = {
    f"{sign}{axis}": tuple((-1.0 if sign else 1.0) * (axis == other) for other in "xyz")
    for axis in "xyz"
    for sign in ("", "-")
}
# From an axis that points up to y up; forward stays forward where z-up files have it along -y.
TO_Y_UP = {
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "x": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "-x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
}
UPWARDS = ("y", "z", "-y", "-z")  # the axes of world that files have up
# The cosine by which a pose may differ from one that stands straight and still be taken for a rest pose.
STANDS = 0.7
BENT = 15.0  # degrees from which a knee or an elbow shows its hinge


class Poses(NamedTuple):
    """[T J 3] world joints and [T J 3 3] world rotations."""

    points: Tensor
    turns: Tensor

    def take(self, frames: Tensor) -> "Poses":
        return Poses(self.points[frames], self.turns[frames])


def moving(bvh: Bvh) -> Poses:
    """The poses of the motion."""
    return Poses(*world(bvh))


def zero_pose(bvh: Bvh) -> Poses:
    """The pose [1 J] in which no joint is turned; bones as long as in the motion."""
    points: list[Tensor] = []
    for bone, parent in zip(bvh.positions.mean(dim=0), bvh.parents, strict=True):
        points.append(points[parent] + bone if parent >= 0 else torch.zeros_like(bone))
    return Poses(torch.stack(points)[None], torch.eye(3, dtype=bvh.rotations.dtype).repeat(1, len(points), 1, 1))


def trunk(points: Tensor, joints: Joints) -> Tensor:
    """[... 3] unit vectors from between the hips to between the shoulders."""
    return normalize(_middle(points, joints, "shoulder") - _middle(points, joints, "hip"), dim=-1)


def across(points: Tensor, joints: Joints, joint: str) -> Tensor:
    """[... 3] unit vectors from the right one to the left one."""
    return normalize(points[..., joints[f"left_{joint}"], :] - points[..., joints[f"right_{joint}"], :], dim=-1)


def bone(points: Tensor, joints: Joints, start: str, end: str) -> Tensor:
    """[... 3] unit vectors."""
    return normalize(points[..., joints[end], :] - points[..., joints[start], :], dim=-1)


def standing(points: Tensor, joints: Joints) -> Tensor:
    """[...] how straight a pose stands, 1 at best: the least of the cosines between legs and trunk, and of left hip to
    right hip with left shoulder to right shoulder, less what these lean."""
    up, hips, shoulders = trunk(points, joints), across(points, joints, "hip"), across(points, joints, "shoulder")
    legs = [
        -(bone(points, joints, f"{side}_{start}", f"{side}_{end}") * up).sum(-1)
        for side in SIDES
        for start, end in (("hip", "knee"), ("knee", "ankle"))
    ]
    level = [1 - (line * up).sum(-1).abs() for line in (hips, shoulders)]
    return torch.stack([*legs, *level, (hips * shoulders).sum(-1)]).amin(dim=0)


def body_up(points: Tensor, joints: Joints) -> Tensor:
    """[... 3] unit vectors from the ankles to the shoulders."""
    return normalize(_middle(points, joints, "shoulder") - _middle(points, joints, "ankle"), dim=-1)


def forward(points: Tensor, joints: Joints) -> Tensor:
    """[... 3] unit vectors ahead, across the trunk."""
    left = normalize(across(points, joints, "hip") + across(points, joints, "shoulder"), dim=-1)
    return normalize(torch.linalg.cross(left, trunk(points, joints)), dim=-1)


def axis_of(vector: Tensor) -> str:
    """The axis nearest to a vector [3]."""
    return max(AXES, key=lambda name: float(vector @ vector.new_tensor(AXES[name])))


def up_axis(motion: Poses, joints: Joints, told: str | None) -> str:
    """The axis that is up in the motion.

    Args:
        told: the axis along which the rest pose stands, if there is one. Only a motion that stands along another, and
            never along that one, overrules it: then its root carries the turn. Who lies seldom does so along an axis.
    """
    ups, straight = body_up(motion.points, joints), standing(motion.points, joints) > STANDS
    shares = {name: ((ups @ ups.new_tensor(AXES[name]) > 0.9) & straight).double().mean().item() for name in UPWARDS}
    best = max(UPWARDS, key=lambda name: shares[name])
    if told is None:
        mean = ups.mean(dim=0)
        nearest = axis_of(mean)
        leans = nearest in UPWARDS and mean @ mean.new_tensor(AXES[nearest]) > STANDS
        return best if shares[best] > 0 else nearest if leans else "y"
    if shares[best] > 0.5 and shares.get(told, 0) == 0:
        mean = normalize(ups[straight].mean(dim=0), dim=0)
        return best if mean @ mean.new_tensor(AXES[best]) > 0.97 else told
    return told


def toes_ahead(bvh: Bvh, motion: Poses, joints: Joints) -> float | None:
    """The median over the frames of how far toes point ahead, 1 straight ahead, -1 backwards; None without toes.

    Bones that hang straight down do not count.
    """
    ahead, down = forward(motion.points, joints), -trunk(motion.points, joints)
    found = []
    for side in SIDES:
        tip = tip_of(bvh, motion, joints, f"{side}_ankle")
        if tip is not None:
            flat = tip - (tip * down).sum(-1, keepdim=True) * down
            found.append((flat * ahead).sum(-1)[flat.norm(dim=-1) > 0.3])
    values = torch.cat(found) if found else torch.empty(0)
    return values.median().item() if len(values) else None


def knees_ahead(motion: Poses, joints: Joints) -> float | None:
    """The mean of how far bent knees point ahead, -1 where left and right are exchanged; None if none bends."""
    found = []
    for side in SIDES:
        thigh = bone(motion.points, joints, f"{side}_hip", f"{side}_knee")
        shank = bone(motion.points, joints, f"{side}_knee", f"{side}_ankle")
        aside = shank - (shank * thigh).sum(-1, keepdim=True) * thigh
        bent = (thigh * shank).sum(-1) < math.cos(math.radians(BENT))
        found.append(-(normalize(aside, dim=-1) * forward(motion.points, joints)).sum(-1)[bent])
    values = torch.cat(found)
    return values.mean().item() if len(values) else None


def tip_of(bvh: Bvh, poses: Poses, joints: Joints, name: str) -> Tensor | None:
    """[T 3] unit vectors from an ankle to the toes or from a wrist to the hand: its children but thumbs, or its end."""
    index, target = joints[name], joints.get(name.replace("ankle", "foot").replace("wrist", "hand"))
    if target is not None and target != index:
        return normalize(poses.points[:, target] - poses.points[:, index], dim=-1)
    tips = [
        bvh.positions[:, child].mean(dim=0) for child in children(bvh, index) if "thumb" not in bvh.names[child].lower()
    ]
    tips += [torch.tensor(offset, dtype=poses.points.dtype) for joint, offset in bvh.ends if joint == index]
    tips = [tip for tip in tips if tip.norm() > 1e-4]
    return normalize(poses.turns[:, index] @ torch.stack(tips).mean(dim=0), dim=-1) if tips else None


def children(bvh: Bvh, joint: int) -> list[int]:
    return [child for child, parent in enumerate(bvh.parents) if parent == joint]


def _middle(points: Tensor, joints: Joints, joint: str) -> Tensor:
    return (points[..., joints[f"left_{joint}"], :] + points[..., joints[f"right_{joint}"], :]) / 2
