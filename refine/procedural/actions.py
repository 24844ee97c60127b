"""The built-in actions: for each one a function from a beat to a gesture, and the parts of the body that it intends."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, pi, radians, sin

import torch
from torch import Tensor

from refine.procedural.curves import held, keyed, wave
from refine.procedural.draws import Beat
from refine.procedural.gaits import run, walk
from refine.procedural.gesture import Arm, Foot, Gesture, Pelvis, Torso, both_arms, leg_swing
from refine.procedural.standing import stand
from renderers.skeleton import LEGS

ARMS = ("left_arm", "right_arm")


@dataclass(frozen=True)
class Action:
    """One built-in action.

    Attributes:
        perform: from a beat to the whole body's gesture.
        intends: the parts it is about (names of ``renderers.skeleton.PARTS``; ``{hand}`` stands for the drawn hand).
        tempo: the usual range, repetitions per second.
    """

    perform: Callable[[Beat], Gesture]
    intends: tuple[str, ...]
    tempo: tuple[float, float]


def mark_time(beat: Beat) -> Gesture:
    """Knees lifted in turn, the other arm swinging forward."""
    swing = radians(20) * (1 + beat.draw.style.arm_swing) * beat.swell
    left_up = wave(beat.cycle - 0.22)
    arms = {
        f"{side}_arm": Arm(forward=swing * (ahead + 0.1), bend=0.5 * swing * (1 + ahead))
        for side, ahead in (("left", -left_up), ("right", left_up))
    }
    return stand(beat) + Gesture(torso=Torso(turn=-0.05 * left_up), **arms, **_knee_lifts(beat))


def punch_and_lift(beat: Beat) -> Gesture:
    """Each knee lifts while the other side's fist strikes."""
    return stand(beat) + Gesture(**_punches(beat, beat.cycle + 0.5, beat.cycle), **_knee_lifts(beat))


def _knee_lifts(beat: Beat) -> dict[str, Pelvis | Foot]:
    """Left knee in the first half of a cycle, right in the second; the pelvis is over the standing leg beforehand."""
    feet = {}
    for side, own in (("left", beat.cycle), ("right", beat.cycle + 0.5)):
        size = beat.size(own)
        angle = radians(44 + 4 * beat.draw.style.reach) * size * held(own, (0.04, 0.23, 0.26, 0.45))
        ahead, lift = leg_swing(angle, 1 - 0.34 * size * held(own, (0.0, 0.21, 0.27, 0.49)))
        feet[f"{side}_foot"] = Foot(lift=lift, ahead=ahead, pitch=radians(26) * held(own, (0.02, 0.12, 0.28, 0.42)))
    left_up = wave(beat.cycle - 0.18)
    return {"pelvis": Pelvis(x=-0.055 * left_up, lean=-0.02, tilt=0.05 * left_up), **feet}


def lunge_left(beat: Beat) -> Gesture:
    """A long step to the left, the weight over the bent left leg, and back."""
    cycle, size = beat.cycle, beat.size(beat.cycle)
    step = (0.72 + 0.06 * beat.draw.style.reach) * size
    over = held(cycle, (0.08, 0.36, 0.48, 0.80))
    unload = keyed(cycle, (0.0, 0.07, 0.24, 0.90, 0.97), (0.0, 1.0, 0.0, 0.0, 0.0))
    return stand(beat) + Gesture(
        torso=Torso(lean=0.10 * over, tilt=0.05 * over),
        **both_arms(Arm(forward=0.12 * over, sideways=0.15 * over, bend=0.2 * over)),
        pelvis=Pelvis(
            x=0.64 * step * over - 0.04 * unload,
            y=-0.24 * size * over,
            z=-0.03 * over,
            lean=0.16 * over,
            tilt=-0.04 * over,
        ),
        left_foot=Foot(
            aside=step * held(cycle, (0.06, 0.26, 0.57, 0.79)),
            lift=keyed(cycle, (0.03, 0.15, 0.28, 0.54, 0.67, 0.81), (0.0, 0.12, 0.0, 0.0, 0.09, 0.0)),
            out=radians(22) * held(cycle, (0.06, 0.26, 0.57, 0.79)),
        ),
    )


def lunge_forward(beat: Beat) -> Gesture:
    """A long step ahead and back, left and right in turn; the heel behind rises."""
    left = _forward_lunge(beat, beat.cycle, "left_foot", "right_foot", 1.0)
    return stand(beat) + left + _forward_lunge(beat, beat.cycle + 0.5, "right_foot", "left_foot", -1.0)


