"""Does the MAE know single actions? Its errors on unseen clips, and whether Eq. 7 can tell actions apart by it.

    OMP_NUM_THREADS=1 python benchmarks/inpainting.py --real DIR_WITH_BVH --out benchmarks/results/inpainting.json

Inpainting: hidden patches of whole pictures, against the mean picture of the training poses and the nearest visible
patch. A clip is one sample, since its frames resemble each other; differences are paired by clip.

Ranking: Eq. 7's term for the sub-action that was composed must be lower than for another action of its kind (legs or
arms) in its place. The composition is that sub-action itself, its coupling with a second action, or the two performed
at once. Where ownership divides the picture, both are asked about the parts that the right one owns; a pair in which it
owns none is not asked about, and counts as wrong.
"""

import argparse
import json
import platform
import shlex
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import torch
from refinement import built_in_pair, real_pair
from torch import Tensor
from tqdm import tqdm

from refine.coupling import couple
from refine.decoupling import PAPER, Decoupler, DecouplingConfig, Reference
from refine.formats.files import load_motion
from refine.intervals import mean_interval, share_interval
from refine.mae import MAE, load_mae
from refine.motion import Motion
from refine.refinement import spread_frames
from refine.seeing import Clips
from renderers.body import Body
from renderers.camera import Camera
from train.checkpoints import commit, read_weights
from train.config import MAETraining
from train.data import DataConfig, load_clips_for
from train.mae import drawing, measure
from train.pictures import PictureConfig, poses_of

SHIPPED = Path(__file__).parents[1] / "refine" / "assets" / "mae.safetensors"
MASKS = {"random": 0.0, "attention": 1.0}
CONFIGS = {"default": DecouplingConfig(), "paper": PAPER}


def inpainting(clips: list[Motion], mean: Tensor, mae: MAE, body: Body, config: PictureConfig, count: int) -> dict:
    """For each kind of mask: the errors of ``train.mae.measure`` and the MAE's differences to the baselines."""
    found = {}
    for mask, share in MASKS.items():
        draw = drawing(body, MAETraining(network=mae.config, pictures=replace(config, attention_share=share)))
        rows = []
        for index, clip in enumerate(tqdm(clips, desc=f"{mask} masks", disable=None)):
            poses = poses_of([clip], body.rest_joints, config.pinned)
            rows.append(measure(mae, draw(poses, count, torch.Generator().manual_seed(index)), mean, 1.0))
        errors = {name: mean_interval([row[name] for row in rows]) for name in rows[0]}
        differences = {
            f"{baseline}_{over}": mean_interval([row[over] - row[f"{baseline}_{over}"] for row in rows])
            for baseline in ("mean", "nearest")
            for over in ("hidden", "body")
        }
        found[mask] = {"errors": errors, "mae_minus": differences}
    return found


class Pair(NamedTuple):
    """A legs clip and an arms clip, and both performed at once where that is known."""

    legs: Motion
    arms: Motion
    truth: Motion | None


def draw_pair(index: int, seed: int, folder: Path | None, rest_joints: Tensor) -> Pair:
    if folder is None:
        return Pair(*built_in_pair(index, seed, rest_joints))
    i, j, _ = real_pair(index, seed, folder, rest_joints)
    return Pair(i, j, None)


def judgements(pairs: list[Pair], decoupler: Decoupler) -> list[dict]:
    """For each pair and composition: is the term of the right sub-action lower, in one random frame?

    Pairs are judged by their legs and by their arms in turns; the wrong action comes from the next pair that has one.
    """
    rows = []
    for index, pair in enumerate(tqdm(pairs, desc="pairs", disable=None)):
        kind = "arms" if index // 2 % 2 else "legs"
        right, other = (pair.arms, pair.legs) if kind == "arms" else (pair.legs, pair.arms)
        following = (getattr(one, kind) for one in pairs[index + 1 :] + pairs[:index])
        wrong = next(clip for clip in following if clip.label != right.label)
        compositions = {"itself": right, "coupled": couple(pair.legs, pair.arms, decoupler.body.rest_joints).motion}
        if pair.truth:
            compositions["true"] = pair.truth
        frame = spread_frames(min(len(right), len(wrong)), 1, torch.Generator().manual_seed(index))
        ask_right, ask_wrong = (Question.build(target, other, decoupler, frame) for target in (right, wrong))
        ask_wrong = ask_wrong._replace(reference=ask_wrong.reference._replace(owned=ask_right.reference.owned))
        row = {"kind": kind, "right": right.label, "wrong": wrong.label, "other": other.label}
        row["asked"] = bool(ask_right.reference.owned.answers.any())
        for name, motion in compositions.items():
            row[name] = ask_right.term(motion, decoupler, frame) < ask_wrong.term(motion, decoupler, frame)
        rows.append(row)
    return rows


