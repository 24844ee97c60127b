"""Clips into batches: one frame rate, windows of a fixed length, pairs of sub-actions, as ACTOR and LFCA draw them.

What is random about a batch is a `Draw`: a few numbers for each pair, which every process of a run draws alike. A
`ClipStore` turns them, or a part of them, into the windows themselves.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.coupling import LambdaLaw, sample_lam
from refine.motion import Motion, canonicalise, crop, resample, to_features
from renderers.checks import UserError, check_known, check_range
from renderers.rotations import heading, matrix_to_6d, rotation_about


@dataclass(frozen=True)
class DataConfig:
    """Which clips, which pairs, which windows."""

    source: str = "synthetic"
    """The built-in actions, a file or folder that `refine data import` wrote, or a folder that `refine data benchmark`
    wrote, whose training clips are learned."""
    actions: tuple[str, ...] = ()
    """Labels to use; none means all there are."""
    lower: tuple[str, ...] = ()
    """With ``upper``: pairs are lower x upper."""
    upper: tuple[str, ...] = ()
    pairs: Literal["test", "product", "all", "single"] = "test"
    """Which pairs are trained on: those that are tested (of a benchmark; elsewhere as "product"), lower x upper (all
    where neither is known), all ordered pairs of different actions ("full class"), or each action alone, which trains
    ACTOR itself."""
    fps: float | None = None
    """Frame rate; none means the benchmark's, elsewhere 30."""
    frames: int | None = None
    """Length of a window; none means the benchmark's, elsewhere 60."""
    lam: LambdaLaw = "gaussian"
    """Lambda from N(0.5, 0.1), from U(0, 1) (the paper's ablation "w/o Gaussian"), or always a half."""
    legacy_windows: bool = False
    """Draw windows as ACTOR does: never from the last possible start."""
    padding: Literal["masked", "real"] | None = None
    """Whether the frames in which a clip that is too short stands still are masked, or learned as ACTOR does. None
    means learned for a benchmark, whose test compositions hold such frames too, and elsewhere masked."""
    held_out: float | None = None
    """Share of each action's clips that is never trained on but measured; at 0 other windows of the training clips are
    measured. None means 0 for a benchmark, which keeps test clips of its own, and elsewhere 0.2."""
    synthetic_clips: int = 20
    """Clips of each built-in action."""
    synthetic_seconds: float = 4.0
    seed: int = 0
    """Of the built-in clips and of the split."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "synthetic_clips")
        check_range(self, 0.1, 600, "synthetic_seconds")
        check_range(self, 0, 2**32 - 1, "seed")
        if self.frames is not None:
            check_range(self, 2, 100_000, "frames")
        if self.fps is not None:
            check_range(self, 1, 1000, "fps")
        if self.held_out is not None:
            check_range(self, 0, 0.9, "held_out")


class Draw(NamedTuple):
    """What is random about a batch of pairs; on the CPU."""

    clips: Tensor  # [B 2] long: places of the clips of i and j in the store
    starts: Tensor  # [B 2] long: first frames of their windows
    lam: Tensor  # [B] share of i


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


@dataclass(frozen=True, eq=False)
class ClipStore:
    """Clips end to end, sorted by label, so that a batch of windows is taken by indexing."""

    classes: tuple[str, ...]  # in alphabetical order; a clip's class is the place of its label among them
    sources: tuple[str, ...]  # of each of the N clips
    labels: Tensor  # [N] long, class of each clip
    lengths: Tensor  # [N] long, frames
    rotations: Tensor  # [F 24 3 3] of all frames, local
    root: Tensor  # [F 3] metres

    @staticmethod
    def build(motions: list[Motion]) -> "ClipStore":
        by_label = group(motions)
        clips = [clip for of_label in by_label.values() for clip in of_label]
        return ClipStore(
            tuple(by_label),
            tuple(clip.source for clip in clips),
            torch.tensor([index for index, of_label in enumerate(by_label.values()) for _ in of_label]),
            torch.tensor([len(clip) for clip in clips]),
            torch.cat([clip.rotations for clip in clips]),
            torch.cat([clip.root for clip in clips]),
        )

    def to(self, device: torch.device | str) -> "ClipStore":
        """With the frames on another device; what batches are drawn by stays on the CPU."""
        return replace(self, rotations=self.rotations.to(device), root=self.root.to(device))

    def windows(self, clips: Tensor, starts: Tensor, frames: int) -> tuple[Tensor, Tensor]:
        """Canonical windows, each as `window` takes it.

        Args:
            clips: [B] places in the store; starts: [B] first frames.

        Returns:
            rotations [B frames 24 3 3] and root [B frames 3] in metres.
        """
        offsets = self.lengths.cumsum(0) - self.lengths
        within = (starts[:, None] + torch.arange(frames)).minimum(self.lengths[clips, None] - 1)
        at = (offsets[clips, None] + within).to(self.root.device)
        rotations, root = self.rotations[at], self.root[at]
        turn = rotation_about("y", -heading(rotations[:, 0, 0]))
        rotations[:, :, 0] = turn[:, None] @ rotations[:, :, 0]
        root = (root - root[:, :1] * root.new_tensor([1.0, 0.0, 1.0])) @ turn.mT
        return rotations, root

    def real_frames(self, draw: Draw, config: DataConfig) -> Tensor:
        """[B] how many frames of each pair are no padding of either side; all where padding counts as real."""
        if config.padding == "real":
            return torch.full((len(draw.lam),), config.frames)
        return (self.lengths[draw.clips] - draw.starts).amin(1).clamp(max=config.frames)

    def pairs(self, draw: Draw, config: DataConfig) -> Pairs:
        """The windows of a draw, on the device of the store."""
        device = self.root.device
        rotations, root = self.windows(draw.clips.T.flatten(), draw.starts.T.flatten(), config.frames)
        features_i, features_j = to_features(matrix_to_6d(rotations), root).chunk(2)
        height_i, height_j = root[:, 0, 1].chunk(2)
        class_i, class_j = self.labels[draw.clips].to(device).unbind(1)
        valid = torch.arange(config.frames) < self.real_frames(draw, config)[:, None]
        lam, valid = draw.lam.to(device), valid.to(device)
        return Pairs(features_i, features_j, height_i, height_j, class_i, class_j, lam, valid)

    def describe(self, draw: Draw, item: int) -> str:
        """The labels, sources and first frames of one pair, for messages."""
        sides = zip(draw.clips[item].tolist(), draw.starts[item].tolist(), strict=True)
        return " + ".join(
            f"{self.classes[self.labels[clip]]} ({self.sources[clip]} from frame {start})" for clip, start in sides
        )

    def short(self, frames: int) -> int:
        """How many clips are shorter than a window, and stand still in their last pose."""
        return int((self.lengths < frames).sum())


@dataclass(frozen=True, eq=False)
class Source:
    """The clips of a configuration."""

    config: DataConfig  # with everything settled that was left open
    clips: list[Motion]
    tested: tuple[tuple[str, str], ...] = ()  # the pairs of a benchmark
    lower: tuple[str, ...] = ()  # its actions
    upper: tuple[str, ...] = ()
    hash: str | None = None  # of a benchmark


def open_source(config: DataConfig, rest_joints: Tensor) -> Source:
    """The clips of a configuration at its frame rate, in a fixed order, and what is known of pairs.

    Raises:
        UserError: no such file or folder, a label that is not in it, nothing left, or a frame rate or length that is
            not the benchmark's.
    """
    from refine.formats.clips import is_shards, load_clips

    if Path(config.source).is_dir() and not is_shards(config.source):
        from train.benchmarks import load_benchmark

        benchmark = load_benchmark(Path(config.source))
        for name in ("fps", "frames"):
            given, has = getattr(config, name), getattr(benchmark, name)
            if given not in (None, has):
                problem = f"the benchmark {benchmark.name} has {has:g}, not {given:g}"
                raise UserError(f"--data.{name}", problem, "leave it out, or build a benchmark of your own")
        config = settled(replace(config, fps=benchmark.fps, frames=benchmark.frames), 0.0, "real")
        clips = chosen(benchmark.clips("train"), config)
        return Source(config, clips, benchmark.pairs, benchmark.lower, benchmark.upper, benchmark.hash)
    config = settled(config)
    motions = perform_all(config, rest_joints) if config.source == "synthetic" else load_clips(config.source)
    return Source(config, chosen(motions, config))


def settled(config: DataConfig, held_out: float = 0.2, padding: Literal["masked", "real"] = "masked") -> DataConfig:
    """The configuration with everything settled that was left open."""
    return replace(
        config,
        fps=30.0 if config.fps is None else float(config.fps),
        frames=60 if config.frames is None else config.frames,
        held_out=held_out if config.held_out is None else config.held_out,
        padding=config.padding or padding,
    )


def chosen(motions: list[Motion], config: DataConfig) -> list[Motion]:
    """The clips with the labels that are asked for, at the frame rate."""
    labels = {motion.label for motion in motions}
    for name in (*config.actions, *config.lower, *config.upper):
        check_known(config.source, name, sorted(labels))
    wanted = set(config.actions or labels) | {*config.lower, *config.upper}
    motions = [resample(motion, config.fps) for motion in motions if motion.label in wanted]
    if not motions:
        raise UserError(config.source, "holds no clips", "import some with `refine data import`")
    return motions


def load_clips_for(config: DataConfig, rest_joints: Tensor) -> list[Motion]:
    """The clips alone of ``open_source``."""
    return open_source(config, rest_joints).clips


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
    more; an action with a single clip is measured on what it is trained on, for want of another. With ``held_out`` 0
    all clips are on both sides."""
    random = torch.Generator().manual_seed(seed)
    train, test = [], []
    for clips in group(motions).values():
        order = [clips[index] for index in torch.randperm(len(clips), generator=random).tolist()]
        count = min(max(1, round(held_out * len(clips))), len(clips) - 1) if held_out else 0
        train += order[count:]
        test += order[:count] or order
    return train, test


