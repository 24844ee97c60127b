"""Skeletons that are known: by the frames of their joints, or only by the names of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from renderers.skeleton import JOINT_NAMES

Vector = tuple[float, float, float]

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SIDES = ("left", "right")

# The bones that must point where the source's do, as SMPL joint -> the joint at the bone's far end.
LIMBS = {
    f"{side}_{joint}": f"{side}_{child}"
    for side in SIDES
    for joint, child in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
}


@dataclass(frozen=True)
class Place:
    """Where an SMPL joint is found: the source joint, and two of its local directions in SMPL's T-pose."""

    joint: str
    up: Vector
    forward: Vector


@dataclass(frozen=True)
class Skeleton:
    """A skeleton whose joints' frames are known.

    Attributes:
        places: SMPL joint -> place in the source. A joint in neither table turns with its parent.
        between: SMPL joint -> (joint before, joint after, share): turns that share of the way between two others.
        grounded: whether the file's floor is looked for and put under SMPL's soles; otherwise heights are only scaled.
        up: the axis of the file that points up.
    """

    name: str
    places: Mapping[str, Place]
    between: Mapping[str, tuple[str, str, float]]
    grounded: bool
    up: str = "y"

    @property
    def joints(self) -> dict[str, str]:
        """SMPL joint -> source joint."""
        return {name: place.joint for name, place in self.places.items()}


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
# All that is known to the frame of each joint.
SKELETONS = (BANDAI_NAMCO, SMPL)
