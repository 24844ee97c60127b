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
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.asf import ROOT, TURNS, Skeleton, numbers_of, read_asf
from refine.formats.bvh import TYPICAL_REACH, UNITS, Bvh
from refine.formats.bvh_parsing import (
    AGAIN,
    CHANNEL_NAMES,
    MAX_JOINT_FRAMES,
    MAX_STILL_JOINT_FRAMES,
    Lines,
)
from refine.formats.untrusted import opened
from renderers.checks import UserError
from renderers.rotations import euler_to_matrix

MAX_MOTION = 1 << 26  # bytes
# The frame rate of nearly all clips of the CMU database; the files do not say it.
CMU_FPS = 120.0


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
    with opened(path, MAX_MOTION) as stream:
        skeleton = read_asf(asf_beside(path))
        order = _from_root(path, skeleton)
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
        fps=CMU_FPS if fps is None else fps,
        unit=unit,
        source=str(path),
    )


def asf_beside(path: Path) -> Path:
    """The skeleton of a motion: the .asf of its name, else of the part before its last "_", else the only one there.

    Raises:
        UserError: there is none, or several of other names.
    """
    try:
        there = sorted(file for file in path.absolute().parent.iterdir() if file.suffix.lower() == ".asf")
    except OSError as error:
        raise UserError(path.parent, f"cannot be looked through ({error.strerror})", "check the folder") from error
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
                row[place : place + count] = numbers_of(words[1:], count)
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
