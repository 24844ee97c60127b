"""Any named skeleton to SMPL's 24 joints, by joint frames.

The zero pose of a file need not be a T-pose: in Bandai-Namco's every bone lies along its own local x axis. So a joint's
rotation is never copied. For each joint a table says which of its local axes point up and forward when the body stands
in SMPL's T-pose; from that follows one constant rotation between the two frames, and the SMPL joint turns in the world
as the source joint does. Upper arms, forearms, thighs and shanks are aligned by the bone itself, so they point exactly
where the source's point, and their twist is the source's twist. Feet are aligned by their soles, which therefore lie
flat when the source's do, though ankles may differ in height.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh, world
from refine.motion import Motion
from renderers.checks import UserError, check_shapes
from renderers.rotations import slerp
from renderers.skeleton import JOINT_NAMES, JOINTS, PARENTS, forward_kinematics

Vector = tuple[float, float, float]

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

# The bones that must point where the source's do, as SMPL joint -> the joint at the bone's far end.
LIMBS = {
    f"{side}_{joint}": f"{side}_{child}"
    for side in ("left", "right")
    for joint, child in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
}
SOLES = tuple(JOINTS[f"{side}_{joint}"] for side in ("left", "right") for joint in ("ankle", "foot"))
# A sole slower than this (metres a second) carries weight.
PLANTED_SPEED = 0.15


@dataclass(frozen=True)
class Place:
    """Where an SMPL joint is found: the source joint, and two of its local directions in SMPL's T-pose."""

    joint: str
    up: Vector
    forward: Vector


@dataclass(frozen=True)
class Skeleton:
    """A known naming of joints.

    Attributes:
        places: SMPL joint -> place in the source. A joint in neither table turns with its parent.
        between: SMPL joint -> (joint before, joint after, share): turns that share of the way between two others.
        grounded: whether the file's floor is looked for and put under SMPL's soles; otherwise heights are only scaled.
    """

    name: str
    places: Mapping[str, Place]
    between: Mapping[str, tuple[str, str, float]]
    grounded: bool


def _minus(vector: Vector) -> Vector:
    return tuple(-x for x in vector)


def _dipped(degrees: float) -> tuple[Vector, Vector]:
    """(up, forward) for a joint whose local y is left and whose local x dips this far below the horizon ahead."""
    sin, cos = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    return (-sin, 0.0, cos), (cos, 0.0, sin)


def _bandai_namco() -> Skeleton:
    """Right limbs run along -x, left ones along +x; elbows and knees bend about y.

    Measured on standing frames of all the clips: the foot dips 39.6 degrees and the toes 23 with the sole flat, and the
    shoulder blades lie 15.5 degrees behind the body's lateral axis with the arms at rest.
    """
    back = math.radians(15.5)
    ahead = (-math.sin(back), 0.0, math.cos(back))
    places = {
        "pelvis": Place("Hips", X, Z),
        "spine1": Place("Spine", X, Y),
        "spine3": Place("Chest", X, Y),
        "neck": Place("Neck", X, Y),
        "head": Place("Head", X, Y),
    }
    for side, letter, sign in (("left", "L", 1.0), ("right", "R", -1.0)):
        turned = (lambda v: v) if sign > 0 else _minus
        arm = turned(Y), turned(Z)
        places[f"{side}_collar"] = Place(f"Shoulder_{letter}", turned(Y), turned(ahead))
        for joint, source in (("shoulder", "UpperArm"), ("elbow", "LowerArm"), ("wrist", "Hand")):
            places[f"{side}_{joint}"] = Place(f"{source}_{letter}", *arm)
        for joint, source in (("hip", "UpperLeg"), ("knee", "LowerLeg")):
            places[f"{side}_{joint}"] = Place(f"{source}_{letter}", turned(_minus(X)), turned(Z))
        for joint, source, dip in (("ankle", "Foot", 39.6), ("foot", "Toes", 23.0)):
            places[f"{side}_{joint}"] = Place(f"{source}_{letter}", *map(turned, _dipped(dip)))
    return Skeleton("Bandai-Namco", places, {"spine2": ("spine1", "spine3", 0.5)}, grounded=True)


BANDAI_NAMCO = _bandai_namco()
SMPL = Skeleton("SMPL", {name: Place(name, Y, Z) for name in JOINT_NAMES}, {}, grounded=False)
SKELETONS = (BANDAI_NAMCO, SMPL)


def recognise(bvh: Bvh) -> Skeleton:
    """The first known skeleton all of whose joints the file has.

    Raises:
        UserError: there is none; the message names joints that the nearest one has and the file lacks.
    """
    present = set(bvh.names)
    missing = {known.name: {place.joint for place in known.places.values()} - present for known in SKELETONS}
    for known in SKELETONS:
        if not missing[known.name]:
            return known
    nearest = min(missing, key=lambda name: len(missing[name]))
    lacks = ", ".join(sorted(missing[nearest])[:4])
    raise UserError(
        bvh.source,
        f"its skeleton is not known: nearest is {nearest}'s, but it lacks {lacks}",
        f"rename its joints to those of {' or '.join(known.name for known in SKELETONS)}",
    )


