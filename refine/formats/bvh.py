"""BVH: any hierarchy, any channel order, any unit of length, in and out.

A joint's rotation is the product of its elementary rotations in the order its channels are listed, and position
channels take the place of its OFFSET (protocol A.8). On disk angles are degrees and lengths have an unknown
unit; inside they are matrices and metres.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.motion import Motion
from renderers.checks import UserError, check_finite, check_shapes
from renderers.outputs import replacing
from renderers.rotations import euler_to_matrix, matrix_to_euler
from renderers.skeleton import JOINT_NAMES, PARENTS

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
CHANNEL_NAMES = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
# An adult's longest chain of bones, from where the limbs branch off to the toes or the fingertips, in metres.
TYPICAL_REACH = 1.0

MAX_BYTES = 1 << 29
MAX_JOINTS = 1024
MAX_DEPTH = 256
MAX_JOINT_FRAMES = 4_000_000


@dataclass(frozen=True, eq=False)
class Bvh:
    """One BVH file.

    Attributes:
        names: J joint names, a parent before its children.
        parents: J indices, -1 for the root.
        offsets: [J 3] OFFSETs in metres.
        channels: J tuples of channel names, each in the order of the file.
        ends: End Sites as (joint index, offset in metres).
        rotations: [T J 3 3] local rotations.
        positions: [T J 3] local positions in metres: the position channels, the OFFSET where there are none.
        fps: frames per second.
        unit: the unit of length on disk, a key of ``UNITS``.
        source: the file, for messages.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Tensor
    channels: tuple[tuple[str, ...], ...]
    ends: tuple[tuple[int, tuple[float, float, float]], ...]
    rotations: Tensor
    positions: Tensor
    fps: float
    unit: str = "cm"
    source: str = "bvh"

    def __len__(self) -> int:
        return self.rotations.shape[0]


def world(bvh: Bvh) -> tuple[Tensor, Tensor]:
    """World joints [T J 3] in metres and world rotations [T J 3 3]."""
    joints, rotations = [], []
    for joint, parent in enumerate(bvh.parents):
        position, rotation = bvh.positions[:, joint], bvh.rotations[:, joint]
        if parent >= 0:
            position = joints[parent] + (rotations[parent] @ position[..., None])[..., 0]
            rotation = rotations[parent] @ rotation
        joints.append(position)
        rotations.append(rotation)
    return torch.stack(joints, dim=1), torch.stack(rotations, dim=1)


def read_bvh(path: str | Path, unit: str | None = None) -> Bvh:
    """Read a BVH file.

    Args:
        unit: a key of ``UNITS``; without it the unit that makes the skeleton most nearly of human size.

    Raises:
        UserError: the file is missing, empty, cut short, not BVH, holds values that are not finite, or claims more
            than the limits of this module; the message names the line.
    """
    path = Path(path)
    lines = _lines(path)
    statements = enumerate(lines, start=1)
    tree = _hierarchy(path, statements)
    frames = _field(path, statements, "Frames:", int)
    seconds = _field(path, statements, "Frame Time:", float)
    if frames <= 0:
        raise UserError(path, f"has {frames} frames", "give a clip with frames")
    if not 0 < seconds < math.inf:
        raise UserError(path, f"Frame Time {seconds} is not a time in seconds", "set it to 1 / frame rate")
    if frames * len(tree.names) > MAX_JOINT_FRAMES:
        problem = f"claims {frames} frames of {len(tree.names)} joints, more than {MAX_JOINT_FRAMES} joints in all"
        raise UserError(path, problem, "cut it into shorter clips")
    values = torch.from_numpy(_values(path, statements, frames, tree))
    offsets = torch.tensor(tree.offsets, dtype=torch.float64)
    unit = unit or _guess_unit(tree)
    rotations, positions = _local(values, tree, offsets)
    return Bvh(
        names=tuple(tree.names),
        parents=tuple(tree.parents),
        offsets=offsets * UNITS[unit],
        channels=tuple(tree.channels),
        ends=tuple((joint, tuple(x * UNITS[unit] for x in offset)) for joint, offset in tree.ends),
        rotations=rotations,
        positions=positions * UNITS[unit],
        fps=_rate(seconds),
        unit=unit,
        source=str(path),
    )