def _forward_lunge(beat: Beat, own: Tensor, front: str, rear: str, side: float) -> Gesture:
    """One lunge in the first half of ``own``; ``side`` is 1 with the left foot in front."""
    size = beat.size(own)
    step = (0.80 + 0.06 * beat.draw.style.reach) * size
    over = held(own, (0.04, 0.18, 0.25, 0.42))
    unload = keyed(own, (0.0, 0.05, 0.13, 0.90, 0.96), (0.0, 1.0, 0.0, 0.0, 0.0))
    stepping = Foot(
        ahead=step * held(own, (0.035, 0.14, 0.295, 0.41)),
        lift=keyed(own, (0.02, 0.08, 0.15, 0.28, 0.35, 0.42), (0.0, 0.12, 0.0, 0.0, 0.10, 0.0)),
        pitch=radians(12)
        * keyed(own, (0.02, 0.07, 0.12, 0.15, 0.28, 0.33, 0.42), (0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 0.0)),
    )
    return Gesture(
        torso=Torso(lean=0.05 * over),
        **both_arms(Arm(forward=0.08 * over, sideways=0.12 * over, bend=0.25 * over)),
        pelvis=Pelvis(x=-0.03 * side * unload, y=-0.25 * size * over, z=0.52 * step * over, lean=0.06 * over),
        **{front: stepping, rear: Foot(pitch=radians(48) * size * over)},
    )


def kick_left(beat: Beat) -> Gesture:
    """The left knee is drawn up, the leg snaps forward and comes back slowly; the body leans over the right leg."""
    cycle, size = beat.cycle, beat.size(beat.cycle)
    highest = radians(72 + 8 * beat.draw.style.reach) * size
    angle = highest * keyed(cycle, (0.10, 0.26, 0.37, 0.40, 0.52, 0.68), (0.0, 0.55, 1.0, 1.0, 0.6, 0.0))
    reach = keyed(cycle, (0.04, 0.24, 0.37, 0.40, 0.52, 0.73), (1.0, 0.70, 1.09, 1.09, 0.72, 1.0))
    ahead, lift = leg_swing(angle, reach)
    up, strike = held(cycle, (0.05, 0.24, 0.42, 0.72)), held(cycle, (0.24, 0.36, 0.40, 0.55))
    return stand(beat) + Gesture(
        torso=Torso(lean=0.06 * strike, turn=0.10 * strike, tilt=-0.05 * up),
        left_arm=Arm(forward=-0.25 * strike, sideways=0.25 * up, bend=0.35 * up),
        right_arm=Arm(forward=0.30 * strike + 0.1 * up, sideways=0.22 * up, bend=0.45 * up),
        pelvis=Pelvis(
            x=-0.095 * held(cycle, (0.92, 0.16, 0.50, 0.78)), lean=-0.16 * strike - 0.04 * up, tilt=0.05 * up
        ),
        left_foot=Foot(
            lift=lift, ahead=ahead, pitch=radians(24) * held(cycle, (0.06, 0.16, 0.24, 0.33)) - radians(48) * strike
        ),
    )


def squat(beat: Beat) -> Gesture:
    """Hips down and back, heels on the floor, the trunk forward for balance."""
    cycle, size, style = beat.cycle, beat.size(beat.cycle), beat.draw.style
    down = held(cycle, (0.06, 0.42, 0.50, 0.84)) * size
    stance = Foot(aside=0.07, out=radians(12))
    return stand(beat) + Gesture(
        torso=Torso(lean=0.16 * down, nod=-0.35 * down),
        **both_arms(Arm(forward=(0.50 + 0.25 * style.reach) * down, bend=0.15 * down, inward=0.2 * down)),
        pelvis=Pelvis(y=-0.40 * down, z=-0.16 * down, lean=0.36 * down),
        left_foot=stance,
        right_foot=stance,
    )


def pull_chest_expander(beat: Beat) -> Gesture:
    """Arms level before the chest, pulled apart to the sides against a spring, let back slowly."""
    style, open_ = beat.draw.style, held(beat.cycle, (0.04, 0.34, 0.44, 0.86)) * beat.size(beat.cycle)
    plane = radians(-4) + radians(84 + 6 * style.plane) * open_
    level = radians(76 + 8 * style.reach)
    arm = Arm(
        forward=level * torch.cos(plane),
        sideways=level * torch.sin(plane),
        inward=radians(55) * (1 - open_),
        bend=radians(38 + 12 * style.plane) * (1 - open_),
    )
    return stand(beat) + Gesture(torso=Torso(lean=-0.07 * open_), **both_arms(arm))


