"""SMPL rotations from joint positions, in closed form for all frames at once.

Positions say where bones point, not how they are turned about themselves, and they belong to a body of other
proportions. So the skeleton behind them is measured first (bone lengths are medians over the clip), a T-pose is made of
these lengths, and the rotations that take it to the positions are found part by part:

- pelvis and chest are rigid (hips and first vertebra; neck and collars): the best rotation in the sense of least
  squares (Kabsch 1976);
- every other bone is swung to where it points, by the smallest turn from where its parent carries it;
- upper arms and thighs are turned about themselves so that elbows and knees bend as hinges do. A limb that is nearly
  straight hardly shows its plane; that is remembered from frames nearby, told by the foot, and at last by the T-pose.

The rotations are then put on the body asked for: limbs point exactly where they are seen to, the trunk turns as the
trunk does, and the path is scaled by the ratio of the leg lengths.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import conv1d, normalize

from refine.motion import Motion
from refine.positions.alignment import NOTHING, across, direction, frame, kabsch, swing
from refine.positions.joint_layouts import LAYOUTS, Layout
from refine.positions.measured_skeleton import (
    ARMS,
    COLLARS,
    HIPS,
    LEGS,
    NECK,
    SPINE,
    leg_length,
    measured_skeleton,
    unsteadiness,
)
from renderers.checks import UserError, check_finite, check_shapes
from renderers.rotations import slerp
from renderers.skeleton import JOINT_NAMES, JOINTS, MIRRORED, PARENTS, forward_kinematics

BLOCK = 4096  # frames at once
GLITCHES = 0.02  # of the frames may reach through the floor
MOBILITY = 0.06  # how far shoulders move against the chest, in widths of the shoulders
HEAD = JOINTS["head"]
SHOULDERS = (JOINTS["left_shoulder"], JOINTS["right_shoulder"])
# The axis about which a positive turn bends the limb, in the T-pose: knees backwards, elbows forwards.
HINGES = dict(zip((*LEGS, *ARMS), ((1.0, 0, 0), (1.0, 0, 0), (0, -1.0, 0), (0, 1.0, 0)), strict=True))


@dataclass(frozen=True)
class FittingConfig:
    """How limbs are turned about themselves where they are nearly straight."""

    spans: tuple[float, ...] = (0.06, 0.3, 1.2)
    """Standard deviations, in seconds, of the times over which a limb's plane is remembered; each counts a hundredth
    of the one before."""
    straight: float = 0.15
    """Sine of the angle up to which a limb is nearly straight. A limb that is bent more counts the square of its sine,
    one that is bent less ever less."""
    foot: float = 0.05
    """What the foot counts for the turn of the thigh."""
    prior: float = 1e-3
    """What the T-pose counts."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A motion fitted to joint positions, and how well.

    Attributes:
        motion: on the body asked for.
        errors: [T] mean distance, in metres, of the joints of each frame to the positions: of the fitted rotations on
            a skeleton with the bone lengths of the file, scaled to the size of the body.
        scale: metres a unit of the file: the legs of the body over those of the file.
        lift: metres by which the path was raised, to stand on the floor with the lowest joint of all but a few frames.
        swapped: whether left and right were exchanged, because the feet pointed backwards otherwise.
        stretch: how much bones change their lengths, as a ratio: the deviation over the mean; near 0 for a body.
    """

    motion: Motion
    errors: Tensor
    scale: float
    lift: float
    swapped: bool
    stretch: float

    @property
    def error(self) -> float:
        """Mean joint error, metres."""
        return float(self.errors.mean())


def fit_joints(
    positions: Tensor,
    rest_joints: Tensor,
    fps: float | None = None,
    layout: Layout | None = None,
    label: str = "",
    source: str = "joints",
    config: FittingConfig | None = None,
) -> Fit:
    """Find the motion of a body whose joints move as the positions do.

    Positions of this very body (all lengths within a hundredth) are met where they are, others are scaled and put on
    the floor.

    Args:
        positions: [T J 3] y up, in any unit; J of 24 (SMPL), 22 (HumanML3D) or 21 (KIT).
        rest_joints: [24 3] T-pose joints of the body, metres, y up, facing +z.
        fps: frames per second; none takes the layout's.
        layout: how the joints are numbered; none goes by their number.

    Raises:
        ShapeError: another shape. UserError: another number of joints, no frame, a frame rate that is none, a value
            that is not finite, or legs without length.
    """
    check_shapes("fit_joints", positions=(positions, "T J 3"), rest_joints=(rest_joints, "24 3"))
    count = positions.shape[1]
    layout = layout or LAYOUTS.get(count)
    if layout is None or len(layout.joints) != count:
        known = ", ".join(f"{number} ({known.name})" for number, known in LAYOUTS.items())
        raise UserError(source, f"has {count} joints", f"known are {known}")
    if len(positions) == 0:
        raise UserError(source, "has no frames", "give a clip of at least one frame")
    check_finite(source, positions, "frame joint coordinate")
    config, fps = config or FittingConfig(), layout.fps if fps is None else fps
    if not 0 < fps < 10_000:
        raise UserError(source, f"frame rate {fps} is not a number of frames per second")
    rest = rest_joints.detach().to("cpu", torch.float64)
    joints, seen = _arranged(positions.detach().to("cpu", torch.float64), layout)
    step = len(joints) // BLOCK + 1  # of a long clip some frames are measured
    swapped = _feet_point_back(joints[::step])
    if swapped:
        joints = joints[:, list(MIRRORED)]
    model = measured_skeleton(joints[::step], seen, layout.rest, rest, source)
    scale = leg_length(rest) / leg_length(model)
    stretch, noise = unsteadiness(joints[::step], seen)
    parts = [
        _fit(joints[start:stop], inner, seen, model, rest, noise, fps, config)
        for start, stop, inner in _blocks(len(joints), max(_reach(span, fps) for span in config.spans))
    ]
    rotations, root, lowest, errors = (torch.cat(values) for values in zip(*parts, strict=True))
    lift = 0.0 if model is rest else float(rest[:, 1].min() - lowest.quantile(GLITCHES))
    root = root + torch.tensor([0.0, lift, 0.0], dtype=root.dtype)
    motion = Motion(rotations, root.float(), fps, label, source)
    return Fit(motion, errors.float(), scale, lift, swapped, stretch)


def _blocks(frames: int, reach: int) -> Iterator[tuple[int, int, slice]]:
    """Blocks of frames, each with what it has to see of its neighbours, and where its own frames lie in it: memory
    does not grow with the clip."""
    for start in range(0, frames, BLOCK):
        first, end = max(0, start - reach), min(start + BLOCK, frames)
        yield first, min(end + reach, frames), slice(start - first, end - first)


def _fit(
    joints: Tensor,
    own: slice,
    seen: list[bool],
    model: Tensor,
    rest: Tensor,
    noise: float,
    fps: float,
    config: FittingConfig,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of a block of joints [S 24 3], for its own T frames: local rotations [T 24 3 3], root [T 3], the height of the
    lowest joint [T], all on the body, and errors [T] in metres."""
    turned = _world_rotations(joints, seen, model, noise, fps, config)[own]
    joints = joints[own]
    scale = leg_length(rest) / leg_length(model)
    at = joints[:, list(HIPS)].mean(dim=1)
    errors = (_stood(turned, at, model) - joints)[:, seen].norm(dim=-1).mean(dim=-1) * scale
    if model is not rest:
        turned = _put_on(turned, model, rest, seen)
    stood = _stood(turned, scale * at, rest)
    return _local(turned).float(), stood[:, 0], stood[..., 1].amin(dim=1), errors


