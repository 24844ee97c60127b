"""How well a labeller finds the parts that phrases are about, against labels by hand (SINC, Table 1)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from refine.formats.untrusted import read_json
from refine.text.parts import BODY_PARTS, Parts
from renderers.checks import UserError

VALUES = (0, 0.5, 1)  # the action is not about the part, may be, is
REMEDY = 'give {"phrase": [global, torso, left arm, right arm, left leg, right leg]}, each 1, 0, or 0.5 for optional'

Label = tuple[float, ...]  # of each of BODY_PARTS, one of VALUES

# Table 1 as it is printed, each part and the mean: 100 descriptions from BABEL, labelled by hand.
PUBLISHED: dict[str, tuple[float, ...]] = {
    "part velocity": (0.72, 0.68, 0.60, 0.55, 0.58, 0.67, 0.65),
    "GPT-3, free form": (0.72, 0.70, 0.85, 0.86, 0.80, 0.83, 0.79),
    "GPT-3, list": (0.79, 0.68, 0.89, 0.90, 0.88, 0.89, 0.84),
    "GPT-3, list and examples": (0.84, 0.72, 0.89, 0.89, 0.89, 0.90, 0.85),
}


@dataclass(frozen=True)
class PartAccuracy:
    """How often one part was found right."""

    accuracy: float
    """Share of the labels that are not optional; NaN where all are."""
    strict: float
    """Share of all labels, where an optional one counts as wrong."""
    n: int
    """Labels that are not optional."""


@dataclass(frozen=True)
class Wrong:
    """A phrase that was labelled otherwise than by hand; optional parts count as right."""

    phrase: str
    parts: tuple[str, ...]
    """Those that differ."""


@dataclass(frozen=True)
class Accuracy:
    """A row of Table 1, by both rules of counting."""

    parts: dict[str, PartAccuracy]
    """By the names of ``BODY_PARTS``."""
    wrong: tuple[Wrong, ...]
    """The phrases that differ, those with the most parts first."""
    n: int
    """Phrases."""

    @property
    def mean(self) -> float:
        """Over the parts, optional labels left out: the rule that the paper states."""
        return _mean([each.accuracy for each in self.parts.values()])

    @property
    def mean_strict(self) -> float:
        """Over the parts, an optional label counting as wrong: the rule that gives nearly the printed figures."""
        return _mean([each.strict for each in self.parts.values()])

    def values(self) -> dict[str, Any]:
        """For programs."""
        parts = {name: {"accuracy": one.accuracy, "strict": one.strict, "n": one.n} for name, one in self.parts.items()}
        wrong = [{"phrase": each.phrase, "parts": list(each.parts)} for each in self.wrong]
        return {"mean": self.mean, "mean_strict": self.mean_strict, "n": self.n, "parts": parts, "wrong": wrong}


def accuracy(phrases: Sequence[str], labels: Sequence[Label], found: Sequence[Parts]) -> Accuracy:
    """Compare the parts that were found with labels by hand, phrase by phrase.

    Raises:
        UserError: there is nothing to compare.
    """
    if not phrases:
        raise UserError("accuracy", "has nothing to compare", "give at least one phrase with its label")
    parts = {}
    for number, name in enumerate(BODY_PARTS):
        pairs = [(label[number], one[number]) for label, one in zip(labels, found, strict=True)]
        right = sum(value == marked for value, marked in pairs)
        n = sum(value != 0.5 for value, _ in pairs)
        parts[name] = PartAccuracy(right / n if n else math.nan, right / len(pairs), n)
    differing = [
        Wrong(
            phrase, tuple(name for name, value, mark in zip(BODY_PARTS, label, one, strict=True) if value == 1 - mark)
        )
        for phrase, label, one in zip(phrases, labels, found, strict=True)
    ]
    wrong = sorted((each for each in differing if each.parts), key=lambda each: -len(each.parts))
    return Accuracy(parts, tuple(wrong), len(phrases))


def read_labels(path: str | Path) -> dict[str, Label]:
    """Labels by hand: a JSON object of phrases, each with six values.

    Raises:
        UserError: the file is missing, too large, no JSON, or of another shape; a phrase is there twice, or a value is
            neither 0, 0.5 nor 1.
    """
    content = read_json(path, unique=True)
    if not isinstance(content, dict) or not content:
        raise UserError(path, "holds no labels", REMEDY)
    for phrase, label in content.items():
        if not phrase.strip():
            raise UserError(path, "has a label for an empty phrase", REMEDY)
        if not isinstance(label, list) or len(label) != len(BODY_PARTS):
            raise UserError(path, f"{phrase!r} has not six values", REMEDY)
        for value in label:
            if isinstance(value, bool) or value not in VALUES:
                raise UserError(path, f"{phrase!r} has {value!r}", REMEDY)
    return {phrase: tuple(map(float, label)) for phrase, label in content.items()}


def table(rows: Mapping[str, Sequence[float]]) -> str:
    """Rows of a value for each part and their mean, in Markdown; no value is a dash."""
    width = max(map(len, rows))
    heads = [f"{name:<5}" for name in (*BODY_PARTS, "mean")]
    lines = [
        f"| {'':<{width}} | {' | '.join(heads)} |",
        f"|-{'-' * width}-|{'|'.join('-' * (len(h) + 2) for h in heads)}|",
    ]
    for name, values in rows.items():
        cells = ("-" if math.isnan(value) else f"{value:.3f}" for value in values)
        lines.append(
            f"| {name:<{width}} | {' | '.join(f'{cell:>{len(h)}}' for h, cell in zip(heads, cells, strict=True))} |"
        )
    return "\n".join(lines)


def report(found: Accuracy, by: str, what: str = "phrases", worst: int = 10) -> str:
    """For people: both rows beside the paper's, and what was labelled wrong most."""
    names = list(found.parts.values())
    rows: dict[str, Sequence[float]] = {
        f"{by}, {found.n} {what}": [*(each.accuracy for each in names), found.mean],
        "  optional counted as wrong": [*(each.strict for each in names), found.mean_strict],
        **{f"paper: {name}": values for name, values in PUBLISHED.items()},
    }
    lines = [table(rows)]
    if found.wrong:
        lines += [f"{len(found.wrong)} of {found.n} {what} have a wrong part; the most:"]
        lines += [f'  "{each.phrase}": {", ".join(each.parts)}' for each in found.wrong[:worst]]
    return "\n".join(lines)


def _mean(values: Sequence[float]) -> float:
    """Of those that there are."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan
