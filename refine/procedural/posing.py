"""From a gesture to rotations: the standing posture, joint limits, and legs by analytic two-bone inverse kinematics."""

from math import radians

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.procedural.gesture import Deviation, Gesture
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import JOINTS

# The standing posture: the T-pose's arms lowered to this angle from the trunk, palms a little inward, joints soft.
ARM_FROM_TRUNK, PALM_INWARD, ELBOW, FINGERS, COLLAR_DROP = (
    radians(11),
    radians(15),
    radians(14),
    radians(22),
    radians(4),
)
FEET_APART, TOES_OUT, KNEE_SOFTNESS = 0.02, radians(6), 0.004

# Joint limits: ranges of healthy adults, rounded.
ELBOW_MIN, ELBOW_MAX = radians(2), radians(150)
KNEE_MAX = radians(150)
ARM_RAISE_MAX, ARM_INWARD_MAX, WRIST_MAX = radians(172), radians(95), radians(65)
SPINE_MAX, HEAD_MAX, PELVIS_MAX, FOOT_PITCH_MAX = radians(70), radians(65), radians(45), radians(60)

STRAIGHTEST = 0.993  # of the leg's length for a leg on the floor, so that its knee never locks
SNUG = 0.006  # leg lengths in which a lifted leg nears full length: a knee that met it at speed would snap
LOWEST = 0.45  # the least height of the hips above standing ankles, leg lengths
SOFTNESS = 0.012  # leg lengths over which one limit of the pelvis height hands over to the next

SIDES = ("left", "right")