def _arranged(positions: Tensor, layout: Layout) -> tuple[Tensor, list[bool]]:
    """[T 24 3] in SMPL's order with zeros for joints that are not there, and which are."""
    joints = positions.new_zeros(len(positions), len(JOINT_NAMES), 3)
    for index, joint in enumerate(layout.joints):
        if joint >= 0:
            joints[:, joint] = positions[:, index]
    return joints, [joint in layout.joints for joint in range(len(JOINT_NAMES))]


def _feet_point_back(joints: Tensor) -> bool:
    """Whether the feet mostly point to what is the back if left is left."""
    left = joints[:, HIPS[0]] - joints[:, HIPS[1]]
    up = joints[:, NECK] - joints[:, list(HIPS)].mean(dim=1)
    feet = sum(joints[:, leg[3]] - joints[:, leg[2]] for leg in LEGS)
    return bool((torch.linalg.cross(left, up) * feet).sum(dim=-1).sign().mean() < -0.5)


def _world_rotations(
    joints: Tensor, seen: list[bool], model: Tensor, noise: float, fps: float, config: FittingConfig
) -> Tensor:
    """[T 24 3 3] world rotations that take the T-pose to the positions, each of which is unsteady by ``noise``."""

    def rigid(joint: int, ends: dict[int, float]) -> Tensor:
        there = joints[:, list(ends)] - joints[:, joint, None]
        return kabsch(model[list(ends)] - model[joint], there, torch.tensor(list(ends.values()), dtype=model.dtype))

    def aimed(carried: Tensor, joint: int, end: int) -> Tensor:
        if not (seen[joint] and seen[end]):
            return carried
        return swing(carried @ (model[end] - model[joint]), joints[:, end] - joints[:, joint]) @ carried

    pelvis = rigid(0, dict.fromkeys((*HIPS, SPINE[0]), 1.0))
    chest = rigid(SPINE[2], _chest(seen, model, noise))
    lower, upper = (slerp(pelvis, chest, pelvis.new_full((len(joints),), share)) for share in (1 / 3, 2 / 3))
    turned = {0: pelvis, SPINE[2]: chest}
    turned[SPINE[0]] = aimed(lower, SPINE[0], SPINE[1] if seen[SPINE[1]] else SPINE[2])
    turned[SPINE[1]] = aimed(upper, SPINE[1], SPINE[2]) if seen[SPINE[1]] else turned[SPINE[0]]
    turned[NECK] = turned[HEAD] = aimed(chest, NECK, HEAD)
    for collar, shoulder in zip(COLLARS, SHOULDERS, strict=True):
        turned[collar] = aimed(chest, collar, shoulder)
    for limb, hinge in HINGES.items():
        first, second, third, tip = limb
        carried = turned[PARENTS[first]]
        axis, along, below = _hinge(joints, seen, model, limb, carried, fps, config)
        bent = torch.tensor(hinge, dtype=model.dtype)
        turned[first] = frame(along, axis) @ frame(model[second] - model[first], bent).mT
        turned[second] = frame(below, axis) @ frame(model[third] - model[second], bent).mT
        turned[third] = turned[tip] = aimed(turned[second], third, tip)
    return torch.stack([turned[joint] for joint in range(len(JOINT_NAMES))], dim=1)


