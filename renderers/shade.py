"""Soft shaded pictures of bodies, for people to look at: a small software z-buffer, no graphics card, no OpenGL.

Nothing here is differentiable; the pictures that gradients flow through are made by ``renderers.silhouette``.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d, normalize

from renderers.camera import Camera
from renderers.checks import check_shapes
from renderers.palette import BACKGROUND, PARTS, rgb

FAR = 1e4  # metres
FINER = 2  # pixels of the body's picture to one of the result, along each side


@dataclass(frozen=True)
class Light:
    """A key light, a sky and a rim; directions point towards the light, in camera axes (x right, y down, z forward)."""

    key: tuple[float, float, float] = (-0.45, -0.65, -0.6)
    ambient: float = 0.58
    diffuse: float = 0.55
    rim: float = 0.22
    shadow: float = 0.32
    shadow_softness: float = 0.05  # metres
    grid: float = 0.5  # metres between the lines of the floor


def part_colours(faces: Tensor, parts: Tensor, vertices: int) -> Tensor:
    """Colours [V 3] of the vertices from the faces' parts [F]; a vertex between two parts gets the mean of both."""
    palette = torch.tensor([rgb(colour) for colour in PARTS])
    corners = palette[parts.cpu() % len(palette)].repeat_interleave(3, dim=0)
    owner = faces.cpu().reshape(-1)
    total = torch.zeros(vertices, 3).index_add_(0, owner, corners)
    return total / torch.bincount(owner, minlength=vertices).clamp(min=1)[:, None]


def shade(
    vertices: Tensor, faces: Tensor, colours: Tensor, camera: Camera, light: Light | None = None, floor: bool = True
) -> Tensor:
    """Shaded pictures of closed meshes.

    Args:
        vertices: [N V 3] metres, y up; the floor is y = 0.
        faces: [F 3] long, counter-clockwise from outside.
        colours: [V 3] in 0..1.
        camera: N views, or one for all.
        floor: draw a faint grid and a soft shadow (left out where the camera looks along the floor).

    Returns:
        [N 3 H W] float in 0..1.
    """
    check_shapes("shade", vertices=(vertices, "N V 3"), faces=(faces, "F 3"), colours=(colours, "V 3"))
    light = light or Light()
    vertices, faces, colours = vertices.detach().cpu().float(), faces.cpu(), colours.cpu().float()
    camera = camera.to("cpu", torch.float32)
    normals = vertex_normals(vertices, faces)
    depth = (vertices @ camera.rotation.mT + camera.translation[:, None])[..., 2]
    points = camera.project(vertices) * FINER
    fine = (camera.size[0] * FINER, camera.size[1] * FINER)

    pictures = []
    for index, body in enumerate(vertices):
        view = index if len(camera) > 1 else 0
        background = _floor(body, faces, camera, view, light) if floor else _plain(camera.size)
        seen, weights = _nearest_faces(points[index].numpy(), depth[index].numpy(), faces.numpy(), fine)
        hit = torch.from_numpy(seen >= 0)
        corners, mix = faces[torch.from_numpy(seen)[hit]], torch.from_numpy(weights)[hit][..., None]
        normal = normalize((normals[index][corners] * mix).sum(1) @ camera.rotation[view].T, dim=-1)
        painted = torch.zeros(*fine, 4)
        painted[hit] = torch.cat([_lit((colours[corners] * mix).sum(1), normal, light), torch.ones(len(normal), 1)], 1)
        coarse = avg_pool2d(painted.permute(2, 0, 1), FINER)
        pictures.append(coarse[:3] + (1 - coarse[3]) * background.permute(2, 0, 1))
    return torch.stack(pictures)


