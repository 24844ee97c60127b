"""``refine evaluate``: a trained generator in numbers, and many of them beside each other."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from train.tables import Evaluation


@dataclass(frozen=True)
class Evaluate:
    """Measure a generator against a benchmark, or text to motion against test clips, or put evaluations into one table.

    Writes every value as JSON and a Markdown table beside it. The benchmark is a folder of `refine data benchmark`
    with the recognisers of `refine train recogniser` in it. What is the same for every run (the mask operator on
    training clips, and the true compositions) is measured once and kept there in recognisers/beside.json. It is
    measured anew for another number of repeats, seed, benchmark, recogniser or version, or if that file is removed.

    With --scorer, runs of `refine train text` and `text-diffusion` are measured by SINC's measures on the test clips of
    what they were trained on, or of --texts.

    Example: refine evaluate runs/generator --benchmark synth-c
    Example: refine evaluate runs/text --scorer runs/text-scorer
    Example: refine evaluate --table runs/*/evaluation.json --against without-dr -o table.md
    """

    what: Positional[tuple[Path, ...]]
    """Run folder of `refine train generator`; with --table, evaluations (.json), or quoted patterns of their names."""
    benchmark: Path | None = None
    """Folder of the benchmark."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """File to write, .json (the table beside it is .md); evaluation.json in the run folder, unless given. With --table
    a .md, unless the table is only to be printed."""
    scorer: Path | None = None
    """Run folder of `refine train text-scorer`."""
    texts: Path | None = None
    """With --scorer: a folder of `refine data texts`, whose test clips are measured."""
    actions: Literal["pairs", "singles", "all"] = "pairs"
    """With --scorer: which test clips, of several actions at once, of one, or all."""
    by: Literal["sentence", "parts"] = "sentence"
    """With --scorer: pairs from a sentence; or each action alone, put together by the parts that its text is about."""
    conjunction: str = "while"
    """With --scorer: how the texts of a pair are said in one sentence, as for `refine generate`."""
    heading: Literal["correct", "sinc_legacy"] = "correct"
    """With --scorer: what a body's heading is, or what SINC's released code takes for it."""
    refined: bool = False
    """With --scorer: refine each motion through the decoupling loss before it is measured; seconds each."""
    most: int | None = None
    """With --scorer: measure no more test clips than these, spread evenly over them."""
    encoder: Path | None = None
    """With --scorer: local Hugging Face folder of the text encoder that was trained with, unless it is MiniLM."""
    repeats: int | None = None
    """Sets of motions, each as many as are tested, that are drawn and measured; 20 unless given, or 5 with --scorer."""
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
        if len(self.what) != 1 or (self.benchmark is None) == (self.scorer is None):
            problem = "takes one run and its --benchmark, or --scorer for text to motion"
            raise UserError("refine evaluate", problem, "for several runs use --table")
        return self.measure(self.what[0])

    def measure(self, run: Path) -> Result:
        from renderers.outputs import refuse_existing
        from train.checkpoints import replace_file
        from train.loop import check_device
        from train.tables import evaluation_table, save_evaluation

        out = self.out or run / "evaluation.json"
        if out.suffix != ".json":
            raise UserError(out, "an evaluation is a .json file", "end its name in .json")
        check_device(self.device)
        for path in (out, out.with_suffix(".md")):
            refuse_existing(path, self.force)
        evaluation = self.of_labels(run, self.benchmark) if self.benchmark else self.of_texts(run, self.scorer)
        table = evaluation_table(evaluation)
        save_evaluation(out, evaluation)
        replace_file(out.with_suffix(".md"), table.encode())
        return Result(f"{table}\n{out}", (out, out.with_suffix(".md")), {"evaluation": evaluation.to_json()})

    def of_labels(self, run: Path, folder: Path) -> "Evaluation":
        from train.benchmarks import load_benchmark
        from train.evaluate import EvaluationConfig, evaluate

        config = EvaluationConfig(repeats=self.repeats or 20, seed=self.seed, device=self.device)
        return evaluate(run, load_benchmark(folder), config, self.row)

    def of_texts(self, run: Path, scorer: Path) -> "Evaluation":
        from train.text_evaluate import TextEvaluationConfig, evaluate_text

        config = TextEvaluationConfig(
            repeats=self.repeats or 5,
            actions=self.actions,
            conjunction=self.conjunction,
            by=self.by,
            heading=self.heading,
            refined=self.refined,
            most=self.most,
            seed=self.seed,
            device=self.device,
        )
        return evaluate_text(run, scorer, self.texts, config, self.row, self.encoder)

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
