"""``refine evaluate``: a trained generator in numbers, and many of them beside each other."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError


@dataclass(frozen=True)
class Evaluate:
    """Measure a generator against a benchmark, or put evaluations into one table.

    Writes every value as JSON and a Markdown table beside it. The benchmark is a folder of `refine data benchmark`
    with the recognisers of `refine train recogniser` in it. What is the same for every run (the mask operator on
    training clips, and the true compositions) is measured once and kept there in recognisers/beside.json. It is
    measured anew for another number of repeats, seed, benchmark, recogniser or version, or if that file is removed.

    Example: refine evaluate runs/generator --benchmark synth-c
    Example: refine evaluate --table runs/*/evaluation.json --against without-dr -o table.md
    """

    what: Positional[tuple[Path, ...]]
    """Run folder of `refine train generator`; with --table, evaluations (.json), or quoted patterns of their names."""
    benchmark: Path | None = None
    """Folder of the benchmark."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """File to write, .json (the table beside it is .md); evaluation.json in the run folder, unless given. With --table
    a .md, unless the table is only to be printed."""
    repeats: int = 20
    """Sets of motions, each as large as the benchmark's, that are drawn and measured."""
    row: str = ""
    """What tables call the method; the run's variant, unless given."""
    table: bool = False
    """Compare evaluations that are already there, beside the figures that the paper prints."""
    against: str | None = None
    """With --table: the row that every other one is compared with, as a difference and a ratio with intervals."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``."""
    force: bool = False
    """Replace the files if they are there."""
    seed: int = 0
    """Of the motions that are drawn."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        if self.table:
            return self.tabulate()
        if self.against is not None:
            raise UserError("--against", "compares rows of a table", "give it with --table and evaluations")
        if len(self.what) != 1 or self.benchmark is None:
            raise UserError("refine evaluate", "takes one run and its --benchmark", "for several use --table")
        return self.measure(self.what[0], self.benchmark)

    def measure(self, run: Path, folder: Path) -> Result:
        from renderers.outputs import refuse_existing
        from train.benchmarks import load_benchmark
        from train.checkpoints import replace_file
        from train.evaluate import EvaluationConfig, evaluate
        from train.loop import check_device
        from train.tables import evaluation_table, save_evaluation

        out = self.out or run / "evaluation.json"
        if out.suffix != ".json":
            raise UserError(out, "an evaluation is a .json file", "end its name in .json")
        check_device(self.device)
        config = EvaluationConfig(repeats=self.repeats, seed=self.seed, device=self.device)
        for path in (out, out.with_suffix(".md")):
            refuse_existing(path, self.force)
        evaluation = evaluate(run, load_benchmark(folder), config, self.row)
        table = evaluation_table(evaluation)
        save_evaluation(out, evaluation)
        replace_file(out.with_suffix(".md"), table.encode())
        return Result(f"{table}\n{out}", (out, out.with_suffix(".md")), {"evaluation": evaluation.to_json()})

    def tabulate(self) -> Result:
        from refine.cli.inputs import expand
        from renderers.outputs import refuse_existing
        from train.checkpoints import replace_file
        from train.tables import comparison_table, contrast_table, load_evaluation

        if not self.what:
            raise UserError("refine evaluate --table", "no evaluation was given", "name .json files")
        if self.out is not None and self.out.suffix != ".md":
            raise UserError(self.out, "the table is a Markdown file", "end its name in .md")
        if self.out is not None:
            refuse_existing(self.out, self.force)
        evaluations = [load_evaluation(path) for path in expand(self.what)]
        parts = [comparison_table(evaluations)]
        if self.against is not None:
            rows = dict.fromkeys(each.row for each in evaluations)
            parts += [contrast_table(evaluations, row, self.against) for row in rows if row != self.against]
        text = "\n".join(parts)
        if self.out is not None:
            replace_file(self.out, text.encode())
        values = {"evaluations": [each.to_json() for each in evaluations]}
        return Result(text, (self.out,) if self.out else (), values)
