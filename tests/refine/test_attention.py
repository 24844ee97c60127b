"""Eq. 6 by hand (protocol G.6)."""

import pytest
import torch

from refine.attention import attention_map
from refine.patches import patch_means


def one_joint(x, y, energy=2.0, size=(32, 48)):
    return attention_map(torch.tensor([[energy]]), torch.tensor([[[x, y]]]), size)[0]


def test_value_by_hand():
    field = one_joint(10.5, 20.5)
    assert field[20, 10] == 2.0
    assert field[24, 13] == pytest.approx(2 / 26)
    assert field[23, 14] == pytest.approx(2 / 26)


def test_x_is_across_and_y_is_down():
    field = one_joint(40.5, 3.5)
    assert field.argmax() == 3 * 48 + 40
    assert field[3, 40] == 2.0 and field[3, 3] < 0.01


def test_linear_and_additive(generator):
    joints = torch.rand(2, 5, 2, generator=generator) * 32
    energies = torch.rand(2, 5, generator=generator)
    whole = attention_map(energies, joints, (32, 32))
    singles = [attention_map(energies[:, n : n + 1], joints[:, n : n + 1], (32, 32)) for n in range(5)]
    assert torch.allclose(whole, sum(singles))
    assert torch.allclose(attention_map(3 * energies, joints, (32, 32)), 3 * whole)


def test_shift_by_a_patch_shifts_the_patch_map():
    here = patch_means(one_joint(10.5, 12.5, size=(64, 64))[None], 16).reshape(4, 4)
    there = patch_means(one_joint(26.5, 12.5, size=(64, 64))[None], 16).reshape(4, 4)
    assert torch.allclose(here[:, :3], there[:, 1:])


def test_epsilon_bounds_the_peak():
    field = attention_map(torch.tensor([[2.0]]), torch.tensor([[[4.5, 4.5]]]), (8, 8), epsilon=4.0)
    assert field.max() == 0.5
