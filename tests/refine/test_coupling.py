"""Eqs. 1 and 3 against protocol G.3 to G.5."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from refine.coupling import (
    CouplingConfig,
    couple,
    couple_features,
    coupling_weights,
    point_bones,
    sample_lam,
    shortest_arc,
)
from refine.motion import Motion, to_features
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from renderers.skeleton import JOINTS, PARENTS, PARTS, forward_kinematics

CONFIG = CouplingConfig(root="blend")


def clip(seed, frames=20, scale=0.3, fps=30.0):
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randn(frames, 24, 3, generator=generator, dtype=torch.float64) * 0.05
    pose = torch.randn(1, 24, 3, generator=generator, dtype=torch.float64) * scale
    root = torch.randn(frames, 3, generator=generator, dtype=torch.float64)
    return Motion(
        axis_angle_to_matrix(pose + steps.cumsum(0)), root, fps, label=f"action-{seed}", source=f"clip {seed}"
    )


@pytest.fixture
def rest_joints():
    return torch.randn(24, 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64)


@pytest.mark.parametrize(
    ("lam", "of_i", "of_j", "share"),
    [
        (0.5, 4, 1, 0.8),
        (0.6, 4, 1, 0.857142857),
        (0.3, 2, 2, 0.3),
        (0.0, 5, 1, 0.0),
        (1.0, 1, 5, 1.0),
        (0.4, 0, 0, 0.4),
    ],
)
def test_shares(lam, of_i, of_j, share):
    energies = [torch.full((24,), float(value), dtype=torch.float64) for value in (of_i, of_j)]
    weights = coupling_weights(*energies, lam, CONFIG)
    assert torch.allclose(weights, torch.tensor(share, dtype=torch.float64), atol=1e-7)


@given(st.floats(0, 1), st.floats(0.01, 100), st.integers(0, 1000))
def test_shares_are_scale_free_and_swap(lam, scale, seed):
    generator = torch.Generator().manual_seed(seed)
    of_i, of_j = torch.rand(2, 24, generator=generator, dtype=torch.float64) + 0.1
    weights = coupling_weights(of_i, of_j, lam, CONFIG)
    assert ((weights >= 0) & (weights <= 1)).all()
    assert torch.allclose(coupling_weights(scale * of_i, scale * of_j, lam, CONFIG), weights, atol=1e-5)
    assert torch.allclose(coupling_weights(of_j, of_i, 1 - lam, CONFIG), 1 - weights, atol=1e-9)


@given(st.floats(0.05, 0.95), st.integers(0, 1000))
def test_leaning_adds_to_the_log_odds_of_each_part_and_swaps(lam, seed):
    generator = torch.Generator().manual_seed(seed)
    of_i, of_j = torch.rand(2, 24, generator=generator, dtype=torch.float64) + 0.1
    lean = 3 * torch.randn(5, generator=generator, dtype=torch.float64)
    plain, leaning = (coupling_weights(of_i, of_j, lam, CONFIG, some) for some in (None, lean))
    for row, joints in enumerate(PARTS.values()):
        some = list(joints)
        raised = torch.logit(leaning[some]) - torch.logit(plain[some])
        torch.testing.assert_close(raised, lean[row].expand(len(some)), atol=1e-5, rtol=0)
    assert leaning[0] == plain[0]  # whose travel it is stays
    torch.testing.assert_close(coupling_weights(of_j, of_i, 1 - lam, CONFIG, -lean), 1 - leaning)
    given_away = coupling_weights(of_i.float(), of_j.float(), lam, CONFIG, torch.full((5,), 1e4))
    assert torch.allclose(given_away[1:], torch.ones(23))


def test_switches():
    of_i, of_j = torch.full((24,), 9.0), torch.full((24,), 1.0)
    assert torch.allclose(coupling_weights(of_i, of_j, 0.3, replace(CONFIG, mask=False)), torch.tensor(0.3))
    assert torch.allclose(
        coupling_weights(of_i, of_j, 0.3, replace(CONFIG, normalise_energies=True)), torch.tensor(0.3)
    )
    owned = coupling_weights(of_i, of_j, 0.5, CouplingConfig())
    assert owned[0] == 1 and owned[1] == pytest.approx(0.9)
    assert torch.allclose(coupling_weights(of_i, of_j, 0.3, CouplingConfig(mask=False)), torch.tensor(0.3))


def test_the_root_has_the_mean_weight_of_the_legs():
    """Protocol B.4 no. 8: the weights are averaged, not the energies, or one wild leg would own the whole body."""
    of_i, of_j = torch.ones(24), torch.ones(24)
    of_i[list(PARTS["left_leg"])], of_j[list(PARTS["right_leg"])] = 9.0, 99.0
    of_i[0], of_j[0] = 5.0, 50.0
    weights = coupling_weights(of_i, of_j, 0.5, CONFIG)
    assert float(weights[0]) == pytest.approx((0.9 + 0.01) / 2)
    of_i[0], of_j[0] = 500.0, 50.0  # the root's own energy has no say
    assert coupling_weights(of_i, of_j, 0.5, CouplingConfig())[0] == 0


def test_root_belongs_wholly_to_the_owner_of_the_legs(rest_joints):
    i, j = clip(0), clip(1)
    coupled = couple(i, j, rest_joints)
    owner = i if coupled.weights[1] > 0.5 else j
    assert torch.equal(coupled.motion.root, owner.root)
    assert torch.allclose(coupled.motion.rotations[:, 0], owner.rotations[:, 0])
    assert not torch.allclose(couple(i, j, rest_joints, config=CONFIG).motion.root, owner.root)


@pytest.mark.parametrize("space", ["rot6d", "joints"])
def test_swap_symmetry_and_identity(rest_joints, space):
    i, j, config = clip(0), clip(1), CouplingConfig(blend_space=space)
    one, two = couple(i, j, rest_joints, 0.3, config).motion, couple(j, i, rest_joints, 0.7, config).motion
    assert torch.allclose(one.rotations, two.rotations) and torch.allclose(one.root, two.root)
    same = couple(i, i, rest_joints, 0.3, config).motion
    assert torch.allclose(same.rotations, i.rotations, atol=1e-6) and torch.allclose(same.root, i.root)


@pytest.mark.parametrize("space", ["rot6d", "joints"])
def test_blend_is_a_rigid_body(rest_joints, space):
    motion = couple(clip(0), clip(1), rest_joints, config=CouplingConfig(blend_space=space)).motion
    identity = motion.rotations @ motion.rotations.mT
    assert torch.allclose(identity, torch.eye(3, dtype=torch.float64).expand_as(identity), atol=1e-6)
    assert torch.allclose(torch.linalg.det(motion.rotations), torch.tensor(1.0, dtype=torch.float64), atol=1e-6)
    joints = motion.joints(rest_joints)
    for child, parent in enumerate(PARENTS[1:], start=1):
        length = (joints[:, child] - joints[:, parent]).norm(dim=-1)
        assert torch.allclose(length, (rest_joints[child] - rest_joints[parent]).norm().expand_as(length))


def test_joint_blend_points_limbs_at_the_blended_joints(rest_joints):
    motion = clip(3)
    target = forward_kinematics(clip(4).rotations, motion.root, rest_joints)[0]
    joints = forward_kinematics(point_bones(motion.rotations, target, rest_joints), motion.root, rest_joints)[0]
    elbow, wrist = JOINTS["left_elbow"], JOINTS["left_wrist"]
    got, wanted = joints[:, wrist] - joints[:, elbow], target[:, wrist] - target[:, elbow]
    assert torch.allclose(got / got.norm(dim=-1, keepdim=True), wanted / wanted.norm(dim=-1, keepdim=True))


def test_shortest_arc(generator):
    start, end = torch.randn(2, 50, 3, generator=generator, dtype=torch.float64)
    turned = (shortest_arc(start, end) @ start[..., None])[..., 0]
    assert torch.allclose(turned / turned.norm(dim=-1, keepdim=True), end / end.norm(dim=-1, keepdim=True))


@pytest.mark.parametrize("short_of_opposite", [0.0, 1e-4, 1e-3, 3e-3, 0.1])
def test_shortest_arc_is_a_rotation_near_opposite_directions(short_of_opposite):
    angle = torch.tensor(math.pi - short_of_opposite)
    start, end = torch.tensor([1.0, 0.0, 0.0]), torch.stack([angle.cos(), angle.sin(), torch.tensor(0.0)])
    turn = shortest_arc(start, end)
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3), atol=1e-5, rtol=0)
    assert torch.linalg.det(turn) > 0.99
    if short_of_opposite:
        torch.testing.assert_close(turn @ start, end, atol=2e-3, rtol=0)


def test_the_calm_part_goes_to_the_action_that_moves_it(rest_joints):
    still = clip(0)
    still = replace(still, rotations=still.rotations[:1].expand_as(still.rotations))
    moving_arm = still.rotations.clone()
    swing = torch.zeros(len(still), 3, dtype=torch.float64)
    swing[:, 2] = torch.linspace(0, 2, len(still))
    elbow = JOINTS["right_elbow"]
    moving_arm[:, elbow] = moving_arm[:, elbow] @ axis_angle_to_matrix(swing)
    coupled = couple(still, replace(still, rotations=moving_arm), rest_joints)
    assert coupled.weights[list(PARTS["right_arm"])].max() < 1e-3
    assert coupled.weights[list(PARTS["left_arm"])].tolist() == pytest.approx([0.5] * 5)


def test_batch_agrees_with_clips(rest_joints):
    pairs = [(clip(0), clip(1)), (clip(2), clip(3))]
    lam = torch.tensor([0.4, 0.7], dtype=torch.float64)
    x_i, x_j = (torch.stack([to_features(pair[side].six, pair[side].root) for pair in pairs]) for side in (0, 1))
    got = couple_features(x_i, x_j, lam, rest_joints)
    for row, (i, j) in enumerate(pairs):
        motion = couple(i, j, rest_joints, float(lam[row])).motion
        assert torch.allclose(got[row], to_features(motion.six, motion.root), atol=1e-9)


def test_lam_is_normal_with_a_deviation_of_a_tenth(generator):
    lam = sample_lam(100_000, generator)
    assert float(lam.mean()) == pytest.approx(0.5, abs=0.002) and float(lam.std()) == pytest.approx(0.1, abs=0.002)
    assert lam.min() >= 0 and lam.max() <= 1
    assert float(sample_lam(100_000, generator, "uniform").std()) == pytest.approx(1 / 12**0.5, abs=0.002)


def test_length_label_and_refusals(rest_joints):
    coupled = couple(clip(0, frames=20), clip(1, frames=12), rest_joints).motion
    assert len(coupled) == 12 and coupled.label == "action-0+action-1"
    with pytest.raises(UserError, match="30 fps.*60.*resample"):
        couple(clip(0), clip(1, fps=60.0), rest_joints)
    with pytest.raises(UserError, match="between 0 and 1, got 1.5"):
        couple(clip(0), clip(1), rest_joints, lam=1.5)
    with pytest.raises(UserError, match="at least two frames"):
        couple(clip(0, frames=1), clip(1), rest_joints)
