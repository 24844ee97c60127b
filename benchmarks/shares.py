"""What makes the shares of a coupling better? Pseudo-compositions of a benchmark's training clips, each way.

    python benchmarks/shares.py --benchmark synth-c

Nothing is generated here: windows of training clips are coupled at lambda a half, and measured against the test
compositions as `refine evaluate` measures a generator. The rows differ in how the shares of parts are found: by Eq. 3;
by ownership alone, which needs no picture; by the decoupling loss, ours with several weights of ``stay`` and with an
inpainter that has learned nothing or does nothing, and as published but for the pictures, which show parts as ours do,
since the inpainter is ours. The table goes beside the JSON, as Markdown.
"""

import argparse
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from machine import hardware, keep, versions
from refinement import inpainter
from torch import Tensor
from tqdm import tqdm

from refine.coupling import couple_features
from refine.decoupling import PAPER, Decoupler
from refine.generator import stand
from refine.intervals import summarise_repeats
from refine.motion import from_features
from refine.ownership import PART_OF_CHANNEL
from refine.seeing import Clips
from renderers.skeleton import PART_NAMES
from train.benchmarks import load_benchmark
from train.checkpoints import commit
from train.config import GENERATOR_PRESETS
from train.data import DataConfig, Pairs, draw_windows, index_pairs
from train.evaluate import Judge, Sample
from train.generator import Training
from train.processes import Processes
from train.shares import SharesConfig
from train.tables import METRICS

RESULTS = Path(__file__).parent / "results"
COLUMNS = ("fid_c", "fid_true", "accuracy", "both_actions", "legs", "arms", "nearest_true", "foot_skate", "jitter")
WHOLLY = 6.0  # log odds of a part that is given away: 400 to 1
STAYS = (1e-4, 3e-5, 3e-6)

Leans = Callable[[Pairs], Tensor]


def by_table(table: Tensor) -> Leans:
    """What `refine_shares` found for pairs of classes."""
    return lambda batch: table[batch.class_i, batch.class_j]


def by_ownership(decoupler: Decoupler) -> Leans:
    """Every part to the action that answers for it, as far as it does, clip by clip; nobody's parts stay."""

    def lean(batch: Pairs) -> Tensor:
        sides = decoupler.ownership(*(Clips(*from_features(some)) for some in (batch.features_i, batch.features_j)))
        found = torch.zeros(len(batch.lam), len(PART_NAMES))
        for owned, sign in zip(sides, (1, -1), strict=True):
            found[:, PART_OF_CHANNEL] += sign * WHOLLY * owned.answers
        return found

    return lean


def ways(training: Training) -> dict[str, Callable[[], Leans]]:
    """Every row's name and how its shares are found."""
    config, decoupler = training.config, training.decoupler

    def decoupled(shares: SharesConfig = config.shares, judged: Decoupler = decoupler) -> Leans:
        training.config, training.decoupler = replace(config, shares=shares), judged
        return by_table(training.refine_shares())

    def judged(name: str) -> Decoupler:
        return Decoupler(training.body, inpainter(name, None), config.decoupling)

    published = replace(PAPER, precision=config.decoupling.precision)
    return {
        "Eq. 3": lambda: by_table(torch.zeros_like(training.leans)),
        "ownership, no picture": lambda: by_ownership(decoupler),
        f"decoupling, ours (stay {config.shares.stay:g})": decoupled,
        **{
            f"the same, stay {stay:g}": lambda stay=stay: decoupled(replace(config.shares, stay=stay)) for stay in STAYS
        },
        "the same, untrained inpainter": lambda: decoupled(judged=judged("untrained")),
        "the same, no inpainter": lambda: decoupled(judged=judged("none")),
        "the published loss, on pictures of parts": lambda: decoupled(
            judged=Decoupler(training.body, decoupler.mae, published)
        ),
    }


@torch.no_grad()
def measure(leans: Leans, training: Training, judge: Judge, repeats: int) -> dict[str, list[float]]:
    """Every measure of ``repeats`` sets, one composition a test composition, at lambda a half."""
    store, rest = training.learned, judge.rest_joints
    data = DataConfig(fps=judge.benchmark.fps, frames=judge.benchmark.frames, lam="half", padding="real")
    pairs, rows = index_pairs(store, judge.pairs), []
    for number in range(repeats):
        random = torch.Generator().manual_seed(number)
        batch = store.pairs(draw_windows(store, pairs, data, random), data)
        made = couple_features(batch.features_i, batch.features_j, batch.lam, rest, judge.coupling, leans(batch))
        rows.append(judge.measure(Sample(*stand(*from_features(made), rest)), random))
    return {name: [row[name] for row in rows] for name in COLUMNS if name in rows[0]}


def table(found: dict) -> str:
    """A row a way, means with 95 % intervals over draws."""
    rows = found["rows"]
    columns = [name for name in COLUMNS if name in next(iter(rows.values()))["metrics"]]
    lines = [
        f"N = {found['n']} compositions of training clips, {found['repeats']} draws; 95 % intervals over draws. "
        f"Reproduce: `{found['command']}` (commit {found['commit'][:8]}, {found['hardware']}).",
        "",
        "| shares by | " + " | ".join(METRICS[name].head for name in columns) + " | seconds |",
        "|---" * (len(columns) + 2) + "|",
    ]
    for name, row in rows.items():
        cells = []
        for column in columns:
            metric, values = METRICS[column], row["metrics"][column]
            mean, low, high = (metric.print(metric.scale * one) for one in (values["mean"], *values["ci95"]))
            cells.append(f"{mean} [{low}, {high}]")
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {row['seconds']:.0f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benchmark", type=Path, required=True, help="with recognisers: `refine train recogniser`")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, help="default: results/shares-BENCHMARK.json")
    args = parser.parse_args()
    benchmark = load_benchmark(args.benchmark)
    preset = GENERATOR_PRESETS["small"][1]
    config = replace(preset, data=replace(preset.data, source=str(args.benchmark)))
    training = Training(replace(config, shares=replace(config.shares, looks=0)), Processes(), "cpu")
    training.config = replace(training.config, shares=config.shares)
    judge = Judge(benchmark, training.body.rest_joints)
    rows = {}
    for name, find in tqdm(ways(training).items(), desc="ways", disable=None):
        started = time.monotonic()
        leans = find()
        seconds = time.monotonic() - started
        values = measure(leans, training, judge, args.repeats)
        rows[name] = {
            "metrics": {key: {"values": one} | summarise_repeats(one) for key, one in values.items()},
            "seconds": round(seconds, 1),
        }
    found = {
        "command": shlex.join(["python", "benchmarks/shares.py", *sys.argv[1:]]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "versions": versions(("refine-motion", "torch", "numpy")),
        "benchmark": {"name": benchmark.name, "hash": benchmark.hash},
        "n": len(judge.labels),
        "repeats": args.repeats,
        "rows": rows,
    }
    out = args.out or RESULTS / f"shares-{benchmark.name}.json"
    keep(out, found, table(found))


if __name__ == "__main__":
    main()
