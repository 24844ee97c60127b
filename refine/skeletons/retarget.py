"""Any skeleton to SMPL's 24 joints, by joint frames.

The zero pose of a file need not be a T-pose: in Bandai-Namco's every bone lies along its own local x axis. So a joint's
rotation is never copied. For each joint it is known (``skeletons``) or found (``mapping``) which of its local axes
point up and forward when the body stands in SMPL's T-pose; from that follows one constant rotation between the two
frames, and the SMPL joint turns in the world as the source joint does. Upper arms, forearms, thighs and shanks are
aligned by the bone itself, so they point exactly where the source's point, and their twist is the source's twist. Feet
are aligned by their soles, which therefore lie flat when the source's do, though ankles may differ in height.
"""

from dataclasses import replace

import torch
from torch import Tensor

from refine.formats.bvh import Bvh, world
from refine.motion import Motion
from refine.skeletons.joint_axes import frame_of
from refine.skeletons.known import LIMBS, Skeleton, Y, Z
from refine.skeletons.mapping import Mapping, mapping_of, skeleton_of
from refine.skeletons.rest_pose import TO_Y_UP
from renderers.checks import UserError, check_shapes
from renderers.rotations import slerp
from renderers.skeleton import JOINT_NAMES, JOINTS, PARENTS, forward_kinematics

SOLES = tuple(JOINTS[f"{side}_{joint}"] for side in ("left", "right") for joint in ("ankle", "foot"))
# A sole slower than this (metres a second) carries weight.
PLANTED_SPEED = 0.15


def retarget(bvh: Bvh, rest_joints: Tensor, skeleton: Skeleton | Mapping | None = None, label: str = "") -> Motion:
    """Put a file's motion on a body with the T-pose joints [24 3] in metres.

    The path is scaled by the ratio of the leg lengths, and the floor moved under the soles if the skeleton asks for it.

    Args:
        skeleton: the frames of its joints, or which joint is which; without it that is found, see ``mapping_of``.

    Raises:
        UserError: the file's skeleton is no body, has a limb of length zero, or is not the mapping's.
    """
    check_shapes("retarget", rest_joints=(rest_joints, "24 3"))
    rest = rest_joints.detach().to("cpu", torch.float64)
    skeleton = skeleton or mapping_of(bvh)
    if isinstance(skeleton, Mapping):
        skeleton = skeleton_of(bvh, skeleton, rest)
    source = {name: bvh.names.index(place.joint) for name, place in skeleton.places.items()}
    joints, rotations = world(y_up(bvh, skeleton.up))
    bones = {name: _bone(bvh, joints, rotations, source[name], source[end]) for name, end in LIMBS.items()}
    alignments = _alignments(bones, skeleton, rest)
    turned = _complete({name: rotations[:, source[name]] @ alignments[name] for name in source}, skeleton)
    hips = (joints[:, source["left_hip"]] + joints[:, source["right_hip"]]) / 2
    middle = (rest[JOINTS["left_hip"]] + rest[JOINTS["right_hip"]]) / 2 - rest[0]
    root = hips * _leg_ratio(bones, rest) - (turned[:, 0] @ middle)
    local = turned.clone()
    local[:, 1:] = turned[:, list(PARENTS[1:])].mT @ turned[:, 1:]
    if skeleton.grounded:
        root[:, 1] -= _floor(forward_kinematics(local, root, rest)[0], rest, bvh.fps)
    return Motion(local.float(), root.float(), bvh.fps, label, bvh.source)


def y_up(bvh: Bvh, up: str) -> Bvh:
    """The file with its root turned so that the axis ``up``, a key of ``rest_pose.AXES``, points along y."""
    if up == "y":
        return bvh
    turn = torch.tensor(TO_Y_UP[up], dtype=bvh.rotations.dtype)
    rotations, positions = bvh.rotations.clone(), bvh.positions.clone()
    rotations[:, 0], positions[:, 0] = turn @ rotations[:, 0], positions[:, 0] @ turn.mT
    return replace(bvh, rotations=rotations, positions=positions)


def _alignments(bones: dict[str, Tensor], skeleton: Skeleton, rest: Tensor) -> dict[str, Tensor]:
    """For each placed joint the rotation [3 3], of limbs [T 3 3], from T-pose world axes to the source's local ones."""
    alignments = {}
    for name, place in skeleton.places.items():
        theirs, ours = torch.tensor(place.up, dtype=rest.dtype), torch.tensor(Y, dtype=rest.dtype)
        if name in LIMBS:
            theirs, ours = bones[name], rest[JOINTS[LIMBS[name]]] - rest[JOINTS[name]]
        forward = torch.tensor(place.forward, dtype=rest.dtype)
        alignments[name] = frame_of(theirs, forward) @ frame_of(ours, torch.tensor(Z, dtype=rest.dtype)).mT
    return alignments


def _bone(bvh: Bvh, joints: Tensor, rotations: Tensor, start: int, end: int) -> Tensor:
    """[T 3] from a joint to one below in the first one's frame: what the motion says, for it overrides OFFSET."""
    bone = (rotations[:, start].mT @ (joints[:, end] - joints[:, start])[..., None])[..., 0]
    if bone.norm(dim=-1).min() < 1e-6:
        raise UserError(
            bvh.source, f"the bone that ends in {bvh.names[end]} has no length", "export the skeleton with its offsets"
        )
    return bone


def _complete(turned: dict[str, Tensor], skeleton: Skeleton) -> Tensor:
    """World rotations [T 24 3 3], the joints that the source lacks filled in."""
    for name, (before, after, share) in skeleton.between.items():
        weight = turned[before].new_full(turned[before].shape[:1], share)
        turned[name] = slerp(turned[before], turned[after], weight)
    for name, parent in zip(JOINT_NAMES, PARENTS, strict=True):
        if name not in turned:
            turned[name] = turned[JOINT_NAMES[parent]]
    return torch.stack([turned[name] for name in JOINT_NAMES], dim=1)


def _leg_ratio(bones: dict[str, Tensor], rest: Tensor) -> float:
    legs = [(start, end) for start, end in LIMBS.items() if start.endswith(("hip", "knee"))]
    ours = sum((rest[JOINTS[end]] - rest[JOINTS[start]]).norm().item() for start, end in legs)
    return ours / sum(bones[start].norm(dim=-1).mean().item() for start, _ in legs)


def _floor(joints: Tensor, rest: Tensor, fps: float) -> Tensor:
    """Height of the floor under the soles: the median over the frames in which the lowest sole is planted."""
    soles = joints[:, list(SOLES)]
    height, lowest = (soles[..., 1] - rest[list(SOLES), 1]).min(dim=1)
    if len(height) == 1:
        return height[0]
    speed = soles.diff(dim=0).norm(dim=-1).gather(1, lowest[1:, None])[:, 0] * fps
    planted = height[1:][speed < PLANTED_SPEED]
    return planted.median() if len(planted) else height.quantile(0.1)
