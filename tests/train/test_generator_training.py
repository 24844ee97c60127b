"""The generator's program end to end on the built-in actions."""

import json
import math
import re
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file, save_file

from refine.formats.clips import save_clips
from refine.generator import SPREAD, TINY, Generator, generate_motions, label_weights
from refine.mae import MAE, MAEConfig
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from train.checkpoints import save_weights
from train.config import GENERATOR_PRESETS, MAE_PRESETS, GeneratorTraining
from train.data import DataConfig
from train.generator import Training, known_leans, load_generator, train_generator
from train.loop import LoopConfig
from train.processes import Processes
from train.shares import SharesConfig
from train.steps import GeneratorLoss
from train.variants import as_variant


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
            shares=SharesConfig(looks=0),
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


def test_refined_shares_are_learned_and_kept_with_the_weights(mae, tmp_path, monkeypatch):
    whole = config(tmp_path / "run", mae, shares=SharesConfig(looks=3), loss=PLAIN)
    leaning = Training(whole, Processes(), "cpu")
    plain = Training(replace(whole, shares=SharesConfig(looks=0)), Processes(), "cpu")
    classes = torch.tensor([[1, 2]]).expand(4, 2)  # a walk and a wave
    made, unchanged = (one.compositions(classes, torch.Generator().manual_seed(0))[0] for one in (leaning, plain))
    assert (made - unchanged).abs().amax((0, 1, 3))[[16, 17]].min() > 1e-3  # the shoulders lean
    plain.generator = leaning.generator
    drawn, noise = leaning.draw(leaning.learned, 4, torch.Generator().manual_seed(0))
    first, without = (one.terms(one.learned, drawn, noise, slice(None), PLAIN)["rc"] for one in (leaning, plain))
    assert first != without

    brief = replace(whole, loop=replace(whole.loop, steps=10))
    train_generator(brief)
    kept = json.loads((tmp_path / "run" / "last.json").read_text())["leans"]
    assert [found["pair"] for found in kept] == [["squat", "wave-both-hands"], ["walk", "wave-both-hands"]]
    assert torch.equal(known_leans(tmp_path / "run" / "last.json", leaning.learned.classes), leaning.leans)
    assert known_leans(tmp_path / "run" / "last.json", ("walk", "drink")) is None
    record = json.loads((tmp_path / "run" / "last.json").read_text())
    lacking = [{**record, "leans": leans} for leans in (None, [{}], [{"pair": ["walk", "walk"]}])]
    for damaged in ('{"leans": [', "[]", '{"leans": []}', *map(json.dumps, lacking)):
        (tmp_path / "damaged.json").write_text(damaged)
        with pytest.raises(UserError, match="cannot be read|damaged leans"):
            known_leans(tmp_path / "damaged.json", ("walk",))
    monkeypatch.setattr("train.generator.refine_shares", None)
    with pytest.raises(UserError, match="already holds a run"):  # said before anything is refined
        train_generator(whole)
    monkeypatch.undo()
    monkeypatch.setattr("train.generator.refine_shares", None)  # a run that goes on has no need of it
    train_generator(replace(whole, resume=True))
    monkeypatch.undo()
    train_generator(replace(whole, out=tmp_path / "unbroken"))
    logs = [(tmp_path / name / "log.jsonl").read_text().splitlines() for name in ("run", "unbroken")]
    rows = [[{**json.loads(line), "seconds": None} for line in log] for log in logs]
    assert rows[0] == rows[1]


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


def walking(frames: int) -> Motion:
    random = torch.Generator().manual_seed(frames)
    turns = axis_angle_to_matrix(0.3 * torch.randn(frames, 24, 3, generator=random))
    return Motion(turns, torch.zeros(frames, 3), 30.0, "walk", f"walk-{frames}")


@pytest.fixture
def clips(tmp_path):
    """A clip that is long enough and one that is not, and a wave."""
    motions = [walking(frames) for frames in (15, 40)]
    save_clips(tmp_path / "clips.npz", [*motions, replace(walking(50), label="wave", source="wave-50")])
    return DataConfig(source=str(tmp_path / "clips.npz"), lower=("walk",), upper=("wave",), frames=20, held_out=0.0)


PLAIN = GeneratorLoss(decoupling=0.0)


def test_short_clips_are_counted_and_said(clips, mae, tmp_path, capsys):
    brief = LoopConfig(steps=2, save_every=2)
    train_generator(config(tmp_path / "run", mae, data=clips, loss=PLAIN, loop=brief))
    assert "refine: 1 of 3 clips are shorter than 20 frames" in capsys.readouterr().err
    described = json.loads((tmp_path / "run" / "best.json").read_text())
    assert described["data"]["clips"] == 3 and described["data"]["short_clips"] == 1
    assert described["processes"] == 1


def test_a_run_on_other_clips_is_not_resumed(clips, mae, tmp_path):
    whole = config(tmp_path / "run", mae, data=clips, loss=PLAIN, loop=LoopConfig(steps=2, save_every=2))
    train_generator(whole)
    save_clips(tmp_path / "clips.npz", [walking(41), replace(walking(50), label="wave")])
    with pytest.raises(UserError, match=r"last.json: is of a run on other clips; give the same"):
        train_generator(replace(whole, resume=True))


def test_a_run_with_another_mae_in_the_same_place_is_not_resumed(mae, tmp_path):
    own = tmp_path / "mae.safetensors"
    for path in (own, own.with_suffix(".json")):
        path.write_bytes(mae.with_suffix(path.suffix).read_bytes())
    whole = config(tmp_path / "run", own, loop=LoopConfig(steps=1, save_every=1))
    train_generator(whole)
    tensors = load_file(own)
    save_file(tensors | {"mask_token": tensors["mask_token"] + 1}, own)
    with pytest.raises(UserError, match=r"last.json: is of a run with another MAE; give the same"):
        train_generator(replace(whole, resume=True))


