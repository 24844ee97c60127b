"""The generator against protocol G.9 and G.10."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from refine.generator import (
    PAPER,
    SPREAD,
    TINY,
    Generator,
    GeneratorConfig,
    generate,
    generate_motions,
    label_weights,
    positions,
)
from renderers.checks import ShapeError, UserError
from renderers.skeleton import JOINTS, forward_kinematics


def names(count: int) -> tuple[str, ...]:
    return tuple(f"action-{index}" for index in range(count))


@pytest.fixture(scope="module")
def small() -> Generator:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Generator(GeneratorConfig(("walk", "wave", "squat"), 30.0, latent=32, feedforward=64, layers=2)).eval()


@pytest.fixture
def features(generator) -> torch.Tensor:
    return torch.randn(4, 7, 25, 6, generator=generator)


VALID = torch.ones(4, 7, dtype=torch.bool)


@pytest.mark.parametrize("classes, parameters", [(12, 14_832_022), (40, 14_853_526), (10, 14_830_486)])
def test_paper_preset_has_the_published_parameter_counts(classes, parameters):
    with torch.device("meta"):
        model = Generator(GeneratorConfig.paper(names(classes)))
    assert sum(parameter.numel() for parameter in model.parameters()) == parameters


def test_positions_interleave_sine_and_cosine():
    expected = torch.tensor(
        [0.909297, -0.416147, 0.958144, -0.286285]
    )  # sin 2, cos 2, sin and cos of 2 * 10000^(-1/128)
    torch.testing.assert_close(positions(3, 256)[2, :4], expected, atol=1e-5, rtol=0)
    halves = torch.cat([positions(3, 256)[2, 0::2], positions(3, 256)[2, 1::2]])
    assert not torch.allclose(halves[:4], expected, atol=1e-2)


def test_the_two_tokens_stand_before_the_frames(small, features, generator):
    """A frame's position is 2 + its index: encoding must depend on the order of frames but see the tokens apart."""
    weights = torch.eye(3)[[0, 1, 2, 0]]
    seen = []
    hook = small.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    small.encode(features, weights, VALID)
    hook.remove()
    places = positions(9, 32)
    torch.testing.assert_close(seen[0][:, 0], weights @ small.mean_tokens + places[0])
    torch.testing.assert_close(seen[0][:, 1], weights @ small.variance_tokens + places[1])
    torch.testing.assert_close(seen[0][:, 2:], small.read(features.flatten(2)) + places[2:])


def test_soft_one_hot_is_the_hard_label(small, features):
    hard = torch.tensor([2, 0, 1, 1])
    soft = label_weights(hard, torch.tensor([0, 1, 2, 0]), torch.ones(4), 3)
    assert torch.equal(soft @ small.mean_tokens, small.mean_tokens[hard])
    assert torch.equal(soft @ small.decoder_biases, small.decoder_biases[hard])


def test_label_weights_mix_and_sum_to_one():
    weights = label_weights(torch.tensor([0, 2]), torch.tensor([1, 2]), torch.tensor([0.3, 0.3]), 3)
    torch.testing.assert_close(weights, torch.tensor([[0.3, 0.7, 0.0], [0.0, 0.0, 1.0]]))


def test_labels_and_lambda_change_sides_together():
    i, j, lam = torch.tensor([0, 2]), torch.tensor([1, 2]), torch.tensor([0.3, 0.8])
    torch.testing.assert_close(label_weights(i, j, lam, 3), label_weights(j, i, 1 - lam, 3))


def test_permuting_the_batch_permutes_the_output(small, features):
    order = torch.tensor([2, 0, 3, 1])
    weights = torch.eye(3)[[0, 1, 2, 0]]
    valid = VALID.clone()
    valid[1, 4:] = False
    mean, _ = small.encode(features, weights, valid)
    permuted, _ = small.encode(features[order], weights[order], valid[order])
    torch.testing.assert_close(permuted, mean[order])
    decoded = small.decode(mean, weights, valid)
    torch.testing.assert_close(small.decode(mean[order], weights[order], valid[order]), decoded[order])


def test_padded_frames_are_zero_and_do_not_matter(small, features):
    weights = torch.eye(3)[[0, 1, 2, 0]]
    valid = VALID.clone()
    valid[:, 5:] = False
    other = features.clone()
    other[:, 5:] = 9.0
    mean, log_variance = small.encode(features, weights, valid)
    for ours, theirs in zip((mean, log_variance), small.encode(other, weights, valid), strict=True):
        torch.testing.assert_close(ours, theirs)
    decoded = small.decode(mean, weights, valid)
    assert decoded[:, 5:].abs().max() == 0
    torch.testing.assert_close(decoded[:, :5], small.decode(mean, weights, valid[:, :5]))


