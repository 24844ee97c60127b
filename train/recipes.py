"""What the named benchmarks are made of: their actions, their pairs, which clips, and how these are split."""

from dataclasses import replace

import torch
from torch import Tensor

from refine.motion import Motion
from refine.synthetic import draw, perform, perform_together
from train.building import Material

FRAMES = 60
FPS = 30.0

UESTC_LOWER = (
    "marking-time-and-knee-lifting",
    "punching-and-knee-lifting",
    "left-lunging",
    "left-kicking",
    "forward-lunging",
)
UESTC_UPPER = (
    "pulling-chest-expanders",
    "punching",
    "elbow-circling",
    "shoulder-abduction",
    "standing-rotation",
)


def product(lower: tuple[str, ...], upper: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """All pairs of different labels, the first ones slowest."""
    return tuple((i, j) for i in lower for j in upper if i != j)


def synth_c(
    rest_joints: Tensor, seed: int = 0, train: int = 5, test: int = 5, extra: int = 20, seconds: float = 4.0
) -> Material:
    """The ten sub-actions of LFCA's UESTC-C, as the built-in generator performs them: ``train``, ``test`` and ``extra``
    sequences of each, no two alike, and both at once for the true compositions."""
    frames = round(seconds * FPS)
    draws, splits = {}, {"train": [], "test": [], "extra": []}
    for index, label in enumerate(UESTC_LOWER + UESTC_UPPER):
        random = torch.Generator().manual_seed(seed * 1009 + index)
        for split, count in (("train", train), ("test", test), ("extra", extra)):
            for number in range(count):
                source = f"{split}/{label}_{number:03d}"
                draws[source] = draw(label, random, FPS)
                splits[split].append(replace(perform(draws[source], frames, rest_joints), source=source))

    def together(i: Motion, j: Motion) -> Motion:
        return perform_together(draws[i.source], draws[j.source], frames, rest_joints)

    return Material(
        name="synth-c",
        version=1,
        fps=FPS,
        frames=FRAMES,
        lower=UESTC_LOWER,
        upper=UESTC_UPPER,
        pairs=product(UESTC_LOWER, UESTC_UPPER),
        rule=f"built-in actions, {seconds:g} s each: of every action the first {train} draws train, the next {test} "
        f"test, the next {extra} are extra",
        together=together,
        **splits,
    )
