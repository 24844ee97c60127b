"""The MAE's program end to end, and the baselines it is measured against."""

import json
from dataclasses import replace

import pytest
import torch

from refine.mae import MAE, MAEConfig, load_mae
from refine.patches import patchify
from renderers.checks import UserError
from train.config import MAETraining
from train.data import DataConfig
from train.loop import LoopConfig
from train.mae import fill_from_nearest, measure, train_mae
from train.pictures import PictureConfig, Pictures


def config(folder, **changes) -> MAETraining:
    return replace(
        MAETraining(
            out=folder,
            data=DataConfig(actions=("walk", "wave-both-hands"), synthetic_clips=2, synthetic_seconds=1.0),
            network=MAEConfig(width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1),
            loop=LoopConfig(steps=30, learning_rate=3e-3, save_every=15),
            batch=8,
            measured=70,
        ),
        **changes,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mae") / "run"
    return folder, train_mae(config(folder))


def test_the_error_falls_and_the_weights_load(trained):
    folder, weights = trained
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert rows[-1]["held_out"]["total"] < 0.8 * rows[0]["total"]
    mae = load_mae(weights)
    assert mae.config == config(folder).network
    assert not any(value.requires_grad for value in mae.parameters())


def test_the_run_says_how_it_came_to_be(trained):
    folder, weights = trained
    described = json.loads(weights.with_suffix(".json").read_text())
    assert described["provenance"]["seed"] == 10
    assert described["data"] == {"source": "synthetic", "clips": 2, "held_out_clips": 2}
    assert described["pictures"]["kept"] == pytest.approx(1 / 3)
    assert {"total", "hidden", "body", "mean_hidden", "nearest_hidden"} <= described["held_out"].keys()
    assert json.loads((folder / "config.json").read_text())["network"]["width"] == 48


def test_a_resumed_run_continues_with_the_very_losses(trained, tmp_path):
    folder, _ = trained
    short = config(tmp_path / "run", loop=replace(config(folder).loop, steps=15))
    train_mae(short)
    train_mae(replace(short, loop=config(folder).loop, resume=True))

    def losses(run):
        return [json.loads(line)["total"] for line in (run / "log.jsonl").read_text().splitlines()]

    assert losses(tmp_path / "run") == losses(folder)


def test_bfloat16_trains_too(tmp_path):
    loop = LoopConfig(steps=2, save_every=2)
    exact, rounded = (
        json.loads(train_mae(config(tmp_path / name, loop=loop, precision=name)).with_suffix(".json").read_text())
        for name in ("float32", "bfloat16")
    )
    assert rounded["held_out"]["total"] != exact["held_out"]["total"]
    assert rounded["held_out"]["total"] == pytest.approx(exact["held_out"]["total"], rel=0.05)


def test_a_device_that_is_not_here_is_refused(tmp_path):
    with pytest.raises(UserError, match="--device: 'nowhere' does not work here .*; try cpu"):
        train_mae(config(tmp_path / "run", device="nowhere"))
    assert not (tmp_path / "run").exists()


def test_nearest_fill_copies_the_nearest_visible_patch():
    patches = torch.arange(9.0).reshape(1, 9, 1)
    kept = torch.zeros(1, 9, dtype=torch.bool)
    kept[0, [0, 5]] = True  # row 0 column 0, row 1 column 2
    filled = fill_from_nearest(patches, kept)[0, :, 0].reshape(3, 3)
    assert filled.tolist() == [[0, 0, 5], [0, 5, 5], [0, 5, 5]]


class Oracle:
    """Knows the pictures."""

    config = MAEConfig(size=16, patch=8, channels=1)

    def __init__(self, images):
        self.answer = patchify(images, 8)

    def __call__(self, images, kept):
        return self.answer


def test_baselines_by_hand():
    images = torch.zeros(2, 1, 16, 16)
    images[:, :, :8, :8] = 1.0
    kept = torch.tensor([[False, True, False, False]] * 2)
    pictures = Pictures(images, kept, torch.ones(2, 1, dtype=torch.bool))
    figures = measure(Oracle(images), pictures, torch.full((1, 16, 16), 0.5), 4.0)
    assert (figures["total"], figures["hidden"], figures["body"]) == (0.0, 0.0, 0.0)
    assert figures["mean_hidden"] == pytest.approx(0.25)
    assert figures["nearest_hidden"] == pytest.approx(1 / 3)
    assert figures["nearest_body"] == pytest.approx(1.0)


def test_hidden_patches_without_a_body_are_no_error_on_it_for_anybody():
    images = torch.zeros(1, 1, 16, 16)
    images[:, :, :8, :8] = 1.0
    kept = torch.tensor([[True, False, False, False]])
    pictures = Pictures(images, kept, torch.ones(1, 1, dtype=torch.bool))
    figures = measure(Oracle(images), pictures, torch.zeros(1, 16, 16), 4.0)
    assert (figures["body"], figures["mean_body"], figures["nearest_body"]) == (0.0, 0.0, 0.0)


class Empty(Oracle):
    """Sees nothing anywhere."""

    def __init__(self):
        pass

    def __call__(self, images, kept):
        return torch.zeros(len(images), 4, 64)


def test_every_patch_counts_alike_in_whichever_batch_it_is():
    """65 pictures are two batches; the last picture, alone in its own, has two patches of a faint body."""
    images = torch.zeros(65, 1, 16, 16)
    images[:-1, :, :8, :8] = 1.0
    images[-1, :, :, :8] = 0.5
    kept = torch.tensor([[False, True, False, True]] * 65)
    pictures = Pictures(images, kept, torch.ones(65, 1, dtype=torch.bool))
    figures = measure(Empty(), pictures, torch.zeros(1, 16, 16), 4.0)
    assert figures["body"] == pytest.approx((64 * 1 + 2 * 0.25) / 66)
    assert figures["hidden"] == pytest.approx((64 * 1 + 2 * 0.25) / 130)
    assert (figures["body"], figures["hidden"]) == (figures["mean_body"], figures["mean_hidden"])


def test_a_run_can_start_from_weights_and_says_so(trained, tmp_path):
    _, weights = trained
    before, slow = load_mae(weights), replace(config(tmp_path).loop, steps=1, learning_rate=1e-9)
    tuned = train_mae(config(tmp_path / "tuned", start=weights, loop=slow))
    after = load_mae(tuned).state_dict()
    assert all(torch.allclose(value, after[name], atol=1e-6) for name, value in before.state_dict().items())
    assert json.loads(tuned.with_suffix(".json").read_text())["start"]["step"] == 30


@pytest.mark.parametrize("normalisation", ["none", "imagenet"])
def test_pictures_in_colours_are_learned(tmp_path, normalisation):
    colours = replace(config(tmp_path).network, channels=3, normalisation=normalisation)
    body = PictureConfig(pinned="body")
    weights = train_mae(config(tmp_path / "run", network=colours, pictures=body))
    held_out = json.loads(weights.with_suffix(".json").read_text())["held_out"]
    assert held_out["total"] < 0.8 * json.loads((tmp_path / "run" / "log.jsonl").read_text().splitlines()[0])["total"]
    assert load_mae(weights).config == colours


def test_an_official_checkpoint_can_be_tuned(tmp_path):
    official = MAE(
        MAEConfig(32, 8, 3, 64, 1, 1, decoder_width=32, decoder_depth=1, decoder_heads=1, normalisation="imagenet")
    )
    torch.save({"model": official.state_dict()}, tmp_path / "mae.pth")
    loop, body = LoopConfig(steps=1, learning_rate=1e-9), PictureConfig(pinned="body")
    tuned = config(tmp_path / "run", start=tmp_path / "mae.pth", network=official.config, loop=loop, pictures=body)
    weights = train_mae(tuned)
    assert torch.allclose(load_mae(weights).norm.weight, official.norm.weight, atol=1e-6)
    assert json.loads(weights.with_suffix(".json").read_text())["start"] == {"official": "mae.pth"}


def test_weights_that_cannot_be_started_from_leave_nothing_behind(trained, tmp_path):
    _, weights = trained
    other = replace(config(tmp_path).network, depth=2)
    for changes, message in (
        ({"start": tmp_path / "no.safetensors"}, "no such file"),
        ({"start": weights}, "same network"),
    ):
        with pytest.raises(UserError, match=message):
            train_mae(config(tmp_path / "run", network=other, **changes))
    assert not (tmp_path / "run").exists()
