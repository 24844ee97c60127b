"""The text of a BVH file, read line by line: nothing is kept that the file has not shown, and every limit is met before
memory is taken."""

import io
import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from renderers.checks import UserError, check_finite

CHANNEL_NAMES = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")

MAX_JOINTS = 1024
MAX_DEPTH = 256
MAX_JOINT_FRAMES = 4_000_000
MAX_STILL_JOINT_FRAMES = 1_000_000  # of joints without channels, for which the file need not hold anything
MAX_STATEMENTS = 50_000  # of a hierarchy
MAX_LINE = 1 << 18  # characters
MAX_EMPTY = 20_000  # lines without statements, beyond as many as there are with them
EMPTY = "\n#:"  # how they begin
MAX_NAME = 256
MAX_VALUE = 1e9  # of a length in any unit, or of an angle in degrees
AGAIN = "export the file again"


@dataclass
class Tree:
    """The HIERARCHY section, in the file's unit: names, parents, OFFSETs and channels by joint, and End Sites as
    (joint, offset)."""

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
        if len(name) > MAX_NAME:
            raise UserError(where, f"a joint's name has {len(name)} characters", "give it a shorter one")
        if name in self.names:
            raise UserError(where, f"a second joint is called '{name}'", "rename one")
        if len(self.names) == MAX_JOINTS:
            raise UserError(where, f"more than {MAX_JOINTS} joints", "export fewer joints")
        self.declared.append(len(self.names))
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append((0.0, 0.0, 0.0))
        self.channels.append(())


class Lines:
    """The lines of a text file in UTF-8, counted from 1; ``number`` is that of the last one given."""

    def __init__(self, path: str | Path, stream: BinaryIO):
        self.path, self.number = path, 0
        self._text = io.TextIOWrapper(stream, "utf-8-sig", errors="replace")

    def __iter__(self) -> Iterator[str]:
        empty = 0
        try:
            while line := self._text.readline(MAX_LINE):
                self.number += 1
                if len(line) == MAX_LINE:
                    raise UserError(self.where, f"is longer than {MAX_LINE} characters", AGAIN)
                empty += line[0] in EMPTY
                if empty > self.number / 2 + MAX_EMPTY:
                    raise UserError(self.where, "comes after more empty lines than others", AGAIN)
                yield line
        finally:
            with suppress(ValueError):  # it may be closed already, by who opened it
                self._text.detach()

    @property
    def where(self) -> str:
        return f"{self.path}, line {self.number}"


def parse_bvh(path: str | Path, stream: BinaryIO) -> tuple[Tree, float, np.ndarray]:
    """The hierarchy, the seconds of a frame, and the values [T columns] as they are on disk.

    Raises:
        UserError: the file is cut short, holds something else or values that are not finite, or claims more than the
            limits of this module; the message names the line.
    """
    lines = Lines(path, stream)
    statements = iter(lines)
    tree = _hierarchy(lines, statements)
    frames = _field(lines, statements, "Frames:", int)
    seconds = _field(lines, statements, "Frame Time:", float)
    if frames <= 0:
        raise UserError(path, f"has {frames} frames", "give a clip with frames")
    if not 1e-4 < seconds < 1e4:
        raise UserError(path, f"Frame Time {seconds} is not a time in seconds", "set it to 1 / frame rate")
    joints = len(tree.names)
    if frames * joints > MAX_JOINT_FRAMES:
        problem = f"claims {frames} frames of {joints} joints, more than {MAX_JOINT_FRAMES} joints in all"
        raise UserError(path, problem, "cut it into shorter clips")
    if frames * tree.channels.count(()) > MAX_STILL_JOINT_FRAMES:
        raise UserError(path, f"claims {frames} frames of {joints} joints, most without channels", AGAIN)
    return tree, seconds, _values(lines, statements, frames, tree)


def _hierarchy(lines: Lines, statements: Iterator[str]) -> Tree:
    """Read up to and with the line MOTION."""
    tree, count = Tree(), 0
    for line in statements:
        for statement in filter(None, (part.strip() for part in re.split(r"([{}])", line))):
            count += 1
            key, *words = statement.split()
            if key.upper() == "MOTION" and tree.names and not tree.opened:
                if not tree.columns:
                    raise UserError(lines.path, "no joint has channels", "export the animation too")
                return tree
            if count > MAX_STATEMENTS or not tree.take(lines.where, key.upper(), words):
                problem = f"'{statement[:40]}' does not belong here, {len(tree.opened)} braces deep"
                raise UserError(lines.where, problem, AGAIN)
    raise UserError(lines.where, "the file ends inside its HIERARCHY", AGAIN)


