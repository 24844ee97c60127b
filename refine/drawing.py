"""Motions as pictures and films, for people."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from refine.motion import Motion, canonicalise
from renderers.body import Body
from renderers.camera import Camera, frame
from renderers.images import part_picture
from renderers.mesh import Mesh
from renderers.shade import part_colours, shade
from renderers.silhouette import silhouette

Style = Literal["shaded", "parts", "silhouette"]
YAW, ELEVATION = 28.0, 14.0  # degrees; a little from the left and from above, so that depth is seen


@dataclass(frozen=True)
class Painter:
    """Draws vertices [N V 3], of one body or of several side by side, as pictures [N 3 H W] in 0..1."""

    style: Style
    mesh: Mesh
    colours: Tensor  # [V 3]

    @classmethod
    def of(cls, body: Body, style: Style = "shaded", copies: int = 1) -> "Painter":
        count = len(body.rest_vertices)
        faces = (body.faces.cpu() + count * torch.arange(copies)[:, None, None]).reshape(-1, 3)
        parts = body.face_parts.cpu().repeat(copies)
        mesh = Mesh.build(faces, parts if style == "parts" else None)
        return cls(style, mesh, part_colours(faces, parts, count * copies))

    def __call__(self, vertices: Tensor, camera: Camera) -> Tensor:
        if self.style == "shaded":
            return shade(vertices, self.mesh.faces, self.colours, camera)
        with torch.no_grad():
            return torch.stack([part_picture(image) for image in silhouette(vertices, self.mesh, camera)])


def strip(
    motions: Sequence[Motion],
    body: Body,
    poses: int = 8,
    height: int = 300,
    yaw: float = YAW,
    style: Style = "shaded",
) -> list[Tensor]:
    """For each motion one wide picture [3 H W]: poses at even times, side by side, travel left out.

    All motions are drawn at one scale from one camera. Times run from the first to the last frame of each.
    """
    rows = []
    for motion in motions:
        facing = canonicalise(motion)
        frames = torch.linspace(0, len(motion) - 1, min(poses, len(motion))).round().long()
        root = facing.root[frames] * torch.tensor([0.0, 1.0, 0.0])
        rows.append(_posed(body, facing.rotations[frames], root))
    # Bodies are set along the camera's own x axis, so that no body stands nearer than another.
    turn = math.radians(yaw)
    aside = torch.tensor([math.cos(turn), 0.0, -math.sin(turn)])
    step = max(0.62, *(_clearance(row, aside) for row in rows))
    spread = [row + (torch.arange(len(row))[:, None, None] - (len(row) - 1) / 2) * step * aside for row in rows]
    points = torch.cat([row.reshape(-1, 3) for row in spread])
    width = round(height * (_width(points[None], aside) + 0.2) / (float(points[:, 1].amax()) + 0.35))
    camera = frame(points, (height, width), yaw=turn, elevation=math.radians(ELEVATION), margin=0.04)
    return [Painter.of(body, style, len(row))(row.reshape(1, -1, 3), camera)[0] for row in spread]


def film(
    motions: Sequence[Motion],
    body: Body,
    size: tuple[int, int] = (360, 300),
    fps: float = 15.0,
    yaw: float = YAW,
    style: Style = "shaded",
    progress: Callable[[], None] = lambda: None,
) -> list[list[Tensor]]:
    """Frames of several motions at one scale: for each moment one picture [3 H W] a motion.

    The camera turns to face the first frame and follows the pelvis, so the floor moves under a body that travels.
    A motion that ends early rests in its last frame. ``progress`` is called after each moment.
    """
    turned = [canonicalise(motion) for motion in motions]
    moments = max(1, round(max(motion.seconds for motion in turned) * fps))
    shown = [[min(round(k * motion.fps / fps), len(motion) - 1) for k in range(moments)] for motion in turned]
    posed = [_posed(body, m.rotations[at], m.root[at]) for m, at in zip(turned, shown, strict=True)]
    paths = [smoothed(m.root, m.fps)[at] * torch.tensor([1.0, 0.0, 1.0]) for m, at in zip(turned, shown, strict=True)]
    points = torch.cat([(v - path[:, None]).reshape(-1, 3) for v, path in zip(posed, paths, strict=True)])
    still = frame(points, size, yaw=math.radians(yaw), elevation=math.radians(ELEVATION), margin=0.06)
    paint, pictures = Painter.of(body, style), []
    for k in range(moments):
        cameras = [following(still, path[k]) for path in paths]
        pictures.append([paint(v[k : k + 1], camera)[0] for v, camera in zip(posed, cameras, strict=True)])
        progress()
    return pictures


def following(camera: Camera, offset: Tensor) -> Camera:
    """The same camera carried along by ``offset`` [3] metres."""
    return replace(camera, translation=camera.translation - (camera.rotation @ offset[:, None])[..., 0])


def smoothed(path: Tensor, fps: float, seconds: float = 0.6) -> Tensor:
    """A moving mean over [T 3], so that a camera that follows does not shake."""
    half = round(seconds * fps / 2)
    padded = torch.cat([path[:1].expand(half, 3), path, path[-1:].expand(half, 3)])
    return padded.unfold(0, 2 * half + 1, 1).mean(-1)


def _posed(body: Body, rotations: Tensor, root: Tensor) -> Tensor:
    with torch.no_grad():
        return body(rotations.float(), root.float()).vertices.cpu()


def _clearance(poses: Tensor, aside: Tensor) -> float:
    """How far apart neighbours in [K V 3] have to stand along a direction, metres, so that they do not touch."""
    across = poses @ aside
    gaps = across[:-1].amax(1) - across[1:].amin(1)
    return float(gaps.max()) + 0.05 if len(gaps) else 0.0


def _width(vertices: Tensor, aside: Tensor) -> float:
    """The greatest extent of any pose in [K V 3] along a direction, metres."""
    across = vertices @ aside
    return float((across.amax(1) - across.amin(1)).amax())
