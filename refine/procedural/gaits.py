"""Walking and running: one description of a step with two sets of numbers."""

from dataclasses import dataclass
from math import radians

from torch import Tensor

from refine.procedural.curves import eased, keyed, wave
from refine.procedural.draws import Beat
from refine.procedural.gesture import Arm, Foot, Gesture, Pelvis, Torso
from refine.procedural.standing import stand


@dataclass(frozen=True)
class Gait:
    """What tells a walk from a run; phases in strides, lengths in leg lengths, angles in radians.

    Attributes:
        stride: ground covered by two steps.
        stance: share of a stride that a foot is on the floor.
        lead: how far the pelvis is ahead of the middle of a stance.
        lateness: above 1, a foot in the air moves on late, so that the leg is not stretched long before it lands.
        foot_times, foot_pitch, foot_lift: the roll and rise of a foot through its cycle, which starts at its landing.
        bob: rise and fall of the pelvis; positive, highest over the standing leg.
        crouch: how much lower than standing.
        lean: of the trunk.
        arm_swing, elbow: swing to either side, and the elbow's bend.
    """

    stride: float
    stance: float
    lead: float
    lateness: float
    foot_times: tuple[float, ...]
    foot_pitch: tuple[float, ...]
    foot_lift: tuple[float, ...]
    bob: float
    crouch: float
    lean: float
    arm_swing: float
    elbow: float


WALK = Gait(
    stride=1.55,
    stance=0.62,
    lead=0.09,
    lateness=1.0,
    foot_times=(0.0, 0.09, 0.33, 0.62, 0.67, 0.76, 0.93),
    foot_pitch=tuple(map(radians, (-17, 0, 0, 52, 54, 20, -17))),
    foot_lift=(0.0, 0.0, 0.0, 0.0, 0.04, 0.095, 0.025),
    bob=0.030,
    crouch=0.037,
    lean=radians(2),
    arm_swing=radians(24),
    elbow=radians(12),
)
RUN = Gait(
    stride=2.6,
    stance=0.33,
    lead=0.15,
    lateness=1.3,
    foot_times=(0.0, 0.06, 0.12, 0.33, 0.42, 0.62, 0.86),
    foot_pitch=tuple(map(radians, (-6, 0, 0, 54, 58, 35, -8))),
    foot_lift=(0.0, 0.0, 0.0, 0.0, 0.14, 0.42, 0.14),
    bob=-0.032,
    crouch=0.068,
    lean=radians(8),
    arm_swing=radians(42),
    elbow=radians(75),
)


def walk(beat: Beat) -> Gesture:
    return _go(beat, WALK)


def run(beat: Beat) -> Gesture:
    return _go(beat, RUN)


def _go(beat: Beat, gait: Gait) -> Gesture:
    """Walking or running ahead: each foot stays where it landed while the pelvis passes over it."""
    style, cycle = beat.draw.style, beat.cycle
    longer = 0.4 + 0.6 * beat.draw.amplitude
    stride = gait.stride * longer
    swing = gait.arm_swing * (1 + style.arm_swing) * beat.swell
    yaw = radians(5) * (1 + style.twist)
    over_left = wave(cycle - gait.stance / 2)  # 1 when the left leg carries the body
    return stand(beat) + Gesture(
        torso=Torso(lean=gait.lean, turn=1.9 * yaw * wave(cycle), look=-0.9 * yaw * wave(cycle), nod=-0.8 * gait.lean),
        left_arm=_swinging_arm(-wave(cycle), swing, gait.elbow),
        right_arm=_swinging_arm(wave(cycle), swing, gait.elbow),
        pelvis=Pelvis(
            x=0.022 * over_left,
            y=longer**2 * (gait.bob * wave(2 * cycle - gait.stance) - gait.crouch),
            z=stride * (cycle - beat.draw.phase),
            lean=0.4 * gait.lean,
            turn=-yaw * wave(cycle),
            tilt=-0.04 * over_left,
        ),
        left_foot=_stepping_foot(cycle, 0.0, stride, gait, beat),
        right_foot=_stepping_foot(cycle, 0.5, stride, gait, beat),
    )


def _swinging_arm(ahead: Tensor, swing: Tensor, elbow: float) -> Arm:
    """Arm of a gait; ``ahead`` in -1..1. It swings further ahead than back and bends while it comes forward."""
    return Arm(
        forward=swing * (ahead + 0.15),
        inward=0.25 * swing * (1 + ahead),
        bend=elbow + 0.35 * swing * (1 + ahead),
    )


def _stepping_foot(cycle: Tensor, delay: float, stride: float, gait: Gait, beat: Beat) -> Foot:
    own = cycle + delay
    landed = own.floor() - delay + gait.stance / 2 - beat.draw.phase
    swung = ((own - own.floor() - gait.stance) / (1 - gait.stance)).clamp(min=0)
    onward = eased(swung**gait.lateness)
    return Foot(
        aside=-0.035 - 0.5 * beat.draw.style.feet_apart,
        lift=keyed(own, gait.foot_times, gait.foot_lift),
        ahead=stride * (landed + onward) - gait.lead,
        pitch=keyed(own, gait.foot_times, gait.foot_pitch),
    )