def write_bvh(path: str | Path, motion: Motion, rest_joints: Tensor) -> None:
    """Write a motion on a skeleton with T-pose joints [24 3] in metres: smplx's joint names, centimetres."""
    with replacing(path) as partial:
        partial.write_text(bvh_text(motion_to_bvh(motion, rest_joints)))


def motion_to_bvh(motion: Motion, rest_joints: Tensor) -> Bvh:
    """The motion on a skeleton with T-pose joints [24 3] in metres, leaves prolonged by an End Site."""
    check_shapes("motion_to_bvh", rest_joints=(rest_joints, "24 3"))
    rest = rest_joints.detach().to("cpu", torch.float64)
    offsets = torch.stack([rest[joint] - rest[max(parent, 0)] for joint, parent in enumerate(PARENTS)])
    positions = offsets.repeat(len(motion), 1, 1)
    positions[:, 0] = motion.root.detach().to(positions)
    turning = ("Zrotation", "Xrotation", "Yrotation")
    return Bvh(
        names=JOINT_NAMES,
        parents=PARENTS,
        offsets=offsets,
        channels=(CHANNEL_NAMES[:3] + turning,) + (turning,) * (len(JOINT_NAMES) - 1),
        ends=tuple(
            (joint, tuple((offsets[joint] / 2).tolist())) for joint in range(len(PARENTS)) if joint not in PARENTS
        ),
        rotations=motion.rotations.detach().to(positions),
        positions=positions,
        fps=motion.fps,
        source=motion.source,
    )


def bvh_text(bvh: Bvh) -> str:
    """The file's text; joints come depth first, as the format wants them.

    Six decimals of a centimetre and of a degree keep a chain of ten bones within a micrometre.
    """
    scale = 1 / UNITS[bvh.unit]
    header, order = ["HIERARCHY"], []

    def describe(joint: int, depth: int) -> None:
        pad = "  " * depth
        order.append(joint)
        header.extend([f"{pad}{'JOINT' if depth else 'ROOT'} {bvh.names[joint]}", pad + "{"])
        header.append(f"{pad}  OFFSET {_numbers(bvh.offsets[joint] * scale)}")
        header.append(f"{pad}  CHANNELS {' '.join((str(len(bvh.channels[joint])), *bvh.channels[joint]))}")
        for child, parent in enumerate(bvh.parents):
            if parent == joint:
                describe(child, depth + 1)
        for owner, offset in bvh.ends:
            if owner == joint:
                end = _numbers(torch.tensor(offset) * scale)
                header.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET {end}", f"{pad}  }}"])
        header.append(pad + "}")

    describe(0, 0)
    values = torch.cat([_channel_values(bvh, joint, scale) for joint in order], dim=1)
    header += ["MOTION", f"Frames: {len(bvh)}", f"Frame Time: {1 / bvh.fps:.9f}"]
    return "\n".join([*header, *map(_numbers, values)]) + "\n"


def _numbers(values: Tensor) -> str:
    return " ".join(f"{value:.6f}" for value in values.tolist())


def _channel_values(bvh: Bvh, joint: int, scale: float) -> Tensor:
    """[T channels of the joint] in the file's unit and degrees."""
    axes = _rotation_axes(bvh.channels[joint])
    angles = torch.rad2deg(matrix_to_euler(bvh.rotations[:, joint], axes)) if axes else bvh.rotations.new_empty(0, 0)
    columns = []
    for name in bvh.channels[joint]:
        axis = name[0].lower()
        position = name.endswith("position")
        columns.append(bvh.positions[:, joint, "xyz".index(axis)] * scale if position else angles[:, axes.index(axis)])
    return torch.stack(columns, dim=1) if columns else bvh.positions.new_empty(len(bvh), 0)


def _rotation_axes(channels: tuple[str, ...]) -> str:
    return "".join(name[0].lower() for name in channels if name.endswith("rotation"))


