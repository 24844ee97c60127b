"""The text of an Acclaim skeleton (ASF): bones with their frames and their hierarchy."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from refine.formats.bvh_parsing import AGAIN, MAX_JOINTS, MAX_NAME, MAX_VALUE, Lines
from refine.formats.untrusted import opened
from renderers.checks import UserError

MAX_SKELETON = 1 << 20  # bytes
ROOT = "root"
TURNS, MOVES = ("rx", "ry", "rz"), ("tx", "ty", "tz")


@dataclass
class Bone:
    """One bone as the ASF has it, in its unit and in radians."""

    name: str
    direction: tuple[float, ...] = (0.0, 0.0, 0.0)
    length: float = 0.0
    axis: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis_order: str = "xyz"
    dof: tuple[str, ...] = ()


@dataclass
class Skeleton:
    """An ASF file: the root first in ``bones``, parents by name; ``length`` as in :units."""

    bones: dict[str, Bone] = field(default_factory=dict)
    parents: dict[str, str] = field(default_factory=dict)
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    degrees: bool = True
    length: float = 1.0


def read_asf(path: str | Path) -> Skeleton:
    """Read an ASF file.

    Raises:
        UserError: it is missing, too large, or damaged; the message names the line.
    """
    skeleton, section, bone = Skeleton(bones={ROOT: Bone(ROOT)}), "", None
    with opened(path, MAX_SKELETON) as stream:
        lines = Lines(path, stream)
        for line in lines:
            words = line.partition("#")[0].translate(str.maketrans("(),", "   ")).split()
            if not words:
                continue
            key = words[0].lower()
            if key.startswith(":"):
                section, bone = key, None
                continue
            try:
                if section == ":units":
                    _take_unit(skeleton, key, words[1:])
                elif section == ":root":
                    _take_root(skeleton, key, words[1:])
                elif section == ":bonedata":
                    bone = _take_bone(skeleton, bone, key, words[1:])
                elif section == ":hierarchy" and key not in ("begin", "end"):
                    _take_children(skeleton, words)
            except (ValueError, IndexError) as error:
                problem = f"'{' '.join(words)[:60]}' does not belong here ({str(error)[:80]})"
                raise UserError(lines.where, problem, AGAIN) from None
    if len(skeleton.bones) < 2:
        raise UserError(path, "holds no bones", "give an Acclaim skeleton (.asf)")
    return _in_radians(skeleton)


def _take_unit(skeleton: Skeleton, key: str, words: list[str]) -> None:
    if key == "length":
        (skeleton.length,) = numbers_of(words, 1)
        if not 1e-6 < skeleton.length < 1e6:
            raise ValueError("no factor of lengths")
    elif key == "angle":
        skeleton.degrees = words[0].lower().startswith("deg")


def _take_root(skeleton: Skeleton, key: str, words: list[str]) -> None:
    root = skeleton.bones[ROOT]
    if key == "order":
        root.dof = _dof(words, (*MOVES, *TURNS))
    elif key == "axis":
        root.axis_order = _order(words[0])
    elif key == "position":
        skeleton.position = numbers_of(words, 3)
    elif key == "orientation":
        root.axis = numbers_of(words, 3)


def _take_bone(skeleton: Skeleton, bone: Bone | None, key: str, words: list[str]) -> Bone | None:
    """The bone whose description goes on."""
    if key == "begin":
        return Bone("")
    if key == "end":
        if bone is None or not bone.name:
            raise ValueError("a bone without a name")
        return None
    if bone is None:
        return None  # "limits" goes on over lines, and what is unknown is nobody's
    if key == "name":
        bone.name = words[0].lower()
        if bone.name in skeleton.bones or len(bone.name) > MAX_NAME or len(skeleton.bones) >= MAX_JOINTS:
            raise ValueError("a second bone of this name, a name too long, or a bone too many")
        skeleton.bones[bone.name] = bone
    elif key == "direction":
        bone.direction = numbers_of(words, 3)
    elif key == "length":
        (bone.length,) = numbers_of(words, 1)
    elif key == "axis":
        bone.axis, bone.axis_order = numbers_of(words[:3], 3), _order(words[3] if len(words) > 3 else "xyz")
    elif key == "dof":
        bone.dof = _dof(words, TURNS)
    return bone


def _take_children(skeleton: Skeleton, words: list[str]) -> None:
    parent, *children = (word.lower() for word in words)
    for child in children:
        if parent not in skeleton.bones or child not in skeleton.bones or child in skeleton.parents or child == ROOT:
            raise ValueError("a bone that is not there, or has a parent")
        skeleton.parents[child] = parent


def numbers_of(words: list[str], count: int) -> tuple[float, ...]:
    """So many finite numbers of a sensible size, else a ValueError."""
    values = tuple(map(float, words))
    if len(values) != count or not all(abs(value) <= MAX_VALUE for value in values):
        raise ValueError(f"{count} finite numbers expected")
    return values


def _order(word: str) -> str:
    if sorted(word.lower()) != ["x", "y", "z"]:
        raise ValueError("no order of axes")
    return word.lower()


def _dof(words: list[str], known: tuple[str, ...]) -> tuple[str, ...]:
    dof = tuple(word.lower() for word in words)
    if not set(dof) <= set(known) or len(set(dof)) < len(dof):
        raise ValueError(f"known are {' '.join(known)}")
    return dof


def _in_radians(skeleton: Skeleton) -> Skeleton:
    factor = math.pi / 180 if skeleton.degrees else 1.0
    for bone in skeleton.bones.values():
        bone.axis = tuple(factor * angle for angle in bone.axis)
        size = math.hypot(*bone.direction)
        bone.direction = tuple(x / size for x in bone.direction) if size > 1e-9 else (0.0, 0.0, 0.0)
    root = skeleton.bones[ROOT]
    root.dof = root.dof or (*MOVES, *TURNS)
    return skeleton
