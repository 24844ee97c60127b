"""Clips into batches: one frame rate, windows of a fixed length, pairs of sub-actions (protocol A.4, B.3, B.4)."""

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from refine.coupling import sample_lam
from refine.motion import Motion, canonicalise, crop, resample, to_features
from renderers.checks import UserError, check_known, check_range


@dataclass(frozen=True)
class DataConfig:
    """Which clips, which pairs, which windows."""

    source: str = "synthetic"
    """The built-in actions, or a file that `refine data import` wrote."""
    actions: tuple[str, ...] = ()
    """Labels to use; none means all there are."""
    lower: tuple[str, ...] = ()
    """With ``upper``: pairs are lower x upper. Without either: all ordered pairs of different actions."""
    upper: tuple[str, ...] = ()
    fps: float = 30.0
    frames: int = 60
    """Length of a window."""
    uniform_lambda: bool = False
    """Draw lambda from U(0, 1) instead of N(0.5, 0.1) (the paper's ablation "w/o Gaussian")."""
    legacy_windows: bool = False
    """Sample as ACTOR does: the last possible start is never drawn, and padding counts as real frames."""
    held_out: float = 0.2
    """Share of each action's clips that is never trained on."""
    synthetic_clips: int = 20
    """Clips of each built-in action."""
    synthetic_seconds: float = 4.0
    seed: int = 0
    """Of the built-in clips and of the split."""

    def __post_init__(self):
        check_range(self, 2, 100_000, "frames")
        check_range(self, 1, math.inf, "synthetic_clips")
        check_range(self, 0.1, 600, "synthetic_seconds")
        check_range(self, 1, 1000, "fps")
        check_range(self, 0, 0.9, "held_out")
        check_range(self, 0, 2**32 - 1, "seed")


class Pairs(NamedTuple):
    """A batch of pairs of windows, each canonical: facing +z in its first frame, above x = z = 0."""

    features_i: Tensor  # [B T 25 6]
    features_j: Tensor  # [B T 25 6]
    height_i: Tensor  # [B] metres, of the pelvis in the first frame, which the features leave out
    height_j: Tensor  # [B]
    class_i: Tensor  # [B] long
    class_j: Tensor  # [B] long
    lam: Tensor  # [B] share of i
    valid: Tensor  # [B T] True = a real frame of both


def load_clips_for(config: DataConfig, rest_joints: Tensor) -> list[Motion]:
    """The clips of a configuration at its frame rate, in a fixed order.

    Raises:
        UserError: no such file, a label that is not in it, or nothing left.
    """
    if config.source == "synthetic":
        motions = perform_all(config, rest_joints)
    else:
        from refine.formats.clips import load_clips

        motions = load_clips(Path(config.source))
    labels = {motion.label for motion in motions}
    for name in (*config.actions, *config.lower, *config.upper):
        check_known(config.source, name, sorted(labels))
    wanted = set(config.actions or labels) | {*config.lower, *config.upper}
    motions = [resample(motion, config.fps) for motion in motions if motion.label in wanted]
    if not motions:
        raise UserError(config.source, "holds no clips", "import some with `refine data import`")
    return motions


def perform_all(config: DataConfig, rest_joints: Tensor) -> list[Motion]:
    """``synthetic_clips`` clips of each built-in action that is asked for, no two alike."""
    from refine.synthetic import ACTIONS, draw, perform

    asked = {*config.actions, *config.lower, *config.upper}
    for name in asked:
        check_known("synthetic", name, ACTIONS)
    frames = round(config.synthetic_seconds * config.fps)
    motions = []
    for index, name in enumerate(ACTIONS):
        random = torch.Generator().manual_seed(config.seed * 1009 + index)
        if name in asked or not asked:
            draws = [draw(name, random, config.fps) for _ in range(config.synthetic_clips)]
            motions += [perform(drawn, frames, rest_joints) for drawn in draws]
    return motions


