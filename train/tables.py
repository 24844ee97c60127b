"""Evaluations as JSON, and as Markdown tables that say what their figures can and cannot tell."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any, Literal, Self

from refine.formats.untrusted import read_json
from refine.intervals import compare, summarise_repeats
from renderers.checks import UserError
from train import published
from train.checkpoints import replace_file, to_json

SCHEMA = 1
REAL = "Real"
TRUE = "True compositions"
BESIDE = (REAL, TRUE)
"""Rows that no method has made; they do not compete."""
NONE = "–"


@dataclass(frozen=True)
class Metric:
    """How a measure is printed."""

    label: str
    better: Literal["lower", "higher", "real"] | None = None
    """Which values are better; ``real``: the nearer to that of real motions."""
    unit: str = ""
    scale: float = 1.0
    """What a stored value is multiplied with to be in ``unit``."""
    decimals: int = 2

    @property
    def head(self) -> str:
        arrow = {"lower": " ↓", "higher": " ↑", "real": " →", None: ""}[self.better]
        return self.label + (f", {self.unit}" if self.unit else "") + arrow

    def print(self, value: float | None) -> str:
        return NONE if value is None else f"{value:.{self.decimals}f}"


# Stored values are in metres, seconds and shares of 1.
METRICS = {
    "fid_c": Metric("FID-C", "lower"),
    "fid_half": Metric("FID-C, recogniser of one half", "lower"),
    "fid_true": Metric("FID to true", "lower"),
    "kid_c": Metric("KID-C", "lower", decimals=3),
    "kid_half": Metric("KID-C, recogniser of one half", "lower", decimals=3),
    "kid_true": Metric("KID to true", "lower", decimals=3),
    "accuracy": Metric("accuracy", "higher", "%", 100, 1),
    "accuracy_half": Metric("accuracy, recogniser of one half", "higher", "%", 100, 1),
    "accuracy_true": Metric("accuracy, recogniser of true", "higher", "%", 100, 1),
    "both_actions": Metric("both actions", "higher", "%", 100, 1),
    "legs": Metric("legs' action", "higher", "%", 100, 1),
    "arms": Metric("arms' action", "higher", "%", 100, 1),
    "diversity": Metric("diversity", "real"),
    "diversity_exact": Metric("diversity, all pairs", "real"),
    "multimodality": Metric("multimodality", "real"),
    "multimodality_exact": Metric("multimodality, all pairs", "real"),
    "nearest_true": Metric("error to nearest true", "lower", "cm", 100),
    "covered_true": Metric("error of true to nearest", "lower", "cm", 100),
    "temos": Metric("TEMOS score", "higher", decimals=3),
    "ape_root": Metric("APE root", "lower", "m", decimals=3),
    "ape_trajectory": Metric("APE trajectory", "lower", "m", decimals=3),
    "ape_local": Metric("APE mean local", "lower", "m", decimals=3),
    "ape_global": Metric("APE mean global", "lower", "m", decimals=3),
    "ave_root": Metric("AVE root", "lower", "m²", decimals=3),
    "ave_trajectory": Metric("AVE trajectory", "lower", "m²", decimals=3),
    "ave_local": Metric("AVE mean local", "lower", "m²", decimals=3),
    "ave_global": Metric("AVE mean global", "lower", "m²", decimals=3),
    "text_top1": Metric("R-precision, top 1", "higher", "%", 100, 1),
    "text_top3": Metric("R-precision, top 3", "higher", "%", 100, 1),
    "text_rank": Metric("median rank", "lower", decimals=1),
    "text_diversity": Metric("diversity", "real", decimals=3),
    "text_multimodality": Metric("multimodality", decimals=3),
    "foot_skate": Metric("foot skate", "lower", "m/s", 1, 3),
    "floor_penetration": Metric("floor penetration", "lower", "cm", 100),
    "jitter": Metric("jitter", "real", "m/s³", 1, 1),
}


@dataclass(frozen=True)
class Sayings:
    """What is said above and below the tables of one kind of evaluation."""

    caution: str
    """What its figures cannot see."""
    repeats: str
    """What a repeat is, and what stands beside the model."""
    seeds: str
    truth: str
    """What the true motions' figures mean."""
    published: Callable[[], str]
    """The paper's own figures."""


