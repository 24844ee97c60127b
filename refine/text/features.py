"""What a model of texts and motions sees: 135 numbers a frame, of clips turned to one direction (TEMOS and SINC)."""

import math
from typing import Literal

import torch
from torch import Tensor

from refine.motion import Motion, canonicalise
from renderers.checks import check_shapes
from renderers.rotations import matrix_from_6d, matrix_to_6d, matrix_to_axis_angle, rotation_about

JOINTS = 22  # SMPL-H's body: SMPL's joints without the hands
WIDTH = 1 + 2 + 6 * JOINTS

Canon = Literal["true_yaw", "temos_legacy"]
"""By what yaw a clip is turned back: its first frame's, or what TEMOS and SINC take for it (``legacy_yaw``)."""


def to_text_features(rotations: Tensor, root: Tensor) -> Tensor:
    """[... T 135]: height of the pelvis, its step along x and z since the frame before, and 22 joints' rotations in 6D.

    Any batch, with gradients. Where a clip stands in the plane is not in them; which way it faces is.

    Args:
        rotations: [... T 24 3 3]; the hands, 22 and 23, are left out.
        root: [... T 3] metres.

    Returns:
        height in metres and absolute, steps in metres (the first frame's are 0), the pelvis' rotation first.
    """
    check_shapes("to_text_features", rotations=(rotations, "... T 24 3 3"), root=(root, "... T 3"))
    planar = root[..., [0, 2]]
    steps = torch.cat([torch.zeros_like(planar[..., :1, :]), planar.diff(dim=-2)], dim=-2)
    six = matrix_to_6d(rotations[..., :JOINTS, :, :]).flatten(-2)
    return torch.cat([root[..., 1:2], steps, six], dim=-1)


def from_text_features(features: Tensor) -> tuple[Tensor, Tensor]:
    """[... T 135] -> rotations [... T 24 3 3] and root [... T 3] in metres, from x = z = 0 on; hands are straight.

    The inverse of ``to_text_features`` for clips that start there. What a network makes up becomes rotations by
    Gram-Schmidt, and its first step is left out.
    """
    check_shapes("from_text_features", features=(features, f"... T {WIDTH}"))
    path = features[..., 1:3].cumsum(-2)
    path = path - path[..., :1, :]
    root = torch.stack([path[..., 0], features[..., 0], path[..., 1]], dim=-1)
    rotations = matrix_from_6d(features[..., 3:].unflatten(-1, (JOINTS, 6)))
    hands = torch.eye(3).to(rotations).expand(*rotations.shape[:-3], 2, 3, 3)
    return torch.cat([rotations, hands], dim=-3), root


def canonical(motion: Motion, canon: Canon = "true_yaw") -> Motion:
    """Turned back by the first frame's yaw and moved to x = z = 0; heights and later turns are kept."""
    return canonicalise(motion, legacy_yaw(motion.rotations[0, 0]) if canon == "temos_legacy" else None)


def legacy_yaw(orientation: Tensor) -> Tensor:
    """What the code of TEMOS and SINC turns a clip back by, in radians: orientations [... 3 3] -> [...].

    It takes the z component of the axis-angle vector for the yaw, in AMASS' world, whose z is up. A body stands
    upright there by a quarter turn about x, so that this is too little: 23.5, 46.7, 69.3 and 110.4 degrees where the
    body is turned by 30, 60, 90 and 150. (The code then adds a quarter turn, since it lets clips face another way.)
    """
    check_shapes("legacy_yaw", orientation=(orientation, "... 3 3"))
    z_up = rotation_about("x", orientation.new_tensor(math.pi / 2))
    return matrix_to_axis_angle(z_up @ orientation)[..., 2]
