"""Where SMPL's axes lie in the frames of a skeleton's joints: its rest pose tells, or its motion for want of one."""

import math
from itertools import pairwise

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh
from refine.skeletons.known import LIMBS, SIDES, Place, Y, Z
from refine.skeletons.rest_pose import (
    AXES,
    BENT,
    Joints,
    Poses,
    across,
    axis_of,
    bone,
    forward,
    standing,
    tip_of,
    trunk,
)
from renderers.skeleton import JOINTS

# Frames that stand nearly as straight as the straightest.
NEARLY = 0.01
AGREED = 0.7  # how far the frames must agree on it
ALONG = 0.985  # the cosine from which a bone lies along an axis of its joint
ALIGNED = 13.0  # degrees by which the joints of such a rig seem to be off their axes, at the median
SNAP = 50.0  # degrees within which an axis of a joint is taken for the one that is meant
TRUNK_SNAP = 35.0  # and in the spine, which stands straighter than limbs do
FAR = 75.0  # degrees up to which it is taken for that of the joint before
SAME_AXES = (("hip", "knee"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"))
SPINE = ("pelvis", "spine1", "spine2", "spine3")
TRUNK = (*SPINE, "neck", "head", "left_collar", "right_collar")


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