CAUTION = (
    "FID-C and accuracy compare with compositions made by the same mask operator that makes the training pairs, by a "
    "recogniser trained on them. They reward that operator, and a method that composes better than it is punished. "
    "Read them beside both-actions accuracy, whose part-wise recognisers saw single actions only, and, where a set has "
    "true compositions, beside FID and error to those. FID is biased upwards at small N: compare at equal N, and with "
    "real against real."
)
OVER_REPEATS = (
    "Repeats draw new motions from one trained model: sd and the 95 % interval (Student's t) tell how exactly this "
    "model is measured, not how another training would turn out. `actor_pm` is 1.96 times the variance, as ACTOR "
    "prints after ±. Real against real: compositions that the mask operator makes of training clips, as many, measured "
    "in the same way; nothing is learned."
)
OVER_SEEDS = (
    "Mean over training seeds of the mean over repeats, with its 95 % interval (Student's t over seeds; none for one "
    "seed). Bold: better than all others, and its interval excludes theirs (the means of rows with one seed)."
)
OF_REAL = "Real: compositions that the mask operator makes of training clips, as many; they do not compete."
OF_TRUTH = (
    f"{TRUE}: the benchmark's own, measured once in the same way. A method that composed perfectly would have about "
    "this FID-C, which is not the lowest; what compares them with themselves is left out."
)


