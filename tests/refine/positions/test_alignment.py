"""Rotations between directions: right, smallest, finite where a direction is missing."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from refine.positions.alignment import across, direction, frame, kabsch, swing
from renderers.rotations import rotation_angle

coordinate = st.floats(-2, 2)
vector = st.tuples(coordinate, coordinate, coordinate).filter(lambda v: math.hypot(*v) > 1e-3)


def double(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def is_rotation(matrix: torch.Tensor) -> bool:
    whole = torch.eye(3, dtype=matrix.dtype).expand_as(matrix)
    return torch.allclose(matrix @ matrix.mT, whole, atol=1e-6) and bool((torch.linalg.det(matrix) > 0.99).all())


@settings(max_examples=100, deadline=None)
@given(start=vector, end=vector)
def test_a_swing_takes_one_direction_to_the_other_by_the_angle_between(start, end):
    start, end = double(*start), double(*end)
    turned = swing(start, end)
    assert is_rotation(turned)
    torch.testing.assert_close(turned @ direction(start, start), direction(end, end), atol=1e-6, rtol=0)
    between = torch.atan2(torch.linalg.cross(start, end).norm(), start @ end)
    assert float(rotation_angle(turned)) == pytest.approx(float(between), abs=1e-5)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 2, 3), (1, 1, 1)])
@pytest.mark.parametrize("nearly", [0.0, 1e-12, 1e-9, 1e-6, 1e-4])
def test_half_a_turn_is_one(axis, nearly):
    start = double(*axis)
    end = -start + nearly * double(0.3, -0.7, 0.2)
    turned = swing(start, end)
    assert is_rotation(turned)
    torch.testing.assert_close(turned @ direction(start, start), direction(end, end), atol=2e-4, rtol=0)


def test_what_has_no_length_has_no_direction():
    zero, ahead = torch.zeros(2, 3, dtype=torch.float64), double(0.0, 0.0, 2.0).expand(2, 3)
    whole = torch.eye(3, dtype=torch.float64).expand(2, 3, 3)
    torch.testing.assert_close(swing(ahead, zero), whole)
    torch.testing.assert_close(direction(zero, ahead), ahead / 2)
    assert is_rotation(swing(zero, ahead)) and is_rotation(
        kabsch(torch.zeros(3, 3).double(), zero[:, None].repeat(1, 3, 1))
    )


def test_frames_are_right_handed():
    columns = frame(double(0.0, 3.0, 0.0), double(0.5, 9.0, 0.0))
    torch.testing.assert_close(columns, double([0.0, 1, 0], [1, 0, 0], [0, 0, -1]))
    torch.testing.assert_close(across(double(1.0, 2, 3), double(0.0, 1, 0)), double(1.0, 0, 3))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 6))
def test_kabsch_agrees_with_scipy(seed, count):
    random = torch.Generator().manual_seed(seed)
    still, moved = (torch.randn(*shape, 3, generator=random).double() for shape in ((count,), (4, count)))
    weights = torch.rand(count, generator=random).double() + 0.1
    turned = kabsch(still, moved, weights)
    for one, vectors in zip(turned, moved, strict=True):
        best = Rotation.align_vectors(vectors.numpy(), still.numpy(), weights=weights.numpy())[0]
        theirs, ours = (
            float((weights * (vectors - still @ matrix.T).square().sum(dim=1)).sum())
            for matrix in (torch.from_numpy(best.as_matrix()), one)
        )
        assert ours == pytest.approx(theirs, rel=1e-6, abs=1e-9)
    assert is_rotation(turned)


def test_a_mirror_image_is_met_by_a_rotation():
    still = torch.eye(3, dtype=torch.float64)
    assert is_rotation(kabsch(still, -still[None]))
