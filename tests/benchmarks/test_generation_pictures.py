"""Learning curves that are kept with results, and the sheet of compositions."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from refine.coupling import couple
from refine.synthetic import draw, perform
from renderers.body import Body
from train.evaluate import Sample

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def curves(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("generation_curves")


@pytest.fixture
def sheet(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("generation_sheet")


def test_curves_are_means_over_equal_stretches(curves, tmp_path):
    rows = [{"step": step, "rc": 1.0 + step, "seconds": 0.1} for step in range(0, 40)]
    rows[20]["dr"] = 0.123456
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    found = curves.thinned(tmp_path / "log.jsonl", points=4)
    assert set(found) == {"rc", "dr"}
    assert found["rc"] == [5.5, 15.5, 25.5, 35.5]
    assert found["dr"] == [None, None, 0.1235, 0.1235]


def test_a_row_is_one_line_of_the_mean_over_its_seeds(curves, monkeypatch):
    drawn = []
    monkeypatch.setattr(curves, "chart", lambda lines, *_, **__: drawn.append(lines) or torch.zeros(3, 4, 5))
    picture = curves.draw_runs(
        {
            "with-dr-0": {"rc": [1.0, 2.0], "dr": [None, 3.0]},
            "with-dr-1": {"rc": [3.0, 4.0]},
            "other-0": {"rc": [0.0, 1.0]},
        },
        "title",
    )
    assert drawn == [
        {"with-dr": [2.0, 3.0], "other": [0.0, 1.0]},
        {"with-dr": [pytest.approx(float("nan"), nan_ok=True), 3.0]},
    ]
    assert picture.shape == (3, 8, 5)


def test_pairs_on_a_sheet_show_as_many_actions_as_they_can(sheet):
    pairs = tuple((i, j) for i in "ab" for j in "xyz")
    assert sheet.spread_pairs(pairs, 3) == [("a", "x"), ("b", "y"), ("a", "z")]
    assert len(sheet.spread_pairs(pairs, 10)) == 6


def test_a_sheet_has_a_row_a_pair_and_a_column_a_run(sheet, monkeypatch):
    rest = Body.free("light").rest_joints
    random = torch.Generator().manual_seed(0)
    walk, wave = (perform(draw(name, random), 20, rest) for name in ("walk", "wave-both-hands"))
    made = couple(walk, wave, rest).motion
    benchmark = SimpleNamespace(
        name="small", fps=30.0, frames=20, pairs=((walk.label, wave.label),), has_true=False,
        compositions=lambda kind: [made, made],
    )  # fmt: skip
    sample = Sample(walk.rotations.expand(2, -1, -1, -1, -1), walk.root.expand(2, -1, -1))
    monkeypatch.setattr(sheet, "first_set", lambda run, asked: sample)
    seen = []
    monkeypatch.setattr(sheet, "contact_sheet", lambda rows, *words, **more: seen.append((rows, words)) or rows[0][0])
    sheet.draw_sheet(benchmark, {"mine": Path("run")}, 0, height=60, poses=2)
    ((rows, words),) = seen
    assert [len(row) for row in rows] == [2]
    assert words[:2] == (["walk + wave-both-hands"], ["mask composition", "mine"])
    assert (rows[0][0] - rows[0][1]).abs().max() > 0.1  # the wave is in the first alone
