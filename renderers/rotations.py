"""Rotations: axis-angle, matrix, 6D. The only file that converts between them.

Matrices act on column vectors (``R @ v``). Axis-angle is in radians. 6D is the **first two rows** of the matrix,
flattened row-major, as ACTOR, TEMOS and SINC use it; HumanML3D's is the first two columns, so files of the two
families must never be mixed. Quaternions are (w, x, y, z) and of unit length; files of another order turn it
at their edge.
"""

import torch
from torch import Tensor

from renderers.checks import check_shapes


def axis_angle_to_matrix(axis_angle: Tensor) -> Tensor:
    """[... 3] radians -> [... 3 3]; exact with finite gradients at 0 and pi."""
    from kornia.geometry.conversions import axis_angle_to_rotation_matrix

    check_shapes("axis_angle_to_matrix", axis_angle=(axis_angle, "... 3"))
    return axis_angle_to_rotation_matrix(axis_angle.reshape(-1, 3)).reshape(*axis_angle.shape[:-1], 3, 3)


def matrix_to_axis_angle(matrix: Tensor) -> Tensor:
    """[... 3 3] -> [... 3] radians, with an angle in [0, pi]."""
    from kornia.geometry.conversions import rotation_matrix_to_axis_angle

    check_shapes("matrix_to_axis_angle", matrix=(matrix, "... 3 3"))
    return rotation_matrix_to_axis_angle(matrix.reshape(-1, 3, 3)).reshape(*matrix.shape[:-2], 3)


def matrix_to_6d(matrix: Tensor) -> Tensor:
    """[... 3 3] -> [... 6]: row 0, then row 1 (protocol A.1)."""
    check_shapes("matrix_to_6d", matrix=(matrix, "... 3 3"))
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def matrix_from_6d(six: Tensor) -> Tensor:
    """[... 6] -> [... 3 3] by Gram-Schmidt on the two rows; the third row is their cross product.

    The length of either row does not matter. Two parallel rows have no rotation; they give a matrix that is finite
    but not orthonormal.
    """
    check_shapes("matrix_from_6d", six=(six, "... 6"))
    first = torch.nn.functional.normalize(six[..., :3], dim=-1)
    second = six[..., 3:] - (first * six[..., 3:]).sum(-1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-2)


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """[... 3 3] -> [... 4] unit quaternions (w, x, y, z); of the two that there are, either."""
    from kornia.geometry.conversions import rotation_matrix_to_quaternion

    check_shapes("matrix_to_quaternion", matrix=(matrix, "... 3 3"))
    quaternion = rotation_matrix_to_quaternion(matrix.reshape(-1, 3, 3)).reshape(*matrix.shape[:-2], 4)
    return torch.nn.functional.normalize(quaternion, dim=-1)


def quaternion_to_matrix(quaternion: Tensor) -> Tensor:
    """[... 4] (w, x, y, z) of any length but zero -> [... 3 3]."""
    from kornia.geometry.conversions import quaternion_to_rotation_matrix

    check_shapes("quaternion_to_matrix", quaternion=(quaternion, "... 4"))
    return quaternion_to_rotation_matrix(quaternion.reshape(-1, 4)).reshape(*quaternion.shape[:-1], 3, 3)


def continuous(quaternions: Tensor) -> Tensor:
    """[T ... 4] the same rotations, each quaternion on the side of the one before: no sign flips along the time."""
    flips = (quaternions[1:] * quaternions[:-1]).sum(dim=-1, keepdim=True) < 0
    signs = torch.cat([flips.new_zeros(1, *flips.shape[1:]), flips]).cumsum(dim=0) % 2
    return quaternions * (1 - 2 * signs)


def rotation_angle(matrix: Tensor) -> Tensor:
    """[... 3 3] -> [...] angle in radians in [0, pi]."""
    return matrix_to_axis_angle(matrix).norm(dim=-1)