def test_a_generator_is_standardised_by_the_compositions_it_is_trained_on(mae, tmp_path):
    training = Training(config(tmp_path / "run", mae, loss=PLAIN), Processes(), "cpu")
    classes = training.pairs[torch.arange(4000) % len(training.pairs)]
    features, _ = training.compositions(classes, torch.Generator().manual_seed(99))
    flat = features.flatten(2).flatten(0, 1)
    centre, spread = training.generator.centre, training.generator.spread
    assert (centre - flat.mean(0)).abs().max() < 0.1 * flat.std(0).max()
    assert (spread / (flat.std(0) + SPREAD) - 1).abs().max() < 0.2
    assert spread.max() > 5 * spread.min()


def test_the_pairs_that_a_step_broke_on_are_named(clips, mae, tmp_path, monkeypatch):
    """The generator breaks on walk-40 alone: only its pairs are named, with their first frames."""
    whole = config(tmp_path / "run", mae, data=clips, loss=PLAIN, loop=LoopConfig(steps=6, save_every=2))
    encode, steps = Generator.encode, []

    def breaking(self, features, weights, valid):
        mean, log_variance = encode(self, features, weights, valid)
        steps.append(self.training)
        return mean * torch.where(valid.all(1) & (sum(steps) > 3), math.inf, 1.0)[:, None], log_variance

    monkeypatch.setattr(Generator, "encode", breaking)
    with pytest.raises(UserError) as caught:
        train_generator(whole)
    message = str(caught.value)
    assert message.startswith("step 3: the term ") and "walk-15" not in message and "\n" not in message
    assert re.search(r"became (nan|inf) on walk \(walk-40 from frame \d+\) \+ wave \(wave-50 from frame \d+\)", message)
    assert f"the last good checkpoint is {tmp_path / 'run' / 'state.safetensors'}" in message
    assert json.loads((tmp_path / "run" / "last.json").read_text())["step"] == 2


def test_half_precision_trains_and_measures(mae, tmp_path, trained):
    train_generator(config(tmp_path / "run", mae, precision="bfloat16"))
    ours, exact = terms(tmp_path / "run"), terms(trained)
    assert ours != exact
    for name in ("rc", "rcxyz", "kl", "total"):
        assert ours[-1][name] == pytest.approx(exact[-1][name], rel=0.1), name


def test_actions_are_learned_alone_for_actor_itself(mae, tmp_path):
    whole = config(tmp_path / "run", mae, loss=PLAIN)
    data = replace(whole.data, pairs="single", actions=("drink",))
    train_generator(replace(whole, data=data, loop=LoopConfig(steps=2, save_every=2)))
    assert load_generator(tmp_path / "run").config.classes == ("drink", "squat", "walk", "wave-both-hands")
    assert json.loads((tmp_path / "run" / "best.json").read_text())["data"]["pairs"] == 4


def test_a_way_of_looking_that_cannot_be_is_refused(mae, tmp_path):
    whole = config(tmp_path / "run", mae)
    with pytest.raises(UserError, match="70 of 20 frames cannot be drawn"):
        train_generator(replace(whole, shares=SharesConfig(looks=1, frames=70)))
    with pytest.raises(UserError, match="21 of 20 frames cannot be drawn"):
        train_generator(replace(whole, loss=GeneratorLoss(decoupling_frames=21)))
    with pytest.raises(UserError, match=r"plain silhouettes, and .* reads 6 channels"):
        train_generator(as_variant(replace(whole, variant="dr-paper")))
    for rate in (-1.0, float("nan"), 1e38):
        with pytest.raises(UserError, match="at most 10"):
            SharesConfig(rate=rate)
    assert not (tmp_path / "run").exists()


def test_presets_are_complete():
    assert MAE_PRESETS.keys() == {"tiny", "small", "plain", "paper"}
    assert GENERATOR_PRESETS.keys() == {"tiny", "small", "paper"}
    assert GENERATOR_PRESETS["paper"][1].batch == 800


def test_priors_are_fitted_to_the_pairs_that_are_trained_and_saved_with_the_weights(mae, tmp_path):
    training = Training(config(tmp_path / "run", mae), Processes(), "cpu")
    training.run()
    model = load_generator(tmp_path / "run" / "last.safetensors")
    network = model.config
    assert network.prior == "fitted" and len(network.pairs) > 1
    assert len({frozenset(pair) for pair in network.pairs}) == len(network.pairs)
    # By hand, of new compositions: the moments are those of the pair up to sampling.
    i, j = network.pairs[-1]
    classes = torch.tensor([[network.classes.index(i), network.classes.index(j)]]).expand(2000, 2)
    features, drawn = training.compositions(classes, torch.Generator().manual_seed(99))
    weights = label_weights(drawn.class_i, drawn.class_j, drawn.lam, len(network.classes))
    with torch.no_grad():
        mean, log_variance = model.encode(features, weights, drawn.valid)
    covariance = torch.cov(mean.T) + log_variance.exp().mean(0).diag()
    root = model.prior_roots[-1]
    error = (model.prior_means[-1] - mean.mean(0)).abs() / covariance.diag().sqrt()
    assert error.max() < 5 / 256**0.5
    assert ((root @ root.T).diag() / covariance.diag() - 1).abs().max() < 0.6
    other = (model.prior_means[0] - model.prior_means[-1]).norm()
    assert other > 3 * (model.prior_means[-1] - mean.mean(0)).norm()