def _lit(albedo: Tensor, normal: Tensor, light: Light) -> Tensor:
    """Wrapped Lambert key light, a sky that is brighter from above, and a rim where the surface turns away."""
    key = normalize(torch.tensor(light.key), dim=0)
    wrapped = ((normal @ key + 0.3) / 1.3).clamp(min=0)
    sky = 0.5 - 0.5 * normal[:, 1]
    rim = light.rim * (1 + normal[:, 2]).clamp(0, 1) ** 3 * sky
    strength = light.ambient * (0.6 + 0.4 * sky) + light.diffuse * wrapped
    return (albedo * strength[:, None] + rim[:, None]).clamp(0, 1)


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals [N V 3], faces weighted by their area."""
    corner = vertices[:, faces]
    face_normals = torch.linalg.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    total = torch.zeros_like(vertices)
    for k in range(3):
        total.index_add_(1, faces[:, k], face_normals)
    return normalize(total, dim=-1)


def _nearest_faces(points: np.ndarray, depth: np.ndarray, faces: np.ndarray, size: tuple[int, int]):
    """For each pixel the nearest face that covers its centre, -1 for none [H W], and barycentric weights [H W 3]."""
    height, width = size
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    low = np.ceil(np.minimum(np.minimum(a, b), c) - 0.5).clip(0, [width, height]).astype(np.int64)
    high = np.floor(np.maximum(np.maximum(a, b), c) - 0.5).clip(-1, [width - 1, height - 1]).astype(np.int64)
    box = (high - low + 1).clip(min=0)
    box[np.abs(area) < 1e-9] = 0
    counts = box.prod(1)

    # Every pixel of every face's box in one flat list: (owner, x, y).
    owner = np.repeat(np.arange(len(faces)), counts)
    step = np.arange(len(owner)) - np.repeat(counts.cumsum() - counts, counts)
    x = low[owner, 0] + step % box[owner, 0].clip(min=1)
    y = low[owner, 1] + step // box[owner, 0].clip(min=1)
    px, py = x + 0.5, y + 0.5

    def edge(p, q):
        return (q[owner, 0] - p[owner, 0]) * (py - p[owner, 1]) - (q[owner, 1] - p[owner, 1]) * (px - p[owner, 0])

    weights = np.stack([edge(b, c), edge(c, a), edge(a, b)], axis=1) / area[owner, None]
    inside = (weights >= 0).all(1)
    owner, weights, pixel = owner[inside], weights[inside].astype(np.float32), (y * width + x)[inside]
    far_first = np.argsort(-(depth[faces[owner]] * weights).sum(1), kind="stable")

    seen = np.full(height * width, -1, np.int64)
    mix = np.zeros((height * width, 3), np.float32)
    seen[pixel[far_first]] = owner[far_first]  # the last one written, the nearest, stays
    mix[pixel[far_first]] = weights[far_first]
    return seen.reshape(size), mix.reshape(*size, 3)


def _plain(size: tuple[int, int]) -> Tensor:
    return torch.tensor(rgb(BACKGROUND)).expand(*size, 3).clone()


def _floor(body: Tensor, faces: Tensor, camera: Camera, view: int, light: Light) -> Tensor:
    """Background [H W 3] with the floor's grid and the body's shadow, both fading out around the body."""
    canvas = _plain(camera.size)
    low, high = body[:, [0, 2]].amin(0), body[:, [0, 2]].amax(0)
    ground = _floor_points(camera, view, (low + high) / 2)
    if ground is None:
        return canvas
    outside = (torch.maximum(low - ground, ground - high)).clamp(min=0).norm(dim=-1)
    fade = torch.exp(-((outside / 0.55) ** 2))
    cell = (ground / light.grid + 0.5).remainder(1) - 0.5
    pixel = (ground[1:, :-1] - ground[:-1, :-1]).abs().amax(-1).amin().clamp(min=1e-4)
    line = (1 - (cell.abs().amin(-1) * light.grid / (0.008 + pixel)).clamp(max=1)) * 0.07
    shadow = light.shadow * _shadow(body, faces, ground, low, high, light)
    return canvas * (1 - (line * fade) - shadow * fade)[..., None].clamp(0, 1)


def _floor_points(camera: Camera, view: int, centre: Tensor) -> Tensor | None:
    """Floor coordinates (x, z) [H W 2] seen at each pixel centre, far away on and above the horizon; None when edge-on.

    The floor maps to the picture by a homography for either kind of camera, so four of its points are enough.
    """
    import cv2

    square = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) + centre
    on_floor = torch.stack([square[:, 0], torch.zeros(4), square[:, 1]], dim=-1)
    pixels = camera.project(on_floor.expand(len(camera), 4, 3))[view]
    across, along = pixels[1] - pixels[0], pixels[3] - pixels[0]
    height, width = camera.size
    if (across[0] * along[1] - across[1] * along[0]).abs() < 1e-4 * height * width:
        return None
    to_floor = torch.from_numpy(cv2.getPerspectiveTransform(pixels.numpy(), square.numpy())).float()
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    points = torch.stack([columns, rows, torch.ones_like(rows)], dim=-1) @ to_floor.T
    return (points[..., :2] / points[..., 2:]).nan_to_num(FAR, FAR, -FAR)


def _shadow(body: Tensor, faces: Tensor, ground: Tensor, low: Tensor, high: Tensor, light: Light) -> Tensor:
    """Shade [H W] in 0..1 of the floor: the body's area above each spot, weaker the higher it is, blurred."""
    texel, border = 0.02, 0.3
    corner = body[faces]
    area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).norm(dim=-1) / 2
    middle = corner.mean(1)
    place = middle[:, [0, 2]] + 0.12 * middle[:, 1:2].clamp(min=0)  # the key light comes from above, a little aslant
    size = ((high - low + 2 * border) / texel).ceil().long() + 1
    at = ((place - low + border) / texel).long().clamp(min=0).minimum(size - 1)
    weight = area * torch.exp(-middle[:, 1].clamp(min=0) / 0.45)
    density = torch.zeros(int(size.prod())).index_add_(0, at[:, 1] * size[0] + at[:, 0], weight)
    density = density.reshape(1, 1, int(size[1]), int(size[0])) / texel**2
    reach = int(3 * light.shadow_softness / texel)
    kernel = torch.exp(-((torch.arange(-reach, reach + 1) * texel / light.shadow_softness) ** 2) / 2)
    kernel = kernel / kernel.sum()
    density = conv2d(density, kernel.reshape(1, 1, -1, 1), padding=(reach, 0))
    density = conv2d(density, kernel.reshape(1, 1, 1, -1), padding=(0, reach))
    grid = ((ground - low + border) / (texel * size)) * 2 - 1
    sampled = torch.nn.functional.grid_sample(density, grid[None], align_corners=False)
    return 1 - torch.exp(-1.5 * sampled[0, 0])
