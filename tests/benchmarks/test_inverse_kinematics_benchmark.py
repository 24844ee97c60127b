"""The benchmark of fitted rotations: what its cases are, and that its table says what was measured."""

import importlib
from pathlib import Path

import pytest
import torch

from renderers.body import Body
from renderers.skeleton import PARENTS

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
REST = Body.free("light").rest_joints


@pytest.fixture
def fitting(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("inverse_kinematics")


@pytest.fixture
def clips(fitting):
    return fitting.built_in(REST, 1, seed=0)[:2]


def test_cases_are_bodies_that_move_alike(fitting, clips):
    cases = {
        case.name: case for case in fitting.as_files_hold_it(clips[0], REST.double(), torch.Generator().manual_seed(0))
    }
    assert [case.positions.shape[1] for case in cases.values()] == [24, 22, 22, 22, 21, 22, 22, 22]
    lengths = {
        name: torch.stack([(case.joints[0, j] - case.joints[0, PARENTS[j]]).norm() for j in range(1, 24)])
        for name, case in cases.items()
    }
    ratio = lengths["other bones, 22"] / lengths["own body, 22"]
    assert 0.7 <= float(ratio.min()) < 0.9 and 1.1 < float(ratio.max()) <= 1.3
    exact, shaken = cases["other bones, 22"].positions, cases["other bones, 22, unsteady by 5 mm"].positions
    assert float((shaken - exact).std()) == pytest.approx(0.005, rel=0.05)


def test_the_table_says_what_was_measured(fitting, clips):
    random = torch.Generator().manual_seed(0)
    summary = fitting.summarise([fitting.measure(clip, REST, random) for clip in clips])
    assert summary["own body, 24"]["error"]["worst"] < 0.01
    assert summary["other bones, 22, unsteady by 5 mm"]["to_truth"]["mean"] > 0.3
    speed = {case: {"frames_per_second": 12345.6} for case in summary}
    report = {"command": "python x", "commit": "abc", "hardware": "a machine", "speed": speed}
    text = fitting.table(report | {"built-in": {"clips": 2, "frames": 180, "summary": summary}})
    assert "## 2 built-in clips, 180 frames" in text and "12,346" in text
    value = summary["KIT, 21"]["error"]
    assert f"| KIT, 21 | {value['mean']:.2f} [" in text and f"| {value['worst']:.2f} | - |" in text


def test_speed_is_frames_over_seconds(fitting, clips, monkeypatch):
    monkeypatch.setattr(fitting, "SPEED_FRAMES", 90)
    monkeypatch.setattr(fitting, "SPEED_REPEATS", 2)
    for found in fitting.speed(clips[0], REST).values():
        assert found["frames_per_second"] == pytest.approx(90 / min(found["seconds"])) and len(found["seconds"]) == 2
