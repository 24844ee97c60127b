"""Acclaim's ASF and AMC: a skeleton and its motion in two files, as the same value as a BVH file.

The conventions are those of the format's definition (Schafer 1994) and of the CMU motion capture database. A bone
begins where its parent ends and runs along ``direction`` in the axes of the whole skeleton. Its angles turn it about
the axes of its own frame C, which ``axis`` gives: seen in the skeleton's axes the turn is C M C^-1. Both M and C are
made of turns about fixed axes, the first one listed done first. So in the zero pose of the result nothing is turned,
and the joint of a bone is where it begins.
"""

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.bvh import TYPICAL_REACH, UNITS, Bvh
from refine.formats.bvh_parsing import (
    AGAIN,
    CHANNEL_NAMES,
    MAX_JOINT_FRAMES,
    MAX_JOINTS,
    MAX_NAME,
    MAX_STILL_JOINT_FRAMES,
    MAX_VALUE,
    Lines,
)
from refine.formats.untrusted import opened
from renderers.checks import UserError
from renderers.rotations import euler_to_matrix

MAX_SKELETON = 1 << 20  # bytes
MAX_MOTION = 1 << 26
# The frame rate of nearly all clips of the CMU database; the files do not say it.
CMU_FPS = 120.0
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


def read_amc(path: str | Path, fps: float | None = None, unit: str | None = None) -> Bvh:
    """Read an AMC file on the skeleton of the ASF file beside it, see :func:`asf_beside`.

    Args:
        fps: frames per second, which the files do not say; that of the CMU database if it is not given.
        unit: a key of ``bvh.UNITS``; without it the unit that makes the skeleton most nearly of human size, the
            ASF's own factor considered.

    Raises:
        UserError: a file is missing, damaged, or larger than what is read, or they are not of one skeleton; the message
            names the line.
    """
    path = Path(path)
    skeleton = read_asf(asf_beside(path))
    order = _from_root(path, skeleton)
    with opened(path, MAX_MOTION) as stream:
        values, degrees = _motion(Lines(path, stream), skeleton, order)
    factor = math.pi / 180 if degrees else 1.0
    offsets, rotations, positions = _posed(skeleton, order, values, factor)
    unit, scale = _unit(skeleton, order, offsets, unit)
    leaves = [name for name in order if name not in skeleton.parents.values()]
    ends = [
        (order.index(name), tuple(scale * skeleton.bones[name].length * x for x in skeleton.bones[name].direction))
        for name in leaves
    ]
    turning = ("Zrotation", "Xrotation", "Yrotation")
    return Bvh(
        names=tuple(order),
        parents=tuple(order.index(skeleton.parents[name]) if name != ROOT else -1 for name in order),
        offsets=offsets * scale,
        channels=tuple(
            CHANNEL_NAMES[:3] + turning if name == ROOT else turning if skeleton.bones[name].dof else ()
            for name in order
        ),
        ends=tuple(ends),
        rotations=rotations,
        positions=positions * scale,
        fps=fps or CMU_FPS,
        unit=unit,
        source=str(path),
    )


def asf_beside(path: Path) -> Path:
    """The skeleton of a motion: the .asf of its name, else of the part before its last "_", else the only one there.

    Raises:
        UserError: there is none, or several of other names.
    """
    there = sorted(file for file in path.absolute().parent.iterdir() if file.suffix.lower() == ".asf")
    for stem in (path.stem, path.stem.rpartition("_")[0], path.stem.partition("_")[0]):
        for file in there:
            if stem and file.stem.lower() == stem.lower():
                return file
    if len(there) == 1:
        return there[0]
    problem = (
        f"none of the {len(there)} skeletons (.asf) beside it has its name" if there else "its skeleton is missing"
    )
    raise UserError(path, problem, f"put {path.stem.partition('_')[0]}.asf beside it")


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
        (skeleton.length,) = _numbers(words, 1)
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
        skeleton.position = _numbers(words, 3)
    elif key == "orientation":
        root.axis = _numbers(words, 3)


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
        bone.direction = _numbers(words, 3)
    elif key == "length":
        (bone.length,) = _numbers(words, 1)
    elif key == "axis":
        bone.axis, bone.axis_order = _numbers(words[:3], 3), _order(words[3] if len(words) > 3 else "xyz")
    elif key == "dof":
        bone.dof = _dof(words, TURNS)
    return bone


def _take_children(skeleton: Skeleton, words: list[str]) -> None:
    parent, *children = (word.lower() for word in words)
    for child in children:
        if parent not in skeleton.bones or child not in skeleton.bones or child in skeleton.parents or child == ROOT:
            raise ValueError("a bone that is not there, or has a parent")
        skeleton.parents[child] = parent


def _numbers(words: list[str], count: int) -> tuple[float, ...]:
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


def _from_root(path: Path, skeleton: Skeleton) -> list[str]:
    """The names of the bones, a parent before its children; what hangs nowhere is left out."""
    below: dict[str, list[str]] = {}
    for child, parent in skeleton.parents.items():
        below.setdefault(parent, []).append(child)
    order, waiting = [], [ROOT]
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(below.get(order[-1], []))
    if len(order) < 2:
        raise UserError(path, "its skeleton's :hierarchy says of no bone that it hangs from the root", AGAIN)
    return order


