"""The benchmark of refinement after generation: whose motions are refined, and what the table says of them."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from refine.generator import Generator, GeneratorConfig
from refine.metrics import mean_joint_error
from renderers.checks import UserError
from train.checkpoints import save_weights

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
CLASSES = ("walk", "wave")


@pytest.fixture
def refined(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("refined")


def run_of(folder: Path, pairs: str) -> Path:
    """A run folder of an untrained generator of two actions."""
    folder.mkdir()
    torch.manual_seed(0)
    config = GeneratorConfig(CLASSES, latent=32, feedforward=64, layers=1)
    save_weights(folder / "last.safetensors", "generator", Generator(config), {})
    said = {"data": {"pairs": pairs}, "loop": {"seed": 0, "steps": 1}, "coupling": {}}
    (folder / "config.json").write_text(json.dumps(said))
    return folder


def judge_of(rest_joints) -> SimpleNamespace:
    benchmark = SimpleNamespace(frames=8, fps=30.0)
    return SimpleNamespace(benchmark=benchmark, rest_joints=rest_joints, pairs=[CLASSES] * 5)


def test_both_actions_are_made_alone_the_same_for_a_seed(refined, tmp_path, rest_joints):
    run, judge = run_of(tmp_path / "run", "single"), judge_of(rest_joints)
    made = refined.single_actions(run, judge, 3, seed=1)
    assert [(i.label, j.label, len(i), len(j)) for i, j in made] == [(*CLASSES, 8, 8)] * 3
    again, other = (refined.single_actions(run, judge, 3, seed) for seed in (1, 2))
    assert torch.equal(made[0][0].rotations, again[0][0].rotations)
    assert not torch.equal(made[0][0].rotations, other[0][0].rotations)
    assert not torch.equal(made[0][0].rotations, made[1][0].rotations)


def test_a_generator_of_compositions_is_refused(refined, tmp_path, rest_joints):
    with pytest.raises(UserError, match="has not learned single actions; .*pretrain-mask"):
        refined.single_actions(run_of(tmp_path / "run", "test"), judge_of(rest_joints), 1, seed=0)


def test_refinement_moves_what_was_coupled(refined, rest_joints):
    from refine.coupling import CouplingConfig
    from refine.synthetic import draw, perform

    random = torch.Generator().manual_seed(0)
    pair = tuple(perform(draw(name, random, 30.0), 8, rest_joints) for name in ("run", "wave-left-hand"))
    one = refined.refined(pair, CouplingConfig())
    assert one.label == "run+wave-left-hand" and len(one.coupled) == len(one.refined) == 8
    moved = mean_joint_error(one.refined.joints(rest_joints), one.coupled.joints(rest_joints))
    assert 0.001 < moved < 0.5


def test_the_table_has_a_row_a_measure_in_the_units_of_its_head(refined):
    value = {"mean": 0.5, "ci95": [0.25, 0.75]}
    found = {
        "n": 4,
        "seconds_a_motion": 8.04,
        "command": "python benchmarks/refined.py run",
        "commit": "0" * 40,
        "hardware": "none",
        "benchmark": {"name": "synth-c"},
        "measures": {"both_actions": {"coupled": value, "refined": value, "difference": value}},
        "distances": {"fid_true": {"coupled": 3.0, "refined": 1.5}},
    }
    lines = refined.table(found).splitlines()
    assert lines[4] == "| both actions, % |" + " 50.00 [25.00, 75.00] |" * 3
    assert lines[5] == "| FID to true | 3.00 | 1.50 | -1.50 |"
