"""LFCA's experiment whole: train every row of the table, measure it, and write what was found.

    python benchmarks/generation.py --benchmark synth-c --rows without-dr with-dr --seeds 0 1 2

For each row and seed it runs the commands that a user would (they are in the results), two at a time on one thread
each; what is already there is not run again, and a run that was stopped goes on. ``--table`` only draws the table anew,
and beside it learning curves and a sheet of compositions, of those runs whose folders are there.
"""

import argparse
import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

from commands import refine
from generation_curves import draw_runs, thinned
from generation_sheet import draw_sheet

from renderers.images import save_png
from train.benchmarks import load_benchmark
from train.checkpoints import replace_file
from train.lessons import kinds_of
from train.recogniser import place_of
from train.tables import Evaluation, comparison_table, contrast_table, load_evaluation
from train.variants import VARIANTS

TRAINING_MAE = Lock()
RESULTS = Path(__file__).parent / "results"
CLAIMS = (("with-dr", "without-dr"), ("with-dr", "pretrain-mask"), ("dr-paper", "without-dr"))
SHOWN = ("pretrain-mask", "without-dr", "with-dr")


def one(row: str, seed: int, args: argparse.Namespace) -> Path:
    """Train one row with one seed and measure it; the evaluation's place among the results."""
    name = f"{row}-{seed}"
    run, found = runs_of(args) / name, place(args) / f"{name}.json"
    if not (run / "done").exists():
        resume = ["--resume"] if (run / "config.json").exists() else []
        refine("train", "generator", args.preset, "--data.source", args.benchmark, "--variant", row, "--seed", seed,
               "--out", run, *inpainter(row, args), *args.flags, *resume)  # fmt: skip
        (run / "done").touch()
    if found.exists() and load_evaluation(found).hashes["benchmark"] != load_benchmark(args.benchmark).hash:
        raise RuntimeError(f"{found} is of another build of the benchmark; remove it")
    if not found.exists():
        refine("evaluate", run, "--benchmark", args.benchmark, "--repeats", args.repeats, "-o", found)
        found.with_suffix(".md").unlink()  # the table of all rows says the same
    print(found, flush=True)
    return found


def inpainter(row: str, args: argparse.Namespace) -> list:
    """The flag of a row that looks at plain silhouettes; their inpainter is trained when the first one asks."""
    if not VARIANTS[row].plain:
        return []
    run = args.runs / "mae-plain"
    with TRAINING_MAE:
        if not (run / "done").exists():
            refine("train", "mae", "plain", "--out", run, *(["--resume"] if (run / "config.json").exists() else []))
            (run / "done").touch()
    return ["--mae", run / "best.safetensors"]


def digest(args: argparse.Namespace) -> str:
    """A few letters for the benchmark's build and the flags: other runs must not be taken for these."""
    told = " ".join([load_benchmark(args.benchmark).hash, *args.flags])
    return hashlib.sha256(told.encode()).hexdigest()[:8]


def runs_of(args: argparse.Namespace) -> Path:
    """The folder of all runs with a benchmark, a preset and flags."""
    return args.runs / f"{args.benchmark.name}-{args.preset}-{digest(args)}"


def place(args: argparse.Namespace) -> Path:
    """The folder of a benchmark's and preset's results; with other flags they are others."""
    return args.out / "-".join([args.benchmark.name, args.preset, *([digest(args)] if args.flags else [])])


def tabulate(args: argparse.Namespace) -> str:
    """All evaluations that there are, in the order of the rows, and the claims with their intervals."""
    there = {path: load_evaluation(path) for path in sorted(place(args).glob("*-[0-9]*.json"))}
    order = list(VARIANTS)
    evaluations: list[Evaluation] = sorted(there.values(), key=lambda each: (order.index(each.row), each.seed))
    rows = {each.row for each in evaluations}
    parts = [comparison_table(evaluations)]
    parts += [contrast_table(evaluations, *claim, paired=False) for claim in CLAIMS if rows.issuperset(claim)]
    return "\n".join(parts)


def draw(args: argparse.Namespace):
    """The curves of all runs that are or were there, those of `SHOWN` as a picture, and a sheet of what these make."""
    runs = sorted(log.parent for log in runs_of(args).glob("*/log.jsonl") if (log.parent / "done").exists())
    kept = place(args) / "curves.json"
    curves = json.loads(kept.read_text()) if kept.exists() else {}
    curves |= {run.name: thinned(run / "log.jsonl") for run in runs}
    replace_file(kept, (json.dumps(curves) + "\n").encode())
    drawn = {name: curve for name, curve in curves.items() if name.rpartition("-")[0] in SHOWN}
    if drawn:
        save_png(place(args) / "curves.png", draw_runs(drawn, place(args).name))
    shown = {row: runs_of(args) / f"{row}-{args.seeds[0]}" for row in SHOWN}
    shown = {row: run for row, run in shown.items() if run in runs}
    if shown:
        save_png(place(args) / "sheet.png", draw_sheet(load_benchmark(args.benchmark), shown, args.seeds[0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benchmark", type=Path, required=True, help="folder of `refine data benchmark`")
    parser.add_argument("--rows", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--preset", default="small")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are kept")
    parser.add_argument("--out", type=Path, default=RESULTS, help="where results go")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only draw table and pictures of what there is")
    parser.add_argument("--flags", nargs=argparse.REMAINDER, default=[], help="more flags of the training, last")
    args = parser.parse_args()
    if not args.table:
        place(args).mkdir(parents=True, exist_ok=True)
        benchmark = load_benchmark(args.benchmark)
        missing = [kind for kind in kinds_of(benchmark) if not place_of(benchmark, kind).with_suffix(".json").exists()]
        if missing:
            refine("train", "recogniser", "small", "--benchmark", args.benchmark, "--kinds", *missing)
        tasks = [(row, seed) for seed in args.seeds for row in args.rows]
        with ThreadPoolExecutor(args.workers) as pool:
            for waiting in [pool.submit(one, *task, args) for task in tasks]:
                waiting.result()
    table = tabulate(args)
    replace_file(place(args).with_suffix(".md"), table.encode())
    draw(args)
    print(table)


if __name__ == "__main__":
    main()