def test_no_causal_mask_so_length_changes_every_frame(small):
    latent, weights = torch.zeros(1, 32), torch.eye(3)[:1]
    short = small.decode(latent, weights, torch.ones(1, 6, dtype=torch.bool))
    long = small.decode(latent, weights, torch.ones(1, 8, dtype=torch.bool))
    assert ((short - long[:, :6]).abs().amax(dim=(2, 3)) > 1e-5).all()


def test_noise_moves_the_motion_and_not_the_posterior(small, features, generator):
    weights = torch.eye(3)[[0, 1, 2, 0]]
    noise = torch.randn(4, 32, generator=generator)
    first, again, other = (small(features, weights, VALID, drawn) for drawn in (noise, noise, -noise))
    assert torch.equal(first.features, again.features)
    assert not torch.allclose(first.features, other.features)
    assert torch.equal(first.mean, other.mean)


def test_latent_is_mean_plus_deviation_times_noise(small, features, generator, monkeypatch):
    weights = torch.eye(3)[[0, 1, 2, 0]]
    seen = []

    def record(latent, *_):
        seen.append(latent)
        return features

    monkeypatch.setattr(small, "decode", record)
    noise = torch.randn(4, 32, generator=generator)
    out = small(features, weights, VALID, noise)
    torch.testing.assert_close(seen[0], out.mean + torch.exp(0.5 * out.log_variance) * noise)


def test_half_precision_rounds_products_alone(small, features, generator, monkeypatch):
    """Labels, posterior and results keep float32; the motion differs from float32's as bfloat16's 8 bits allow."""
    weights = label_weights(torch.tensor([0, 1, 2, 0]), torch.tensor([1, 2, 0, 2]), torch.full((4,), 0.537), 3)
    noise = torch.randn(4, 32, generator=generator)
    exact = small(features, weights, VALID, noise)
    seen = []
    hook = small.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    with torch.autocast("cpu", torch.bfloat16):
        rounded = small(features, weights, VALID, noise)
    hook.remove()
    assert {value.dtype for value in (*rounded, *seen)} == {torch.float32}
    torch.testing.assert_close(seen[0][:, 0], weights @ small.mean_tokens + positions(9, 32)[0])
    error = (rounded.features - exact.features).norm() / exact.features.norm()
    assert 1e-5 < error < 0.02


def test_two_memory_tokens_hold_latent_and_label_apart(generator):
    config = GeneratorConfig(names(3), latent=32, feedforward=64, layers=1, memory="concat")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = Generator(config).eval()
    seen = []
    model.decoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    latent, weights = torch.randn(2, 32, generator=generator), torch.eye(3)[:2]
    model.decode(latent, weights, VALID[:2])
    assert torch.equal(seen[0], torch.stack([latent, model.decoder_biases[:2]], dim=1))


