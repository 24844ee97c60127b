"""Loss terms of text to motion, against plain formulas."""

import pytest
import torch
from torch.distributions import Normal, kl_divergence
from torch.nn.functional import smooth_l1_loss

from refine.text.model import Distribution, TextToMotion, TextToMotionConfig
from renderers.body import Body
from renderers.checks import UserError
from train.text_data import batch_of
from train.text_steps import TextLoss, contrast, kl_between, positions_of, text_step

CONFIG = TextToMotionConfig(latent=16, feedforward=32, heads=2, layers=1, dropout=0.0, encoder="test", text_width=12)


def distribution(seed: int, count: int = 4) -> Distribution:
    random = torch.Generator().manual_seed(seed)
    return Distribution(*(torch.randn(count, 16, generator=random, dtype=torch.double) for _ in range(2)))


def test_kl_is_that_of_torch_and_a_mean():
    one, other = distribution(0), distribution(1)
    normals = [Normal(each.mean, (each.log_variance / 2).exp()) for each in (one, other)]
    torch.testing.assert_close(kl_between(one, other), kl_divergence(*normals).mean())
    assert float(kl_between(one, one)) == 0
    ones, zeros = torch.ones(2, 256), torch.zeros(2, 256)
    assert float(kl_between(Distribution(ones, zeros), Distribution(zeros, zeros))) == 0.5


def test_contrast_is_a_cross_entropy_without_what_means_the_same():
    random = torch.Generator().manual_seed(2)
    text, motion = (torch.randn(3, 5, generator=random, dtype=torch.double) for _ in range(2))
    sentences = torch.eye(3, dtype=torch.double)
    sentences[2] = sentences[1]  # the last two say the same
    found = contrast(text, motion, sentences, 0.1, 0.8)
    cosine = torch.nn.functional.cosine_similarity(text[:, None], motion[None], dim=-1) / 0.1
    allowed = {0: [0, 1, 2], 1: [0, 1], 2: [0, 2]}
    losses = []
    for table in (cosine, cosine.T):
        for row, columns in allowed.items():
            losses.append(table[row, columns].logsumexp(0) - table[row, row])
    assert float(found) == pytest.approx(float(torch.stack(losses).mean()))


@pytest.fixture(scope="module")
def batch():
    from refine.synthetic import draw, perform

    random = torch.Generator().manual_seed(0)
    rest_joints = Body.free("light").rest_joints
    motions = [perform(draw(name, random), frames, rest_joints) for name, frames in (("walk", 20), ("squat", 31))]
    return batch_of(motions, [("walk",), ("squat",)], ["walk", "squat"])


def test_terms_of_a_batch(batch):
    torch.manual_seed(0)
    model = TextToMotion(CONFIG).eval()
    model.standardise(batch.features[batch.valid])
    text = Distribution(*(value.float() for value in distribution(3, 2)))
    noise = torch.randn(2, 2, 16, generator=torch.Generator().manual_seed(1))
    rest_joints = Body.free("light").rest_joints
    arguments = (batch.features, batch.valid, text, model, noise)
    masked = text_step(*arguments, TextLoss(joints=2.0), rest_joints)
    legacy = text_step(*arguments, TextLoss(padding="legacy"), rest_joints)
    made = model.decode(text.draw(noise[0]), batch.valid)
    hidden = ~batch.valid[..., None]
    normal = [model.normal(each).masked_fill(hidden, 0) for each in (made, batch.features)]
    # In SINC's code both are zero where a clip is padded, and the mean is over everything.
    torch.testing.assert_close(legacy["text"], smooth_l1_loss(*normal))
    torch.testing.assert_close(masked["text"] * batch.valid.sum(), legacy["text"] * batch.valid.numel())
    loss = TextLoss()
    expected = masked["text"] + masked["motion"] + loss.kl * masked["kl"] + loss.latent * masked["latent"]
    torch.testing.assert_close(masked["total"], expected + 2 * masked["joints"])
    assert "joints" not in legacy and "contrastive" not in legacy


def test_a_learned_prior_lets_texts_be_wide(batch):
    torch.manual_seed(0)
    model = TextToMotion(CONFIG).eval()
    text = Distribution(*(value.float() for value in distribution(3, 2)))
    noise = torch.zeros(2, 2, 16)
    arguments = (batch.features, batch.valid, text, model, noise)
    rest_joints = Body.free("light").rest_joints
    found = text_step(*arguments, TextLoss(text=0.0, latent=0.0, prior="learned"), rest_joints)
    assert set(found) == {"motion", "kl", "total"}
    motion = model.encode_motion(batch.features, batch.valid)
    torch.testing.assert_close(found["kl"], kl_between(motion, text))
    matched = text_step(*arguments, TextLoss(), rest_joints)
    standard = Distribution(torch.zeros(2, 16), torch.zeros(2, 16))
    others = kl_between(text, motion) + kl_between(text, standard) + kl_between(motion, standard)
    torch.testing.assert_close(matched["kl"], found["kl"] + others)
    with pytest.raises(UserError, match="weigh one of them"):
        TextLoss(text=0.0, motion=0.0)


def test_positions_are_over_real_frames_and_do_not_travel(batch):
    rest_joints = Body.free("light").rest_joints
    joints = positions_of(batch.features, batch.valid, rest_joints)
    assert joints.shape == (51, 24, 3)
    assert joints[:, 0, [0, 2]].abs().max() < 1e-6
    assert 0.5 < float(joints[:, 0, 1].mean()) < 1.2


def test_gradients_reach_both_encoders(batch):
    torch.manual_seed(0)
    model = TextToMotion(CONFIG)
    states = torch.randn(2, 4, 12)
    text = model.encode_text([type("W", (), {"states": states, "valid": torch.ones(2, 4).bool()})()])
    noise = torch.zeros(2, 2, 16)
    text_step(batch.features, batch.valid, text, model, noise, TextLoss(), Body.free("light").rest_joints)[
        "total"
    ].backward()
    assert all(value.grad is not None and value.grad.isfinite().all() for value in model.parameters())
