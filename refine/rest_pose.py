"""How a skeleton stands: which way is up, whether its zero pose is a pose, and where its joints' axes point.

What a body is told by is its joints: two hips, knees, ankles, shoulders, elbows and wrists. The trunk runs from between
the hips to between the shoulders, left is where the left ones are, forward is across both. Arrays of poses are
[... J 3] world joints and [... J 3 3] world rotations in the file's axes; ``joints`` maps SMPL's names to indices.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh, world
from refine.skeletons import LIMBS, SIDES, Place, Y, Z
from renderers.skeleton import JOINTS

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
# Frames that stand nearly as straight as the straightest.
NEARLY = 0.01
BENT = 15.0  # degrees from which a knee or an elbow shows its hinge
AGREED = 0.7  # how far the frames must agree on it
ALONG = 0.985  # the cosine from which a bone lies along an axis of its joint
ALIGNED = 13.0  # degrees by which the joints of such a rig seem to be off their axes, at the median
SNAP = 50.0  # degrees within which an axis of a joint is taken for the one that is meant
TRUNK_SNAP = 20.0  # and in the spine, which stands straighter than limbs do
FAR = 75.0  # degrees up to which it is taken for that of the joint before
SAME_AXES = (("hip", "knee"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"))
SPINE = ("pelvis", "spine1", "spine2", "spine3")
TRUNK = (*SPINE, "neck", "head", "left_collar", "right_collar")


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


def places(bvh: Bvh, joints: Joints, poses: Poses, up: str, is_rest: bool, ours: Tensor) -> dict[str, Place]:
    """Where the axes of SMPL's T-pose lie in the frame of each joint.

    Args:
        joints: SMPL joint -> index in the file.
        poses: the rest pose, or the whole motion where there is none.
        up: the axis that is up in these poses.
        is_rest: whether they are the rest pose: trunk and feet stand as in the T-pose then. Otherwise they are looked
            at in the straightest frames, the limbs where they bend, the feet where they are lowest, and axes that lie
            near those of the joint are taken for them.
        ours: [24 3] joints of the T-pose.
    """
    rest = {name: ours[JOINTS[name]] for name in JOINTS}
    straight = standing(poses.points, joints)
    chosen = poses.take(straight >= straight.max() - NEARLY)
    frames = _trunk_frames(chosen, joints, up, is_rest, rest)
    frames |= _limb_frames(bvh, chosen, joints, frames, rest)
    local = {name: _mean(chosen.turns[:, joints[name]].mT @ frame) for name, frame in frames.items() if name in joints}
    if not is_rest:
        local |= _hinges(poses, joints, rest)
        local = _snapped(bvh, joints, local, rest)
    local |= _feet(bvh, chosen if is_rest else poses, joints, up, is_rest, rest)
    return {
        name: Place(bvh.names[joints[name]], tuple(turn[:, 1].tolist()), tuple(turn[:, 2].tolist()))
        for name, turn in local.items()
    }


def _trunk_frames(poses: Poses, joints: Joints, up: str, is_rest: bool, rest: dict[str, Tensor]) -> dict[str, Tensor]:
    """SMPL's T-pose axes in the world, [T 3 3] columns left, up, forward, for the joints of the trunk."""
    if is_rest:
        vertical = poses.points.new_tensor(AXES[up])
        left = normalize(across(poses.points, joints, "hip") + across(poses.points, joints, "shoulder"), dim=-1)
        ahead = torch.linalg.cross(left, vertical.expand_as(left))
        nearest = ahead.new_tensor(AXES[axis_of(normalize(ahead.mean(dim=0), dim=0))])
        ahead = nearest.expand_as(ahead) if ahead[0] @ nearest > 0.97 else normalize(ahead, dim=-1)
        frame = torch.stack(
            [torch.linalg.cross(vertical.expand_as(ahead), ahead), vertical.expand_as(ahead), ahead], -1
        )
        return dict.fromkeys(TRUNK, frame)
    frames = {}
    for part, joint in (("hips", "hip"), ("shoulders", "shoulder")):
        theirs = frame_of(trunk(poses.points, joints), across(poses.points, joints, joint))
        middle = (rest["left_shoulder"] + rest["right_shoulder"] - rest["left_hip"] - rest["right_hip"]) / 2
        frames[part] = theirs @ frame_of(middle, rest[f"left_{joint}"] - rest[f"right_{joint}"]).mT
    return {name: frames["hips" if name in ("pelvis", "spine1") else "shoulders"] for name in TRUNK}


