"""Does refinement help? Fifty true compositions and fifty real pairs, before and after.

    python benchmarks/refinement.py --real DIR_WITH_BVH --out benchmarks/results/refinement.json

Built-in pairs have a ground truth: the generator performs both actions at once. Real pairs have none; there the legs
are compared with sub-action i and the arms that j intends with j. Half of the pairs overlap on purpose: the legs'
action also swings an arm that the other action needs.
"""

import argparse
import json
import platform
import shlex
import sys
import time
from dataclasses import asdict
from multiprocessing import Pool
from pathlib import Path
from statistics import mean

import torch
from torch import Tensor, nn
from tqdm import tqdm

from refine import synthetic
from refine.coupling import couple
from refine.decoupling import PAPER, Decoupler, DecouplingConfig
from refine.formats.files import load_motion
from refine.intervals import mean_interval
from refine.mae import MAE, load_mae
from refine.metrics import foot_skate, jitter, joint_errors, mean_joint_error, part_errors
from refine.motion import canonicalise, crop
from refine.patches import patchify
from refine.refinement import RefinementConfig, refine_motion
from renderers.body import Body
from renderers.skeleton import PARTS
from train.checkpoints import commit

FRAMES = 60
# (legs' action, arms' action); an overlapping pair's legs' action swings an arm that the other needs.
CALM = ("walk", "squat", "marking-time-and-knee-lifting", "left-kicking", "forward-lunging", "left-lunging")
SWINGING = ("run", "walk", "punching-and-knee-lifting")
ARMS = ("wave-left-hand", "wave-right-hand", "wave-both-hands", "raise-up-left-hand", "drink", "shoulder-abduction",
        "elbow-circling", "pulling-chest-expanders", "punching", "standing-rotation")  # fmt: skip
REAL_LEGS = ("walk", "run", "dash", "walk-left", "walk-turn-left", "walk-back")
REAL_ARMS = {
    "wave-left-hand": ("left_arm",),
    "wave-right-hand": ("right_arm",),
    "wave-both-hands": ("left_arm", "right_arm"),
    "raise-up-left-hand": ("left_arm",),
    "raise-up-right-hand": ("right_arm",),
    "raise-up-both-hands": ("left_arm", "right_arm"),
}


class AsItIs(nn.Module):
    """Inpaints nothing: the loss compares pictures as they are drawn."""

    def __init__(self, config):
        super().__init__()
        self.config = config

    def forward(self, images: Tensor, kept: Tensor) -> Tensor:
        return patchify(images, self.config.patch)


def inpainter(name: str, weights: Path | None) -> nn.Module:
    """The trained MAE, a fresh one of its size, or none: what is the training worth?"""
    trained = load_mae(weights)
    torch.manual_seed(0)
    return {"trained": trained, "untrained": MAE(trained.config), "none": AsItIs(trained.config)}[name]


def built_in_pair(index: int, seed: int, rest_joints):
    """Sub-actions i and j, and their true composition; odd pairs overlap."""
    generator = torch.Generator().manual_seed(seed * 10_000 + index)
    legs = SWINGING if index % 2 else CALM
    names = [choices[int(torch.randint(len(choices), (), generator=generator))] for choices in (legs, ARMS)]
    draws = [synthetic.draw(name, generator) for name in names]
    i, j = (synthetic.perform(draw, FRAMES, rest_joints) for draw in draws)
    return i, j, synthetic.perform_together(*draws, FRAMES, rest_joints)


def real_pair(index: int, seed: int, folder: Path, rest_joints):
    """A legs clip and an arms clip, cut to two seconds from a random start; odd pairs run or dash."""
    generator = torch.Generator().manual_seed(seed * 10_000 + index)
    clips = []
    for names in (("run", "dash") if index % 2 else REAL_LEGS, tuple(REAL_ARMS)):
        name = names[int(torch.randint(len(names), (), generator=generator))]
        paths = sorted(folder.rglob(f"dataset-?_{name}_*.bvh"))
        motion = load_motion(paths[int(torch.randint(len(paths), (), generator=generator))], rest_joints)
        start = int(torch.randint(max(1, len(motion) - FRAMES), (), generator=generator))
        clips.append((name, canonicalise(crop(motion, start, min(len(motion), start + FRAMES)))))
    frames = min(len(clip) for _, clip in clips)
    (_, i), (arms, j) = ((name, crop(clip, 0, frames)) for name, clip in clips)
    return i, j, REAL_ARMS[arms]


