"""What does better inpainting buy? A ladder of small MAEs, each trained for the same number of steps.

    python benchmarks/ladder.py --real DIR_WITH_BVH --out benchmarks/results/ladder.json

Each rung differs from the base in one thing: the network's size, the patch, the channels, the masks that it learned
from, whether whole parts were hidden, the steps; two rungs bound it, an untrained network and no inpainting at all.

For each: how well it inpaints clips that it has not seen, whether the decoupling loss is lower for the right action
than for a wrong one (see inpainting.py), and how near refinement by that loss comes to true compositions of built-in
pairs (see refinement.py). The table goes beside the JSON, as Markdown.
"""

import argparse
import json
import platform
import shlex
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import refinement
import torch
from inpainting import SHIPPED, Pair, batch, draw_pair, inpainting, judgements, shares
from machine import keep
from torch import nn
from tqdm import tqdm

from refine.coupling import couple
from refine.decoupling import PAPER, Decoupler, DecouplingConfig, default_for
from refine.formats.files import load_motion
from refine.intervals import mean_interval
from refine.mae import MAE, MAEConfig, load_mae
from refine.motion import Motion
from refine.refinement import RefinementConfig
from renderers.body import Body
from train.checkpoints import commit, replace_file, save_weights
from train.config import MAE_LOOP, MAETraining
from train.data import DataConfig, load_clips_for
from train.mae import drawing, train_mae
from train.pictures import PictureConfig, poses_of

BASE = MAEConfig(width=96, depth=3, decoder_width=64, decoder_depth=1, decoder_heads=2)
PLAIN = PictureConfig(pinned="body")


@dataclass(frozen=True)
class Rung:
    """One inpainter."""

    name: str
    network: MAEConfig = BASE
    pictures: PictureConfig = field(default_factory=PictureConfig)
    share: float = 1.0
    """Of the steps; 0 leaves the network as it starts."""
    inpaints: bool = True
    """False: the loss compares pictures as they are drawn."""
    weights: Path | None = None
    """Trained already."""


RUNGS = (
    Rung("base"),
    Rung("half as wide", replace(BASE, width=48, decoder_width=32, decoder_heads=1)),
    Rung("twice as wide and deep", replace(BASE, width=192, depth=6, decoder_width=128, decoder_depth=2)),
    Rung("patches of 4 px", replace(BASE, patch=4)),
    Rung("patches of 16 px", replace(BASE, patch=16)),
    Rung("1 channel", replace(BASE, channels=1), PLAIN),
    Rung("3 channels", replace(BASE, channels=3), PLAIN),
    Rung("random masks alone", pictures=PictureConfig(attention_share=0.0)),
    Rung("attention masks alone", pictures=PictureConfig(attention_share=1.0)),
    Rung("no part hidden", pictures=PictureConfig(parts_hidden=0.0)),
    Rung("a quarter of the steps", share=0.25),
    Rung("untrained", share=0.0),
    Rung("no inpainting", share=0.0, inpaints=False),
    Rung("shipped", weights=SHIPPED),
)
SLOWEST_FIRST = ("patches of 4 px", "twice as wide and deep", "shipped")


@dataclass(frozen=True)
class Settings:
    """How much of everything."""

    steps: int = 1200
    batch: int = 32
    training_clips: int = 10
    """Of each action; so are the next."""
    clips: int = 3
    real_clips: int = 60
    """All in all, of the folder's."""
    pictures: int = 4
    """Of each clip that is inpainted."""
    pairs: int = 100
    """Ranked."""
    refined: int = 16
    """Pairs that are refined, by either loss."""
    precision: str = "bfloat16"
    seed: int = 1
    """Of what is measured; trained is on 0."""


QUICK = Settings(steps=60, training_clips=2, clips=1, real_clips=10, pictures=1, pairs=12, refined=2)