def group(motions: list[Motion]) -> dict[str, list[Motion]]:
    """Motions by label; labels in alphabetical order."""
    by_label: dict[str, list[Motion]] = defaultdict(list)
    for motion in motions:
        by_label[motion.label].append(motion)
    return dict(sorted(by_label.items()))


def pair_labels(source: Source) -> list[tuple[str, str]]:
    """The ordered pairs (i, j) that are trained on; an action is paired with itself only where it is learned alone.

    The labels that the configuration names go before those of a benchmark.
    """
    config, classes = source.config, sorted({motion.label for motion in source.clips})
    if config.pairs == "single":
        return [(name, name) for name in classes]
    if bool(config.lower) != bool(config.upper):
        raise UserError("data", "lower and upper go together", "give both, or neither for all pairs")
    lower, upper = (config.lower, config.upper) if config.lower else (source.lower, source.upper)
    if config.pairs == "all" or not lower:
        lower = upper = tuple(classes)
    pairs = [(i, j) for i in lower for j in upper if i != j]
    if config.pairs == "test" and source.tested and not config.lower:
        pairs = list(source.tested)
    pairs = [pair for pair in pairs if set(pair) <= set(classes)]
    if not pairs:
        raise UserError("data", f"no pair of different actions among {', '.join(classes)}", "name at least two actions")
    return pairs


