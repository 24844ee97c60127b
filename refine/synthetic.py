"""Built-in procedural actions, and their true compositions: both actions at once, made by the generator itself.

A true composition follows how people do two things together. Every action *intends* some parts of the body
(``intended``); the rest of its movement is *incidental* (a walk's arm swing, sway, breath). Then, with the same draws:

- a part that one action intends is done by that action alone;
- a part that neither intends shows the incidental movement of both, added as deviations from the standing posture;
- a part that both intend is held half way between the two mean postures, and both movements about them are added;
- the pelvis, and with it place and heading, belongs to whoever intends the legs (if both do, their deviations add, and
  a foot is lifted as high as the higher of the two);
- the legs' inverse kinematics is solved last, on the composed pelvis, so that planted feet stay planted.

No energy and no mask is involved.
"""

from dataclasses import replace

import torch
from torch import Tensor

from refine.motion import Motion
from refine.procedural.actions import ACTIONS as _ACTIONS
from refine.procedural.draws import Beat, Draw, draw_parameters
from refine.procedural.gesture import Curve, Deviation, Foot, Gesture
from refine.procedural.posing import pose
from renderers.checks import UserError, check_known, check_shapes
from renderers.skeleton import LEGS

ACTIONS: tuple[str, ...] = tuple(_ACTIONS)

UPPER_LIMBS = ("torso", "left_arm", "right_arm")
LEG_LIMBS = ("pelvis", "left_foot", "right_foot")
SAMPLES = 64  # of one repetition, for its mean posture


def draw(name: str, generator: torch.Generator, fps: float = 30.0) -> Draw:
    """Tempo, amplitude, phase, style and noise of one performance of the action ``name``; no two draws are alike.

    Raises:
        UserError: an unknown action, or a frame rate that is not positive.
    """
    check_known("draw(name)", name, ACTIONS)
    if not 0 < fps < 10_000:
        raise UserError("draw(fps)", f"expected a positive frame rate, got {fps}")
    return draw_parameters(name, _ACTIONS[name].tempo, generator, fps)


def intended(performance: Draw) -> frozenset[str]:
    """The parts (names of ``renderers.skeleton.PARTS``) that a performance is about; the rest is incidental."""
    return frozenset(part.format(hand=performance.hand) for part in _ACTIONS[performance.action].intends)


def perform(performance: Draw, frames: int, rest_joints: Tensor) -> Motion:
    """The motion of a draw: the same draw gives the same motion, and a longer one only continues it.

    Args:
        performance: from ``draw``.
        frames: how many, at the draw's frame rate.
        rest_joints: [24 3] T-pose joints in metres, y up, facing +z; the feet tread at the height they have there.

    Returns:
        Motion [frames], facing +z, on the device and of the dtype of ``rest_joints``.

    Raises:
        UserError: fewer than one frame. ShapeError: joints of another shape.
    """
    gesture = _gesture(performance, _seconds(frames, performance.fps, rest_joints))
    return _motion(gesture, rest_joints, performance.fps, performance.action)


def perform_together(draw_i: Draw, draw_j: Draw, frames: int, rest_joints: Tensor) -> Motion:
    """Both performances at once by one body, as the module describes; exchanging the draws changes nothing.

    Arguments and errors as for ``perform``; also a UserError where the frame rates differ.
    """
    if draw_i.fps != draw_j.fps:
        raise UserError(
            "perform_together", f"frame rates {draw_i.fps} and {draw_j.fps} differ", "draw both at the same rate"
        )
    i, j = sorted((draw_i, draw_j), key=lambda one: ACTIONS.index(one.action))
    gesture_i, gesture_j = (_gesture(one, _seconds(frames, one.fps, rest_joints)) for one in (i, j))
    upper = {limb: _compose_upper(limb, (i, gesture_i), (j, gesture_j)) for limb in UPPER_LIMBS}
    legs = {limb: _compose_legs(limb, (i, gesture_i), (j, gesture_j)) for limb in LEG_LIMBS}
    return _motion(Gesture(**upper, **legs), rest_joints, i.fps, f"{i.action}+{j.action}")


def _compose_upper(limb: str, one: tuple[Draw, Gesture], other: tuple[Draw, Gesture]) -> Deviation:
    claims = [limb in intended(performance) for performance, _ in (one, other)]
    mine, its = getattr(one[1], limb), getattr(other[1], limb)
    if claims == [True, True]:
        return mine + its - (_mean_posture(one[0], limb) + _mean_posture(other[0], limb)) * 0.5
    return _owned(claims, mine, its)


def _compose_legs(limb: str, one: tuple[Draw, Gesture], other: tuple[Draw, Gesture]) -> Deviation:
    claims = [intended(performance).issuperset(LEGS) for performance, _ in (one, other)]
    mine, its = getattr(one[1], limb), getattr(other[1], limb)
    if claims == [True, True] and isinstance(mine, Foot):
        return replace(mine + its, lift=_higher(mine.lift, its.lift))
    return _owned(claims, mine, its)


def _higher(mine: Curve, its: Curve) -> Curve:
    """A foot is in the air when either action lifts it, and no higher than either does."""
    return torch.maximum(torch.as_tensor(mine, dtype=torch.float64), torch.as_tensor(its, dtype=torch.float64))


def _owned(claims: list[bool], mine: Deviation, its: Deviation) -> Deviation:
    """The only claimant's movement; both added where none or both claim."""
    if claims[0] == claims[1]:
        return mine + its
    return mine if claims[0] else its


def _mean_posture(performance: Draw, limb: str) -> Deviation:
    """The mean of a limb over the first repetition, whatever the length of the clip."""
    repetition = torch.arange(SAMPLES, dtype=torch.float64) / (SAMPLES * performance.tempo)
    return getattr(_gesture(performance, repetition), limb).mean()


def _seconds(frames: int, fps: float, rest_joints: Tensor) -> Tensor:
    """Time of each frame [T]; double, so that a long clip keeps its phase."""
    if frames < 1:
        raise UserError("perform(frames)", f"expected at least one frame, got {frames}")
    check_shapes("perform", rest_joints=(rest_joints, "24 3"))
    return torch.arange(frames, dtype=torch.float64, device=rest_joints.device) / fps


def _gesture(performance: Draw, seconds: Tensor) -> Gesture:
    return _ACTIONS[performance.action].perform(Beat(performance, seconds))


def _motion(gesture: Gesture, rest_joints: Tensor, fps: float, label: str) -> Motion:
    rotations, root = pose(gesture, rest_joints)
    return Motion(rotations, root, fps, label, source="built-in actions")