def punch(beat: Beat) -> Gesture:
    """Straight punches from a guard, left and right in turn, the trunk behind them."""
    return stand(beat) + Gesture(**_punches(beat, beat.cycle, beat.cycle + 0.5), pelvis=Pelvis(y=-0.03))


def _punches(beat: Beat, left: Tensor, right: Tensor) -> dict[str, Torso | Arm]:
    """Both arms and the trunk; a fist strikes early in its own cycle, fast out and slower back."""
    reach = {"left": _strike(left) * beat.size(left), "right": _strike(right) * beat.size(right)}
    twist = radians(13) * (1 + beat.draw.style.twist) * (reach["right"] - reach["left"])
    return {
        "torso": Torso(lean=0.05, turn=twist, look=-0.8 * twist),
        **{f"{side}_arm": _punching_arm(beat, extended) for side, extended in reach.items()},
    }


def _strike(own: Tensor) -> Tensor:
    return keyed(own, (0.0, 0.06, 0.24, 0.28, 0.52), (0.0, -0.10, 1.0, 1.0, 0.0))


def _punching_arm(beat: Beat, extended: Tensor) -> Arm:
    style = beat.draw.style
    return Arm(
        forward=radians(24 + 5 * style.plane) + radians(58 + 5 * style.reach) * extended,
        sideways=radians(6) - radians(20) * extended,
        inward=radians(12) + radians(30) * extended,
        bend=radians(104 + 8 * style.plane) * (1 - extended),
    )


def circle_elbows(beat: Beat) -> Gesture:
    """Fingers on the shoulders, elbows drawing circles at the sides."""
    cycle, style = beat.cycle, beat.draw.style
    radius = radians(30) * beat.swell
    raised = radians(70 + 6 * style.reach) + radius * torch.cos(2 * pi * cycle)
    plane = radians(52 + 8 * style.plane) + 1.1 * radius * torch.sin(2 * pi * cycle)
    arm = Arm(
        forward=raised * torch.cos(plane),
        sideways=raised * torch.sin(plane),
        inward=radians(-40) - 0.5 * plane,
        bend=radians(130) + 0.08 * radius * torch.sin(2 * pi * cycle),
        wrist=radians(40),
    )
    return stand(beat) + Gesture(torso=Torso(lean=-0.03 * torch.sin(2 * pi * cycle)), **both_arms(arm))


def abduct_shoulders(beat: Beat) -> Gesture:
    """Straight arms raised sideways, to the level or above, and lowered."""
    style, up = beat.draw.style, held(beat.cycle, (0.05, 0.40, 0.50, 0.90)) * beat.size(beat.cycle)
    raised = radians(96 + 26 * style.reach) * up
    arm = Arm(forward=raised * 0.08, sideways=raised, inward=-0.35 * raised, bend=-0.5 * radians(14) * up)
    return stand(beat) + Gesture(torso=Torso(lean=-0.03 * up), **both_arms(arm))


def rotate_standing(beat: Beat) -> Gesture:
    """The trunk turned left and right on planted feet, elbows raised before the chest, the eyes following."""
    style = beat.draw.style
    turn = keyed(beat.cycle, (0.0, 0.22, 0.30, 0.50, 0.72, 0.80), (0.0, 1.0, 1.0, 0.0, -1.0, -1.0)) * beat.swell
    arm = Arm(
        forward=radians(42 + 12 * style.plane),
        sideways=radians(52 + 10 * style.plane),
        inward=radians(8),
        bend=radians(84 + 12 * style.reach),
    )
    trail = {
        "left_arm": replace(arm, forward=arm.forward - 0.10 * turn),
        "right_arm": replace(arm, forward=arm.forward + 0.10 * turn),
    }
    return stand(beat) + Gesture(
        torso=Torso(turn=radians(44) * turn, look=radians(12) * turn),
        pelvis=Pelvis(turn=radians(12) * turn, x=0.015 * turn, y=-0.01),
        **trail,
    )


def wave_left(beat: Beat) -> Gesture:
    return stand(beat) + Gesture(torso=_attending(-1.0), left_arm=_waving_arm(beat))


def wave_right(beat: Beat) -> Gesture:
    return stand(beat) + Gesture(torso=_attending(1.0), right_arm=_waving_arm(beat))


