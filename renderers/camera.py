"""Cameras, and the conventions of the whole project.

World: right-handed, y up, metres; a canonical body faces +z with its left side at +x.
Camera: x right, y down, z forward (as OpenCV and kornia); ``x_camera = rotation @ x_world + translation``.
Pixels: (x, y) from the top-left corner of the image; pixel (column 0, row 0) has its centre at (.5, .5).
Images: [N C H W] floats in 0..1. Sizes: (height, width). Angles: radians.

Projection is kornia's: pinhole (``u = f x / z + c``), or weak perspective, which is the orthographic projection
(``u = f x + c``) with a focal length in pixels per metre.
"""

from dataclasses import dataclass, fields, replace
from math import cos, radians, sin, tan
from typing import Literal

import torch
from torch import Tensor

from renderers.checks import UserError, check_shapes

NEAR = 0.01  # metres before a pinhole camera; what is nearer is not seen
FIELD_OF_VIEW = radians(30)  # of a framed pinhole camera, over the longer side of what it frames

Kind = Literal["pinhole", "weak"]


@dataclass(frozen=True)
class Camera:
    """N cameras of one kind and one image size; a single one serves any number of frames."""

    rotation: Tensor  # [N 3 3] world to camera
    translation: Tensor  # [N 3] metres
    focal: Tensor  # [N 2] pixels (pinhole), pixels per metre (weak)
    centre: Tensor  # [N 2] pixels, (x, y) where the optical axis meets the image
    size: tuple[int, int]  # (height, width)
    kind: Kind = "weak"

    def __post_init__(self):
        check_shapes(
            "Camera",
            rotation=(self.rotation, "N 3 3"),
            translation=(self.translation, "N 3"),
            focal=(self.focal, "N 2"),
            centre=(self.centre, "N 2"),
        )
        if self.kind not in ("pinhole", "weak"):
            raise UserError("Camera(kind)", f"expected pinhole or weak, got {self.kind!r}")
        if min(self.size) < 1:
            raise UserError("Camera(size)", f"expected a positive (height, width), got {self.size}")

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, index: Tensor | slice) -> "Camera":
        """The cameras at ``index``; `repeat_interleave` of a range gives every frame of a clip the clip's camera."""
        return replace(self, **{name: getattr(self, name)[index] for name in _TENSORS})

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "Camera":
        return replace(self, **{name: getattr(self, name).to(device=device, dtype=dtype) for name in _TENSORS})

    def project(self, points: Tensor) -> Tensor:
        """World points [N P 3] in metres -> pixels [N P 2] (x, y).

        Raises:
            UserError: for a point that is not in front of a pinhole camera.
        """
        seen = self.view(points)
        if self.kind == "pinhole":
            _check_in_front(seen)
        return self.pixels(seen)

    def view(self, points: Tensor) -> Tensor:
        """World points [N P 3] -> camera axes [N P 3]: x right, y down, z forward, metres."""
        check_shapes("Camera.view", points=(points, "N P 3"))
        if len(self) not in (1, len(points)):
            raise UserError("Camera.view", f"{len(self)} cameras do not fit {len(points)} sets of points")
        return points @ self.rotation.mT + self.translation[:, None]

    def pixels(self, seen: Tensor) -> Tensor:
        """Points in camera axes [N P 3], in front of a pinhole camera -> pixels [N P 2]."""
        from kornia.geometry.camera import project_points_orthographic, project_points_z1

        plane = project_points_orthographic(seen) if self.kind == "weak" else project_points_z1(seen)
        return plane * self.focal[:, None] + self.centre[:, None]


_TENSORS = tuple(field.name for field in fields(Camera) if field.type is Tensor)


def cat(cameras: list[Camera]) -> Camera:
    """Cameras of one kind and size as one batch."""
    first = cameras[0]
    for camera in cameras:
        if (camera.size, camera.kind) != (first.size, first.kind):
            raise UserError("camera.cat", f"{camera.kind} {camera.size} does not go with {first.kind} {first.size}")
    return replace(first, **{name: torch.cat([getattr(camera, name) for camera in cameras]) for name in _TENSORS})


def frame(
    points: Tensor,
    size: tuple[int, int],
    yaw: float = 0.0,
    elevation: float = 0.0,
    margin: float = 0.1,
    kind: Kind = "weak",
) -> Camera:
    """One camera that sees all points [... 3], as large as they fit and in the middle of the image.

    Frame the union of all motions that are to be compared: each framed alone, the pictures would differ by placement.

    Args:
        points: world, metres: vertices, or joints with a wider margin.
        size: (height, width).
        yaw: radians about world y. At 0 the camera stands on +z and sees the front of a canonical body; growing yaw
            moves it towards +x, the body's left side.
        elevation: radians, growing upwards from the horizontal.
        margin: the part of each side that stays free between the points and either border.

    Raises:
        UserError: for no points, or a margin outside 0..0.5.
    """
    check_shapes("frame", points=(points, "... 3"))
    return frame_each(points.reshape(1, -1, 3), size, yaw, elevation, margin, kind)


@torch.no_grad()
def frame_each(
    points: Tensor,
    size: tuple[int, int],
    yaw: float = 0.0,
    elevation: float = 0.0,
    margin: float = 0.1,
    kind: Kind = "weak",
) -> Camera:
    """N cameras, each of which frames its own of the N sets of points [N P 3]; see `frame`."""
    check_shapes("frame", points=(points, "N P 3"))
    if points.numel() == 0:
        raise UserError("frame", "there are no points to frame")
    if not 0 <= margin < 0.5:
        raise UserError("frame(margin)", f"expected 0 <= margin < 0.5, got {margin}")
    rotation = points.new_tensor(
        [  # right, down, forward
            [cos(yaw), 0.0, -sin(yaw)],
            [sin(yaw) * sin(elevation), -cos(elevation), cos(yaw) * sin(elevation)],
            [-sin(yaw) * cos(elevation), -sin(elevation), -cos(yaw) * cos(elevation)],
        ]
    )
    turned = points @ rotation.T
    low, high = turned.amin(1), turned.amax(1)
    translation = -(low + high) / 2
    # Far enough that the nearest points span the field of view.
    translation[:, 2] = (high - low)[:, :2].amax(1) / (2 * tan(FIELD_OF_VIEW / 2)) - low[:, 2] + NEAR

    one = points.new_ones(len(points), 2)
    camera = Camera(rotation.expand(len(points), -1, -1), translation, one, 0 * one, size, kind)
    plane = camera.project(points)
    low, high = plane.amin(1), plane.amax(1)
    sides = points.new_tensor([size[1], size[0]])
    focal = ((1 - 2 * margin) * sides / (high - low).clamp(min=1e-6)).amin(1, keepdim=True)
    return replace(camera, focal=focal * one, centre=sides / 2 - focal * (low + high) / 2)


def _check_in_front(points: Tensor):
    depth = points[..., 2]
    if (depth < NEAR).any():
        frame, point = (depth < NEAR).nonzero()[0].tolist()
        raise UserError(
            "Camera.project",
            f"point {point} of frame {frame} has depth {depth[frame, point].item():.3g} m, which is not in front",
            "move the camera back, or let frame() place it",
        )
