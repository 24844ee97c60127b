"""What is wrong with a clip, as far as its numbers tell: each oddity is a function with its threshold beside it.

All are made to keep quiet about real captures: what they say is worth a look, and what is worth a look they may miss.
NaN and infinity are no oddity but a refusal: no `Motion` holds them.
"""

import math
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from refine.motion import Motion
from renderers.rotations import heading
from renderers.skeleton import JOINT_NAMES, JOINTS, forward_kinematics

SHORTEST = 10, 0.3
"""Frames and seconds; a clip with less of either holds no action."""

RATES = (10, 12, 12.5, 15, 18, 20, 23.976, 24, 25, 29.97, 30, 48, 50, 59.94, 60, 75, 90, 100, 119.88, 120, 144, 150,
         180, 200, 240, 250, 300, 480)  # fmt: skip
RATE_OFF = 0.002
"""Frame rates of cameras and programs, and the share by which one may be off."""

FASTEST_PELVIS = 13.0
"""Metres a second: the fastest sprinters reach 12.4."""
FASTEST_JOINT = 25.0
"""Metres a second against the pelvis: wrists and feet of athletes who throw and kick reach 20."""
LEAP, LEAP_RATIO, LEAP_RATE = 0.15, 6.0, 20.0
"""A joint that moves this many metres from one frame to the next, and so many times less before and after, leaps; said
of clips with at least so many frames a second, where no muscle does that."""

STILL, MOVING = 1e-5, 1e-3
"""Metres: a frame in which no joint moves further than the first is a copy, one in which one moves further than the
second is not. Captures always tremble by more than the first."""
COPIES, COPIES_SHARE, COPIES_RUN = 2, 0.01, 5
"""At least so many copied frames, and this share of the clip; of runs no longer than this amid movement."""
FROZEN = 0.3
"""Seconds that a clip may rest in its last pose to the last digit."""

SLIDING, LOW = 0.8, 0.05
"""Metres a second that the slowest of the soles near the floor moves along it, in the middle of all frames with such
soles; near is within this many metres of the lowest that it reaches."""

LYING, LEGS_MOVE = 60.0, 0.5
"""Degrees from upright beyond which a trunk lies in the middle of all frames, and the mean metres a second of ankles
against the pelvis from which legs walk."""

BENT, BACKWARDS = 30.0, 0.5
"""Degrees from which a knee or elbow counts as bent, and the share of its bent frames in which it bends the wrong way
that is too large."""
CROSSED, CROSSED_SHARE = 0.05, 0.5
"""Metres by which the left ankle is to the right of the right one, and the share of frames with that."""
OTHER_SIDE = 4.0
"""How many times as much the other side's limb moves than the one that the label names."""
OTHER_TURN = 30.0
"""Degrees of a turn to the other side than the label's."""

FLOOR_OFF = 0.25
"""Metres between the soles, where they are lowest, and the floor at height 0."""

HEIGHTS = 0.9, 2.3
"""Metres, of a standing body; more or less is another unit of length, or an animal."""
UNEVEN = 0.15
"""Share by which a bone may be longer than its like on the other side."""