@dataclass
class _Tree:
    """The HIERARCHY section while it is read, in the file's unit."""

    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[tuple[float, ...]] = field(default_factory=list)
    channels: list[tuple[str, ...]] = field(default_factory=list)
    ends: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)
    opened: list[int | None] = field(default_factory=list)  # joints whose braces are open, None for an End Site
    declared: list[int | None] = field(default_factory=list)  # what the next brace opens, if anything

    @property
    def columns(self) -> list[tuple[int, str]]:
        """(joint, channel name) of every value of a frame."""
        return [(joint, name) for joint, names in enumerate(self.channels) for name in names]

    def take(self, where: str, key: str, words: list[str]) -> bool:
        """Take one statement in; False if it does not belong here."""
        joint = self.opened[-1] if self.opened else None
        if bool(self.declared) != (key == "{"):
            return False
        match key:
            case "HIERARCHY":
                return not self.names
            case "ROOT" if words and not self.names:
                self._declare(where, " ".join(words), -1)
            case "JOINT" if words and joint is not None:
                self._declare(where, " ".join(words), joint)
            case "END" if joint is not None:
                self.declared.append(None)
            case "{" if len(self.opened) < MAX_DEPTH:
                self.opened.append(self.declared.pop())
            case "}" if self.opened:
                self.opened.pop()
            case "OFFSET" if joint is not None:
                self.offsets[joint] = _offset(where, words)
            case "OFFSET" if self.opened:
                self.ends.append((self.opened[-2], _offset(where, words)))
            case "CHANNELS" if joint is not None:
                self.channels[joint] = _channels(where, words)
            case _:
                return False
        return True

    def _declare(self, where: str, name: str, parent: int) -> None:
        if name in self.names:
            raise UserError(where, f"a second joint is called '{name}'", "rename one")
        if len(self.names) == MAX_JOINTS:
            raise UserError(where, f"more than {MAX_JOINTS} joints", "export fewer joints")
        self.declared.append(len(self.names))
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append((0.0, 0.0, 0.0))
        self.channels.append(())


def _lines(path: Path) -> list[str]:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UserError(
                path, f"has {size} bytes, more than the {MAX_BYTES} that are read", "cut it into shorter clips"
            )
        raw = path.read_bytes()
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not raw.strip():
        raise UserError(path, "is empty", "give a BVH file")
    if b"\0" in raw[:4096] or not raw.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper() == b"HIERARCHY":
        raise UserError(path, "is not a BVH file: it does not begin with HIERARCHY", "give a BVH file")
    return raw.decode("utf-8-sig", errors="replace").splitlines()


def _hierarchy(path: Path, lines: Iterator[tuple[int, str]]) -> _Tree:
    """Read up to and with the line MOTION."""
    tree, number = _Tree(), 0
    for number, line in lines:
        for statement in filter(None, (part.strip() for part in re.split(r"([{}])", line))):
            key, *words = statement.split()
            if key.upper() == "MOTION" and tree.names and not tree.opened:
                if not tree.columns:
                    raise UserError(path, "no joint has channels", "export the animation too")
                return tree
            where = f"{path}, line {number}"
            if not tree.take(where, key.upper(), words):
                problem = f"'{statement[:40]}' does not belong here, {len(tree.opened)} braces deep"
                raise UserError(where, problem, "export the file again")
    raise UserError(f"{path}, line {number}", "the file ends inside its HIERARCHY", "export the file again")


def _offset(where: str, words: list[str]) -> tuple[float, ...]:
    try:
        x, y, z = map(float, words)
    except ValueError:
        raise UserError(where, f"OFFSET takes three numbers, got '{' '.join(words)[:40]}'", "export again") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise UserError(where, f"OFFSET {' '.join(words)} is not finite", "export the file again")
    return x, y, z


def _channels(where: str, words: list[str]) -> tuple[str, ...]:
    names = tuple(word.capitalize() for word in words[1:])
    if not words or words[0] != str(len(names)):
        problem = f"CHANNELS promises {words[0] if words else 'no number of'} channels and lists {len(names)}"
        raise UserError(where, problem, "export the file again")
    if len(set(names)) < len(names) or not set(names) <= set(CHANNEL_NAMES):
        problem = f"unknown or repeated channel in '{' '.join(names)[:99]}'"
        raise UserError(where, problem, f"known are {' '.join(CHANNEL_NAMES)}")
    return names


