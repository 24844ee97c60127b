"""SINC's experiment whole: train every row of its tables, measure it, and write what was found.

    python benchmarks/text.py --preset sinc --seeds 0 1 2

Trains the scorer, then each row with each seed by the commands that a user would type (they are in the results), two
at a time on one thread each; what is already there is not run again, and a run that was stopped goes on. ``--table``
only draws the table anew, and a sheet of what the rows that are there make of three texts.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from commands import refine

from renderers.images import contact_sheet, save_png
from train.checkpoints import replace_file
from train.tables import Evaluation, comparison_table, contrast_table, load_evaluation

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Row:
    """One row of the tables.

    Attributes:
        training: flags of `refine train text`, of the run that is measured.
        measuring: flags of `refine evaluate`.
        diffusion: train a latent diffusion model with these flags on the run of single actions, and measure that.
    """

    training: tuple[str, ...]
    measuring: tuple[str, ...] = ()
    diffusion: bool = False

    @property
    def run(self) -> str:
        """Name of the run that it measures; rows that differ in how they are measured share it."""
        kind = "diffusion" if self.diffusion else "text"
        return "-".join([kind, *(flag.removeprefix("--").replace(".", "-") for flag in self.training)])


SINGLES = ("--data.no-pairs", "--data.synthetic", "none")
PAIRS = ("--data.no-singles", "--data.synthetic", "none")
NONE, PARTS, RANDOM, ENERGIES = (("--data.synthetic", how) for how in ("none", "parts", "random", "energies"))
FEW = ("--repeats", "1", "--most", "28")  # refining takes seconds a clip
REFINED = (*FEW, "--refined")
ROWS = {
    "single actions": Row(SINGLES),
    "single actions, put together": Row(SINGLES, ("--by", "parts")),
    "pairs, texts apart (STE)": Row((*PAIRS, "--network.separate")),
    "pairs": Row(PAIRS),
    "pairs and singles": Row(NONE),
    "random": Row(("--data.no-pairs", *RANDOM)),
    "parts": Row(("--data.no-pairs", *PARTS)),
    "energies": Row(("--data.no-pairs", *ENERGIES)),
    "pairs and random": Row(RANDOM),
    "pairs and parts": Row(PARTS),
    "diffusion, pairs and singles": Row(NONE, diffusion=True),
    "diffusion, pairs and parts": Row(PARTS, diffusion=True),
}
REFINING = {
    "pairs and parts": Row(PARTS, FEW),
    "pairs and parts, refined": Row(PARTS, REFINED),
    "single actions, put together": Row(SINGLES, ("--by", "parts", *FEW)),
    "single actions, put together, refined": Row(SINGLES, ("--by", "parts", *REFINED)),
}
"""A table of its own, of fewer clips."""
CLAIMS = (
    ("parts", "single actions"),
    ("parts", "random"),
    ("pairs and parts", "pairs and singles"),
    ("pairs and parts", "pairs and random"),
    ("pairs and parts", "single actions"),
    ("parts", "single actions, put together"),
    ("parts", "energies"),
    ("pairs and parts, refined", "pairs and parts"),
    ("single actions, put together, refined", "single actions, put together"),
    ("diffusion, pairs and parts", "diffusion, pairs and singles"),
)
SHOWN = ("single actions", "random", "parts", "pairs and parts")
TEXTS = (
    ("walk forwards", "wave with the right hand"),
    ("squat", "raise both arms sideways"),
    ("kick with the left leg", "punch with both arms"),
)
LOCKS: dict[Path, Lock] = {}


def trained(run: Path, *arguments: object) -> Path:
    """A run that is done, trained now unless it is there; two rows may ask for the same."""
    with LOCKS.setdefault(run, Lock()):
        if not (run / "done").exists():
            refine("train", *arguments, "--out", run, *(["--resume"] if (run / "config.json").exists() else []))
            (run / "done").touch()
    return run


def one(name: str, seed: int, args: argparse.Namespace) -> Path:
    """Train one row with one seed and measure it; the evaluation's place among the results."""
    row, found = rows_of(args)[name], place(args) / f"{slug(name)}-{seed}.json"
    if found.exists():
        return found
    source = ("--data.source", args.source, "--seed", seed)

    def text_run(row: Row) -> Path:
        folder = args.runs / f"{args.preset}-{row.run}-{seed}"
        return trained(folder, "text", args.preset, *source, *row.training, *args.flags)

    if row.diffusion:
        start, folder = text_run(ROWS["single actions"]), args.runs / f"{args.preset}-{row.run}-{seed}"
        run = trained(folder, "text-diffusion", other(args.preset), "--start", start, *source, *row.training)
    else:
        run = text_run(row)
    refine("evaluate", run, "--scorer", args.runs / "scorer", "--row", name, "--actions", args.actions, *row.measuring,
           "-o", found)  # fmt: skip
    found.with_suffix(".md").unlink()  # the table of all rows says the same
    print(found, flush=True)
    return found


