"""The benchmark of shares: who gets a part without a picture, and what the table says."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from refine.ownership import Owned
from renderers.skeleton import DRAWN_PART_NAMES, PART_NAMES

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def shares(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("shares")


def test_ownership_gives_a_part_wholly_to_who_answers_for_it(shares):
    answers = torch.zeros(2, 1, len(DRAWN_PART_NAMES))
    answers[0, 0, DRAWN_PART_NAMES.index("left_leg")] = 1.0
    answers[1, 0, [DRAWN_PART_NAMES.index(name) for name in ("torso", "head")]] = 0.5
    sides = tuple(Owned(some, some > 0) for some in answers)
    features = torch.zeros(1, 2, 25, 6)
    features[..., :24, 0] = features[..., :24, 4] = 1.0
    batch = SimpleNamespace(features_i=features, features_j=features, lam=torch.tensor([0.5]))
    lean = shares.by_ownership(SimpleNamespace(ownership=lambda i, j: sides))(batch)[0]
    expected = dict.fromkeys(PART_NAMES, 0.0) | {"left_leg": shares.WHOLLY, "torso": -shares.WHOLLY / 2}
    assert dict(zip(PART_NAMES, lean.tolist(), strict=True)) == expected


def test_the_table_has_a_row_a_way_in_the_units_of_its_head(shares):
    metrics = {
        "both_actions": {"mean": 0.5, "ci95": [0.25, 0.75]},
        "nearest_true": {"mean": 0.07, "ci95": [0.06, 0.08]},
    }
    found = {
        "n": 4,
        "repeats": 2,
        "command": "python benchmarks/shares.py",
        "commit": "0" * 40,
        "hardware": "none",
        "rows": {"Eq. 3": {"metrics": metrics, "seconds": 1.2}},
    }
    lines = shares.table(found).splitlines()
    assert lines[2].startswith("| shares by | both actions, % ↑ | error to nearest true, cm ↓ | seconds |")
    assert lines[4] == "| Eq. 3 | 50.0 [25.0, 75.0] | 7.00 [6.00, 8.00] | 1 |"
