"""Rotations: the row reading of 6D, round trips at 0 and pi, Euler orders with their wrong readings, heading."""

import itertools
import math

import pytest
import torch

from renderers.checks import ShapeError
from renderers.rotations import (
    axis_angle_to_matrix,
    continuous,
    euler_to_matrix,
    heading,
    matrix_from_6d,
    matrix_to_6d,
    matrix_to_axis_angle,
    matrix_to_euler,
    matrix_to_quaternion,
    quaternion_to_matrix,
    rotation_about,
    rotation_angle,
    slerp,
    slerp_quaternions,
)

HALF_TURN = torch.tensor(math.pi / 2, dtype=torch.float64)
ORDERS = ["".join(axes) for axes in itertools.permutations("xyz")]


def random_rotations(generator, *shape):
    return axis_angle_to_matrix(2 * torch.randn(*shape, 3, generator=generator, dtype=torch.float64))


def test_6d_is_the_first_two_rows():
    """Protocol G.8; the column reading of the same six numbers is the inverse rotation."""
    quarter = rotation_about("z", HALF_TURN)
    six = matrix_to_6d(quarter)
    torch.testing.assert_close(six, torch.tensor([0.0, -1, 0, 1, 0, 0], dtype=torch.float64), atol=1e-12, rtol=0)
    by_columns = torch.tensor([0.0, 1, 0, -1, 0, 0], dtype=torch.float64)
    torch.testing.assert_close(matrix_from_6d(by_columns), quarter.mT, atol=1e-12, rtol=0)
    assert matrix_to_6d(torch.eye(3)).tolist() == [1, 0, 0, 0, 1, 0]


def test_6d_round_trip_ignores_the_rows_lengths(generator):
    matrix = random_rotations(generator, 50)
    scale = torch.tensor([3.0] * 3 + [0.2] * 3, dtype=torch.float64)
    torch.testing.assert_close(matrix_from_6d(matrix_to_6d(matrix) * scale), matrix, atol=1e-12, rtol=0)


def test_6d_of_any_numbers_is_a_rotation(generator):
    matrix = matrix_from_6d(torch.randn(100, 6, generator=generator, dtype=torch.float64))
    torch.testing.assert_close(matrix @ matrix.mT, torch.eye(3, dtype=torch.float64).expand(100, 3, 3))
    torch.testing.assert_close(torch.linalg.det(matrix), torch.ones(100, dtype=torch.float64))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, math.pi - 1e-4, math.pi])
@pytest.mark.parametrize("axis", [(1.0, 0, 0), (1.0, -1.0, 0), (-0.3, 0.5, 0.8)])
def test_axis_angle_round_trip(angle, axis):
    axis = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0)
    matrix = axis_angle_to_matrix(angle * axis)
    cross = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, dtype=torch.float64)).mT
    torch.testing.assert_close(matrix, torch.linalg.matrix_exp(angle * cross), atol=1e-7, rtol=0)
    torch.testing.assert_close(axis_angle_to_matrix(matrix_to_axis_angle(matrix)), matrix, atol=1e-7, rtol=0)
    assert rotation_angle(matrix).item() == pytest.approx(angle, abs=1e-6)


def test_axis_angle_has_a_gradient_at_rest():
    at_rest = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    axis_angle_to_matrix(at_rest)[2, 1].backward()
    torch.testing.assert_close(at_rest.grad, torch.tensor([1.0, 0, 0], dtype=torch.float64))


def test_rotation_about_turns_by_the_right_hand():
    ahead, up, left = torch.eye(3, dtype=torch.float64).flip(0)
    torch.testing.assert_close(rotation_about("y", HALF_TURN) @ ahead, left)
    torch.testing.assert_close(rotation_about("x", HALF_TURN) @ up, ahead)
    torch.testing.assert_close(rotation_about("z", HALF_TURN) @ left, up)


def test_euler_multiplies_in_the_order_listed():
    angles = torch.tensor([0.3, -0.5, 1.1], dtype=torch.float64)
    z, x, y = (rotation_about(axis, angle) for axis, angle in zip("zxy", angles, strict=True))
    torch.testing.assert_close(euler_to_matrix(angles, "zxy"), z @ x @ y)
    assert (euler_to_matrix(angles, "zxy") - y @ x @ z).abs().max() > 0.3