def other(preset: str) -> str:
    """The preset of the scorer and of diffusion that goes with one of text to motion."""
    return "small" if preset == "sinc" else preset


def rows_of(args: argparse.Namespace) -> dict[str, Row]:
    return REFINING if args.refining else ROWS


def slug(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower()).strip("-")


def place(args: argparse.Namespace) -> Path:
    refining = "-refined" if args.refining else ""
    return args.out / f"text-{Path(args.source).name}-{args.preset}{refining}"


def tabulate(args: argparse.Namespace) -> str:
    """All evaluations that there are, in the order of the rows, and the claims with their intervals."""
    found = [load_evaluation(path) for path in sorted(place(args).glob("*-[0-9]*.json"))]
    order = list(rows_of(args))
    evaluations: list[Evaluation] = sorted(found, key=lambda each: (order.index(each.row), each.seed))
    rows = {each.row for each in evaluations}
    parts = [comparison_table(evaluations)]
    paired = args.refining  # refined or not, they are motions of the same models
    parts += [contrast_table(evaluations, *claim, paired) for claim in CLAIMS if rows.issuperset(claim)]
    return "\n".join(parts)


def draw(args: argparse.Namespace):
    """What the rows that are there make of ``TEXTS``, one row of poses each."""
    import torch

    from refine.drawing import strip
    from refine.text.generation import generate_described
    from renderers.body import Body
    from train.text_models import encoder_of, load_text_model

    body, rows, captions = Body.free("light"), [], []
    for name in SHOWN:
        run = args.runs / f"{args.preset}-{ROWS[name].run}-{args.seeds[0]}"
        if (run / "done").exists():
            model = load_text_model(run / "last.safetensors")
            frames = [45] * len(TEXTS)
            made = generate_described(model, encoder_of(model), TEXTS, frames, torch.Generator().manual_seed(0))
            rows += [[picture] for picture in strip(made, body, height=120)]
            captions += [f"{name}: {motion.label}" for motion in made]
    if rows:
        save_png(place(args) / "sheet.png", contact_sheet(rows, captions))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="builtin", help="builtin, or a folder of `refine data texts`")
    parser.add_argument("--rows", nargs="+", choices=[*ROWS, *REFINING], help="all, unless given")
    parser.add_argument("--refining", action="store_true", help="the table of what refinement does, of fewer clips")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--preset", default="small")
    parser.add_argument("--actions", default="pairs", help="which test clips are measured")
    parser.add_argument("--runs", type=Path, default=Path("runs/text"), help="where runs are kept")
    parser.add_argument("--out", type=Path, default=RESULTS, help="where results go")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only draw the table and the sheet of what there is")
    parser.add_argument("--flags", nargs=argparse.REMAINDER, default=[], help="more flags of the training, last")
    args = parser.parse_args()
    if not args.table:
        place(args).mkdir(parents=True, exist_ok=True)
        trained(args.runs / "scorer", "text-scorer", other(args.preset), "--data.source", args.source)
        tasks = [(row, seed) for seed in args.seeds for row in args.rows or rows_of(args)]
        with ThreadPoolExecutor(args.workers) as pool:
            for waiting in [pool.submit(one, *task, args) for task in tasks]:
                waiting.result()
    table = tabulate(args)
    replace_file(place(args).with_suffix(".md"), table.encode())
    if not args.refining:
        draw(args)
    print(table)


if __name__ == "__main__":
    main()