@dataclass(frozen=True)
class Evaluation:
    """What one trained model was measured at."""

    row: str
    """The method, as tables name it; ``REAL`` for compositions of real clips."""
    seed: int
    """Of the training."""
    benchmark: str
    n: int
    """Motions a repeat."""
    metrics: dict[str, list[float]]
    """Values of each measure, one a repeat, in metres, seconds and shares of 1."""
    real: dict[str, list[float]] = field(default_factory=dict)
    """The same of compositions of real clips that are not in the test set, at equal n."""
    truth: dict[str, list[float]] = field(default_factory=dict)
    """The same of the true test compositions, where there are such: one value each, since nothing is drawn."""
    versions: dict[str, str] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    """SHA-256 of what was measured, ``model``, and of what measured it: benchmark, recognisers. Rows of one table must
    agree in all but the model's."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Command, commit, hardware, seconds."""

    def __post_init__(self):
        for name, values in [*self.metrics.items(), *self.real.items(), *self.truth.items()]:
            strange = [value for value in values if not math.isfinite(value)]
            if strange or not values:
                what = f"{len(strange)} of {len(values)} values are not finite" if strange else "there are no values"
                raise UserError(f"evaluation of {self.row}, seed {self.seed}", f"{name}: {what}")

    def to_json(self) -> dict:
        """Everything, with a summary of each measure in the units of the tables."""
        summary = {
            name: {"unit": metric_of(name).unit, **summarise_repeats(scaled(name, values))}
            for name, values in self.metrics.items()
        }
        return {"schema": SCHEMA, "kind": "evaluation", **asdict(self), "summary": summary}

    @classmethod
    def from_json(cls, found: dict) -> Self:
        """The evaluation of ``to_json``; its summary is not read.

        Raises:
            UserError: it is none, of another schema, or holds values that are no numbers.
        """
        again = "give what `refine evaluate` wrote"
        if not isinstance(found, dict) or found.get("kind") != "evaluation":
            raise UserError("Evaluation", "is no evaluation", again)
        if found.get("schema") != SCHEMA:
            raise UserError("Evaluation", f"is of schema {found.get('schema')}, this version reads {SCHEMA}", again)
        try:
            found = {"truth": {}, **found}  # evaluations of before it was measured
            values = {name: found[name] for name in cls.__dataclass_fields__}
            for group in ("metrics", "real", "truth"):
                values[group] = {name: [float(each) for each in row] for name, row in found[group].items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError("Evaluation", f"is damaged ({type(error).__name__}: {error})", again) from error
        return cls(**values)


def save_evaluation(path: Path, evaluation: Evaluation):
    replace_file(path, to_json(evaluation.to_json()))


def load_evaluation(path: Path) -> Evaluation:
    """Read what ``save_evaluation`` wrote.

    Raises:
        UserError: it is missing or not an evaluation.
    """
    if not path.is_file():
        raise UserError(path, "no such file", "give what `refine evaluate` wrote")
    try:
        return Evaluation.from_json(read_json(path, finite=False))
    except UserError as error:
        raise UserError(path, error.problem, error.remedy) from error


def sayings_of(evaluation: Evaluation) -> Sayings:
    """Those of compositions of labels, or of motions from texts."""
    return OF_TEXTS if "temos" in evaluation.metrics else OF_LABELS


def metric_of(name: str) -> Metric:
    return METRICS.get(name, Metric(name.replace("_", " "), decimals=3))


def scaled(name: str, values: Iterable[float]) -> list[float]:
    return [value * metric_of(name).scale for value in values]


def in_order(names: Iterable[str]) -> list[str]:
    """Known measures in the order of ``METRICS``, then the others as they came."""
    names = list(dict.fromkeys(names))
    return [name for name in METRICS if name in names] + [name for name in names if name not in METRICS]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column is of words, the others of numbers."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def interval(metric: Metric, ends: Sequence[float] | None) -> str:
    return NONE if ends is None else f"[{metric.print(ends[0])}, {metric.print(ends[1])}]"


def evaluation_table(evaluation: Evaluation) -> str:
    """One model: every measure with N, repeats, mean, sd, interval, ACTOR's plus-minus, and real against real."""
    rows = []
    for name in in_order(evaluation.metrics):
        metric, found = metric_of(name), summarise_repeats(scaled(name, evaluation.metrics[name]))
        real = mean(scaled(name, evaluation.real[name])) if name in evaluation.real else None
        rows.append(
            [
                metric.head,
                f"{evaluation.n}",
                f"{found['n']}",
                metric.print(found["mean"]),
                metric.print(found["sd"]),
                interval(metric, found["ci95"]),
                NONE if found["actor_pm"] is None else f"{found['actor_pm']:.3g}",
                metric.print(real),
            ]
        )
        if evaluation.truth:
            truth = mean(scaled(name, evaluation.truth[name])) if name in evaluation.truth else None
            rows[-1].append(metric.print(truth))
    head = ["measure", "N", "repeats", "mean", "sd", "95 % interval", "actor_pm", "real against real"]
    head += [TRUE.lower()] if evaluation.truth else []
    sayings = sayings_of(evaluation)
    said = "\n\n".join([sayings.caution, sayings.repeats, *([sayings.truth] if evaluation.truth else [])])
    facts = [f"{name} {number}" for name, number in evaluation.versions.items()]
    facts += [f"{name} `{digest[:12]}`" for name, digest in evaluation.hashes.items()]
    title = f"## {evaluation.row} on {evaluation.benchmark}, training seed {evaluation.seed}"
    parts = [title, said, table(head, rows), ", ".join(facts)]
    return "\n\n".join(part for part in parts if part) + "\n"


def comparison_table(evaluations: Sequence[Evaluation], metrics: Sequence[str] | None = None) -> str:
    """Methods beside each other over training seeds, and below them the figures that the paper prints.

    Args:
        evaluations: one a method and seed, all of one benchmark, N and recognisers; methods come in this order, after
            rows ``REAL`` and ``TRUE`` of what the first that has it measured beside its model.
        metrics: those to show; all that were measured, unless given.

    Raises:
        UserError: there are none, they do not belong in one table, or a method has a seed twice.
    """
    rows = by_row(evaluations)
    for name, group in ((TRUE, "truth"), (REAL, "real")):
        beside = next((each for each in evaluations if getattr(each, group)), None)
        if beside and name not in rows:
            rows = {name: [replace(beside, row=name, metrics=getattr(beside, group))], **rows}
    rows = {name: rows[name] for name in BESIDE if name in rows} | rows
    names = in_order(name for each in evaluations for name in each.metrics) if metrics is None else list(metrics)
    columns = {name: {row: [*over_seeds(name, group).values()] for row, group in rows.items()} for name in names}
    winners = {name: best(metric_of(name), column) for name, column in columns.items()}

    def cell(name: str, row: str) -> str:
        metric, values = metric_of(name), columns[name][row]
        if not values:
            return NONE
        found = summarise_repeats(values)
        text = metric.print(found["mean"])
        text = f"**{text}**" if winners[name] == row else text
        return text if found["ci95"] is None else f"{text} {interval(metric, found['ci95'])}"

    head = ["", "seeds", *(metric_of(name).head for name in names)]
    body = [
        [row, NONE if row in BESIDE else f"{len(group)}", *(cell(name, row) for name in names)]
        for row, group in rows.items()
    ]
    first = evaluations[0]
    repeats = sorted({len(values) for each in evaluations for values in each.metrics.values()})
    said = f"{first.n} motions a repeat, {' or '.join(map(str, repeats))} repeats a model."
    title = f"## Methods on {first.benchmark}"
    sayings = sayings_of(first)
    above = [sayings.caution, f"{OVER_SEEDS} {sayings.seeds} {said}", *([sayings.truth] if TRUE in rows else [])]
    return "\n\n".join([title, *above, table(head, body), sayings.published()]) + "\n"


def contrast_table(
    evaluations: Sequence[Evaluation],
    row: str,
    against: str,
    paired: bool = False,
    metrics: Sequence[str] | None = None,
) -> str:
    """One method against another over training seeds: differences and ratios with their intervals.

    Args:
        evaluations: as ``comparison_table``.
        paired: compare seed by seed; both must have the same.

    Raises:
        UserError: one of the two has no evaluation, or seeds are not pairs.
    """
    rows = by_row(evaluations)
    for name in (row, against):
        if name not in rows:
            raise UserError("contrast_table", f"no evaluation of {name!r}", f"there are {', '.join(rows)}")
    shared = [name for name in in_order(rows[row][0].metrics) if metrics is None or name in metrics]
    body = []
    for name in shared:
        metric, ours, theirs = metric_of(name), over_seeds(name, rows[row]), over_seeds(name, rows[against])
        if not ours or not theirs:
            continue
        if paired and ours.keys() != theirs.keys():
            raise UserError("contrast_table", f"{row} and {against} do not have {name} for the same seeds")
        found, ratio = compare([*ours.values()], [*theirs.values()], paired), Metric("", decimals=3)
        body.append(
            [
                metric.head,
                f"{len(ours)}, {len(theirs)}",
                f"{found['difference']:+.{metric.decimals}f}",
                interval(metric, found["difference_ci95"]),
                ratio.print(found["ratio"]),
                interval(ratio, found["ratio_ci95"]),
            ]
        )
    how = "Seeds are compared one by one" if paired else "Seeds are independent (Welch)"
    text = (
        f"{how}. A difference is shown where its interval excludes 0; “10 % lower” where the ratio's interval ends at "
        "0.900 or below. Each interval stands for itself: among twenty measures one misses its value by chance."
    )
    head = ["measure", "seeds", "difference", "95 % interval", "ratio", "95 % interval"]
    title = f"### {row} against {against}, {evaluations[0].benchmark}"
    return "\n\n".join([title, text, table(head, body)]) + "\n"


def by_row(evaluations: Sequence[Evaluation]) -> dict[str, list[Evaluation]]:
    """Evaluations by method, seeds in order; refused when they do not belong in one table."""
    if not evaluations:
        raise UserError("tables", "there are no evaluations", "give the files that `refine evaluate` wrote")
    rows: dict[str, list[Evaluation]] = {}
    first = evaluations[0]
    measured = {name: digest for name, digest in first.hashes.items() if name != "model"}
    for each in evaluations:
        whose = f"{each.row}, seed {each.seed}"
        for what in ("benchmark", "n"):
            if getattr(each, what) != getattr(first, what):
                raise UserError(
                    whose, f"{what} is {getattr(each, what)}, that of {first.row} {getattr(first, what)}",
                    "only what was measured alike can be compared",
                )  # fmt: skip
        other = {name: digest for name, digest in each.hashes.items() if name != "model"}
        if other != measured:
            differing = sorted(name for name in measured | other if measured.get(name) != other.get(name))
            raise UserError(
                whose, f"was measured with another {', '.join(differing)} than {first.row}", "evaluate it again"
            )
        group = rows.setdefault(each.row, [])
        if any(each.seed == one.seed for one in group):
            raise UserError(whose, "is there twice", "give one evaluation of a training")
        group.append(each)
    return {row: sorted(group, key=lambda each: each.seed) for row, group in rows.items()}


def over_seeds(name: str, group: Sequence[Evaluation]) -> dict[int, float]:
    """A measure's mean over repeats, for each seed that has it, in the unit of the tables."""
    return {each.seed: mean(scaled(name, each.metrics[name])) for each in group if name in each.metrics}


def best(metric: Metric, column: dict[str, list[float]]) -> str | None:
    """The method whose values are best beyond the intervals, if there is one; real and true ones do not compete."""
    real = column.get(REAL)
    rivals = {row: values for row, values in column.items() if row not in BESIDE and values}
    if metric.better is None or len(rivals) < 2 or (metric.better == "real" and not real):
        return None
    if metric.better == "real":
        rivals = {row: [abs(value - mean(real)) for value in values] for row, values in rivals.items()}
    sign = -1 if metric.better == "higher" else 1
    found = {row: summarise_repeats([sign * value for value in values]) for row, values in rivals.items()}
    winner = min(found, key=lambda row: found[row]["mean"])
    if found[winner]["ci95"] is None:
        return None
    ends = [(each["ci95"] or [each["mean"]])[0] for row, each in found.items() if row != winner]
    return winner if found[winner]["ci95"][1] < min(ends) else None


def published_table() -> str:
    """The paper's figures as printed, and what is doubtful about them."""
    sets, columns = (published.UESTC, published.HUMANACT), ("fid_c", "accuracy", "diversity", "multimodality")
    methods = dict.fromkeys((each.table, each.method) for each in published.PUBLISHED)
    found = {(each.table, each.method, each.benchmark): each for each in published.PUBLISHED}

    def cell(name: str, figure: published.Figure) -> str:
        return f"{METRICS[name].print(figure.mean)} ± {figure.plus_minus:.2f}"

    body = []
    for source, method in methods:
        on = [found[source, method, benchmark] for benchmark in sets]
        body.append([method, source, *(cell(name, getattr(each, name)) for each in on for name in columns)])
    head = ["as published", "in", *(f"{each}: {METRICS[name].head}" for each in sets for name in columns)]
    doubts = [
        f"- {each.method} on {each.benchmark} ({each.table}): {each.doubt}."
        for each in published.PUBLISHED
        if each.doubt
    ]
    text = (
        "LFCA's own figures. Its sets and recognisers were never released, so only orders and ratios between methods "
        f"can be compared with ours. {published.PLUS_MINUS}"
    )
    return "\n\n".join([text, table(head, body), "Doubtful:\n\n" + "\n".join(doubts)])


def published_text_table() -> str:
    """SINC's figures as printed, and what is doubtful about them."""
    names = published.SINC_MEASURES
    rows = [
        [
            each.method,
            each.table,
            *(metric_of(name).print(value) for name, value in zip(names, each.values, strict=True)),
        ]
        for each in published.SINC
    ]
    head = ["as published", "in", *(metric_of(name).head for name in names)]
    doubts = [f"- {each.method} ({each.table}): {each.doubt}." for each in published.SINC if each.doubt]
    text = (
        "SINC's own figures, on 667 pairs of BABEL, with an encoder that was never released; their released code "
        "measures headings in a mirrored frame. Only orders and ratios between methods can be compared with ours."
    )
    scores = "; ".join(f"{name} {before} to {after}" for name, (before, after) in published.SINC_SCORES.items())
    scores = f"What is made of single actions changes the TEMOS score so (Table A.1): {scores}."
    return "\n\n".join([text, table(head, rows), scores, "Doubtful:\n\n" + "\n".join(doubts)])


OF_LABELS = Sayings(CAUTION, OVER_REPEATS, OF_REAL, OF_TRUTH, published_table)
OF_TEXTS = Sayings(
    caution=(
        "A text allows many motions, and the clip it is compared with is one of them. APE and AVE are low for motions "
        "that lack an action, above all a fine one, and for motions that hardly move; the TEMOS score and R-precision "
        "are only as good as the encoder that gives them, which learned single actions alone. Read them together."
    ),
    repeats=(
        "Repeats draw new motions from one trained model, one a text: sd and the 95 % interval (Student's t) tell how "
        "exactly this model is measured, not how another training would turn out. APE is a mean over all frames of "
        "all clips, AVE over clips; multimodality is the mean distance of one text's motions over the repeats."
    ),
    seeds="Rows of one seed have no interval.",
    truth=(
        "True compositions: the test clips themselves. Their errors are 0 and their TEMOS score 1 by definition and "
        "left out; R-precision and diversity are what a method that matched them would have."
    ),
    published=published_text_table,
)
