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
from renderers.checks import UserError
from renderers.images import part_picture
from renderers.mesh import Mesh
from renderers.palette import BACKGROUND, rgb
from renderers.shade import part_colours, shade
from renderers.silhouette import silhouette

Style = Literal["shaded", "parts", "silhouette"]
Draw = Callable[[Tensor, Tensor, Tensor, Camera], Tensor]  # as shade: vertices, faces, colours, camera -> pictures
YAW, ELEVATION = 28.0, 14.0  # degrees; a little from the left and from above, so that depth is seen
ACROSS = 60.0  # degrees at least between a path and the camera that sees a body come along it, from left to right
NEARER = 2.5  # metres at most that it comes nearer on its way
STRIDE = 0.25  # metres between neighbours of a strobe picture; those of a motion that travels less stand side by side
BORDER = 0.08  # of the height, on each side of a picture with wide shadows
WIDEST = 16384  # pixels of a strobe
FAINTEST = 0.22  # how much of its colour the first body of a strobe picture keeps


@dataclass(frozen=True)
class Painter:
    """Draws vertices [N V 3], of one body or of several side by side, as pictures [N 3 H W] in 0..1."""

    style: Style
    mesh: Mesh
    colours: Tensor  # [V 3]
    draw: Draw = shade  # what draws the style "shaded"

    @classmethod
    def of(cls, body: Body, style: Style = "shaded", copies: int = 1, draw: Draw = shade) -> "Painter":
        count = len(body.rest_vertices)
        faces = (body.faces.cpu() + count * torch.arange(copies)[:, None, None]).reshape(-1, 3)
        parts = body.face_parts.cpu().repeat(copies)
        mesh = Mesh.build(faces, parts if style == "parts" else None)
        return cls(style, mesh, part_colours(faces, parts, count * copies), draw)

    def __call__(self, vertices: Tensor, camera: Camera) -> Tensor:
        if self.style == "shaded":
            return self.draw(vertices, self.mesh.faces, self.colours, camera)
        with torch.no_grad():
            return torch.stack([part_picture(image) for image in silhouette(vertices, self.mesh, camera)])


def strip(
    motions: Sequence[Motion],
    body: Body,
    poses: int = 8,
    height: int = 300,
    yaw: float = YAW,
    style: Style = "shaded",
    draw: Draw = shade,
    border: float = 0.0,
) -> list[Tensor]:
    """For each motion one wide picture [3 H W]: poses at even times, side by side, travel left out.

    All motions are drawn at one scale from one camera. Times run from the first to the last frame of each.
    ``border`` is the part of the height that is added on each side, for shadows that reach far.
    """
    rows = [_posed(body, *_in_place(*_moments(motion, poses))) for motion in motions]
    spread = _side_by_side(rows, yaw)
    camera = _wide(spread, height, yaw, border)
    return [Painter.of(body, style, len(row), draw)(row.reshape(1, -1, 3), camera)[0] for row in spread]


def strobe(
    motion: Motion, body: Body, poses: int = 8, height: int = 300, yaw: float | None = None, draw: Draw = shade
) -> Tensor:
    """One picture [3 H W] of the body at even times along its real path, the earlier the paler.

    A motion that stays in place is drawn as in a `strip`. Without a yaw, the path is seen from aside, from left to
    right.

    Raises:
        UserError: a path so long that the picture would be wider than `WIDEST`.
    """
    rotations, root = _moments(motion, poses)
    path = root[:, [0, 2]]
    travels = len(path) > 1 and (path[1:] - path[:-1]).norm(dim=1).mean() > STRIDE
    if travels:
        yaw = _beside(path[-1] - path[0]) if yaw is None else yaw
        bodies = _posed(body, rotations, root)
        camera = _along(bodies, height, yaw, BORDER)
    else:
        yaw = YAW if yaw is None else yaw
        [bodies] = _side_by_side([_posed(body, *_in_place(rotations, root))], yaw)
        camera = _wide([bodies], height, yaw, BORDER)
    painter = Painter.of(body, "shaded", len(bodies), draw)
    share = torch.linspace(FAINTEST, 1, len(bodies)) if len(bodies) > 1 else torch.ones(1)
    paper = torch.tensor(rgb(BACKGROUND))
    colours = torch.lerp(paper, painter.colours, share.repeat_interleave(bodies.shape[1])[:, None])
    return replace(painter, colours=colours)(bodies.reshape(1, -1, 3), camera)[0]


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


def _moments(motion: Motion, count: int) -> tuple[Tensor, Tensor]:
    """Rotations [K 24 3 3] and root [K 3] at even times from the first to the last frame, which faces +z at first."""
    facing = canonicalise(motion)
    frames = torch.linspace(0, len(motion) - 1, min(count, len(motion))).round().long()
    return facing.rotations[frames], facing.root[frames]


def _in_place(rotations: Tensor, root: Tensor) -> tuple[Tensor, Tensor]:
    return rotations, root * torch.tensor([0.0, 1.0, 0.0])


def _side_by_side(rows: Sequence[Tensor], yaw: float) -> list[Tensor]:
    """Rows of bodies [K V 3] set apart along the camera's own x axis, so that no body stands nearer than another."""
    aside = _aside(yaw)
    step = max(0.62, *(_clearance(row, aside) for row in rows))
    return [row + (torch.arange(len(row))[:, None, None] - (len(row) - 1) / 2) * step * aside for row in rows]


def _beside(way: Tensor) -> float:
    """The yaw in degrees of a camera that sees a way [2] (x, z) run to its right, and come somewhat nearer."""
    length, (x, z) = float(way.norm()), way.tolist()
    across = math.acos(min(math.cos(math.radians(ACROSS)), NEARER / max(length, 1e-6)))
    return math.degrees(math.atan2(x, z) - across)


def _aside(yaw: float) -> Tensor:
    """The x axis of a camera at a yaw in degrees."""
    return torch.tensor([math.cos(math.radians(yaw)), 0.0, -math.sin(math.radians(yaw))])


def _wide(rows: Sequence[Tensor], height: int, yaw: float, border: float) -> Camera:
    """One camera for rows of bodies [K V 3] that stand side by side."""
    points = torch.cat([row.reshape(-1, 3) for row in rows])
    edge = round(border * height)
    height -= 2 * edge
    width = round(height * (_width(points[None], _aside(yaw)) + 0.2) / (float(points[:, 1].amax()) + 0.35))
    return _bordered(frame(points, (height, width), math.radians(yaw), math.radians(ELEVATION), margin=0.04), edge)


def _along(bodies: Tensor, height: int, yaw: float, border: float) -> Camera:
    """A camera with perspective for bodies [K V 3] anywhere, its picture as wide as they need."""
    points, angles = bodies.reshape(-1, 3), (math.radians(yaw), math.radians(ELEVATION))
    edge = round(border * height)
    height -= 2 * edge
    seen = frame(points, (height, height), *angles, kind="pinhole").project(points[None])[0]
    across, down = (seen.amax(0) - seen.amin(0)).tolist()
    width = round(height * across / down)
    if width > WIDEST:
        problem = f"its path would make a picture of {width} x {height} pixels, {WIDEST} is the widest"
        raise UserError("strobe", problem, "crop the motion, ask for a smaller size, or look along the path")
    return _bordered(frame(points, (height, width), *angles, margin=0.0, kind="pinhole"), edge)


def _bordered(camera: Camera, edge: int) -> Camera:
    """The same view with ``edge`` more pixels on each side."""
    height, width = camera.size
    return replace(camera, size=(height + 2 * edge, width + 2 * edge), centre=camera.centre + edge)


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
