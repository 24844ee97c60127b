"""Features of texts and motions: their layout by hand, the way back, and the two ways to turn a clip."""

import math

import numpy as np
import pytest
import torch

from refine.motion import Motion
from refine.text.features import WIDTH, canonical, from_text_features, legacy_yaw, to_text_features
from renderers.rotations import axis_angle_to_matrix, heading, rotation_about


def clip(frames: int = 7, batch: tuple[int, ...] = ()) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    rotations = axis_angle_to_matrix(torch.randn(*batch, frames, 24, 3, generator=generator, dtype=torch.float64) / 2)
    return rotations, torch.randn(*batch, frames, 3, generator=generator, dtype=torch.float64)


def test_features_hold_height_steps_and_first_two_rows():
    rotations, root = clip(3)
    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # about z
    rotations[1, 0] = quarter
    features = to_text_features(rotations, root)
    assert WIDTH == 135 and features.shape == (3, 135)
    assert torch.equal(features[:, 0], root[:, 1])
    assert features[0, 1:3].tolist() == [0, 0]
    assert torch.equal(features[2, 1:3], torch.stack([root[2, 0] - root[1, 0], root[2, 2] - root[1, 2]]))
    assert features[1, 3:9].tolist() == [0, -1, 0, 1, 0, 0]
    assert torch.equal(features[2, -6:], rotations[2, 21, :2].flatten())


def test_features_lead_back_to_canonical_motions():
    rotations, root = clip(9, (2, 3))
    rotations[..., 22:, :, :] = torch.eye(3, dtype=torch.float64)
    root[..., [0, 2]] -= root[..., :1, [0, 2]].clone()
    back, path = from_text_features(to_text_features(rotations, root))
    torch.testing.assert_close(back, rotations)
    torch.testing.assert_close(path, root)


def test_a_first_step_that_is_made_up_moves_nothing():
    features = to_text_features(*clip(4))
    moved = features.clone()
    moved[0, 1:3] = 5.0
    torch.testing.assert_close(from_text_features(moved)[1], from_text_features(features)[1])


def test_gradients_reach_every_feature_but_the_first_step():
    features = to_text_features(*clip(4)).requires_grad_()
    rotations, root = from_text_features(features)
    weights = torch.linspace(1, 2, rotations.numel(), dtype=torch.float64).view_as(rotations)
    ((rotations * weights).sum() + root.square().sum()).backward()
    reached = features.grad.abs() > 1e-9
    assert not reached[0, 1:3].any() and reached[1:, :].all() and reached[0, 3:].all()


@pytest.mark.parametrize(("turned", "removed"), [(30, 23.5), (60, 46.7), (90, 69.3), (150, 110.4)])
def test_legacy_takes_too_little_for_the_yaw(turned, removed):
    """Independent: the axis-angle vector that AMASS would hold, by the formula of the rotation's axis."""
    psi = math.radians(turned)
    about_z = np.array([[math.cos(psi), -math.sin(psi), 0], [math.sin(psi), math.cos(psi), 0], [0, 0, 1]])
    amass = about_z @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    angle = math.acos((np.trace(amass) - 1) / 2)
    by_hand = math.degrees(angle * (amass[1, 0] - amass[0, 1]) / (2 * math.sin(angle)))
    assert by_hand == pytest.approx(removed, abs=0.05)
    ours = rotation_about("y", torch.tensor(psi, dtype=torch.float64))
    assert math.degrees(legacy_yaw(ours)) == pytest.approx(by_hand, abs=1e-6)


@pytest.mark.parametrize(("canon", "left"), [("true_yaw", 0.0), ("temos_legacy", 20.7)])
def test_canonical_turns_and_moves_the_whole_clip(canon, left):
    rotations, root = clip(5)
    rotations[:, 0] = rotation_about("y", torch.full((5,), math.pi / 2, dtype=torch.float64))
    root[0] = torch.tensor([1.0, 0.9, 2.0])
    root[1] = root[0] + torch.tensor([1.0, 0.0, 0.0])  # ahead of the body
    turned = canonical(Motion(rotations, root, 30.0), canon)
    assert math.degrees(heading(turned.rotations[0, 0])) == pytest.approx(left, abs=0.05)
    assert turned.root[0].tolist() == pytest.approx([0, 0.9, 0])
    ahead = [math.sin(math.radians(left)), 0.9, math.cos(math.radians(left))]
    assert turned.root[1].tolist() == pytest.approx(ahead, abs=1e-3)
    assert torch.equal(turned.rotations[:, 1:], rotations[:, 1:])