def _limb_frames(
    bvh: Bvh, poses: Poses, joints: Joints, frames: dict[str, Tensor], rest: dict[str, Tensor]
) -> dict[str, Tensor]:
    """T-pose axes in the world for the joints of the limbs: each turned by the least from the one before."""
    found = {}
    for side in SIDES:
        for before, chain in (("pelvis", ("hip", "knee", "ankle")), ("spine3", ("shoulder", "elbow", "wrist", "hand"))):
            frame = frames[before]
            for start, end in pairwise(chain):
                start, end = f"{side}_{start}", f"{side}_{end}"
                theirs = (
                    tip_of(bvh, poses, joints, start)
                    if end.endswith("hand")
                    else bone(poses.points, joints, start, end)
                )
                if theirs is not None:
                    turned = _swing(frame @ normalize(rest[end] - rest[start], dim=0), theirs) @ frame
                    # A hand far off its forearm is no rest pose, and its children are not its fingers.
                    far = end.endswith("hand") and (turned * frame).sum((-1, -2)).min() < 2.0
                    frame = frame if far else turned
                found[start] = frame
        found[f"{side}_hand"] = found[f"{side}_wrist"]
    return found


def _hinges(poses: Poses, joints: Joints, rest: dict[str, Tensor]) -> dict[str, Tensor]:
    """Local T-pose axes [3 3] of the limbs that bend: knees backwards and elbows forward."""
    found = {}
    for side in SIDES:
        for upper, lower, end, sign in (("hip", "knee", "ankle", -1.0), ("shoulder", "elbow", "wrist", 1.0)):
            upper, lower, end = (f"{side}_{joint}" for joint in (upper, lower, end))
            first, second = bone(poses.points, joints, upper, lower), bone(poses.points, joints, lower, end)
            bend = torch.linalg.cross(first, second)  # the longer, the more it says
            if bend.norm(dim=-1).max() < math.sin(math.radians(BENT)):
                continue
            for joint, along, far in ((upper, first, lower), (lower, second, end)):
                turns, ours = poses.turns[:, joints[joint]], rest[far] - rest[joint]
                aheads = (turns.mT @ torch.linalg.cross(sign * bend, along)[..., None])[..., 0]
                if aheads.sum(dim=0).norm() < AGREED * aheads.norm(dim=-1).sum():
                    continue
                bone_there = (turns.mT @ along[..., None])[..., 0].mean(dim=0)
                found[joint] = frame_of(bone_there, aheads.sum(dim=0)) @ frame_of(ours, ours.new_tensor(Z)).mT
    return found


def _feet(bvh: Bvh, poses: Poses, joints: Joints, up: str, is_rest: bool, rest: dict[str, Tensor]) -> dict[str, Tensor]:
    """Local T-pose axes [3 3] of ankles and toes: soles flat in the rest pose, or where ankle and toes are lowest; feet
    turned out as theirs are."""
    vertical, found = poses.points.new_tensor(AXES[up]), {}
    for side in SIDES:
        ankle, foot = f"{side}_ankle", f"{side}_foot"
        low = poses
        if not is_rest:
            height = poses.points[:, [joints[name] for name in (ankle, foot) if name in joints]].sum(dim=1) @ vertical
            low = poses.take(height <= height.quantile(0.1))
        theirs, ahead = tip_of(bvh, low, joints, ankle), forward(low.points, joints)
        ours = (rest[foot] - rest[ankle]) * rest[foot].new_tensor([1.0, 0.0, 1.0])
        if theirs is None or ((theirs @ vertical).abs() > 0.95).any() or (theirs * ahead).sum(-1).median() < 0.3:
            theirs, ours = ahead, ours.new_tensor(Z)
        frame = frame_of(vertical.expand_as(theirs), theirs) @ frame_of(ours.new_tensor(Y), ours).mT
        for name in (ankle, foot):
            if name in joints:
                found[name] = _mean(low.turns[:, joints[name]].mT @ frame)
    return found


