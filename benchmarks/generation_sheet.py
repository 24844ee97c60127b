"""A sheet of compositions: what a benchmark asks for beside what trained generators make of it.

Nothing is picked by hand. Test compositions are the first of their pairs; generated motions are those that stand in
the same places of the first set that the evaluation draws and measures.
"""

import json
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from refine.drawing import strip
from refine.motion import Motion
from renderers.body import Body
from renderers.images import contact_sheet
from train.benchmarks import Benchmark
from train.evaluate import EvaluationConfig, Sample, check_run, generated, read_config, sample_of
from train.generator import load_generator
from train.loop import seed_of

PAIRS = 6
POSES = 4
HEIGHT = 150  # pixels of a body's picture


class Asked(NamedTuple):
    """A benchmark's test compositions, as ``train.evaluate.generated`` asks for them: a judge without recognisers."""

    benchmark: Benchmark
    pairs: list[tuple[str, str]]  # of each test composition
    rest_joints: Tensor  # [24 3] metres


def spread_pairs(pairs: tuple[tuple[str, str], ...], count: int = PAIRS) -> list[tuple[str, str]]:
    """``count`` of the pairs, or all if there are fewer: in their order, each time the first of those whose actions
    have been taken least often, so that as many actions as possible are seen."""
    taken, chosen = Counter(), []
    for _ in range(min(count, len(pairs))):
        pair = min((pair for pair in pairs if pair not in chosen), key=lambda pair: sum(taken[name] for name in pair))
        taken.update(pair)
        chosen.append(pair)
    return chosen


def first_set(run: Path, asked: Asked) -> Sample:
    """The first set of motions that `refine evaluate` draws from a run and measures, one a test composition.

    Raises:
        UserError: no such run, one that is not finished, or one of another benchmark.
    """
    weights, config = run / "last.safetensors", EvaluationConfig()
    generator, trained = load_generator(weights), read_config(run)
    check_run(run, trained, json.loads(weights.with_suffix(".json").read_text()), asked.benchmark)
    coupled = trained["coupling"] if trained["data"]["pairs"] == "single" else None
    draw = generated(generator, asked, coupled, config)
    return draw(torch.Generator().manual_seed(seed_of(config.seed, 0)))


def draw_sheet(
    benchmark: Benchmark,
    runs: dict[str, Path],
    seed: int,
    pairs: int = PAIRS,
    poses: int = POSES,
    height: int = HEIGHT,
) -> Tensor:
    """One row a pair: its mask composition, its true one where there is one, and a motion of each run.

    Args:
        runs: the folder of each column's run, by the name that stands over it.
        seed: of the runs' training, for the caption.

    Returns:
        [3 H W] in 0..1.

    Raises:
        UserError: as ``first_set``.
    """
    masked, body = benchmark.compositions("mask"), Body.free("light")
    asked = Asked(benchmark, [tuple(motion.label.split("+")) for motion in masked], body.rest_joints)
    columns = {"mask composition": sample_of(masked)}
    if benchmark.has_true:
        columns["true composition"] = sample_of(benchmark.compositions("true"))
    columns |= {name: first_set(run, asked) for name, run in runs.items()}
    chosen = spread_pairs(benchmark.pairs, pairs)
    at = [asked.pairs.index(pair) for pair in chosen]
    motions = [
        Motion(sample.rotations[index], sample.root[index], benchmark.fps)
        for index in at
        for sample in columns.values()
    ]
    pictures = strip(motions, body, poses, height)  # all at one scale, so that they line up
    many = len(columns)
    notes = [
        "Nothing is picked by hand: the first test composition of each pair, and what stands in its place in the "
        f"first set of motions that the evaluation draws from each generator (training seed {seed}).",
        f"{poses} poses at even times over {benchmark.frames / benchmark.fps:g} s, from left to right; travel is left "
        "out.",
    ]
    return contact_sheet(
        [pictures[row * many : (row + 1) * many] for row in range(len(chosen))],
        [" + ".join(pair) for pair in chosen],
        list(columns),
        f"{benchmark.name}: compositions",
        notes=notes,
    )
