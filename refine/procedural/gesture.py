"""What an action asks of each limb, as deviations from the standing posture. Deviations add.

Angles in radians, lengths in leg lengths (hip to ankle), so that a gesture fits any body. Every field is [T] or a
number. Arms and feet are described anatomically: the same numbers on left and right are mirror images.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

Curve = Tensor | float


@dataclass(frozen=True)
class Deviation:
    """Base of the limbs' values: arithmetic field by field."""

    def __add__(self, other):
        return type(self)(*(mine + its for mine, its in zip(self.values, other.values, strict=True)))

    def __sub__(self, other):
        return type(self)(*(mine - its for mine, its in zip(self.values, other.values, strict=True)))

    def __mul__(self, factor: float):
        return type(self)(*(value * factor for value in self.values))

    @property
    def values(self) -> tuple[Curve, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))

    def mean(self):
        """The same with every curve replaced by its mean over time."""
        return type(self)(*(value.mean() if isinstance(value, Tensor) else value for value in self.values))

    def stacked(self, like: Tensor) -> dict[str, Tensor]:
        """Every field by its name as a curve [T], with frames, dtype and device of ``like`` [T ...]."""
        zero = like.new_zeros(like.shape[0])
        return {field.name: (zero + value).to(like) for field, value in zip(fields(self), self.values, strict=True)}


@dataclass(frozen=True)
class Torso(Deviation):
    """Spine and head relative to the pelvis: pitch forward, turn to the left, tilt to the right."""

    lean: Curve = 0.0
    turn: Curve = 0.0
    tilt: Curve = 0.0
    nod: Curve = 0.0
    look: Curve = 0.0
    head_tilt: Curve = 0.0


@dataclass(frozen=True)
class Arm(Deviation):
    """One arm relative to the chest.

    ``forward`` and ``sideways`` are the rotation vector that raises the upper arm (90 degrees of one: level),
    ``inward`` turns the arm about itself, ``bend`` is the elbow's, ``wrist`` flexes the hand towards the palm,
    ``wave`` moves it towards the thumb.
    """

    forward: Curve = 0.0
    sideways: Curve = 0.0
    inward: Curve = 0.0
    bend: Curve = 0.0
    wrist: Curve = 0.0
    wave: Curve = 0.0


@dataclass(frozen=True)
class Pelvis(Deviation):
    """Place (x to the body's left, y up, z ahead) and orientation of the pelvis in the world."""

    x: Curve = 0.0
    y: Curve = 0.0
    z: Curve = 0.0
    lean: Curve = 0.0
    turn: Curve = 0.0
    tilt: Curve = 0.0


@dataclass(frozen=True)
class Foot(Deviation):
    """One foot in the world: where it treads (``aside`` outward, ``ahead``), how high, how turned.

    ``pitch`` rolls it over the ball (positive, heel up) or over the heel (negative), ``out`` turns the toes out. A foot
    with ``lift`` 0 touches the floor whatever its pitch.
    """

    aside: Curve = 0.0
    lift: Curve = 0.0
    ahead: Curve = 0.0
    pitch: Curve = 0.0
    out: Curve = 0.0


@dataclass(frozen=True)
class Gesture(Deviation):
    """All limbs at once. The pelvis goes with the feet: whoever owns the legs carries the body."""

    torso: Torso = Torso()
    left_arm: Arm = Arm()
    right_arm: Arm = Arm()
    pelvis: Pelvis = Pelvis()
    left_foot: Foot = Foot()
    right_foot: Foot = Foot()


def both_arms(arm: Arm) -> dict[str, Arm]:
    return {"left_arm": arm, "right_arm": arm}


def leg_swing(angle: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """(ahead, lift) of a foot on a leg swung forward by ``angle`` and ``reach`` long (1: straight)."""
    return reach * torch.sin(angle), 1 - reach * torch.cos(angle)