def split(motions: list[Motion], held_out: float, seed: int) -> tuple[list[Motion], list[Motion]]:
    """Clips to train on and clips to measure on. Of each action at least one goes to either side where it has two or
    more; an action with a single clip is measured on what it is trained on, for want of another."""
    random = torch.Generator().manual_seed(seed)
    by_label = group(motions)
    train, test = [], []
    for clips in by_label.values():
        order = [clips[index] for index in torch.randperm(len(clips), generator=random).tolist()]
        count = min(max(1, round(held_out * len(clips))), len(clips) - 1)
        train += order[count:]
        test += order[:count] or order
    return train, test


def group(motions: list[Motion]) -> dict[str, list[Motion]]:
    """Motions by label; labels in alphabetical order."""
    by_label: dict[str, list[Motion]] = defaultdict(list)
    for motion in motions:
        by_label[motion.label].append(motion)
    return dict(sorted(by_label.items()))


def pair_labels(config: DataConfig, classes: tuple[str, ...]) -> list[tuple[str, str]]:
    """The ordered pairs (i, j) that are trained on; an action is never paired with itself (protocol B.4 no. 14)."""
    if bool(config.lower) != bool(config.upper):
        raise UserError("data", "lower and upper go together", "give both, or neither for all pairs")
    pairs = [(i, j) for i in config.lower or classes for j in config.upper or classes if i != j]
    if not pairs:
        raise UserError("data", f"no pair of different actions among {', '.join(classes)}", "name at least two actions")
    return pairs


def start_of_window(length: int, frames: int, legacy: bool, random: torch.Generator) -> int:
    """First frame of a window: uniform over all that fit; in the legacy rule over all but the last (protocol A.4)."""
    last = max(0, length - frames - (1 if legacy else 0))
    return int(torch.randint(last + 1, (), generator=random))


def window(motion: Motion, start: int, frames: int) -> tuple[Motion, int]:
    """A canonical window of exactly ``frames`` frames, and how many of them are real: a clip that is too short stands
    still in its last pose."""
    real = min(frames, len(motion) - start)
    taken = canonicalise(crop(motion, start, start + real))
    index = torch.arange(frames).clamp(max=real - 1)
    return Motion(taken.rotations[index], taken.root[index], taken.fps, taken.label, taken.source), real


def draw_pairs(
    clips: dict[str, list[Motion]],
    pairs: list[tuple[str, str]],
    count: int,
    config: DataConfig,
    random: torch.Generator,
) -> Pairs:
    """A batch of ``count`` pairs: labels, clips, windows and lambda are all drawn afresh (protocol B.4 nos. 11, 16)."""
    classes = list(clips)
    chosen = [pairs[index] for index in torch.randint(len(pairs), (count,), generator=random).tolist()]
    sides = [draw_windows(clips, [pair[side] for pair in chosen], config, random) for side in (0, 1)]
    index = [torch.tensor([classes.index(pair[side]) for pair in chosen]) for side in (0, 1)]
    (features_i, height_i, valid_i), (features_j, height_j, valid_j) = sides
    lam = sample_lam(count, random, config.uniform_lambda)
    return Pairs(features_i, features_j, height_i, height_j, *index, lam, valid_i & valid_j)


def draw_windows(
    clips: dict[str, list[Motion]], labels: list[str], config: DataConfig, random: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """One window for each label: features [B T 25 6], first pelvis heights [B], valid [B T]."""
    windows, real = [], []
    for label in labels:
        motion = clips[label][int(torch.randint(len(clips[label]), (), generator=random))]
        start = start_of_window(len(motion), config.frames, config.legacy_windows, random)
        taken, frames = window(motion, start, config.frames)
        windows.append(taken)
        real.append(config.frames if config.legacy_windows else frames)
    root = torch.stack([taken.root for taken in windows])
    features = to_features(torch.stack([taken.six for taken in windows]), root)
    valid = torch.arange(config.frames) < torch.tensor(real)[:, None]
    return features, root[:, 0, 1], valid