def _offset(where: str, words: list[str]) -> tuple[float, ...]:
    try:
        x, y, z = map(float, words)
    except ValueError:
        raise UserError(where, f"OFFSET takes three numbers, got '{' '.join(words)[:40]}'", AGAIN) from None
    if not all(map(math.isfinite, (x, y, z))):
        raise UserError(where, f"OFFSET {' '.join(words)[:99]} is not finite", AGAIN)
    if max(abs(x), abs(y), abs(z)) > MAX_VALUE:
        raise UserError(where, f"OFFSET {' '.join(words)[:99]} is larger than any body", AGAIN)
    return x, y, z


def _channels(where: str, words: list[str]) -> tuple[str, ...]:
    names = tuple(word.capitalize() for word in words[1:])
    if not words or words[0] != str(len(names)):
        problem = f"CHANNELS promises {words[0][:20] if words else 'no number of'} channels and lists {len(names)}"
        raise UserError(where, problem, AGAIN)
    if len(set(names)) < len(names) or not set(names) <= set(CHANNEL_NAMES):
        problem = f"unknown or repeated channel in '{' '.join(names)[:99]}'"
        raise UserError(where, problem, f"known are {' '.join(CHANNEL_NAMES)}")
    return names


def _field(lines: Lines, statements: Iterator[str], name: str, kind: type):
    for line in statements:
        if line.strip():
            head, colon, value = line.partition(":")
            try:
                if (head.strip() + colon).lower() != name.lower():
                    raise ValueError
                return kind(value)
            except ValueError:
                problem = f"expected '{name} number', got '{line.strip()[:40]}'"
                raise UserError(lines.where, problem, AGAIN) from None
    raise UserError(lines.path, f"ends before its '{name}' line", AGAIN)


def _values(lines: Lines, statements: Iterator[str], frames: int, tree: Tree) -> np.ndarray:
    """[T columns] as on disk."""
    columns = tree.columns
    frame, row = -1, ""

    def rows() -> Iterator[str]:
        nonlocal frame, row
        for line in statements:
            if not line.strip():
                continue
            frame, row = frame + 1, line
            if frame == frames:
                problem = f"holds more frames than the {frames} that its Frames line claims"
                raise UserError(lines.where, problem, AGAIN)
            if frame == 0 and len(line.split()) != len(columns):
                raise _bad_row(lines, frame, row, tree)
            yield line
        if frame + 1 < frames:
            raise UserError(lines.where, f"holds {frame + 1} frames, its Frames line claims {frames}", AGAIN)

    try:
        values = np.loadtxt(rows(), dtype=np.float64, comments=None, ndmin=2)
    except ValueError:  # NumPy takes one line after the other, so that it failed in the last one
        raise _bad_row(lines, frame, row, tree) from None
    names = tuple(f"{tree.names[joint]} {channel}" for joint, channel in columns)
    check_finite(lines.path, values, "frame channel", {"channel": names})
    if np.abs(values).max() > MAX_VALUE:
        frame, column = np.argwhere(np.abs(values) > MAX_VALUE)[0]
        problem = f"value {values[frame, column]} at frame {frame}, channel {names[column]}"
        raise UserError(lines.path, f"{problem} is no length and no angle", "repair or crop the file")
    return values


def _bad_row(lines: Lines, frame: int, row: str, tree: Tree) -> UserError:
    """What is wrong with the line that was read last."""
    words, columns = row.split(), tree.columns
    where = f"{lines.where} (frame {frame})"
    for word, (joint, channel) in zip(words, columns, strict=False):
        try:
            float(word.replace("_", "?"))  # Python reads 1_0 as ten, NumPy does not read it
        except ValueError:
            return UserError(where, f"'{word[:20]}' is not a number ({tree.names[joint]} {channel})", AGAIN)
    if len(words) != len(columns):
        problem = f"has {len(words)} values, the hierarchy has {len(columns)} channels"
        return UserError(where, problem, "the file is cut short or damaged: export it again")
    return UserError(where, "cannot be read as numbers", AGAIN)