def _field(path: Path, lines: Iterator[tuple[int, str]], name: str, kind: type):
    number = 0
    for number, line in lines:
        if line.strip():
            head, colon, value = line.partition(":")
            try:
                if (head.strip() + colon).lower() != name.lower():
                    raise ValueError
                return kind(value)
            except ValueError:
                problem = f"expected '{name} number', got '{line.strip()[:40]}'"
                raise UserError(f"{path}, line {number}", problem, "export the file again") from None
    raise UserError(path, f"ends before its '{name}' line", "export the file again")


def _values(path: Path, lines: Iterator[tuple[int, str]], frames: int, tree: _Tree) -> np.ndarray:
    """[T columns] as on disk."""
    rows = [(number, line) for number, line in lines if line.strip()]
    if len(rows) != frames:
        where = f"{path}, line {rows[-1][0]}" if rows else path
        raise UserError(where, f"holds {len(rows)} frames, its Frames line claims {frames}", "export the file again")
    columns = tree.columns
    try:
        values = np.loadtxt([line for _, line in rows], dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        values = None
    if values is None or values.shape[1] != len(columns):
        raise _bad_row(path, rows, tree)
    names = tuple(f"{tree.names[joint]} {channel}" for joint, channel in columns)
    check_finite(path, values, "frame channel", {"channel": names})
    return values


def _bad_row(path: Path, rows: list[tuple[int, str]], tree: _Tree) -> UserError:
    """Name the first row that made the fast reading fail."""
    columns = tree.columns
    for frame, (number, line) in enumerate(rows):
        words = line.split()
        where = f"{path}, line {number} (frame {frame})"
        for word, (joint, channel) in zip(words, columns, strict=False):
            try:
                float(word.replace("_", "?"))  # Python reads 1_0 as ten, NumPy does not read it
            except ValueError:
                problem = f"'{word[:20]}' is not a number ({tree.names[joint]} {channel})"
                return UserError(where, problem, "export the file again")
        if len(words) != len(columns):
            problem = f"has {len(words)} values, the hierarchy has {len(columns)} channels"
            return UserError(where, problem, "the file is cut short or damaged: export it again")
    return UserError(path, "its motion cannot be read as numbers", "export the file again")


def _rate(seconds: float) -> float:
    """Frames per second; a Frame Time cut to a few digits, such as 0.0333333, means a whole number."""
    rate = 1 / seconds
    return float(round(rate)) if abs(rate - round(rate)) < 2e-4 * rate else round(rate, 3)


def _guess_unit(tree: _Tree) -> str:
    """The unit in which the skeleton's longest chain is nearest to a person's.

    The root may hang on a long offset from the origin, so chains are measured from the first joint that branches.
    """
    children = [tree.parents.count(joint) for joint in range(len(tree.names))]
    trunk = next((joint for joint, count in enumerate(children) if count > 1), 0)
    reach = {trunk: 0.0}
    for joint, parent in enumerate(tree.parents):
        if parent in reach:
            reach[joint] = reach[parent] + math.hypot(*tree.offsets[joint])
    longest = max([*reach.values(), *(reach.get(joint, 0.0) + math.hypot(*offset) for joint, offset in tree.ends)])
    if longest == 0:
        return "m"
    return min(UNITS, key=lambda unit: abs(math.log(longest * UNITS[unit] / TYPICAL_REACH)))


def _local(values: Tensor, tree: _Tree, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Local rotations [T J 3 3] and positions [T J 3] in the file's unit; joints with equal channels go together."""
    frames, joints = values.shape[0], len(tree.names)
    rotations = torch.eye(3, dtype=values.dtype).repeat(frames, joints, 1, 1)
    positions = offsets.repeat(frames, 1, 1)
    column = {key: index for index, key in enumerate(tree.columns)}
    for channels in set(tree.channels):
        members = [joint for joint, names in enumerate(tree.channels) if names == channels]
        turning = [name for name in channels if name.endswith("rotation")]
        if turning:
            angles = values[:, [[column[joint, name] for name in turning] for joint in members]]
            rotations[:, members] = euler_to_matrix(torch.deg2rad(angles), _rotation_axes(channels))
        for name in set(channels) - set(turning):
            positions[:, members, "XYZ".index(name[0])] = values[:, [column[joint, name] for joint in members]]
    return rotations, positions