SOLES = [JOINTS[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")]
ANKLES = [JOINTS["left_ankle"], JOINTS["right_ankle"]]
# Words of a label, and the joint at whose end they look.
LIMB_WORDS = {"wrist": ("hand", "arm", "wave", "punch", "elbow", "shoulder"), "ankle": ("leg", "foot", "kick", "knee")}


class Oddity(NamedTuple):
    """One thing that is odd about a clip."""

    name: str
    text: str
    frame: int | None = None  # where it is seen first


class Seen(NamedTuple):
    """What the oddities look at."""

    motion: Motion
    joints: Tensor  # [T 24 3] world, metres, float64
    rest: Tensor  # [24 3] T-pose joints, metres, float64
    bones: Mapping[str, float]  # metres, of the skeleton in the file, as far as it has one

    @property
    def steps(self) -> Tensor:
        """[T-1] metres: how far the joint that moves furthest does from one frame to the next."""
        return self.joints.diff(dim=0).norm(dim=-1).amax(1)


def find(motion: Motion, rest_joints: Tensor, bones: Mapping[str, float] | None = None) -> list[Oddity]:
    """All oddities of a clip.

    Args:
        rest_joints: [24 3] T-pose joints in metres of the body that the clip is on.
        bones: lengths in metres in the file's own skeleton, by SMPL's name of the joint at the far end; and "height".
    """
    rest = rest_joints.detach().cpu().double()
    rotations, root = motion.rotations.detach().cpu().double(), motion.root.detach().cpu().double()
    seen = Seen(motion, forward_kinematics(rotations, root, rest)[0], rest, bones or {})
    found = [too_short(seen), odd_rate(seen), odd_body(seen)]
    if len(motion) > 2:
        found += [check(seen) for check in MOVING_CHECKS]
    return [oddity for oddity in found if oddity]


def too_short(seen: Seen) -> Oddity | None:
    """Fewer frames or seconds than `SHORTEST`."""
    frames, seconds = SHORTEST
    if len(seen.motion) < frames or seen.motion.seconds < seconds:
        return Oddity("too short", f"{len(seen.motion)} frames, {seen.motion.seconds:.2f} s")
    return None


def odd_rate(seen: Seen) -> Oddity | None:
    """A frame rate that is none of `RATES`."""
    if any(abs(seen.motion.fps - rate) <= RATE_OFF * rate for rate in RATES):
        return None
    return Oddity("odd frame rate", f"{seen.motion.fps:g} frames a second")


def jumps(seen: Seen) -> Oddity | None:
    """A joint that is faster than `FASTEST_PELVIS` or `FASTEST_JOINT`, or leaps, see `LEAP`; copied frames aside."""
    copied = [step + 1 for start, stop in _copies(seen) for step in range(start, stop)]
    kept = torch.tensor(sorted(set(range(len(seen.joints))) - set(copied)))
    joints = seen.joints[kept]
    relative = joints - joints[:, :1]
    relative[:, 0] = joints[:, 0]
    moved = relative.diff(dim=0).norm(dim=-1)  # [S 24]
    rate = seen.motion.fps / kept.diff()  # [S]
    limit = torch.full((len(JOINT_NAMES),), FASTEST_JOINT, dtype=moved.dtype)
    limit[0] = FASTEST_PELVIS
    odd = (moved * rate[:, None] > limit) | (_leaps(moved) & (rate[:, None] >= LEAP_RATE))
    if not odd.any():
        return None
    step = int(odd.any(1).nonzero()[0])
    joint = int((moved[step] * odd[step]).argmax())
    text = f"{JOINT_NAMES[joint]} moves {moved[step, joint]:.2f} m in a frame, in {int(odd.any(1).sum())} frames"
    return Oddity("jump", text, int(kept[step + 1]))


def _leaps(moved: Tensor) -> Tensor:
    """Steps [S 24] that are long, with short ones before and after; a leap and the leap back count as one."""
    padded = torch.cat([moved.new_zeros(2, 24), moved, moved.new_zeros(2, 24)])
    steps = len(moved)
    before2, before, after, after2 = (padded[k : k + steps] for k in (0, 1, 3, 4))
    small = moved / LEAP_RATIO
    alone = (before <= small) & (after <= small)
    there = (before <= small) & (after >= moved / 2) & (after2 <= small)
    back = (after <= small) & (before >= moved / 2) & (before2 <= small)
    return (moved >= LEAP) & (alone | there | back)


def copied_frames(seen: Seen) -> Oddity | None:
    """Frames that are copies of the one before amid movement, see `STILL` and `COPIES`: a rate that was faked."""
    amid = _copies(seen)
    count = sum(stop - start for start, stop in amid)
    if count < max(COPIES, COPIES_SHARE * len(seen.motion)):
        return None
    return Oddity("copied frames", f"{count} frames are the one before again", amid[0][0] + 1)


def frozen(seen: Seen) -> Oddity | None:
    """A clip that does not move at all, or stays in its last pose longer than `FROZEN`."""
    runs = _runs(seen.steps <= STILL)
    if not runs or runs[-1][1] != len(seen.steps):
        return None
    start, stop = runs[-1]
    if start == 0:
        return Oddity("still", "nothing moves")
    if (stop - start) / seen.motion.fps < FROZEN:
        return None
    return Oddity("frozen tail", f"the last {(stop - start) / seen.motion.fps:.1f} s are one pose", start + 1)


def sliding_feet(seen: Seen) -> Oddity | None:
    """Feet that stand and move along the floor, see `SLIDING`."""
    soles = seen.joints[:, SOLES]
    low = soles[..., 1] < soles[..., 1].amin(0) + LOW
    both = low[1:] & low[:-1]
    speeds = soles[..., [0, 2]].diff(dim=0).norm(dim=-1) * seen.motion.fps
    slowest = torch.where(both, speeds, torch.inf).amin(1)
    slowest = slowest[slowest.isfinite()]
    if len(slowest) < SHORTEST[0] or float(slowest.median()) < SLIDING:
        return None
    return Oddity("sliding feet", f"soles near the floor slide at {float(slowest.median()):.2f} m/s")


def wrong_up(seen: Seen) -> Oddity | None:
    """A body that lies while its legs walk, or is upside down, see `LYING`: another axis is up."""
    trunk = seen.joints[:, JOINTS["neck"]] - seen.joints[:, 0]
    lean = math.degrees(math.acos(max(-1.0, min(1.0, float((trunk[:, 1] / trunk.norm(dim=-1)).median())))))
    if lean > 180 - LYING:
        return Oddity("wrong up axis", "the body is upside down")
    legs = (seen.joints[:, ANKLES] - seen.joints[:, :1]).diff(dim=0).norm(dim=-1).mean() * seen.motion.fps
    if lean < LYING or float(legs) < LEGS_MOVE:
        return None
    return Oddity("wrong up axis", f"the trunk leans {lean:.0f} degrees while the legs walk")


def backwards_joints(seen: Seen) -> Oddity | None:
    """Knees or elbows that bend the wrong way, see `BENT`: left and right, or front and back, are exchanged."""
    wrong = []
    for joint, child, forward in (("knee", "ankle", -1.0), ("elbow", "wrist", 1.0)):
        for side in ("left", "right"):
            at, end = JOINTS[f"{side}_{joint}"], JOINTS[f"{side}_{child}"]
            bone = (seen.rest[end] - seen.rest[at]) / (seen.rest[end] - seen.rest[at]).norm()
            turned = seen.motion.rotations[:, at].detach().cpu().double() @ bone
            cosine = (turned @ bone).clamp(-1, 1)
            bent = cosine < math.cos(math.radians(BENT))
            against = forward * turned[:, 2] < -0.7 * (1 - cosine**2).sqrt()
            if int(bent.sum()) >= SHORTEST[0] and float(against[bent].double().mean()) > BACKWARDS:
                wrong.append(f"{side} {joint}")
    if not wrong:
        return None
    return Oddity("bends backwards", f"{' and '.join(wrong)} mostly the wrong way")


def crossed_legs(seen: Seen) -> Oddity | None:
    """The left foot mostly on the right, see `CROSSED`: left and right are exchanged."""
    to_left = seen.motion.rotations[:, 0, :, 0].detach().cpu().double()  # the pelvis' own x axis, to its left
    apart = ((seen.joints[:, ANKLES[0]] - seen.joints[:, ANKLES[1]]) * to_left).sum(-1)
    share = float((apart < -CROSSED).double().mean())
    return Oddity("crossed legs", f"in {share:.0%} of the frames") if share > CROSSED_SHARE else None


def other_side(seen: Seen) -> Oddity | None:
    """A label that says left where the right limb moves, or the other way round, see `OTHER_SIDE`."""
    words = set(re.split(r"[\W_\d]+", seen.motion.label.lower()))
    if len({"left", "right"} & words) != 1:
        return None
    side, other = ("left", "right") if "left" in words else ("right", "left")
    if "turn" in words:
        yaw = heading(seen.motion.rotations[:, 0].detach().cpu().double())
        steps = (yaw.diff() + math.pi) % (2 * math.pi) - math.pi
        turned = math.degrees(float(steps.sum())) * (1 if side == "left" else -1)
        return Oddity("other side", f"turns {other} by {-turned:.0f} degrees") if turned < -OTHER_TURN else None
    ends = [end for end, named in LIMB_WORDS.items() if any(word.startswith(named) for word in words)]
    if len(ends) != 1:
        return None
    relative = seen.joints - seen.joints[:, :1]
    moved = {s: float(relative[:, JOINTS[f"{s}_{ends[0]}"]].diff(dim=0).norm(dim=-1).mean()) for s in (side, other)}
    if moved[other] < OTHER_SIDE * max(moved[side], 1e-9):
        return None
    ratio = moved[other] / max(moved[side], 1e-9)
    return Oddity("other side", f"the {other} {ends[0]} moves {min(ratio, 999):.0f} times as much as the {side} one")


def floor_off(seen: Seen) -> Oddity | None:
    """Soles that are never near the floor, see `FLOOR_OFF`: another origin, or another unit."""
    height = float((seen.joints[:, SOLES, 1] - seen.rest[SOLES, 1]).amin(1).quantile(0.05))
    if abs(height) <= FLOOR_OFF:
        return None
    return Oddity("floor far off", f"the soles are {abs(height):.2f} m {'above' if height > 0 else 'below'} height 0")


def odd_body(seen: Seen) -> Oddity | None:
    """A skeleton that no person has, see `HEIGHTS` and `UNEVEN`."""
    height = seen.bones.get("height")
    if height is not None and not HEIGHTS[0] <= height <= HEIGHTS[1]:
        return Oddity("odd body", f"it would stand {height:.2f} m high")
    for name, length in seen.bones.items():
        if name.startswith("left_"):
            other = seen.bones.get(name.replace("left", "right", 1), length)
            if max(length, other) > (1 + UNEVEN) * min(length, other):
                problem = f"{length:.3f} m to the {name.replace('_', ' ')}, {other:.3f} m on the other side"
                return Oddity("odd body", problem)
    return None


def _copies(seen: Seen) -> list[tuple[int, int]]:
    """[first, behind the last) of short runs of steps in which nothing moves, between movement or at the beginning."""
    steps = seen.steps
    moving = steps > MOVING
    return [
        (start, stop)
        for start, stop in _runs(steps <= STILL)
        if (not start or moving[start - 1]) and stop < len(steps) and moving[stop] and stop - start <= COPIES_RUN
    ]


def _runs(flags: Tensor) -> list[tuple[int, int]]:
    """[first, behind the last) of every stretch of True in [N]."""
    edges = torch.cat([flags.new_zeros(1), flags, flags.new_zeros(1)]).int().diff()
    return list(zip((edges == 1).nonzero()[:, 0].tolist(), (edges == -1).nonzero()[:, 0].tolist(), strict=True))


MOVING_CHECKS: tuple[Callable[[Seen], Oddity | None], ...] = (
    jumps, copied_frames, frozen, sliding_feet, wrong_up, backwards_joints, crossed_legs, other_side, floor_off,
)  # fmt: skip
