"""Whose parts? Built-in pairs composed by energies, and by parts: true ones, those that texts say, and random ones.

    python benchmarks/by_parts.py --out benchmarks/results/by_parts.json

The pairs are those of benchmarks/refinement.py: an action of the legs and one of the arms, every second of which is
chosen so that the first swings an arm that the other needs; their true composition is both at once, by the generator
itself. True parts are those that it intends (with global where it intends the legs). Each is measured as coupled, and
refined through the decoupling loss. Differences are paired. With --resume, what --out holds already is not made anew.
"""

import argparse
import json
import shlex
import sys
from multiprocessing import Pool
from pathlib import Path

import torch
from machine import hardware, keep
from refinement import ARMS, CALM, FRAMES, SWINGING
from tqdm import tqdm

from refine import synthetic
from refine.coupling import couple
from refine.coupling_by_parts import JOINTS_OF, couple_by_parts, divide, random_parts, unclaimed
from refine.decoupling import Decoupler
from refine.intervals import compare, mean_interval
from refine.mae import load_mae
from refine.metrics import jitter, mean_joint_error, part_errors
from refine.ownership import Divided
from refine.procedural.draws import Draw
from refine.refinement import refine_motion
from refine.text.labellers import labeller
from refine.text.parts import BODY_PARTS, Parts
from refine.text.phrases import phrase_of
from renderers.body import Body
from renderers.skeleton import LEGS
from train.checkpoints import commit

WAYS = {
    "energies": "energies",
    "text": "parts of the texts",
    "true": "true parts",
    "random": "random parts",
}
STAGES = ("coupled", "refined")
KEPT = ("error", "jitter", "part_error")


def drawn_pair(index: int, seed: int) -> list[Draw]:
    """As ``refinement.built_in_pair`` draws them."""
    generator = torch.Generator().manual_seed(seed * 10_000 + index)
    legs = SWINGING if index % 2 else CALM
    names = [choices[int(torch.randint(len(choices), (), generator=generator))] for choices in (legs, ARMS)]
    return [synthetic.draw(name, generator) for name in names]


def text_of(performance: Draw) -> str:
    hand = f" with the {performance.hand} hand" if performance.action == "drink" else ""
    return phrase_of(performance.action) + hand


def true_parts(performance: Draw) -> Parts:
    intended = synthetic.intended(performance)
    travel = {"global"} if intended & set(LEGS) else set()
    return Parts.of({part.replace("_", " ") for part in intended} | travel)


def parts_of_pair(index: int, seed: int) -> dict[str, list[Parts]]:
    """The parts of both actions, by each way that has some."""
    draws = drawn_pair(index, seed)
    generator = torch.Generator().manual_seed(1_000_000 + seed * 10_000 + index)
    return {
        "text": [labelled.parts for labelled in labeller()([text_of(one) for one in draws])],
        "true": [true_parts(one) for one in draws],
        "random": [random_parts(generator) for _ in draws],
    }


def measure(task: tuple) -> dict:
    """One pair by every way; ways that divide the body alike are measured once.

    Owners are numbers of actions, of what neither claims with a question mark.
    """
    torch.set_num_threads(1)
    index, seed, stages, known = task
    body = Body.free("light")
    rest = body.rest_joints
    draws = drawn_pair(index, seed)
    i, j = (synthetic.perform(draw, FRAMES, rest) for draw in draws)
    truth = synthetic.perform_together(*draws, FRAMES, rest).joints(rest)
    parts = parts_of_pair(index, seed)
    decoupler = Decoupler(body, load_mae())
    made: dict[str, dict] = dict(known)  # by owners
    row = {"pair": index, "i": i.label, "j": j.label, "texts": list(map(text_of, draws)), "overlaps": bool(index % 2)}
    for way in WAYS:
        owners, divided, coupled = "blend", None, None
        if way != "energies":
            division, nobodys = divide(parts[way]), unclaimed(parts[way])
            divided = Divided(division.joints_of(0), nobodys)
            owners = " ".join(
                f"{owner}?" if nobodys[JOINTS_OF[part][0]] else f"{owner}"
                for part, owner in zip(BODY_PARTS, division.owners, strict=True)
            )
        if owners not in made:
            coupled = couple_by_parts(i, j, *parts[way], rest) if divided else couple(i, j, rest)
            motions = {"coupled": coupled.motion}
            if "refined" in stages:
                motions["refined"] = refine_motion(coupled.motion, i, j, decoupler, divided=divided).motion
            joints = {stage: motion.joints(rest) for stage, motion in motions.items()}
            made[owners] = {
                "error": {stage: mean_joint_error(each, truth) for stage, each in joints.items()},
                "jitter": {stage: jitter(each, i.fps) for stage, each in joints.items()},
                "part_error": {stage: part_errors(each, truth) for stage, each in joints.items()},
            }
        row[way] = {"parts": [each.names for each in parts.get(way, ())], "owners": owners, **made[owners]}
    return row


