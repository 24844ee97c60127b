"""A run's log as lines."""

import json
import math

import pytest

from train.curves import dense, draw_curves, smooth


def test_a_term_stays_as_it_was_last_logged():
    rows = [{"step": 0, "rc": 5.0}, {"step": 2, "rc": 4.0, "dr": 1.0}, {"step": 3, "rc": 3.0}, {"step": 5, "dr": 2.0}]
    assert dense(rows, "rc", 7) == [5.0, 5.0, 4.0, 3.0, 3.0, 3.0, 3.0]
    assert dense(rows, "dr", 7) == pytest.approx([math.nan, math.nan, 1.0, 1.0, 1.0, 2.0, 2.0], nan_ok=True)


def test_smoothing_is_the_mean_of_what_there_is():
    nan = math.nan
    assert smooth([1.0, 3.0, 5.0, 9.0], 2) == [1.0, 2.0, 4.0, 7.0]
    assert smooth([nan, nan, 4.0, 2.0, 8.0], 2) == pytest.approx([nan, nan, 4.0, 3.0, 5.0], nan_ok=True)
    assert smooth([4.0, nan, nan, 6.0], 2) == pytest.approx([4.0, 4.0, nan, 6.0], nan_ok=True)


def test_terms_that_begin_late_are_drawn(tmp_path):
    rows = [{"step": n, "rc": 2.0 - n / 9, "total": 3.0} | ({"dr": 0.5} if n > 2 and n % 2 else {}) for n in range(9)]
    rows[-1]["held_out"] = {"total": 2.5}
    log = tmp_path / "log.jsonl"
    drawn = []
    for kept in (("rc", "total"), ("rc", "total", "dr")):
        log.write_text(
            "".join(json.dumps({k: v for k, v in row.items() if k in (*kept, "step")}) + "\n" for row in rows)
        )
        draw_curves(log, tmp_path / "curves.png")
        drawn.append((tmp_path / "curves.png").read_bytes())
    assert drawn[0] != drawn[1]
