"""Loss terms by hand, the generator's step and the MAE's."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from refine.coupling import CouplingConfig, couple_features
from refine.decoupling import Decoupler
from refine.generator import Generator, GeneratorConfig
from refine.mae import MAE, MAEConfig
from refine.motion import from_features, to_features
from refine.patches import keep_random, patchify
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, matrix_to_6d
from renderers.skeleton import PARTS
from train.data import Pairs
from train.pictures import Pictures
from train.steps import (
    GeneratorLoss,
    Noise,
    Share,
    decoupling_term,
    draw_noise,
    generator_step,
    kl_divergence,
    mae_step,
    mean_over_frames,
    position_errors,
)

CLIPS, FRAMES = 3, 8


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.free("light")


@pytest.fixture(scope="module")
def model() -> Generator:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Generator(GeneratorConfig(("walk", "wave"), 30.0, latent=32, feedforward=64, layers=1)).eval()


@pytest.fixture(scope="module")
def decoupler(body) -> Decoupler:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Decoupler(body, MAE(MAEConfig(width=32, depth=1, heads=2, decoder_width=32, decoder_depth=1)))


@pytest.fixture(scope="module")
def batch() -> Pairs:
    """The first action moves the legs most, the second the arms: each has parts to answer for."""
    random = torch.Generator().manual_seed(0)

    def features(*parts):
        size = torch.full((24, 1), 0.02)
        size[[joint for part in parts for joint in PARTS[part]]] = 0.2
        turns = size * torch.randn(CLIPS, FRAMES, 24, 3, generator=random)
        return to_features(matrix_to_6d(axis_angle_to_matrix(turns)), torch.zeros(CLIPS, FRAMES, 3))

    height = torch.full((CLIPS,), 0.9)
    valid = torch.ones(CLIPS, FRAMES, dtype=torch.bool)
    valid[1, 5:] = False
    index = torch.zeros(CLIPS, dtype=torch.long)
    sides = features("left_leg", "right_leg"), features("left_arm", "right_arm")
    return Pairs(*sides, height, height, index, index + 1, torch.full((CLIPS,), 0.5), valid)


def noise_for(loss: GeneratorLoss, seed: int = 0) -> Noise:
    return draw_noise(CLIPS, 32, FRAMES, loss, torch.Generator().manual_seed(seed))


def step(batch, model, body, decoupler=None, seed=0, **loss):
    config = replace(GeneratorLoss(), **loss)
    return generator_step(batch, noise_for(config, seed), model, body, decoupler, config, CouplingConfig())


def test_kl_divergence_by_hand():
    zero = torch.zeros(2, 256)
    assert kl_divergence(zero, zero).tolist() == [0.0, 0.0]
    assert kl_divergence(zero + 1, zero).tolist() == [128.0, 128.0]
    variance = torch.tensor([[2.0]])
    expected = torch.distributions.kl_divergence(
        torch.distributions.Normal(0.3, variance.sqrt()), torch.distributions.Normal(0.0, 1.0)
    )
    torch.testing.assert_close(kl_divergence(torch.tensor([[0.3]]), variance.log()), expected[0])


def test_kl_is_the_mean_over_the_batch_or_the_legacy_sum(batch, model, body):
    mean = step(batch, model, body)
    total = step(batch, model, body, kl_reduction="sum", kl=1e-5)
    torch.testing.assert_close(total["kl"], CLIPS * mean["kl"])


def test_mean_over_frames_leaves_padding_out():
    errors = torch.ones(2, 3, 25, 6)
    errors[1, 2] = 100.0
    valid = torch.tensor([[True, True, True], [True, True, False]])
    assert mean_over_frames(errors, valid).item() == 1.0
    assert mean_over_frames(errors, torch.ones_like(valid)).item() == pytest.approx((5 + 100) / 6)


def test_joint_errors_ignore_translation_and_see_rotation(batch, body):
    moved = batch.features_i.clone()
    moved[:, :, 24, :3] += 2.0
    assert position_errors(moved, batch.features_i, body).max() == 0
    turned = batch.features_i.clone()
    turned[:, :, 18] = batch.features_j[:, :, 18]  # an elbow moves the wrist and the hand below it, and nothing else
    errors = position_errors(turned, batch.features_i, body).sum((0, 1, 3))
    assert errors[[20, 22]].min() > 1e-4
    assert errors[[joint for joint in range(24) if joint not in (20, 22)]].max() < 1e-9


def test_vertex_errors_are_of_bodies_at_the_origin(batch, body):
    moved = batch.features_i.clone()
    moved[:, :, 24, :3] += 2.0
    assert position_errors(moved, batch.features_i, body, "vertices").max() == 0
    errors = position_errors(batch.features_j, batch.features_i, body, "vertices")
    assert errors.shape == (CLIPS, FRAMES, len(body.rest_vertices), 3)
    ours, theirs = (from_features(side)[0][1, 4][None] for side in (batch.features_j, batch.features_i))
    expected = body(ours, torch.zeros(1, 3)).vertices - body(theirs, torch.zeros(1, 3)).vertices
    torch.testing.assert_close(errors[1, 4], expected[0].square())


def test_vertices_are_compared_where_they_are_asked_for(batch, model, body):
    joints, vertices = (step(batch, model, body, positions=of)["rcxyz"] for of in ("joints", "vertices"))
    assert not torch.isclose(joints, vertices, rtol=1e-3)


def test_the_weight_of_the_decoupling_loss_over_the_steps():
    loss = GeneratorLoss(decoupling=2.0)
    assert [loss.decoupling_at(step) for step in (0, 1, 100)] == [2.0] * 3
    late = replace(loss, decoupling_start=10, decoupling_ramp=4)
    assert [late.decoupling_at(step) for step in range(9, 16)] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.0, 2.0]
    seldom = replace(loss, decoupling_start=1, decoupling_every=3)
    assert [seldom.decoupling_at(step) for step in range(8)] == [0, 6.0, 0, 0, 6.0, 0, 0, 6.0]
    assert sum(seldom.decoupling_at(step) for step in range(1, 301)) == 300 * 2.0


def test_the_weight_of_the_kl_term_over_the_steps():
    assert [GeneratorLoss(kl=3.0).kl_at(step) for step in (0, 1, 100)] == [3.0] * 3
    rising = GeneratorLoss(kl=1e-2, kl_first=1e-4, kl_ramp=10)
    assert rising.kl_at(0) == 1e-4 and rising.kl_at(5) == pytest.approx(1e-3)
    assert [rising.kl_at(step) for step in (10, 11, 1000)] == [1e-2] * 3
    assert GeneratorLoss(kl=1e-2, kl_first=1e-4).kl_at(0) == 1e-2  # no steps to rise in
    with pytest.raises(UserError, match="cannot rise"):
        GeneratorLoss(kl_first=0.0)


def test_the_weights_of_a_step_are_those_of_its_terms(batch, model, body):
    loss = GeneratorLoss(kl=1.0, kl_first=1e-2, kl_ramp=2, joints=0.0, decoupling=0.0)
    for number, weight in ((0, 1e-2), (1, 1e-1), (2, 1.0)):
        terms = generator_step(batch, noise_for(loss), model, body, None, loss.at(number), CouplingConfig())
        torch.testing.assert_close(terms["total"], terms["rc"] + weight * terms["kl"])


def test_a_step_without_the_decoupling_loss_draws_nothing(batch, model, body, decoupler):
    loss = GeneratorLoss(decoupling_start=5)
    terms = generator_step(batch, noise_for(loss), model, body, decoupler, loss.at(4), CouplingConfig())
    assert terms.keys() == {"rc", "rcxyz", "kl", "total"}


@pytest.mark.parametrize("kl_reduction", ["mean", "sum"])
@pytest.mark.parametrize("shards", [2, 3])
def test_terms_and_gradients_of_shards_add_up_to_those_of_the_batch(
    batch, model, body, decoupler, shards, kl_reduction
):
    """Shards of unequal lengths, and one in which no clip is looked at."""
    loss = GeneratorLoss(decoupling=3.0, decoupling_clips=2, decoupling_frames=2, kl_reduction=kl_reduction)
    noise, real = noise_for(loss), batch.valid.sum(1)

    def gradients() -> list[torch.Tensor]:
        found = [value.grad.clone() for value in model.parameters() if value.grad is not None]
        model.zero_grad()
        return found

    whole = generator_step(batch, noise, model, body, decoupler, loss, CouplingConfig())
    whole["total"].backward()
    expected = gradients()
    sums = dict.fromkeys(whole, 0.0)
    for index in range(shards):
        some = slice(index, None, shards)
        share = Share(float(real[some].sum() / real.sum()), len(real[some]) / CLIPS, len(noise.chances[some]) / 2)
        part, own = (type(values)(*(value[some] for value in values)) for values in (batch, noise))
        terms = generator_step(part, own, model, body, decoupler, loss, CouplingConfig(), share=share)
        terms["total"].backward()
        sums = {name: sums[name] + terms[name].detach() for name in sums}
    for name, value in whole.items():
        torch.testing.assert_close(sums[name], value.detach(), rtol=2e-6, atol=0, msg=name)
    for ours, theirs in zip(gradients(), expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-6 * float(theirs.abs().max() + 1e-3))


def test_half_precision_stays_in_the_network(batch, model, body, decoupler):
    loss = GeneratorLoss(decoupling_clips=CLIPS)
    exact, rounded = (
        generator_step(batch, noise_for(loss), model, body, decoupler, loss, CouplingConfig(), half=half)
        for half in (False, True)
    )
    for name, value in rounded.items():
        assert value.dtype == torch.float32, name
        assert value.item() == pytest.approx(exact[name].item(), rel=0.03), name
    assert rounded["rc"] != exact["rc"]


def test_total_is_the_weighted_sum(batch, model, body, decoupler):
    terms = step(batch, model, body, decoupler, joints=0.5, kl=2e-3, decoupling=3.0)
    assert terms.keys() == {"rc", "rcxyz", "kl", "dr", "total"}
    expected = terms["rc"] + 0.5 * terms["rcxyz"] + 2e-3 * terms["kl"] + 3.0 * terms["dr"]
    torch.testing.assert_close(terms["total"], expected)


def test_terms_of_weight_zero_are_not_computed(batch, model, body):
    assert step(batch, model, body, joints=0.0, decoupling=0.0).keys() == {"rc", "kl", "total"}


def test_reconstruction_is_of_the_composition(batch, model, body):
    target = couple_features(batch.features_i, batch.features_j, batch.lam, body.rest_joints)
    weights = torch.full((CLIPS, 2), 0.5)
    made = model(target, weights, batch.valid, noise_for(GeneratorLoss()).latent).features
    expected = (made - target)[batch.valid].square().mean()
    torch.testing.assert_close(step(batch, model, body)["rc"], expected)


def test_the_decoupling_term_trains_the_generator_and_not_the_mae(batch, model, body, decoupler):
    terms = step(batch, model, body, decoupler, decoupling_clips=CLIPS)
    model.zero_grad()
    terms["dr"].backward()
    assert model.write.weight.grad.abs().max() > 0
    assert all(torch.isfinite(value.grad).all() for value in model.parameters() if value.grad is not None)
    assert all(value.grad is None for value in decoupler.mae.parameters())


def test_the_decoupling_term_draws_real_frames_of_the_first_clips(batch, decoupler, monkeypatch):
    seen = {}

    def record(composed, i, j, frames):
        seen.update(composed=composed, i=i, frames=frames)
        return SimpleNamespace(loss=torch.zeros(()))

    monkeypatch.setattr(decoupler, "forward", record)
    loss = GeneratorLoss(decoupling_clips=2, decoupling_frames=5)
    random = torch.Generator().manual_seed(0)
    drawn = set()
    for _ in range(20):
        chances = torch.rand(2, FRAMES, generator=random)
        decoupling_term(
            batch.features_i * batch.valid[..., None, None], batch, decoupler, loss.decoupling_frames, chances
        )
        assert seen["frames"].shape == (2, 5)
        assert set(seen["frames"][1].tolist()) == {0, 1, 2, 3, 4}
        drawn |= set(seen["frames"][0].tolist())
    assert drawn == set(range(FRAMES))
    assert torch.equal(seen["i"].root[:, 0, 1], batch.height_i[:2])
    joints = decoupler.body(seen["composed"].rotations[0], seen["composed"].root[0]).joints
    lowest = decoupler.body.rest_joints[:, 1].min().item()
    assert joints[..., 1].min().item() == pytest.approx(lowest, abs=1e-5)


class Constant(nn.Module):
    """Predicts the same number everywhere."""

    def __init__(self, value: float):
        super().__init__()
        self.config = MAEConfig(size=16, patch=8, channels=2)
        self.value = value

    def forward(self, images, kept):
        self.seen = images
        return torch.full((len(images), 4, 128), self.value)


def test_mae_step_by_hand():
    images = torch.zeros(1, 2, 16, 16)
    images[0, 0, :8, :8] = 1.0  # patch 0, channel 0
    images[0, 1, 8:, :8] = 0.5  # patch 2, channel 1
    kept = torch.tensor([[False, True, False, False]])
    everything = torch.ones(1, 2, dtype=torch.bool)
    terms = mae_step(Pictures(images, kept, everything), Constant(0.0), body_weight=3.0)
    # Hidden: patches 0, 2 and 3 in two channels; of these, patches 0 and 2 are touched by the body.
    assert terms["hidden"].item() == pytest.approx((1 + 0.25) / 6)
    assert terms["body"].item() == pytest.approx((1 + 0.25) / 4)
    assert terms["total"].item() == pytest.approx(3 * (1 + 0.25) / (3 * 4 + 2))


def test_a_part_that_is_not_shown_must_be_completed_everywhere():
    images = torch.ones(1, 2, 16, 16)
    kept = torch.tensor([[True, True, False, False]])
    shown = torch.tensor([[True, False]])
    mae = Constant(0.0)
    terms = mae_step(Pictures(images, kept, shown), mae, body_weight=1.0)
    assert mae.seen[0, 1].max() == 0
    assert mae.seen[0, 0].min() == 1
    assert terms["hidden"].item() == 1.0
    halved = images.clone()
    halved[0, 0, :8] = 5.0  # visible: whatever is there is no error
    torch.testing.assert_close(mae_step(Pictures(halved, kept, shown), mae, 1.0)["hidden"], terms["hidden"])


def test_a_perfect_inpainter_has_no_error(generator):
    images = torch.rand(2, 6, 64, 64, generator=generator)
    oracle = SimpleNamespace(config=MAEConfig())
    mae = type("Oracle", (), {"config": oracle.config, "__call__": lambda self, _, kept: patchify(images, 8)})()
    pictures = Pictures(images, keep_random(2, 64, 1 / 3, generator), torch.ones(2, 6, dtype=torch.bool))
    assert mae_step(pictures, mae, 4.0)["total"] == 0