def wave_both(beat: Beat) -> Gesture:
    return stand(beat) + Gesture(**both_arms(_waving_arm(beat)))


def _attending(side: float) -> Torso:
    """The small lean away from a raised arm on the right (1) or left (-1)."""
    return Torso(tilt=-0.03 * side, head_tilt=0.03 * side)


def _waving_arm(beat: Beat) -> Arm:
    """Upper arm out to the side, forearm up and swinging, the hand a little behind."""
    style, swing = beat.draw.style, beat.swell
    return Arm(
        forward=radians(26 + 8 * style.plane),
        sideways=radians(64 + 12 * style.reach) + radians(5) * swing * wave(beat.cycle),
        inward=radians(-88 + 8 * style.plane),
        bend=radians(68 + 10 * style.plane) - radians(24) * swing * wave(beat.cycle),
        wrist=radians(-14) * swing * wave(beat.cycle - 0.12) - radians(15),
    )


def raise_left(beat: Beat) -> Gesture:
    """The left arm up beside the head, held, and down."""
    style, cycle = beat.draw.style, beat.cycle
    up = held(cycle, (0.06, 0.30, 0.58, 0.88)) * (0.85 + 0.15 * beat.size(cycle))
    raised = radians(150 + 9 * style.reach) * up
    plane = radians(38 + 26 * style.plane)
    arm = Arm(
        forward=raised * cos(plane),
        sideways=raised * sin(plane),
        bend=radians(22) * keyed(cycle, (0.06, 0.19, 0.30, 0.60, 0.74, 0.88), (0.0, 1.0, 0.1, 0.1, 1.0, 0.0)),
    )
    return stand(beat) + Gesture(torso=Torso(tilt=0.05 * up, nod=-0.10 * up), left_arm=arm)


def drink(beat: Beat) -> Gesture:
    """A cup held before the body, brought to the mouth, tipped with the head going back, and lowered."""
    style, cycle, hand = beat.draw.style, beat.cycle, beat.draw.hand
    up, tip = held(cycle, (0.08, 0.34, 0.68, 0.92)), held(cycle, (0.34, 0.44, 0.60, 0.70))
    arm = Arm(
        forward=radians(8) + radians(43 + 4 * style.reach) * up + radians(5) * tip,
        sideways=radians(4) - radians(6 - 4 * style.plane) * up + radians(5) * tip,
        inward=radians(8) + radians(15) * up,
        bend=radians(62 + 10 * style.plane) + radians(63 - 10 * style.plane) * up,
        wave=radians(18) * tip,
    )
    return stand(beat) + Gesture(
        torso=Torso(lean=-0.04 * tip, nod=0.05 * up - 0.30 * beat.draw.amplitude * tip), **{f"{hand}_arm": arm}
    )


ACTIONS: dict[str, Action] = {
    "stand": Action(stand, (), (0.2, 0.3)),
    "marking-time-and-knee-lifting": Action(mark_time, LEGS, (0.55, 0.82)),
    "punching-and-knee-lifting": Action(punch_and_lift, (*LEGS, *ARMS), (0.50, 0.75)),
    "left-lunging": Action(lunge_left, LEGS, (0.32, 0.48)),
    "left-kicking": Action(kick_left, LEGS, (0.45, 0.65)),
    "forward-lunging": Action(lunge_forward, LEGS, (0.20, 0.29)),
    "pulling-chest-expanders": Action(pull_chest_expander, ARMS, (0.40, 0.65)),
    "punching": Action(punch, ARMS, (0.65, 1.05)),
    "elbow-circling": Action(circle_elbows, ARMS, (0.50, 0.85)),
    "shoulder-abduction": Action(abduct_shoulders, ARMS, (0.35, 0.55)),
    "standing-rotation": Action(rotate_standing, ("torso", *ARMS), (0.28, 0.45)),
    "walk": Action(walk, LEGS, (0.78, 1.02)),
    "run": Action(run, LEGS, (1.25, 1.5)),
    "squat": Action(squat, LEGS, (0.30, 0.48)),
    "wave-left-hand": Action(wave_left, ("left_arm",), (1.1, 1.9)),
    "wave-right-hand": Action(wave_right, ("right_arm",), (1.1, 1.9)),
    "wave-both-hands": Action(wave_both, ARMS, (1.1, 1.9)),
    "raise-up-left-hand": Action(raise_left, ("left_arm",), (0.28, 0.42)),
    "drink": Action(drink, ("{hand}_arm",), (0.22, 0.34)),
}