def _motion(lines: Lines, skeleton: Skeleton, order: list[str]) -> tuple[np.ndarray, bool]:
    """(the values [T columns] of the bones in ``order``, as on disk, whether angles are in degrees)."""
    first, columns = {}, 0
    for name in order:
        if skeleton.bones[name].dof:
            first[name] = columns
            columns += len(skeleton.bones[name].dof)
    degrees, values, frames = skeleton.degrees, array("d"), 0
    for row in _rows(lines, skeleton, first, columns):
        if isinstance(row, bool):
            degrees = row
            continue
        frames += 1
        if frames * len(order) > MAX_JOINT_FRAMES:
            raise UserError(lines.where, f"goes on after {frames} frames of {len(order)} bones", "cut it into clips")
        values.extend(row)
    if frames * (len(order) - len(first)) > MAX_STILL_JOINT_FRAMES:
        raise UserError(lines.path, f"has {frames} frames of {len(order)} bones, most of which do not move", AGAIN)
    if not frames:
        raise UserError(lines.path, "holds no frames", "give a clip with frames")
    return np.frombuffer(values, dtype=np.float64).reshape(frames, columns), degrees


def _rows(lines: Lines, skeleton: Skeleton, first: dict[str, int], columns: int) -> Iterator[list[float] | bool]:
    """The values of each frame; True or False where the file says degrees or radians."""
    row: list[float] = []
    seen: set[str] = set()
    started = False

    def finished() -> list[float]:
        if len(seen) < len(first):
            missing = next(name for name in first if name not in seen)
            raise UserError(lines.where, f"the frame before has no values of {missing}", AGAIN)
        return row

    for line in lines:
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        name = words[0].lower()
        if name.startswith(":"):
            if name in (":degrees", ":radians"):
                yield name == ":degrees"
        elif len(words) == 1 and name.isdecimal():
            if started:
                yield finished()
            started, row, seen = True, [0.0] * columns, set()
        else:
            place, count = first.get(name), len(words) - 1
            if not started or place is None or name in seen or count != len(skeleton.bones[name].dof):
                problem = f"'{line.strip()[:60]}' is not what the skeleton has" if started else "comes before any frame"
                raise UserError(lines.where, problem, "give the skeleton that it was recorded with")
            try:
                row[place : place + count] = _numbers(words[1:], count)
            except ValueError:
                raise UserError(lines.where, f"'{line.strip()[:60]}' is not all finite numbers", AGAIN) from None
            seen.add(name)
    if started:
        yield finished()


def _posed(skeleton: Skeleton, order: list[str], values: np.ndarray, factor: float) -> tuple[Tensor, Tensor, Tensor]:
    """Offsets [J 3], local rotations [T J 3 3] and positions [T J 3] in the file's unit."""
    numbers, frames = torch.from_numpy(values), len(values)
    offsets = torch.zeros(len(order), 3, dtype=torch.float64)
    rotations = torch.eye(3, dtype=torch.float64).repeat(frames, len(order), 1, 1)
    place, moves = 0, torch.zeros(frames, 3, dtype=torch.float64)
    for joint, name in enumerate(order):
        bone = skeleton.bones[name]
        if name != ROOT and (parent := skeleton.bones[skeleton.parents[name]]).name != ROOT:
            offsets[joint] = torch.tensor(parent.direction, dtype=torch.float64) * parent.length
        columns = {dof: numbers[:, place + index] for index, dof in enumerate(bone.dof)}
        place += len(columns)
        axes = [dof[1] for dof in bone.dof if dof in TURNS]
        frame = _fixed_axes(torch.tensor(bone.axis, dtype=torch.float64), bone.axis_order)
        if axes:
            angles = factor * torch.stack([columns[f"r{axis}"] for axis in axes], dim=-1)
            turn = _fixed_axes(angles, "".join(axes))
            rotations[:, joint] = turn @ frame if name == ROOT else frame @ turn @ frame.mT
        for axis in range(3) if name == ROOT else ():
            moves[:, axis] = columns.get(f"t{'xyz'[axis]}", moves[:, axis])
    positions = offsets.repeat(frames, 1, 1)
    positions[:, 0] = moves + torch.tensor(skeleton.position, dtype=torch.float64)
    return offsets, rotations, positions


def _fixed_axes(angles: Tensor, axes: str) -> Tensor:
    """[... n] radians -> [... 3 3]: turns about fixed axes, the first one done first."""
    return euler_to_matrix(angles.flip(-1), axes[::-1])


def _unit(skeleton: Skeleton, order: list[str], offsets: Tensor, unit: str | None) -> tuple[str, float]:
    """(unit, metres to a number of the file): lengths may be multiplied by the factor of :units or divided by it."""
    if unit:
        return unit, UNITS[unit]
    reach = dict.fromkeys(order, 0.0)
    for joint, name in enumerate(order[1:], start=1):
        reach[name] = reach[skeleton.parents[name]] + offsets[joint].norm().item()
    longest = max(reach[name] + skeleton.bones[name].length for name in order)
    factors = (1.0, skeleton.length, 1 / skeleton.length)
    scales = [(unit, metres * factor) for unit, metres in UNITS.items() for factor in factors]
    if longest < 1e-9:
        return "m", 1.0
    return min(scales, key=lambda scale: abs(math.log(longest * scale[1] / TYPICAL_REACH)))