def rotation_about(axis: str, angle: Tensor) -> Tensor:
    """Rotation about the world axis ``"x"``, ``"y"`` or ``"z"`` by ``angle`` [...] radians -> [... 3 3]."""
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    rows = {
        "x": (one, zero, zero, zero, cos, -sin, zero, sin, cos),
        "y": (cos, zero, sin, zero, one, zero, -sin, zero, cos),
        "z": (cos, -sin, zero, sin, cos, zero, zero, zero, one),
    }[axis]
    return torch.stack(rows, dim=-1).reshape(*angle.shape, 3, 3)


def euler_to_matrix(angles: Tensor, axes: str) -> Tensor:
    """[... n] radians about the n named axes -> [... 3 3], multiplied in the order they are listed.

    ``"zxy"`` gives Rz @ Rx @ Ry, the reading of BVH (protocol A.8).
    """
    check_shapes("euler_to_matrix", angles=(angles, f"... {len(axes)}"))
    matrix = torch.eye(3, dtype=angles.dtype, device=angles.device).expand(*angles.shape[:-1], 3, 3)
    for index, axis in enumerate(axes):
        turn = rotation_about(axis, angles[..., index])
        matrix = turn if index == 0 else matrix @ turn
    return matrix


def matrix_to_euler(matrix: Tensor, axes: str) -> Tensor:
    """[... 3 3] -> [... 3] radians with ``euler_to_matrix(angles, axes)`` equal to ``matrix``; three different axes.

    The last angle is read from what the first two leave over, so the product is right in gimbal lock too.
    """
    check_shapes("matrix_to_euler", matrix=(matrix, "... 3 3"))
    i, j, k = ("xyz".index(axis) for axis in axes)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    first = torch.atan2(-sign * matrix[..., j, k], matrix[..., k, k])
    second = torch.atan2(sign * matrix[..., i, k], torch.hypot(matrix[..., i, i], matrix[..., i, j]))
    left = euler_to_matrix(torch.stack([first, second], dim=-1), axes[:2]).mT @ matrix
    third = torch.atan2(sign * left[..., j, i], left[..., j, j])
    return torch.stack([first, second, third], dim=-1)


def product(a: Tensor, b: Tensor) -> Tensor:
    """a @ b of many small matrices, a [... 3 3] and b [... 3 K].

    On a graphics card element by element: kernels for products are made for matrices many times as large, and take
    several times as long.
    """
    if a.device.type == "cpu":
        return a @ b
    return (a[..., None] * b[..., None, :, :]).sum(-2)


def heading(matrix: Tensor) -> Tensor:
    """Yaw about world y, in radians, of a body orientation [... 3 3] -> [...].

    The twist part of the swing-twist decomposition about y: 0 for a body that faces +z, exact for any lean short of
    upside down. ``rotation_about("y", heading(R)).mT @ R`` has heading 0.
    """
    return torch.atan2(matrix[..., 0, 2] - matrix[..., 2, 0], matrix[..., 0, 0] + matrix[..., 2, 2])


def slerp(start: Tensor, end: Tensor, weight: Tensor) -> Tensor:
    """Along the shortest arc from ``start`` [... 3 3] (weight 0) to ``end`` [... 3 3] (weight 1); weight [...]."""
    step = matrix_to_axis_angle(start.mT @ end)
    return start @ axis_angle_to_matrix(weight[..., None] * step)


def slerp_quaternions(start: Tensor, end: Tensor, weight: Tensor) -> Tensor:
    """As :func:`slerp` on unit quaternions [... 4], for many keys: of two that are opposite, one arc or the other."""
    cosine = (start * end).sum(dim=-1, keepdim=True)
    end, cosine = torch.where(cosine < 0, -end, end), cosine.abs()
    angle = torch.atan2((end - cosine * start).norm(dim=-1, keepdim=True), cosine)
    weight, near = weight[..., None], angle < 1e-6
    sine = torch.where(near, 1.0, angle.sin())
    before = torch.where(near, 1 - weight, ((1 - weight) * angle).sin() / sine)
    after = torch.where(near, weight, (weight * angle).sin() / sine)
    return torch.nn.functional.normalize(before * start + after * end, dim=-1)