def retarget(bvh: Bvh, rest_joints: Tensor, skeleton: Skeleton | None = None, label: str = "") -> Motion:
    """Put a file's motion on a body with the T-pose joints [24 3] in metres.

    The path is scaled by the ratio of the leg lengths, and the floor moved under the soles if the skeleton asks for it.

    Raises:
        UserError: the skeleton is not known, or has a limb of length zero.
    """
    check_shapes("retarget", rest_joints=(rest_joints, "24 3"))
    skeleton = skeleton or recognise(bvh)
    rest = rest_joints.detach().to("cpu", torch.float64)
    source = {name: bvh.names.index(place.joint) for name, place in skeleton.places.items()}
    joints, rotations = world(bvh)
    alignments = _alignments(bvh, skeleton, rest)
    turned = _complete({name: rotations[:, source[name]] @ alignments[name] for name in source}, skeleton)
    hips = (joints[:, source["left_hip"]] + joints[:, source["right_hip"]]) / 2
    middle = (rest[JOINTS["left_hip"]] + rest[JOINTS["right_hip"]]) / 2 - rest[0]
    root = hips * _leg_ratio(bvh, source, rest) - (turned[:, 0] @ middle)
    local = turned.clone()
    local[:, 1:] = turned[:, list(PARENTS[1:])].mT @ turned[:, 1:]
    if skeleton.grounded:
        root[:, 1] -= _floor(forward_kinematics(local, root, rest)[0], rest, bvh.fps)
    return Motion(local.float(), root.float(), bvh.fps, label, bvh.source)


def _alignments(bvh: Bvh, skeleton: Skeleton, rest: Tensor) -> dict[str, Tensor]:
    """For each placed joint the constant rotation [3 3] that takes T-pose world axes to the source's local axes."""
    alignments = {}
    for name, place in skeleton.places.items():
        theirs, ours = torch.tensor(place.up, dtype=rest.dtype), torch.tensor(Y, dtype=rest.dtype)
        if name in LIMBS:
            theirs = _bone(bvh, skeleton.places[LIMBS[name]].joint)
            ours = rest[JOINTS[LIMBS[name]]] - rest[JOINTS[name]]
        forward = torch.tensor(place.forward, dtype=rest.dtype)
        alignments[name] = _frame(theirs, forward) @ _frame(ours, torch.tensor(Z, dtype=rest.dtype)).mT
    return alignments


def _bone(bvh: Bvh, joint: str) -> Tensor:
    """[3] from the parent to the joint in the parent's frame: what the motion says, for it overrides OFFSET."""
    bone = bvh.positions[:, bvh.names.index(joint)].mean(dim=0)
    if bone.norm() < 1e-6:
        raise UserError(
            bvh.source, f"the bone that ends in {joint} has no length", "export the skeleton with its offsets"
        )
    return bone


def _frame(first: Tensor, second: Tensor) -> Tensor:
    """[3 3] right-handed columns: ``first``, the part of ``second`` across it, their cross product."""
    first = normalize(first, dim=0)
    second = normalize(second - (second @ first) * first, dim=0)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=1)


def _complete(turned: dict[str, Tensor], skeleton: Skeleton) -> Tensor:
    """World rotations [T 24 3 3], the joints that the source lacks filled in."""
    for name, (before, after, share) in skeleton.between.items():
        weight = turned[before].new_full(turned[before].shape[:1], share)
        turned[name] = slerp(turned[before], turned[after], weight)
    for name, parent in zip(JOINT_NAMES, PARENTS, strict=True):
        if name not in turned:
            turned[name] = turned[JOINT_NAMES[parent]]
    return torch.stack([turned[name] for name in JOINT_NAMES], dim=1)


def _leg_ratio(bvh: Bvh, source: dict[str, int], rest: Tensor) -> float:
    bones = [(start, end) for start, end in LIMBS.items() if start.endswith(("hip", "knee"))]
    ours = sum((rest[JOINTS[end]] - rest[JOINTS[start]]).norm().item() for start, end in bones)
    theirs = sum(_bone(bvh, bvh.names[source[end]]).norm().item() for _, end in bones)
    return ours / theirs


def _floor(joints: Tensor, rest: Tensor, fps: float) -> Tensor:
    """Height of the floor under the soles: the median over the frames in which the lowest sole is planted."""
    soles = joints[:, list(SOLES)]
    height, lowest = (soles[..., 1] - rest[list(SOLES), 1]).min(dim=1)
    if len(height) == 1:
        return height[0]
    speed = soles.diff(dim=0).norm(dim=-1).gather(1, lowest[1:, None])[:, 0] * fps
    planted = height[1:][speed < PLANTED_SPEED]
    return planted.median() if len(planted) else height.quantile(0.1)
