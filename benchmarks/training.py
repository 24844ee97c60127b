"""A training step of the generator: where its time goes, what the decoupling loss adds to it, and how both grow.

    python benchmarks/training.py           (some minutes; writes results/training.json and .md)
    python benchmarks/training.py --quick   (a minute; writes to --out alone)
    python benchmarks/training.py --device cuda   (the paper's preset whole)

A step is all that training does between two batches: drawing windows, coupling, the network, the losses, the decoupling
loss, the gradients and the optimiser, on built-in clips. Time is wall time, the median of several steps after some that
do not count.

The decoupling loss's overhead is the median of steps with it over that of steps without, which take turns in one run,
so that whatever else the machine does falls on both. A preset that takes it at every n-th step pays an n-th of it. The
shares that are refined once before a run are not in it: benchmarks/shares.py times them.
"""

import argparse
import os
import shlex
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from machine import hardware, keep, versions
from stages import Watched, clock_of, medians, watched
from torch import nn
from tqdm import tqdm

from refine.generator import Generator
from train import steps as terms_module
from train.checkpoints import commit
from train.config import GENERATOR_PRESETS, GeneratorTraining
from train.data import ClipStore
from train.generator import Training
from train.processes import Processes

RESULTS = Path(__file__).parent / "results" / "training.json"
AIMS = {"small": 2.0, "paper": 1.3}
WARM_UP = 3
ACTIONS = {"lower": ("walk", "squat"), "upper": ("wave-both-hands", "punching")}


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    presets: tuple[str, ...]
    repeats: int
    batches: tuple[int, ...]
    clips: tuple[int, ...]
    frames: tuple[int, ...]


FULL = Plan(("tiny", "small", "paper"), 25, (8, 16, 32, 64), (1, 2, 4, 8, 16), (1, 2, 4))
QUICK = Plan(("small",), 5, (8, 32), (2, 8), (1, 2))


# ------------------------------------------------------------------------------------------- one step