@pytest.mark.parametrize("axes", ORDERS)
def test_euler_round_trip(axes, generator):
    matrix = random_rotations(generator, 200)
    torch.testing.assert_close(euler_to_matrix(matrix_to_euler(matrix, axes), axes), matrix, atol=1e-12, rtol=0)


@pytest.mark.parametrize("axes", ORDERS)
@pytest.mark.parametrize("middle", [math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9])
def test_euler_round_trip_in_gimbal_lock(axes, middle):
    angles = torch.tensor([0.7, middle, -1.9], dtype=torch.float64)
    matrix = euler_to_matrix(angles, axes)
    torch.testing.assert_close(euler_to_matrix(matrix_to_euler(matrix, axes), axes), matrix, atol=1e-12, rtol=0)


def test_euler_with_fewer_axes():
    assert euler_to_matrix(torch.zeros(4, 0), "").shape == (4, 3, 3)
    torch.testing.assert_close(euler_to_matrix(HALF_TURN[None], "y"), rotation_about("y", HALF_TURN))


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.5, 2.0])
def test_heading_is_the_yaw_under_any_lean_to_the_front(yaw):
    lean = rotation_about("x", torch.tensor(0.6, dtype=torch.float64))
    turned = rotation_about("y", torch.tensor(yaw, dtype=torch.float64)) @ lean
    assert heading(turned).item() == pytest.approx(yaw, abs=1e-12)


def test_slerp_goes_half_way_at_half():
    start, end = rotation_about("y", torch.tensor([0.2])), rotation_about("y", torch.tensor([1.0]))
    torch.testing.assert_close(slerp(start, end, torch.tensor([0.5])), rotation_about("y", torch.tensor([0.6])))
    torch.testing.assert_close(slerp(start, end, torch.tensor([1.0])), end)


def test_shapes_are_checked():
    with pytest.raises(ShapeError, match=r"matrix_to_6d\(matrix\): expected shape \[\.\.\. 3 3\], got \[3, 6\]"):
        matrix_to_6d(torch.zeros(3, 6))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, math.pi])
def test_quaternions_put_the_cosine_of_half_the_angle_first(angle):
    axis = torch.nn.functional.normalize(torch.tensor([-0.3, 0.5, 0.8], dtype=torch.float64), dim=0)
    expected = torch.cat([torch.tensor([math.cos(angle / 2)], dtype=torch.float64), math.sin(angle / 2) * axis])
    quaternion = matrix_to_quaternion(axis_angle_to_matrix(angle * axis))
    assert (quaternion @ expected).abs() > 1 - 1e-12
    torch.testing.assert_close(quaternion_to_matrix(3 * expected), axis_angle_to_matrix(angle * axis))


def test_quaternion_round_trip(generator):
    matrix = random_rotations(generator, 20, 5)
    torch.testing.assert_close(quaternion_to_matrix(matrix_to_quaternion(matrix)), matrix, atol=1e-12, rtol=0)


def test_continuous_quaternions_do_not_flip(generator):
    """Two turns about an axis, in steps: the quaternion goes once round, and signs drawn at random are undone."""
    half = torch.linspace(0, 2 * math.pi, 50, dtype=torch.float64)
    true = torch.stack([half.cos(), half.sin(), 0 * half, 0 * half], dim=-1)[:, None].repeat(1, 3, 1)
    signs = torch.randint(0, 2, (50, 3, 1), generator=generator) * 2 - 1
    signs[0] = 1
    torch.testing.assert_close(continuous(true * signs), true)
    assert continuous(true[:1]).shape == (1, 3, 4)


def test_slerp_of_quaternions_is_slerp_of_matrices(generator):
    start, end = random_rotations(generator, 100), random_rotations(generator, 100)
    end[:20] = start[:20] @ axis_angle_to_matrix(1e-8 * torch.randn(20, 3, generator=generator, dtype=torch.float64))
    weight = torch.rand(100, generator=generator, dtype=torch.float64)
    signs = 1 - 2 * torch.randint(0, 2, (100, 1), generator=generator)
    between = slerp_quaternions(matrix_to_quaternion(start), signs * matrix_to_quaternion(end), weight)
    torch.testing.assert_close(quaternion_to_matrix(between), slerp(start, end, weight), atol=1e-7, rtol=0)
    torch.testing.assert_close(between.norm(dim=-1), torch.ones(100, dtype=torch.float64))