def earlier_rows(out: Path | None) -> dict[int, dict]:
    """What an earlier report holds, by pair."""
    rows = json.loads(out.read_text())["pairs"] if out and out.exists() else []
    return {row["pair"]: row for row in rows}


def measured(row: dict) -> dict[str, dict]:
    """What has been measured of a pair, by owners."""
    return {row[way]["owners"]: {key: row[way][key] for key in KEPT} for way in WAYS if way in row}


def summarise(rows: list[dict]) -> dict:
    """Means over pairs of every way and stage, and what each way is to energies, pair by pair; metres."""
    stages = list(rows[0]["energies"]["error"])
    values = {(way, stage): [row[way]["error"][stage] for row in rows] for way in WAYS for stage in stages}
    summary = {way: {stage: mean_interval(values[way, stage]) for stage in stages} for way in WAYS}
    for way in WAYS:
        summary[way]["jitter"] = {stage: mean_interval([row[way]["jitter"][stage] for row in rows]) for stage in stages}
        if "refined" in stages:
            summary[way]["refined_to_coupled"] = compare(values[way, "refined"], values[way, "coupled"], paired=True)
        if way != "energies":
            against = {stage: (values[way, stage], values["energies", stage]) for stage in stages}
            summary[way]["to_energies"] = {stage: compare(*pair, paired=True) for stage, pair in against.items()}
    alike = [row["text"]["owners"] == row["true"]["owners"] for row in rows]
    summary["texts_divide_as_true_parts"] = sum(alike)
    return summary


def table(report: dict) -> str:
    summary, count = report["summary"], len(report["pairs"])
    stages = list(report["pairs"][0]["energies"]["error"])
    lines = [
        f"N = {count} built-in pairs, one seed; 95 % intervals over pairs; mean joint error to the true composition. "
        f"Texts divide the body as true parts do in {summary['texts_divide_as_true_parts']} of them. Reproduce: "
        f"`{report['command']}` (commit {(report['commit'] or 'unknown')[:8]}, {report['hardware']}).",
        "",
        "| ".join(["| composed by ", *(f"{stage}, cm ↓ " for stage in stages)])
        + "".join(f"| {stage}: less than by energies, cm " for stage in stages)
        + ("| less by refinement, cm | jitter before, after, m/s³ |" if "refined" in stages else "|"),
        "|---" * (1 + 2 * len(stages) + 2 * ("refined" in stages)) + "|",
    ]
    for way, name in WAYS.items():
        cells = [centimetres(summary[way][stage]["mean"], summary[way][stage]["ci95"]) for stage in stages]
        for stage in stages:
            if way == "energies":
                cells.append("")
                continue
            against = summary[way]["to_energies"][stage]
            low, high = against["difference_ci95"]
            cells.append(centimetres(-against["difference"], [-high, -low]))
        if "refined" in stages:
            found = summary[way]["refined_to_coupled"]
            low, high = found["difference_ci95"]
            cells.append(centimetres(-found["difference"], [-high, -low]))
            cells.append(", ".join(f"{summary[way]['jitter'][stage]['mean']:.0f}" for stage in stages))
        lines.append(f"| {' | '.join([name, *cells])} |")
    return "\n".join(lines) + "\n"


def centimetres(mean: float, interval: list[float]) -> str:
    return f"{100 * mean:.2f} [{', '.join(f'{100 * end:.2f}' for end in interval)}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--coupled", action="store_true", help="leave refinement out, which takes nearly all the time")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    earlier = earlier_rows(args.out) if args.resume else {}
    stages = STAGES[:1] if args.coupled else STAGES
    tasks = [(index, args.seed, stages, measured(earlier.get(index, {}))) for index in range(args.pairs)]
    rows = []
    with Pool(args.workers) as pool:
        for row in tqdm(pool.imap(measure, tasks), total=len(tasks)):
            rows.append(row)
            if args.out and args.resume:
                earlier[row["pair"]] = row
                args.out.write_text(json.dumps({"pairs": list(earlier.values())}))
    report = {
        "command": shlex.join(["python", *(word for word in sys.argv if word != "--resume")]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "summary": summarise(rows),
        "pairs": rows,
    }
    keep(args.out, report, table(report))


if __name__ == "__main__":
    main()
