"""Learning curves of many runs: thinned numbers that are kept with the results, and the picture drawn from them."""

import json
import math
from pathlib import Path
from statistics import mean

import torch
from torch import Tensor
from torch.nn.functional import pad

from renderers.images import chart
from train.curves import dense, smooth

POINTS = 100
TERMS = {
    "rc": "error of features",
    "rcxyz": "squared error of joints, in metres",
    "kl": "KL term",
    "dr": "decoupling loss of generated motions",
}

Curve = dict[str, list[float | None]]
"""A value of each term at each per cent of a run; none before it is first taken. A term that it never takes is absent.
"""


def thinned(log: Path, points: int = POINTS) -> Curve:
    """Every loss term of a ``log.jsonl`` as means over equal stretches of the run, to 4 digits."""
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    steps = rows[-1]["step"] + 1
    points = min(points, steps)
    ends = [(steps * (n + 1)) // points - 1 for n in range(points)]
    terms = [name for name in TERMS if any(name in row for row in rows)]
    curves = {name: smooth(dense(rows, name, steps), max(1, steps // points)) for name in terms}
    return {name: [rounded(curve[end]) for end in ends] for name, curve in curves.items()}


def rounded(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def draw_runs(curves: dict[str, Curve], title: str) -> Tensor:
    """A chart for each term with a line for each row, the mean over its seeds: [3 H W] in 0..1.

    Args:
        curves: of runs named ``row-seed``.
    """
    rows: dict[str, list[Curve]] = {}
    for name, curve in curves.items():
        rows.setdefault(name.rpartition("-")[0], []).append(curve)
    charts = []
    for term, said in TERMS.items():
        lines = {}
        for row, seeds in rows.items():
            known = [curve[term] for curve in seeds if term in curve]
            if known:
                lines[row] = [math.nan if None in values else mean(values) for values in zip(*known, strict=True)]
        if lines:
            charts.append(chart(lines, f"{title}: {said}, against per cent of the steps", size=(360, 860)))
    width = max(one.shape[2] for one in charts)
    return torch.cat([pad(one, (0, width - one.shape[2]), value=1.0) for one in charts], dim=1)