def pose(gesture: Gesture, rest_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Local rotations [T 24 3 3] and pelvis positions [T 3] in metres of a gesture on a skeleton [24 3].

    The feet tread at the height they have in the T-pose. The pelvis sinks where a leg on the floor would not reach.
    """
    frames = max(value.numel() for limb in gesture.values for value in limb.values if isinstance(value, Tensor))
    rotations = torch.eye(3).to(rest_joints).expand(frames, 24, 3, 3).clone()
    _pose_torso(rotations, gesture)
    _pose_arms(rotations, gesture)
    root = _pose_legs(rotations, gesture, rest_joints)
    return rotations, root


def _pose_torso(rotations: Tensor, gesture: Gesture) -> None:
    torso = _curves(rotations, gesture.torso)
    spine = _bounded(torch.stack([torso["lean"], torso["turn"], torso["tilt"]], dim=-1), SPINE_MAX)
    head = _bounded(torch.stack([torso["nod"], torso["look"], torso["head_tilt"]], dim=-1), HEAD_MAX)
    rotations[:, _indices("spine1", "spine2", "spine3")] = axis_angle_to_matrix(spine / 3)[:, None]
    rotations[:, _indices("neck", "head")] = axis_angle_to_matrix(head / 2)[:, None]


def _pose_arms(rotations: Tensor, gesture: Gesture) -> None:
    """Collar, shoulder, elbow, wrist and hand of both arms, relative to the chest, so that arms follow the trunk."""
    arm = _curves(rotations, gesture.left_arm, gesture.right_arm)
    side = rotations.new_tensor([1.0, -1.0]).expand_as(arm["bend"])
    none = torch.zeros_like(side)
    raised = _bounded(torch.stack([-arm["forward"], none, side * arm["sideways"]], dim=-1), ARM_RAISE_MAX)
    inward = PALM_INWARD + arm["inward"].clamp(-ARM_INWARD_MAX, ARM_INWARD_MAX)
    hanging = rotation_about("z", side * (ARM_FROM_TRUNK - radians(90))) @ rotation_about("x", inward)
    in_chest = axis_angle_to_matrix(raised) @ hanging
    collar = axis_angle_to_matrix(_collar(side, side[..., None] * in_chest[..., 0]))
    bend = (ELBOW + arm["bend"]).clamp(ELBOW_MIN, ELBOW_MAX)
    wrist = _bounded(torch.stack([none, -side * arm["wave"], -side * arm["wrist"]], dim=-1), WRIST_MAX)
    rotations[:, _pair("collar")] = collar
    rotations[:, _pair("shoulder")] = collar.mT @ in_chest
    rotations[:, _pair("elbow")] = rotation_about("y", -side * bend)
    rotations[:, _pair("wrist")] = axis_angle_to_matrix(wrist)
    rotations[:, _pair("hand")] = rotation_about("z", -side * FINGERS)


def _collar(side: Tensor, upper_arm: Tensor) -> Tensor:
    """Rotation vector of the collar for the direction of an upper arm [... 3]: it rises and slides with the arm."""
    above = ((upper_arm[..., 1] + 0.4) / 1.4).clamp(0, 1)
    rise = radians(24) * above**2 * (3 - 2 * above) - COLLAR_DROP
    return side[..., None] * torch.stack([torch.zeros_like(rise), -radians(12) * upper_arm[..., 2], rise], dim=-1)


def _pose_legs(rotations: Tensor, gesture: Gesture, rest_joints: Tensor) -> Tensor:
    """Pelvis, hips, knees, ankles and toes; returns the pelvis position [T 3]."""
    pelvis, foot = _curves(rotations, gesture.pelvis), _curves(rotations, gesture.left_foot, gesture.right_foot)
    orientation = axis_angle_to_matrix(
        _bounded(torch.stack([pelvis["lean"], pelvis["turn"], pelvis["tilt"]], dim=-1), PELVIS_MAX)
    )[:, None]
    hip, knee, ankle, toe = (rest_joints[_pair(name)] for name in ("hip", "knee", "ankle", "foot"))
    thigh, shank = knee - hip, ankle - knee
    leg = (thigh.norm(dim=-1) + shank.norm(dim=-1)).mean()
    target, foot_world, yaw = _tread(foot, ankle, toe - ankle, leg)

    from_pelvis = (orientation @ (hip - rest_joints[0])[..., None])[..., 0]
    wish = rest_joints[0] + leg * torch.stack([pelvis["x"], pelvis["y"] - KNEE_SOFTNESS, pelvis["z"]], dim=-1)
    root = _sink(wish, from_pelvis, target, foot["lift"], leg)
    to_foot = target - (root[:, None] + from_pelvis)

    flexion = _knee_flexion(_within_reach(to_foot.norm(dim=-1), leg), thigh, shank)
    knee_local = rotation_about("x", flexion)
    folded = thigh + (knee_local @ shank[..., None])[..., 0]
    facing = rotation_about("y", (yaw + pelvis["turn"][:, None]) / 2)[..., 0]
    lateral = torch.zeros_like(folded)
    lateral[..., 0] = 1.0
    hip_world = _basis(to_foot, facing) @ _basis(folded, lateral).mT

    flat_toes = -foot["pitch"].clamp(0, FOOT_PITCH_MAX) * torch.exp(-foot["lift"] / 0.12)
    rotations[:, 0] = orientation[:, 0]
    rotations[:, _pair("hip")] = orientation.mT @ hip_world
    rotations[:, _pair("knee")] = knee_local
    rotations[:, _pair("ankle")] = (hip_world @ knee_local).mT @ foot_world
    rotations[:, _pair("foot")] = rotation_about("x", flat_toes)
    return root


def _tread(foot: dict[str, Tensor], ankle: Tensor, toe: Tensor, leg: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Ankles [T 2 3], foot orientations [T 2 3 3] and yaws [T 2] of feet that roll over the ball or the heel."""
    side = ankle.new_tensor([1.0, -1.0])
    yaw = side * (TOES_OUT + foot["out"])
    pitch = foot["pitch"].clamp(-FOOT_PITCH_MAX, FOOT_PITCH_MAX)
    turned, rolled = rotation_about("y", yaw), rotation_about("x", pitch)
    heel = toe * toe.new_tensor([0.0, 1.0, -0.35])
    pivot = torch.where(pitch[..., None] > 0, toe, heel)
    roll = (turned @ (pivot - (rolled @ pivot[..., None])[..., 0])[..., None])[..., 0]
    step = torch.stack([side * (FEET_APART + foot["aside"]), foot["lift"], foot["ahead"]], dim=-1)
    return ankle + leg * step + roll, turned @ rolled, yaw


def _sink(wish: Tensor, from_pelvis: Tensor, target: Tensor, lift: Tensor, leg: Tensor) -> Tensor:
    """The wished pelvis position [T 3], lowered smoothly to where the feet on the floor can be reached."""
    away = (wish[:, None] + from_pelvis - target)[..., [0, 2]].square().sum(-1)
    reach = (STRAIGHTEST * leg) ** 2
    # A lifted foot does not hold the pelvis down.
    highest = target[..., 1] + (reach - away).clamp(min=0.05 * reach).sqrt() - from_pelvis[..., 1] + 2 * leg * lift
    softness = SOFTNESS * leg
    limits = torch.cat([wish[:, 1:2], highest], dim=-1)
    height = -softness * torch.logsumexp(-limits / softness, dim=-1)
    lowest = (target[..., 1] - leg * lift).mean(-1) + LOWEST * leg - from_pelvis[..., 1].mean(-1)
    return torch.stack([wish[:, 0], torch.maximum(height, lowest), wish[:, 2]], dim=-1)


def _within_reach(distance: Tensor, leg: Tensor) -> Tensor:
    """Hip to ankle [T 2], unchanged up to ``STRAIGHTEST`` and from there smoothly below the leg's full length."""
    beyond = (distance / leg - STRAIGHTEST).clamp(min=0)
    return torch.minimum(distance, leg * STRAIGHTEST) + leg * SNUG * -torch.expm1(-beyond / SNUG)


def _knee_flexion(distance: Tensor, thigh: Tensor, shank: Tensor) -> Tensor:
    """Angle of the knee about x, relative to the T-pose, that puts the ankle ``distance`` [T 2] from the hip."""
    squares = thigh.square().sum(-1) + shank.square().sum(-1) + 2 * thigh[..., 0] * shank[..., 0]
    product = 2 * thigh[..., 1:].norm(dim=-1) * shank[..., 1:].norm(dim=-1)
    total = torch.acos(((distance.square() - squares) / product).clamp(-1, 1)).clamp(max=KNEE_MAX)
    cross = thigh[..., 1] * shank[..., 2] - thigh[..., 2] * shank[..., 1]
    return total - torch.atan2(cross, (thigh[..., 1:] * shank[..., 1:]).sum(-1))


def _basis(along: Tensor, side: Tensor) -> Tensor:
    """[... 3 3] orthonormal columns: ``along``, then ``side`` made orthogonal to it, then their cross product."""
    first = normalize(along, dim=-1)
    second = normalize(side - (side * first).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def _bounded(vector: Tensor, most: float) -> Tensor:
    """Rotation vectors no longer than ``most`` radians."""
    return vector * (most / vector.norm(dim=-1, keepdim=True).clamp(min=1e-9)).clamp(max=1.0)


def _curves(like: Tensor, *limbs: Deviation) -> dict[str, Tensor]:
    """The fields of one limb as curves [T], or of two like limbs as [T 2]."""
    stacked = [limb.stacked(like) for limb in limbs]
    if len(stacked) == 1:
        return stacked[0]
    return {name: torch.stack([one[name] for one in stacked], dim=-1) for name in stacked[0]}


def _pair(name: str) -> list[int]:
    return _indices(*(f"{side}_{name}" for side in SIDES))


def _indices(*names: str) -> list[int]:
    return [JOINTS[name] for name in names]
