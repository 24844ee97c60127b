"""The generator's program end to end on the built-in actions."""

import json
from dataclasses import replace

import pytest
import torch

from refine.generator import TINY, generate_motions
from refine.mae import MAE, MAEConfig
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from train.checkpoints import save_weights
from train.config import GENERATOR_PRESETS, MAE_PRESETS, GeneratorTraining
from train.data import DataConfig
from train.generator import load_generator, train_generator
from train.loop import LoopConfig
from train.steps import GeneratorLoss


@pytest.fixture(scope="module")
def mae(tmp_path_factory):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        untrained = MAE(MAEConfig(width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1))
    path = tmp_path_factory.mktemp("mae") / "mae.safetensors"
    save_weights(path, "mae", untrained, {})
    return path


def config(folder, mae, **changes) -> GeneratorTraining:
    return replace(
        GeneratorTraining(
            out=folder,
            mae=mae,
            data=DataConfig(
                lower=("walk", "squat"),
                upper=("wave-both-hands",),
                frames=20,
                synthetic_clips=2,
                synthetic_seconds=1.0,
            ),
            network=TINY,
            loss=GeneratorLoss(decoupling_clips=1, decoupling_frames=1),
            loop=LoopConfig(steps=20, learning_rate=1e-3, save_every=10),
            batch=4,
            measured=6,
        ),
        **changes,
    )


def terms(folder):
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [{name: row[name] for name in ("rc", "rcxyz", "kl", "dr", "total")} for row in rows]


@pytest.fixture(scope="module")
def trained(tmp_path_factory, mae):
    folder = tmp_path_factory.mktemp("generator") / "run"
    train_generator(config(folder, mae))
    return folder


def test_every_term_falls(trained):
    found = terms(trained)
    for name in ("rc", "rcxyz", "kl", "dr", "total"):
        first, last = (sum(row[name] for row in part) for part in (found[:4], found[-4:]))
        assert last < 0.97 * first, name


def test_a_resumed_run_continues_with_the_very_losses(trained, mae, tmp_path):
    whole = config(tmp_path / "run", mae)
    train_generator(replace(whole, loop=replace(whole.loop, steps=10)))
    train_generator(replace(whole, resume=True))
    assert terms(tmp_path / "run") == terms(trained)


def test_a_trained_generator_makes_motions(trained):
    generator = load_generator(trained)
    assert generator.config.classes == ("squat", "walk", "wave-both-hands")
    assert not generator.training
    rest = Body.free("light").rest_joints
    motions = generate_motions(generator, ["walk", "wave-both-hands"], 2, 1.0, rest, torch.Generator().manual_seed(0))
    assert [type(motion) for motion in motions] == [Motion, Motion]
    assert [len(motion) for motion in motions] == [30, 30]
    again = generate_motions(
        load_generator(trained / "best.safetensors"),
        ["walk", "wave-both-hands"],
        2,
        1.0,
        rest,
        torch.Generator().manual_seed(0),
    )
    assert torch.equal(again[1].rotations, motions[1].rotations)


def test_unknown_labels_and_damaged_weights_are_refused(trained, mae, tmp_path):
    bad = config(tmp_path / "run", mae, data=DataConfig(lower=("wallk",), upper=("drink",)))
    with pytest.raises(UserError, match=r"unknown name 'wallk'; did you mean walk"):
        train_generator(bad)
    assert not (tmp_path / "run").exists()
    with pytest.raises(UserError, match="holds the weights of a mae, expected a generator"):
        load_generator(mae)
    (tmp_path / "w.safetensors").write_bytes((trained / "best.safetensors").read_bytes())
    described = json.loads((trained / "best.json").read_text())
    described["config"]["latent"] = 64
    (tmp_path / "w.json").write_text(json.dumps(described))
    with pytest.raises(UserError, match="does not fit its description"):
        load_generator(tmp_path / "w.safetensors")


def test_presets_are_complete():
    assert MAE_PRESETS.keys() == {"tiny", "small", "paper"}
    assert GENERATOR_PRESETS.keys() == {"tiny", "small", "paper"}
    assert GENERATOR_PRESETS["paper"][1].batch == 800