def trained(rung: Rung, settings: Settings, folder: Path) -> Path:
    """Weights of the rung, trained into ``folder``."""
    if rung.weights:
        return rung.weights
    place = folder / rung.name.replace(" ", "-")
    steps = round(rung.share * settings.steps)
    if not steps:
        torch.manual_seed(0)
        save_weights(place / "best.safetensors", "mae", MAE(rung.network), {"pictures": rung.pictures})
        return place / "best.safetensors"
    loop = replace(MAE_LOOP, steps=steps, learning_rate=2e-3, warmup=steps // 30, save_every=steps)
    return train_mae(
        MAETraining(
            out=place,
            resume=(place / "config.json").exists(),
            data=DataConfig(synthetic_clips=settings.training_clips),
            network=rung.network,
            pictures=rung.pictures,
            loop=loop,
            precision=settings.precision,
            batch=settings.batch,
            measured=64,
        )
    )


def kept(task: tuple[Rung, Settings, Path | None, Path]) -> dict:
    """``measure``, or what it found before at this commit: a ladder that was stopped goes on."""
    rung, settings, real, folder = task
    place = folder / rung.name.replace(" ", "-") / "row.json"
    asked = json.loads(json.dumps([asdict(rung), asdict(settings), real, commit()], default=str))
    if place.exists() and (found := json.loads(place.read_text()))["asked"] == asked:
        return found["row"]
    row = measure(task)
    place.parent.mkdir(parents=True, exist_ok=True)
    replace_file(place, json.dumps({"asked": asked, "row": row}).encode())
    return row


def measure(task: tuple[Rung, Settings, Path | None, Path]) -> dict:
    """One rung: everything that is reported of it."""
    rung, settings, real, folder = task
    torch.set_num_threads(1)
    start = time.perf_counter()
    weights = trained(rung, settings, folder)
    row = {
        "name": rung.name,
        "network": asdict(load_mae(weights).config),
        "pictures": asdict(rung.pictures),
        "parameters": sum(value.numel() for value in load_mae(weights).parameters()),
        "steps": None if rung.weights else round(rung.share * settings.steps),
        "training_seconds": round(time.perf_counter() - start, 1),
    }
    body, name = Body.free("light"), "trained" if rung.inpaints else "none"
    mae = refinement.inpainter(name, weights)
    row["inpainting"] = inpaint(rung, mae, settings, real, body) if rung.inpaints else None
    losses = {"ours": default_for(mae.config.channels), "as published": PAPER}
    row["ranking"] = {}
    for data, place in {"built-in": None, "real": real}.items():
        if data == "built-in" or real:
            pairs = [draw_pair(index, settings.seed, place, body.rest_joints) for index in range(settings.pairs)]
            row["ranking"][data] = {
                said: shares(judgements(pairs, Decoupler(body, mae, config))) for said, config in losses.items()
            }
    pairs = [draw_pair(index, settings.seed, None, body.rest_joints) for index in range(settings.refined)]
    row["through_mae"] = {said: gradient_share(pairs, body, mae, config) for said, config in losses.items()}
    row["refinement"] = {}
    for said, config in losses.items():
        task = settings.seed, None, config, RefinementConfig(), (name, weights)
        refined = [refinement.measure(("built-in", index, *task)) for index in range(settings.refined)]
        row["refinement"][said] = refinement.summarise(refined)
    return row


def gradient_share(pairs: list[Pair], body: Body, mae: nn.Module, config: DecouplingConfig) -> dict:
    """How large the gradient's part is that passes through the inpainter, by norm, in coupled motions."""
    shares = []
    for pair in pairs:
        coupled = couple(pair.legs, pair.arms, body.rest_joints).motion
        frames = torch.linspace(0, len(coupled) - 1, 4).round().long()[None]
        whole, visible = (
            gradient(coupled, pair, Decoupler(body, mae, replace(config, through_mae=through)), frames)
            for through in (True, False)
        )
        if whole.any():
            shares.append(float((whole - visible).norm() / whole.norm()))
    return mean_interval(shares or [0.0])


def gradient(motion: Motion, pair: Pair, decoupler: Decoupler, frames: torch.Tensor) -> torch.Tensor:
    """Of the loss, by the motion's rotations."""
    composed = batch(motion)
    composed.rotations.requires_grad_()
    decoupler(composed, batch(pair.legs), batch(pair.arms), frames).loss.backward()
    return composed.rotations.grad


def inpaint(rung: Rung, mae: MAE, settings: Settings, real: Path | None, body: Body) -> dict:
    """Errors of hidden patches, by clips and kind of mask, as ``inpainting.inpainting`` gives them."""
    rest, seen = body.rest_joints, DataConfig(synthetic_clips=settings.training_clips)
    draw = drawing(body, MAETraining(network=mae.config, pictures=rung.pictures))
    poses = poses_of(load_clips_for(seen, rest), rest, rung.pictures.pinned)
    mean = draw(poses, 512, torch.Generator().manual_seed(1)).images.mean(0)
    clips = {"built-in": load_clips_for(replace(seen, synthetic_clips=settings.clips, seed=settings.seed), rest)}
    if real:
        paths = sorted(real.rglob("*.bvh"))
        clips["real"] = [load_motion(path, rest) for path in paths[:: max(1, len(paths) // settings.real_clips)]]
    return {
        data: inpainting(motions, mean, mae, body, rung.pictures, settings.pictures) for data, motions in clips.items()
    }


def left(found: dict) -> float:
    """The error on the body under attention's masks, as a share of the mean picture's: comparable over channels."""
    errors = found["attention"]["errors"]
    return errors["body"]["mean"] / errors["mean_body"]["mean"]


def rank_correlation(pairs: list[tuple[float, float]]) -> float:
    """Spearman's, with mean ranks for ties; NaN for a single pair, or where one side does not vary."""
    if len(pairs) < 2:
        return float("nan")
    values = torch.tensor(pairs, dtype=torch.float64).T
    ranks = (values[:, :, None] > values[:, None]).double() + (values[:, :, None] == values[:, None]).double() / 2
    return float(torch.corrcoef(ranks.sum(2))[0, 1])


def tables(report: dict) -> str:
    """The report as Markdown."""
    rows = report["rungs"]
    data, losses = list(rows[0]["ranking"]), list(rows[0]["refinement"])
    head = ["inpainter", "parameters", "steps", *(f"error left, {name}" for name in data)]
    head += [f"right, {name}, {said}" for name in data for said in losses]
    head += [f"gradient through it, {said}" for said in losses]
    head += [f"joint error, cm, {said} [95 %]" for said in losses]
    lines = [
        "Error left: of hidden patches on the body, under masks by attention, as a share of the mean picture's. "
        "Right: the loss is lower for the right action than for a wrong one, in true compositions (in coupled ones of "
        "real clips). Gradient through it: the norm of the part that passes through the inpainter, as a share of the "
        "whole's, in coupled motions. Joint error: mean to the true composition, after refinement by that loss.",
        "",
        f"| {' | '.join(head)} |",
        "|" + "---|" * len(head),
    ]
    for row in rows:
        cells = [row["name"], f"{row['parameters']:,}" if row["inpainting"] else ""]
        cells += ["" if row["steps"] is None else str(row["steps"])]
        cells += [f"{left(row['inpainting'][name]):.2f}" if row["inpainting"] else "" for name in data]
        cells += [f"{accuracy(row, name, said):.0%}" for name in data for said in losses]
        cells += [f"{row['through_mae'][said]['mean']:.1%}" if row["inpainting"] else "" for said in losses]
        for said in losses:
            error = row["refinement"][said]["error"]["refined"]
            low, high = (100 * bound for bound in error["ci95"])
            cells.append(f"{100 * error['mean']:.1f} [{low:.1f}, {high:.1f}]")
        lines.append(f"| {' | '.join(cells)} |")
    coupled = rows[0]["refinement"]["ours"]["error"]["coupled"]
    lines += ["", f"Coupled, before refinement: {100 * coupled['mean']:.1f} cm in {coupled['n']} pairs."]
    lines += [f"Rank correlation with the error left: {said} {value:+.2f}." for said, value in correlations(rows)]
    return "\n".join(lines) + "\n"


def accuracy(row: dict, data: str, said: str) -> float:
    """Share of pairs that are ranked right, of the compositions that are hardest to judge by pixels alone."""
    found = row["ranking"][data][said]
    return found["true" if data == "built-in" else "coupled"]["all"]["share"]


def correlations(rows: list[dict]) -> list[tuple[str, float]]:
    """Over the rungs that inpaint: does a smaller error rank better, and refine better?"""
    some = [(left(row["inpainting"]["built-in"]), row) for row in rows if row["inpainting"]]
    found = []
    for loss in rows[0]["refinement"]:
        for said, value in (
            ("share ranked right", lambda row, loss=loss: accuracy(row, "built-in", loss)),
            ("joint error", lambda row, loss=loss: row["refinement"][loss]["error"]["refined"]["mean"]),
        ):
            found.append((f"{said}, {loss}", rank_correlation([(error, value(row)) for error, row in some])))
    return found


def climb(rungs: tuple[Rung, ...], settings: Settings, real: Path | None, folder: Path, workers: int) -> list[dict]:
    """All rungs, in their order; the slowest start first, so that no worker waits for one at the end."""
    order = sorted(rungs, key=lambda rung: rung.name not in SLOWEST_FIRST)
    tasks = [(rung, settings, real, folder) for rung in order]
    # Fresh processes: one that is forked from a parent with threads may wait for a lock for ever.
    with get_context("spawn").Pool(workers) as pool:
        rows = list(tqdm(pool.imap(kept, tasks), total=len(tasks), desc="rungs", disable=None))
    by_name = {row["name"]: row for row in rows}
    return [by_name[rung.name] for rung in rungs]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few steps and pairs: does the program run?")
    parser.add_argument("--rungs", nargs="+", choices=[rung.name for rung in RUNGS], help="some of them")
    parser.add_argument("--steps", type=int, help="of training, for every rung")
    parser.add_argument("--real", type=Path, help="folder of Bandai-Namco BVH clips; without it only built-in clips")
    parser.add_argument("--runs", type=Path, help="keep networks and rungs here, and go on with those that are there")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    settings = QUICK if args.quick else Settings()
    if args.steps:
        settings = replace(settings, steps=args.steps)
    rungs = tuple(rung for rung in RUNGS if not args.rungs or rung.name in args.rungs)
    start = time.monotonic()
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": f"{platform.machine()}, {args.workers} processes of one thread, torch {torch.__version__}",
        "settings": asdict(settings),
    }
    with tempfile.TemporaryDirectory() as temporary:
        report["rungs"] = climb(rungs, settings, args.real, args.runs or Path(temporary), args.workers)
    report["seconds"] = round(time.monotonic() - start)
    keep(args.out, report, tables(report))


if __name__ == "__main__":
    main()