def _middle(points: Tensor, joints: Joints, joint: str) -> Tensor:
    return (points[..., joints[f"left_{joint}"], :] + points[..., joints[f"right_{joint}"], :]) / 2


def frame_of(first: Tensor, second: Tensor) -> Tensor:
    """[... 3 3] right-handed columns: ``first``, the part of ``second`` across it, their cross product."""
    first = normalize(first, dim=-1)
    second = normalize(second - (second * first).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def _swing(start: Tensor, end: Tensor) -> Tensor:
    """[... 3 3] the least rotation from one unit vector to another; half a turn about any axis if they are opposite."""
    axis = torch.linalg.cross(start, end)
    cos = (start * end).sum(-1)[..., None, None]
    skew = torch.stack([torch.linalg.cross(axis, unit.expand_as(axis)) for unit in torch.eye(3).to(axis)], dim=-1)
    turn = torch.eye(3).to(axis) + skew + skew @ skew / (1 + cos).clamp(min=1e-9)
    other = frame_of(start, start.roll(1, dims=-1) + torch.tensor([0.3, 0.2, 0.1]).to(start))[..., 1]
    half = 2 * other[..., :, None] * other[..., None, :] - torch.eye(3).to(axis)
    return torch.where(cos < -1 + 1e-6, half, turn)


def _mean(turns: Tensor) -> Tensor:
    """The rotation [3 3] nearest to all of [T 3 3]."""
    left, _, right = torch.linalg.svd(turns.mean(dim=0))
    sign = torch.linalg.det(left @ right)
    return left @ torch.diag(torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign])) @ right


def _snapped(bvh: Bvh, joints: Joints, local: dict[str, Tensor], rest: dict[str, Tensor]) -> dict[str, Tensor]:
    """Local T-pose axes [3 3] put on the axes of the joints that they are near, in a rig whose limbs lie along axes.

    Such a rig has the same axes all along a limb, which says more than a head that is turned or a hand that is bent.
    """
    bones = {start: bvh.positions[:, joints[end]].mean(dim=0) for start, end in LIMBS.items()}
    nearest = {
        name: torch.stack([turn.new_tensor(AXES[axis_of(column)]) for column in turn.mT], dim=1)
        for name, turn in local.items()
    }
    off = [_apart(nearest[name], local[name]) for name in (*SPINE, *LIMBS) if name in local]
    along = all(normalize(bone, dim=0).abs().max() > ALONG for bone in bones.values())
    if not along or sorted(off)[len(off) // 2] > ALIGNED:
        return local
    before = {f"{side}_{after}": f"{side}_{joint}" for side in SIDES for joint, after in SAME_AXES}
    before["head"] = "neck"
    axes: dict[str, Tensor] = {}
    for name, turn in local.items():
        if before.get(name) in axes and (name.endswith(("wrist", "hand")) or _apart(axes[before[name]], turn) < FAR):
            axes[name] = axes[before[name]]
        elif "collar" not in name and _apart(nearest[name], turn) < (TRUNK_SNAP if name in SPINE else SNAP):
            axes[name] = nearest[name]
    snapped = local | axes
    for name in set(axes) & set(bones):  # the bone itself, and the axis ahead
        ours = rest[LIMBS[name]] - rest[name]
        snapped[name] = frame_of(bones[name], axes[name][:, 2]) @ frame_of(ours, ours.new_tensor(Z)).mT
    return snapped


def _apart(first: Tensor, second: Tensor) -> float:
    """Degrees between two rotations [3 3]; 180 if one of them is none."""
    if torch.linalg.det(first) < 0.5:
        return 180.0
    return torch.rad2deg(torch.acos((((first * second).sum() - 1) / 2).clamp(-1, 1))).item()
