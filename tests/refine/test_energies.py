"""Eq. 2 against protocol G.1 and G.2."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from refine.energies import energy_signal, joint_energies, part_energies, spread_to_joints
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from renderers.skeleton import PART_NAMES, PARTS


def drift(velocity, frames=7):
    """[T 24 3] every joint moving by ``velocity`` a frame from its own start."""
    start = torch.randn(24, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return start + torch.arange(frames)[:, None, None] * torch.as_tensor(velocity, dtype=torch.float64)


@given(st.integers(2, 40), st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_constant_drift_has_its_squared_speed(frames, velocity):
    energy = part_energies(drift(velocity, frames))
    assert torch.allclose(energy, torch.tensor(velocity, dtype=torch.float64).square().sum(), atol=1e-12)


def test_invariances_and_scaling(generator):
    motion = torch.randn(12, 24, 3, generator=generator, dtype=torch.float64)
    energy = part_energies(motion)
    assert torch.allclose(part_energies(motion + 5.0), energy)
    assert torch.allclose(part_energies(motion.flip(0)), energy)
    assert torch.allclose(part_energies(3.0 * motion), 9.0 * energy)
    steady = drift([0.1, 0.2, 0.0], 13)
    assert torch.allclose(part_energies(steady[::2]), 4 * part_energies(steady))


def test_added_drift_adds_cross_term_and_square(generator):
    motion = torch.randn(9, 24, 3, generator=generator, dtype=torch.float64)
    added = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)
    energy = part_energies(motion + torch.arange(9)[:, None, None] * added)
    for index, joints in enumerate(PARTS.values()):
        mean_velocity = motion.diff(dim=0)[:, list(joints)].mean((0, 1))
        expected = part_energies(motion)[index] + 2 * added @ mean_velocity + added @ added
        assert energy[index] == pytest.approx(float(expected))


def test_travel_is_energy_of_world_joints_only(generator):
    rotations = axis_angle_to_matrix(torch.zeros(5, 24, 3))
    root = torch.arange(5.0)[:, None] * torch.tensor([0.0, 0.0, 0.04])
    rest = torch.randn(24, 3, generator=generator)
    assert part_energies(energy_signal(rotations, root, rest)).abs().max() < 1e-12
    world = part_energies(energy_signal(rotations, root, rest, "joints_abs"))
    assert torch.allclose(world, torch.tensor(0.0016), atol=1e-6)
    assert energy_signal(rotations, root, rest, "rot6d").shape == (5, 24, 6)


def test_only_the_moving_part_has_energy():
    motion = torch.zeros(4, 24, 3)
    motion[:, PARTS["left_arm"][2], 0] = torch.arange(4.0)
    energy = part_energies(motion)
    assert energy.nonzero().flatten().tolist() == [PART_NAMES.index("left_arm")]
    assert energy.max() == pytest.approx(1 / len(PARTS["left_arm"]))


def test_joints_share_their_part_and_the_pelvis_means_the_legs():
    joints = spread_to_joints(torch.tensor([1.0, 2.0, 3.0, 4.0, 6.0]))
    assert joints[15] == 1 and joints[22] == 2 and joints[13] == 2 and joints[23] == 3
    assert joints[10] == 4 and joints[2] == 6 and joints[0] == 5


def test_one_frame_is_refused():
    with pytest.raises(UserError, match="at least two frames"):
        joint_energies(torch.zeros(1, 24, 3))
