"""A run's log as a picture."""

import json
import math
from pathlib import Path

from renderers.images import chart, save_png


def draw_curves(log: Path, picture: Path):
    """Draw every loss term of a ``log.jsonl`` over the steps, on a log axis, and the held-out total as stairs.

    Each line is the mean over the last hundredth of the steps, so that a long run stays readable.
    """
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    found = dict.fromkeys(name for row in rows for name in row)  # a term may be taken at some steps only
    names = [name for name in found if name not in ("step", "seconds", "gradient", "held_out")]
    steps = rows[-1]["step"] + 1
    series = {name: smooth(dense(rows, name, steps), max(1, steps // 100)) for name in names}
    measured = [{"step": row["step"], "total": row["held_out"]["total"]} for row in rows if "held_out" in row]
    if measured:
        series["held out"] = dense(measured, "total", steps)
    save_png(picture, chart(series, f"{picture.parent.name}: loss terms over {steps:,} steps", size=(420, 760)))


def dense(rows: list[dict], name: str, steps: int) -> list[float]:
    """One value a step: the last one logged, NaN before the first."""
    values = [math.nan] * steps
    rows = [row for row in rows if name in row]
    for row, following in zip(rows, [*rows[1:], {"step": steps}], strict=True):
        values[row["step"] : following["step"]] = [row[name]] * (following["step"] - row["step"])
    return values


def smooth(values: list[float], window: int) -> list[float]:
    """Mean of those of the last ``window`` values that are not NaN; NaN where there are none."""
    means, total, count = [], 0.0, 0
    for index, value in enumerate(values):
        leaving = values[index - window] if index >= window else math.nan
        for number, sign in ((value, 1), (leaving, -1)):
            if not math.isnan(number):
                total, count = total + sign * number, count + sign
        means.append(total / count if count else math.nan)
    return means