def prepared(config: GeneratorTraining, device: str) -> GeneratorTraining:
    """A preset on a few built-in clips; on a processor the paper's batch is a 32nd, and so are the clips it looks at,
    which leaves their share as it is."""
    shares = replace(config.shares, looks=0)
    config = replace(config, data=replace(config.data, synthetic_clips=3, **ACTIONS), shares=shares, device=device)
    if device == "cpu" and config.batch > 100:
        looked = max(1, config.loss.decoupling_clips // 32)
        config = replace(config, batch=config.batch // 32, loss=replace(config.loss, decoupling_clips=looked))
    return config


class Stepper:
    """Steps of a run, one after the other."""

    def __init__(self, config: GeneratorTraining):
        self.config, self.now = config, clock_of(config.device)
        self.training = Training(config, Processes(), config.device)
        self.optimiser = torch.optim.AdamW(self.training.generator.parameters(), config.loop.learning_rate)
        self.random = torch.Generator().manual_seed(0)

    def total(self, decoupling: float) -> torch.Tensor:
        """Draw a batch and compute its loss; without the decoupling loss where its weight is 0."""
        training = self.training
        drawn, noise = training.draw(training.learned, self.config.batch, self.random)
        loss = replace(self.config.loss, decoupling=decoupling)
        return training.terms(training.learned, drawn, noise, slice(None), loss)["total"]

    def update(self):
        nn.utils.clip_grad_norm_(self.training.generator.parameters(), 1.0)
        self.optimiser.step()
        self.optimiser.zero_grad()

    def seconds(self, decoupling: float) -> float:
        """Wall time of one step."""
        start = self.now()
        self.total(decoupling).backward()
        self.update()
        return self.now() - start

    def stages(self) -> dict[str, tuple[float, float]]:
        """Forward and backward of every stage of a step with the decoupling loss."""
        losses = [(terms_module, name, "losses") for name in ("position_errors", "mean_over_frames", "kl_divergence")]
        others: list[Watched] = [
            (Training, "draw", "data"),
            (ClipStore, "pairs", "data"),
            (terms_module, "couple_features", "coupling"),
            (Generator, "forward", "generator"),
            *losses,
        ]
        with watched(self.training.decoupler, self.config.device, others) as stages:
            start = self.now()
            total = self.total(self.config.loss.decoupling)
            middle = self.now()
            total.backward()
            end = self.now()
        found = stages.seconds(middle - start, end - middle)
        start = self.now()
        self.update()
        return found | {"optimiser": (self.now() - start, 0.0)}


def alternate(steps: dict[str, Callable[[], float]], repeats: int) -> dict[str, list[float]]:
    """Seconds of several kinds of steps that take turns."""
    found: dict[str, list[float]] = {name: [] for name in steps}
    for turn in range(WARM_UP + repeats):
        for name, step in steps.items():
            seconds = step()
            if turn >= WARM_UP:
                found[name].append(seconds)
    return found


def overhead(stepper: Stepper, repeats: int) -> dict[str, float]:
    """Median ms of a step without and with the decoupling loss, and what the ratio is of a step and on average."""
    weight, every = stepper.config.loss.decoupling, stepper.config.loss.decoupling_every
    found = alternate({"plain": lambda: stepper.seconds(0.0), "with": lambda: stepper.seconds(weight)}, repeats)
    plain, looking = (statistics.median(found[name]) for name in ("plain", "with"))
    ratio = looking / plain
    return {"plain": 1e3 * plain, "with": 1e3 * looking, "ratio": ratio, "average": 1 + (ratio - 1) / every}


# ------------------------------------------------------------------------------------------- what is measured


def measure_preset(name: str, plan: Plan, device: str) -> dict[str, Any]:
    """A preset's overhead and stages."""
    config = prepared(GENERATOR_PRESETS[name][1], device)
    stepper = Stepper(config)
    found = overhead(stepper, plan.repeats)
    steps = [stepper.stages() for _ in range(WARM_UP + plan.repeats)]
    return {
        "preset": name,
        "batch": config.batch,
        "frames": stepper.training.config.data.frames,
        "precision": config.precision,
        "parameters": sum(parameter.numel() for parameter in stepper.training.generator.parameters()),
        "decoupling_clips": config.loss.decoupling_clips,
        "decoupling_frames": config.loss.decoupling_frames,
        "decoupling_every": config.loss.decoupling_every,
        "views": len(config.decoupling.views),
        "aim": AIMS.get(name),
        "overhead": found,
        "stages": medians(steps[WARM_UP:]),
    }


def by_batch(plan: Plan, device: str) -> list[dict[str, float]]:
    """A plain step of the preset `small` against its batch, in both precisions."""
    rows = []
    for batch in tqdm(plan.batches, desc="batch", disable=None):
        config = replace(prepared(GENERATOR_PRESETS["small"][1], device), batch=batch)
        steppers = {name: Stepper(replace(config, precision=name)) for name in ("float32", "bfloat16")}
        found = alternate({name: lambda of=of: of.seconds(0.0) for name, of in steppers.items()}, plan.repeats)
        rows.append({"batch": batch} | {name: 1e3 * statistics.median(times) for name, times in found.items()})
    return rows


def by_pictures(plan: Plan, device: str) -> list[dict[str, float]]:
    """What the decoupling loss adds to a step of `small`, against the clips and the frames that it looks at."""
    preset = prepared(GENERATOR_PRESETS["small"][1], device)
    rows = []
    for clips in tqdm(plan.clips, desc="pictures", disable=None):
        for frames in plan.frames:
            loss = replace(preset.loss, decoupling_clips=clips, decoupling_frames=frames)
            stepper = Stepper(replace(preset, batch=max(plan.clips), loss=loss))
            found = overhead(stepper, max(3, plan.repeats // 3))
            rows.append({"clips": clips, "frames": frames, "added": found["with"] - found["plain"]})
    return rows


# ------------------------------------------------------------------------------------------- the report


def table(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


def markdown(report: dict[str, Any]) -> str:
    versions_said = ", ".join(f"{name} {number}" for name, number in report["versions"].items())
    header = (
        "# A training step, measured\n\n"
        f"`{report['command']}`, commit {report['commit']}, {report['minutes']:.1f} minutes. {report['hardware']}; "
        f"{report['threads']} threads; {versions_said}.\n\n"
        f"Median wall time of {report['plan']['repeats']} steps, ms. How: `benchmarks/training.py`."
    )
    return "\n\n".join([header, *(part(report) for part in (ratios, stages, batches, pictures))]) + "\n"


def ratios(report: dict[str, Any]) -> str:
    rows = []
    for row in report["presets"]:
        found, aim = row["overhead"], f" (aim {row['aim']})" if row["aim"] else ""
        looked = f"{row['decoupling_clips']} x {row['decoupling_frames']} x {row['views']}"
        rows.append(
            [
                row["preset"],
                f"{row['batch']} x {row['frames']}",
                f"{row['parameters'] / 1e6:.2f}",
                row["precision"],
                looked,
                f"{row['decoupling_every']}",
                f"{found['plain']:.0f}",
                f"{found['with']:.0f}",
                f"{found['ratio']:.2f}",
                f"{found['average']:.2f}{aim}",
            ]
        )
    head = ["preset", "batch x frames", "M parameters", "precision", "clips x frames x views", "every", "plain", "with"]
    return "## What the decoupling loss adds\n\n" + table([*head, "ratio", "on average"], rows)


def stages(report: dict[str, Any]) -> str:
    found = {row["preset"]: row["stages"] for row in report["presets"]}
    first = next(iter(found.values()))
    order = sorted(first, key=lambda stage: -first[stage]["share"])
    rows = [
        [stage]
        + [
            f"{of[stage]['forward']:.1f} + {of[stage]['backward']:.1f} ({100 * of[stage]['share']:.0f} %)"
            for of in found.values()
        ]
        for stage in order
    ]
    about = "Of a step with the decoupling loss: forward + backward, and the share of the step."
    return f"## Stages\n\n{about}\n\n" + table(["stage", *found], rows)


def batches(report: dict[str, Any]) -> str:
    rows = [[f"{row['batch']}", f"{row['float32']:.0f}", f"{row['bfloat16']:.0f}"] for row in report["by_batch"]]
    return "## A plain step of `small` against its batch\n\n" + table(["batch", "float32", "bfloat16"], rows)


def pictures(report: dict[str, Any]) -> str:
    added = {(row["clips"], row["frames"]): row["added"] for row in report["by_pictures"]}
    clips, frames = (sorted({key[axis] for key in added}) for axis in (0, 1))
    rows = [[f"{some}", *(f"{added[some, of_each]:.0f}" for of_each in frames)] for some in clips]
    head = ["clips", *(f"{of_each} frame{'s' if of_each > 1 else ''}" for of_each in frames)]
    return "## What it adds to a step of `small` against what it looks at\n\n" + table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one preset, few settings and steps; figures are rough")
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count()))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, help="a .json, beside which a .md is written")
    args = parser.parse_args()
    plan, out = (QUICK, args.out) if args.quick else (FULL, args.out or RESULTS)
    torch.set_num_threads(args.threads)
    start = time.perf_counter()
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": hardware(args.device),
        "versions": versions(("torch", "timm")),
        "threads": args.threads,
        "plan": asdict(plan),
        "presets": [measure_preset(name, plan, args.device) for name in tqdm(plan.presets, disable=None)],
        "by_batch": by_batch(plan, args.device),
        "by_pictures": by_pictures(plan, args.device),
    }
    report["minutes"] = (time.perf_counter() - start) / 60
    keep(out, report, markdown(report))


if __name__ == "__main__":
    main()
