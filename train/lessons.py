"""What the recognisers of a benchmark learn, and what they are asked about afterwards."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.motion import Motion
from refine.recogniser import ARM_JOINTS, LEG_JOINTS, OTHER
from renderers.skeleton import JOINT_NAMES
from train.benchmarks import Benchmark
from train.data import split, start_of_window, window

Kind = Literal["mask", "half", "true", "legs", "arms"]
KINDS: tuple[Kind, ...] = ("mask", "half", "true", "legs", "arms")
PARTS: tuple[Kind, ...] = ("legs", "arms")


class Examples(NamedTuple):
    """Clips as rotations and their classes."""

    six: Tensor  # [N T 24 6]
    classes: Tensor  # [N] long


@dataclass(frozen=True)
class Lesson:
    """What one recogniser learns and what it is asked about afterwards."""

    clips: int
    classes: tuple[str, ...]
    joints: tuple[int, ...]
    draw: Callable[[torch.Generator], Examples]
    """An example of every clip, for one pass."""
    learned: Examples
    """Fixed examples of the same clips: naming all of them ends the training."""
    unseen: dict[str, Examples]


def kinds_of(benchmark: Benchmark) -> tuple[Kind, ...]:
    """The recognisers that a benchmark needs: ``true`` only where it has true compositions."""
    return tuple(kind for kind in KINDS if kind != "true" or benchmark.has_true)


def compositions_of(benchmark: Benchmark) -> tuple[str, ...]:
    return ("mask", "true") if benchmark.has_true else ("mask",)


def lesson_of(benchmark: Benchmark, kind: Kind, held_out: float, seed: int) -> Lesson:
    """What a recogniser of this kind learns from a benchmark."""
    if kind in PARTS:
        return lesson_of_a_part(benchmark, kind, held_out, seed)
    classes = tuple(f"{i}+{j}" for i, j in benchmark.pairs)
    made = {name: whole(benchmark.compositions(name), classes) for name in compositions_of(benchmark)}
    if kind == "half":
        number = numbers(made["mask"].classes)
        learned, rest = (Examples(*(value[number % 2 == odd] for value in made["mask"])) for odd in (0, 1))
        unseen = {"other half": rest} if len(rest.six) else {}
    else:
        learned = made.pop(kind)
        unseen = made
    return Lesson(len(learned.six), classes, tuple(range(len(JOINT_NAMES))), lambda _: learned, learned, unseen)


def lesson_of_a_part(benchmark: Benchmark, kind: Kind, held_out: float, seed: int) -> Lesson:
    """Single actions, as one part of the body shows them: those that live there, and all others as one class.

    The test clips, of which the test compositions are made, are not learned. A generator's training clips are.
    """
    own, joints = (benchmark.lower, LEG_JOINTS) if kind == "legs" else (benchmark.upper, ARM_JOINTS)
    classes = (*own, OTHER)
    learned, rest = split([*benchmark.clips("train"), *benchmark.clips("extra")], held_out, seed)
    frames = benchmark.frames

    def draw(random: torch.Generator) -> Examples:
        starts = [start_of_window(len(clip), frames, False, random) for clip in learned]
        return windows(zip(learned, starts, strict=True), frames, classes)

    def spread(motions: list[Motion]) -> Examples:
        """Three windows of each clip: the first, the middle one and the last."""
        last = [max(0, len(motion) - frames) for motion in motions]
        chosen = [(motion, end * third // 2) for motion, end in zip(motions, last, strict=True) for third in range(3)]
        return windows(chosen, frames, classes)

    unseen = {"held out": spread(rest), "test": spread(benchmark.clips("test"))}
    return Lesson(len(learned), classes, joints, draw, spread(learned), unseen)


def whole(motions: list[Motion], classes: tuple[str, ...]) -> Examples:
    """Clips of one length as they are."""
    return Examples(torch.stack([motion.six for motion in motions]).float(), class_indices(motions, classes))


def windows(chosen: Iterable[tuple[Motion, int]], frames: int, classes: tuple[str, ...]) -> Examples:
    """Canonical windows of clips, each from its start."""
    taken = [window(motion, start, frames)[0] for motion, start in chosen]
    return whole(taken, classes)


def class_indices(motions: list[Motion], classes: tuple[str, ...]) -> Tensor:
    """[N] the class of each motion's label; labels that are no class are the last one, ``"other"``."""
    known = {name: index for index, name in enumerate(classes)}
    return torch.tensor([known.get(motion.label, len(classes) - 1) for motion in motions])


def numbers(classes: Tensor) -> Tensor:
    """[N] how many earlier entries are of the same class [N]."""
    same = classes[:, None] == classes
    return same.tril(-1).sum(1)
