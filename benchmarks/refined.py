"""Refinement after generation: what does the loop add to motions that are already made?

    python benchmarks/refined.py runs/synth-c-small-bc16be1d/pretrain-mask-0 --benchmark synth-c

A generator that learned single actions alone makes both actions, Eq. 3 couples them, and each composition is refined
by itself against the two generated actions, as ``refine compose`` does; a motion takes some seconds. The same motions
are measured before and after, so differences are paired; FID is compared at equal N, a small one, which biases both
alike. The table goes beside the JSON, as Markdown.
"""

import argparse
import shlex
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import torch
from machine import hardware, keep, versions
from torch import Tensor
from tqdm import tqdm

from refine.coupling import CouplingConfig, couple
from refine.decoupling import Decoupler
from refine.distributions import frechet_distance
from refine.generator import generate, label_weights, stand
from refine.intervals import mean_interval
from refine.mae import load_mae
from refine.metrics import foot_skates, jitters, motion_errors
from refine.motion import Motion, from_features
from refine.recogniser import both_actions, features_of
from refine.refinement import refine_motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import matrix_to_6d
from train.benchmarks import load_benchmark
from train.checkpoints import commit
from train.evaluate import Judge, read_config
from train.generator import load_generator
from train.loop import seed_of

RESULTS = Path(__file__).parent / "results"
HEADS = {
    "both_actions": ("both actions, %", 100.0),
    "legs": ("legs' action, %", 100.0),
    "arms": ("arms' action, %", 100.0),
    "nearest_true": ("error to nearest true, cm", 100.0),
    "foot_skate": ("foot skate, m/s", 1.0),
    "jitter": ("jitter, m/s³", 1.0),
}


class Made(NamedTuple):
    """One composition before and after it was refined."""

    label: str
    coupled: Motion
    refined: Motion


def single_actions(run: Path, judge: Judge, each: int, seed: int) -> list[tuple[Motion, Motion]]:
    """For every pair of the benchmark ``each`` generated pairs of actions.

    Raises:
        UserError: the run's generator has learned compositions, and cannot be relied on for actions alone.
    """
    if read_config(run)["data"]["pairs"] != "single":
        raise UserError(run, "has not learned single actions", "train one with `--variant pretrain-mask`")
    generator = load_generator(run / "last.safetensors")
    classes, random = generator.config.classes, torch.Generator().manual_seed(seed_of(seed, 0))
    pairs = [pair for pair in dict.fromkeys(judge.pairs) for _ in range(each)]
    sides = []
    for side in (0, 1):
        of = torch.tensor([classes.index(pair[side]) for pair in pairs])
        weights = label_weights(of, of, torch.full((len(of),), 0.5), len(classes))
        with torch.no_grad():
            features = generate(generator, weights, judge.benchmark.frames, random).float()
        rotations, root = stand(*from_features(features), judge.rest_joints)
        fps = judge.benchmark.fps
        sides.append([Motion(*clip, fps, pair[side]) for *clip, pair in zip(rotations, root, pairs, strict=True)])
    return list(zip(*sides, strict=True))


def refined(pair: tuple[Motion, Motion], coupling: CouplingConfig) -> Made:
    """One composition, on one thread."""
    torch.set_num_threads(1)
    i, j = pair
    body = Body.free("light")
    coupled = couple(i, j, body.rest_joints, 0.5, coupling).motion
    made = refine_motion(coupled, i, j, Decoupler(body, load_mae())).motion
    return Made(f"{i.label}+{j.label}", coupled, made)


def measure(motions: list[Motion], labels: list[str], judge: Judge) -> tuple[dict[str, Tensor], dict[str, float]]:
    """What is known of each motion [N], and the distances of their set from the test compositions."""
    six = torch.stack([matrix_to_6d(motion.rotations) for motion in motions])
    joints = torch.stack([motion.joints(judge.rest_joints) for motion in motions])
    recognised = both_actions(judge.legs, judge.arms, six, labels)
    one = dict(zip(("legs", "arms", "both_actions"), (value.double() for value in recognised), strict=True))
    if judge.benchmark.has_true:
        of_label = {label: torch.tensor([other == label for other in judge.labels]) for label in set(labels)}
        nearest = [
            motion_errors(clip[None], judge.true_joints[of_label[label]]).min()
            for clip, label in zip(joints, labels, strict=True)
        ]
        one["nearest_true"] = torch.stack(nearest)
    one["foot_skate"] = foot_skates(joints, judge.benchmark.fps)
    one["jitter"] = jitters(joints, judge.benchmark.fps)
    distances = {
        f"fid_{'c' if name == 'mask' else name}": frechet_distance(features_of(known, six).features, features)
        for name, (known, features, _) in judge.references.items()
        if name != "half"
    }
    return one, distances


def table(found: dict) -> str:
    """Before, after and the paired difference of every measure."""
    lines = [
        f"N = {found['n']} generated compositions of {found['benchmark']['name']}, each refined by itself in "
        f"{found['seconds_a_motion']:.1f} s; 95 % intervals over compositions. Reproduce: `{found['command']}` "
        f"(commit {found['commit'][:8]}, {found['hardware']}).",
        "",
        "| | coupled | refined | difference |",
        "|---|---|---|---|",
    ]
    for name, (head, scale) in HEADS.items():
        if name in found["measures"]:
            cells = []
            for value in found["measures"][name].values():
                middle, low, high = (scale * x for x in (value["mean"], *value["ci95"]))
                cells.append(f"{middle:.2f} [{low:.2f}, {high:.2f}]")
            lines.append(f"| {head} | {' | '.join(cells)} |")
    for name, head in (("fid_c", "FID-C"), ("fid_true", "FID to true")):
        if name in found["distances"]:
            before, after = found["distances"][name].values()
            lines.append(f"| {head} | {before:.2f} | {after:.2f} | {after - before:+.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="of `refine train generator --variant pretrain-mask`")
    parser.add_argument("--benchmark", type=Path, required=True, help="with recognisers: `refine train recogniser`")
    parser.add_argument("--each", type=int, default=6, help="compositions of each pair")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="default: results/refined-BENCHMARK.json")
    args = parser.parse_args()
    benchmark = load_benchmark(args.benchmark)
    judge = Judge(benchmark, Body.free("light").rest_joints)
    pairs = single_actions(args.run, judge, args.each, args.seed)
    started = time.monotonic()
    with ProcessPoolExecutor(args.workers, get_context("spawn")) as pool:
        waiting = pool.map(refined, pairs, [judge.coupling] * len(pairs))
        made = list(tqdm(waiting, total=len(pairs), desc="refine", disable=None))
    seconds = (time.monotonic() - started) * args.workers / len(made)
    labels = [one.label for one in made]
    before, after = (measure([getattr(one, name) for one in made], labels, judge) for name in ("coupled", "refined"))
    found = {
        "command": shlex.join(["python", "benchmarks/refined.py", *sys.argv[1:]]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "versions": versions(("refine-motion", "torch", "numpy")),
        "benchmark": {"name": benchmark.name, "hash": benchmark.hash},
        "n": len(made),
        "seconds_a_motion": round(seconds, 2),
        "measures": {
            name: {
                "coupled": mean_interval(before[0][name].tolist()),
                "refined": mean_interval(after[0][name].tolist()),
                "difference": mean_interval((after[0][name] - before[0][name]).tolist()),
            }
            for name in before[0]
        },
        "distances": {name: {"coupled": before[1][name], "refined": after[1][name]} for name in before[1]},
    }
    keep(args.out or RESULTS / f"refined-{benchmark.name}.json", found, table(found))


if __name__ == "__main__":
    main()