class Question(NamedTuple):
    """Is one sub-action still recognisable in a composition? One side of Eq. 7."""

    cameras: list[Camera]
    reference: Reference

    @classmethod
    def build(cls, target: Motion, other: Motion, decoupler: Decoupler, frame: Tensor) -> "Question":
        cameras = decoupler.cameras(batch(target), batch(other))
        return cls(cameras, decoupler.references(batch(target), batch(other), frame, cameras)[0])

    @torch.no_grad()
    def term(self, composition: Motion, decoupler: Decoupler, frame: Tensor) -> float:
        """Mean over the views of the frame [1 1]."""
        seen = decoupler.see(batch(composition), frame, self.cameras)
        return float(decoupler.complete(seen, self.reference).loss.mean())


def batch(motion: Motion) -> Clips:
    return Clips(motion.rotations[None], motion.root[None])


def shares(rows: list[dict]) -> dict:
    """Share ranked right of each composition, over all pairs and by kind."""
    kinds = {"all": rows} | {kind: [row for row in rows if row["kind"] == kind] for kind in ("legs", "arms")}
    found = {
        name: {kind: share_interval(sum(row[name] for row in chosen), len(chosen)) for kind, chosen in kinds.items()}
        for name in ("itself", "coupled", "true")
        if name in rows[0]
    }
    return {"asked": {kind: sum(row["asked"] for row in chosen) for kind, chosen in kinds.items()}} | found


def tables(report: dict) -> str:
    """The report as Markdown."""
    lines = [
        "| clips | masks | patches | MAE | mean picture | nearest patch | MAE - mean [95 %] | MAE - nearest [95 %] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for data, by_mask in report["inpainting"].items():
        for mask, found in by_mask.items():
            for over, patches in (("hidden", "all"), ("body", "on the body")):
                errors = [found["errors"][name]["mean"] for name in (over, f"mean_{over}", f"nearest_{over}")]
                differences = [ci(found["mae_minus"][f"{name}_{over}"]["ci95"], ".4f") for name in ("mean", "nearest")]
                n = found["errors"][over]["n"]
                cells = [f"{data} ({n})", mask, patches, *(f"{error:.4f}" for error in errors), *differences]
                lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "| clips | configuration | composition | right [95 %] | by legs | by arms | asked of legs, arms |",
        "|---|---|---|---|---|---|---|",
    ]
    for data, by_config in report["ranking"].items():
        for config, by_composition in by_config.items():
            asked = f"{by_composition['asked']['legs']}, {by_composition['asked']['arms']}"
            for composition in ("itself", "coupled", "true"):
                if by_kind := by_composition.get(composition):
                    found = [f"{one['share']:.1%} {ci(one['ci95'], '.1%')}" for one in by_kind.values()]
                    cells = [f"{data} ({by_kind['all']['n']})", config, composition, *found, asked]
                    lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def ci(bounds: list[float], form: str) -> str:
    return f"[{bounds[0]:{form}}, {bounds[1]:{form}}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mae", type=Path, default=SHIPPED)
    parser.add_argument("--real", type=Path, help="folder of Bandai-Namco BVH clips; without it only built-in clips")
    parser.add_argument("--clips", type=int, default=15, help="built-in clips of each action")
    parser.add_argument("--pictures", type=int, default=4, help="pictures of each clip")
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1, help="of clips and pairs; the MAE was trained on 0")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    start = time.monotonic()
    body, mae = Body.free("light"), load_mae(args.mae)
    rest = body.rest_joints
    pictures = PictureConfig(**read_weights(args.mae, "mae")[1]["pictures"])
    poses = poses_of(load_clips_for(DataConfig(), rest), rest, pictures.pinned)
    draw = drawing(body, MAETraining(network=mae.config, pictures=pictures))
    mean = draw(poses, 512, torch.Generator().manual_seed(1)).images.mean(0)
    clips = {"built-in": load_clips_for(DataConfig(synthetic_clips=args.clips, seed=args.seed), rest)}
    if args.real:
        clips["real"] = [load_motion(path, rest) for path in sorted(args.real.rglob("*.bvh"))]
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": f"{platform.machine()}, {torch.get_num_threads()} thread(s), torch {torch.__version__}",
        "seed": args.seed,
        "pictures": asdict(pictures),
        "configurations": {name: asdict(config) for name, config in CONFIGS.items()},
        "inpainting": {},
        "ranking": {},
    }
    for data, motions in clips.items():
        report["inpainting"][data] = inpainting(motions, mean, mae, body, pictures, args.pictures)
        folder = args.real if data == "real" else None
        pairs = [draw_pair(index, args.seed, folder, rest) for index in range(args.pairs)]
        report["ranking"][data] = {
            name: shares(judgements(pairs, Decoupler(body, mae, config))) for name, config in CONFIGS.items()
        }
    report["seconds"] = round(time.monotonic() - start)
    print(tables(report))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