def start_of_window(length: int, frames: int, legacy: bool, random: torch.Generator) -> int:
    """First frame of a window: uniform over all that fit; in ACTOR's legacy rule over all but the last."""
    return int(draw_starts(torch.tensor([length]), frames, legacy, random))


def draw_starts(lengths: Tensor, frames: int, legacy: bool, random: torch.Generator) -> Tensor:
    """``start_of_window`` for each of lengths [...]."""
    return draw_below((lengths - frames - (1 if legacy else 0)).clamp(min=0) + 1, random)


def draw_below(limits: Tensor, random: torch.Generator) -> Tensor:
    """Whole numbers from 0 to below ``limits`` [...], uniform but for the 53 bits of a double."""
    return (torch.rand(limits.shape, generator=random, dtype=torch.float64) * limits).long()


def window(motion: Motion, start: int, frames: int) -> tuple[Motion, int]:
    """A canonical window of exactly ``frames`` frames, and how many of them are real: a clip that is too short stands
    still in its last pose."""
    real = min(frames, len(motion) - start)
    taken = canonicalise(crop(motion, start, start + real))
    index = torch.arange(frames).clamp(max=real - 1)
    return Motion(taken.rotations[index], taken.root[index], taken.fps, taken.label, taken.source), real


def index_pairs(store: ClipStore, pairs: list[tuple[str, str]]) -> Tensor:
    """[P 2] long: the classes of pairs of labels."""
    return torch.tensor([[store.classes.index(label) for label in pair] for pair in pairs])


def draw_batch(store: ClipStore, pairs: Tensor, count: int, config: DataConfig, random: torch.Generator) -> Draw:
    """``count`` pairs: classes, clips, windows and lambda are all drawn afresh.

    Args:
        pairs: [P 2] from ``index_pairs``.
    """
    return draw_windows(store, pairs[torch.randint(len(pairs), (count,), generator=random)], config, random)


def draw_windows(store: ClipStore, classes: Tensor, config: DataConfig, random: torch.Generator) -> Draw:
    """Clips, windows and lambda for pairs of classes [B 2].

    The actions start independently of each other, as no alignment in time is published. An action that is paired with
    itself is the same window twice.
    """
    clips_of = torch.bincount(store.labels, minlength=len(store.classes))
    first_of = clips_of.cumsum(0) - clips_of
    clips = first_of[classes] + draw_below(clips_of[classes], random)
    starts = draw_starts(store.lengths[clips], config.frames, config.legacy_windows, random)
    alone = classes[:, :1] == classes[:, 1:]
    clips, starts = (torch.where(alone, values[:, :1], values) for values in (clips, starts))
    return Draw(clips, starts, sample_lam(len(classes), random, config.lam))


def draw_pairs(store: ClipStore, pairs: Tensor, count: int, config: DataConfig, random: torch.Generator) -> Pairs:
    """The windows of a ``draw_batch``."""
    return store.pairs(draw_batch(store, pairs, count, config, random), config)