def local_error(joints, reference, parts) -> float:
    """Mean joint error of some parts, metres."""
    chosen = [joint for part in parts for joint in PARTS[part]]
    return float(joint_errors(joints, reference)[:, chosen].mean())


def measure(task: tuple) -> dict:
    """One pair: everything that is reported of it."""
    torch.set_num_threads(1)
    kind, index, seed, folder, decoupling, refinement, mae = task
    body = Body.free("light")
    rest = body.rest_joints
    if kind == "built-in":
        i, j, truth = built_in_pair(index, seed, rest)
    else:
        i, j, needed = real_pair(index, seed, folder, rest)
    coupled = couple(i, j, rest).motion
    start = time.perf_counter()
    refined = refine_motion(coupled, i, j, Decoupler(body, inpainter(*mae), decoupling), refinement)
    seconds = time.perf_counter() - start
    row = {"pair": index, "i": i.label or i.source, "j": j.label or j.source, "overlaps": bool(index % 2)}
    row |= {"seconds": seconds, "loss_before": float(refined.before.loss), "loss_after": float(refined.after.loss)}
    for name, motion in (("coupled", coupled), ("refined", refined.motion)):
        joints = motion.joints(rest)
        row[f"{name}_jitter"] = jitter(joints, motion.fps)
        row[f"{name}_skate"] = foot_skate(joints, motion.fps)
        if kind == "built-in":
            row[f"{name}_error"] = mean_joint_error(joints, truth.joints(rest))
            row[f"{name}_parts"] = part_errors(joints, truth.joints(rest))
        else:
            row[f"{name}_legs_to_i"] = local_error(joints, i.joints(rest), ("left_leg", "right_leg"))
            row[f"{name}_arms_to_j"] = local_error(joints, j.joints(rest), needed)
    return row


def summarise(rows: list[dict]) -> dict:
    """Means over pairs of every pair of numbers, and how much nearer refinement came."""
    summary = {}
    names = [key.removeprefix("coupled_") for key in rows[0] if key.startswith("coupled_") and key != "coupled_parts"]
    for name in names:
        summary[name] = {who: mean_interval([row[f"{who}_{name}"] for row in rows]) for who in ("coupled", "refined")}
    if "error" in names:
        gains = [1 - row["refined_error"] / row["coupled_error"] for row in rows]
        before, after = (summary["error"][who]["mean"] for who in ("coupled", "refined"))
        summary["nearer"] = mean_interval(gains) | {"of_means": 1 - after / before, "worst": min(gains)}
        summary["worse_by_over_5_percent"] = sum(gain < -0.05 for gain in gains)
        for kind in (False, True):
            chosen = [gain for gain, row in zip(gains, rows, strict=True) if row["overlaps"] is kind]
            summary["nearer_overlapping" if kind else "nearer_calm"] = mean_interval(chosen)
        summary["parts"] = {
            part: {who: mean(row[f"{who}_parts"][part] for row in rows) for who in ("coupled", "refined")}
            for part in rows[0]["coupled_parts"]
        }
    return summary


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", type=Path, help="folder of Bandai-Namco BVH clips; without it only built-in pairs")
    parser.add_argument("--mae", type=Path, help="an inpainter other than the shipped one")
    parser.add_argument("--inpainter", choices=("trained", "untrained", "none"), default="trained")
    parser.add_argument("--paper", action="store_true", help="judge by the loss as published, instead of ours")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    decoupling, refinement = PAPER if args.paper else DecouplingConfig(), RefinementConfig()
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": f"{platform.machine()}, {args.workers} processes of one thread, torch {torch.__version__}",
        "decoupling": asdict(decoupling),
        "refinement": asdict(refinement),
    }
    for kind in ("built-in", "real") if args.real else ("built-in",):
        mae = (args.inpainter, args.mae)
        tasks = [(kind, n, args.seed, args.real, decoupling, refinement, mae) for n in range(args.pairs)]
        with Pool(args.workers) as pool:
            rows = list(tqdm(pool.imap(measure, tasks), total=len(tasks), desc=kind))
        report[kind] = {"summary": summarise(rows), "pairs": rows}
        print(json.dumps(report[kind]["summary"], indent=1))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