def _chest(seen: list[bool], model: Tensor, noise: float) -> dict[int, float]:
    """What shows how the chest is turned, and how much each counts. Shoulders are not rigid with it, but collars lie so
    near to each other that they show little where positions are unsteady."""
    if not seen[COLLARS[0]]:
        return dict.fromkeys((NECK, *SHOULDERS), 1.0)
    moves = MOBILITY * float((model[SHOULDERS[0]] - model[SHOULDERS[1]]).norm())
    weight = noise**2 / max(noise**2 + moves**2, NOTHING**2)
    return dict.fromkeys((NECK, *COLLARS), 1.0) | dict.fromkeys(SHOULDERS, weight)


def _hinge(
    joints: Tensor,
    seen: list[bool],
    model: Tensor,
    limb: tuple[int, ...],
    carried: Tensor,
    fps: float,
    config: FittingConfig,
) -> tuple[Tensor, Tensor, Tensor]:
    """Of a limb that its parent carries by ``carried`` [T 3 3]: the axis [T 3] about which it bends, across the upper
    bone, and the directions [T 3] of the upper and the lower bone."""
    first, second, third, tip = limb
    bones = [model[b] - model[a] for a, b in ((first, second), (second, third), (third, tip))]
    swung = swing(carried @ bones[0], joints[:, second] - joints[:, first]) @ carried
    along = normalize(swung @ bones[0], dim=-1)
    below = direction(joints[:, third] - joints[:, second], swung @ bones[1])
    plain = normalize(across(swung @ torch.tensor(HINGES[limb], dtype=model.dtype), along), dim=-1)
    other = torch.linalg.cross(along, plain)

    def vote(axis: Tensor) -> Tensor:
        """[T] complex: the angle from ``plain`` to the axis, with the square of its length for weight."""
        return torch.complex((axis * plain).sum(dim=-1), (axis * other).sum(dim=-1)) * axis.norm(dim=-1)

    bend = torch.linalg.cross(along, below)
    square = bend.square().sum(dim=-1)
    votes = vote(bend) * square / (square + config.straight**2)
    if limb in LEGS and seen[tip]:
        ahead = direction(joints[:, tip] - joints[:, third], swung @ bones[2])
        votes = votes + config.foot * vote(torch.linalg.cross(ahead, along))
    angle = _remembered(votes, fps, config).angle()[:, None]
    return angle.cos() * plain + angle.sin() * other, along, below


def _remembered(votes: Tensor, fps: float, config: FittingConfig) -> Tensor:
    """[T] complex votes, with those of frames nearby added to each, and the T-pose's at angle zero."""
    signal = torch.stack([votes.real, votes.imag])[:, None]
    total = torch.zeros_like(signal)
    for power, span in enumerate(config.spans):
        reach = min(_reach(span, fps), len(votes))
        kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, dtype=signal.dtype) / (span * fps)) ** 2)
        total = total + 100.0**-power * conv1d(signal, kernel[None, None], padding=reach)
    return torch.complex(total[0, 0] + config.prior, total[1, 0])


def _reach(span: float, fps: float) -> int:
    """Frames that a memory reaches to either side."""
    return int(3 * span * fps) + 1


def _put_on(turned: Tensor, model: Tensor, rest: Tensor, seen: list[bool]) -> Tensor:
    """[T 24 3 3] for another T-pose: limbs keep their directions, all else its turn."""
    turned = turned.clone()
    for first, second, third, tip in HINGES:
        for start, end in ((first, second), (second, third)):
            turned[:, start] = turned[:, start] @ swing(rest[end] - rest[start], model[end] - model[start])
        if not seen[tip]:
            turned[:, third] = turned[:, tip] = turned[:, second].clone()
    return turned


def _local(turned: Tensor) -> Tensor:
    local = turned.clone()
    local[:, 1:] = turned[:, list(PARENTS[1:])].mT @ turned[:, 1:]
    return local


def _stood(turned: Tensor, at: Tensor, skeleton: Tensor) -> Tensor:
    """Joints [T 24 3] of a skeleton with these world rotations whose hips have their middle ``at`` [T 3]."""
    middle = skeleton[list(HIPS)].mean(dim=0) - skeleton[0]
    return forward_kinematics(_local(turned), at - turned[:, 0] @ middle, skeleton)[0]