def test_generate_has_one_row_per_label_row(small):
    weights = torch.tensor([[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
    made = generate(small, weights, 9, torch.Generator().manual_seed(0))
    assert made.shape == (2, 9, 25, 6)
    assert torch.equal(made, generate(small, weights, 9, torch.Generator().manual_seed(0)))


def test_generated_motions_stand_on_the_floor(small):
    rest = torch.randn(24, 3, generator=torch.Generator().manual_seed(1))
    rest[:, 1] += 0.1 - rest[:, 1].min()
    motions = generate_motions(small, ["walk", "wave"], 3, 0.5, rest, torch.Generator().manual_seed(0))
    assert [len(motion) for motion in motions] == [15, 15, 15]
    assert {motion.label for motion in motions} == {"walk+wave"}
    for motion in motions:
        joints, _ = forward_kinematics(motion.rotations, motion.root, rest)
        assert joints[..., 1].min().item() == pytest.approx(0.1, abs=1e-5)
        torch.testing.assert_close(
            motion.rotations @ motion.rotations.mT, torch.eye(3).expand(15, 24, 3, 3), atol=1e-5, rtol=0
        )
    assert not torch.allclose(motions[0].root[:, JOINTS["pelvis"]], motions[1].root[:, JOINTS["pelvis"]])


def test_an_unknown_action_offers_the_nearest(small):
    with pytest.raises(UserError, match=r"unknown name 'wavve'; did you mean wave\?"):
        generate_motions(small, ["wavve"], 1, 1.0, torch.zeros(24, 3), torch.Generator())


def test_refusals(small, features):
    with pytest.raises(UserError, match="no action was named; choose from walk, wave, squat"):
        generate_motions(small, [], 1, 1.0, torch.zeros(24, 3), torch.Generator())
    with pytest.raises(UserError, match=r"0\.0 s is not a length"):
        generate_motions(small, ["walk"], 1, 0.0, torch.zeros(24, 3), torch.Generator())
    with pytest.raises(ShapeError, match=r"expected shape \[B C\] with C=3, B=4, got \[4, 2\]"):
        small(features, torch.zeros(4, 2), VALID, torch.zeros(4, 32))
    with pytest.raises(ShapeError, match=r"Generator\(noise\): expected shape \[B D\]"):
        small(features, torch.zeros(4, 3), VALID, torch.zeros(4, 16))
    with pytest.raises(UserError, match="6 heads"):
        GeneratorConfig(names(2), heads=6)
    with pytest.raises(AssertionError):  # torch itself refuses SINC's "6 heads"
        nn.MultiheadAttention(256, 6)


def fitted(pairs=(("walk", "wave"),)):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        config = GeneratorConfig.of(replace(TINY, latent=8, layers=1), ("sit", "walk", "wave"), pairs=pairs)
        return Generator(config).eval()


def test_a_fitted_prior_has_the_moments_of_all_that_the_posteriors_draw(generator):
    model = fitted()
    mean = torch.randn(400, 8, generator=generator) @ torch.randn(8, 8, generator=generator) + 3
    log_variance = torch.randn(400, 8, generator=generator)
    model.fit_prior(0, mean, log_variance)
    drawn = mean[:, None] + (log_variance / 2).exp()[:, None] * torch.randn(400, 500, 8, generator=generator)
    latents = model.draw_latent(torch.tensor([[0.0, 0.5, 0.5]]).repeat(100_000, 1), generator)
    torch.testing.assert_close(latents.mean(0), drawn.mean((0, 1)), atol=0.06, rtol=0)
    expected = torch.cov(drawn.flatten(0, 1).T)
    assert (torch.cov(latents.T) - expected).abs().max() < 0.03 * expected.diag().max()


def test_other_labels_are_drawn_from_the_standard_normal(generator):
    model = fitted()
    model.fit_prior(0, torch.randn(50, 8, generator=generator) + 100, torch.zeros(50, 8))
    rows = [[0.5, 0.5, 0], [0, 0.3, 0.7], [1.0, 0, 0], [0, 1.0, 0], [0.3, 0.3, 0.4], [0, 0.9, 0.1]]
    latents = model.draw_latent(torch.tensor(rows), torch.Generator().manual_seed(1))
    plain = torch.randn(6, 8, generator=torch.Generator().manual_seed(1))
    far = latents.mean(1) > 50
    assert far.tolist() == [False, True, False, False, False, True]
    assert torch.equal(latents[~far], plain[~far])


def test_a_single_action_has_a_prior_of_its_own(generator):
    model = fitted((("walk", "walk"), ("walk", "wave")))
    model.fit_prior(0, torch.randn(50, 8, generator=generator) + 100, torch.zeros(50, 8))
    model.fit_prior(1, torch.randn(50, 8, generator=generator) - 100, torch.zeros(50, 8))
    latents = model.draw_latent(torch.tensor([[0, 1.0, 0], [0, 0.5, 0.5]]), generator)
    assert latents[0].mean() > 50 and latents[1].mean() < -50


def test_the_published_prior_knows_no_pairs():
    assert GeneratorConfig.of(PAPER, ("walk", "wave"), pairs=(("walk", "wave"),)).pairs == ()
    with pytest.raises(UserError, match="pairs"):
        fitted((("walk", "wake"),))


def test_standardised_features_are_read_and_written_in_their_own_units(generator):
    """Shifting and scaling features like centre and spread leaves latents as they are, and moves what is made along."""
    model = fitted()
    features = torch.randn(6, 10, 25, 6, generator=generator)
    model.standardise(features)
    weights, valid = torch.eye(3)[[0, 1, 2, 0, 1, 2]], torch.ones(6, 10, dtype=torch.bool)
    with torch.no_grad():
        before = model.encode(features, weights, valid)[0], model.decode(torch.zeros(6, 8), weights, valid)
        centre, spread = model.centre.clone(), model.spread.clone()
        model.centre.copy_(5 + 2 * centre)
        model.spread.copy_(2 * spread)
        after = model.encode(5 + 2 * features, weights, valid)[0], model.decode(torch.zeros(6, 8), weights, valid)
    torch.testing.assert_close(after[0], before[0], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(after[1], 5 + 2 * before[1], atol=1e-4, rtol=1e-4)
    flat = features.flatten(2).flatten(0, 1)
    torch.testing.assert_close(centre, flat.mean(0))
    torch.testing.assert_close(spread, flat.std(0) + SPREAD)
