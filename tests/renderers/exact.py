"""Exact area coverage by plane geometry: the union of all projected triangles, cut with each pixel's square.

Nothing is sampled and nothing is shared with the rasterisers; shapely (GEOS) does the geometry, in float64.
"""

from collections.abc import Callable

import numpy as np
import shapely
import torch
from torch import Tensor

from renderers.mesh import Mesh


def coverage(points: Tensor, mesh: Mesh, size: tuple[int, int]) -> Tensor:
    """Covered area of each pixel, 0..1, of points [N V 2] in pixels: [N C H W] float64; a channel has its own faces."""
    shapes = unions(points, mesh).ravel().tolist()
    return torch.stack([areas(shape, size) for shape in shapes]).view(len(points), mesh.channels, *size)


def unions(points: Tensor, mesh: Mesh) -> np.ndarray:
    """What the faces of each frame and channel cover together, as polygons [N C]."""
    channels = [mesh.faces[mesh.face_channels == channel] for channel in range(mesh.channels)]
    shapes = [[_union(frame[faces]) for faces in channels] for frame in points.detach().double()]
    return np.array(shapes, dtype=object)


def areas(shape: shapely.Geometry, size: tuple[int, int], zoom: float = 1.0) -> Tensor:
    """Area [H W] of a polygon in each pixel; with ``zoom`` that of the polygon drawn so many times larger."""
    rows, columns = np.indices(size) / zoom
    pixels = shapely.box(columns, rows, columns + 1 / zoom, rows + 1 / zoom)
    shapely.prepare(shape)
    area = shapely.contains(shape, pixels).astype(float)
    cut = shapely.intersects(shape, pixels) & (area == 0)
    area[cut] = shapely.area(shapely.intersection(shape, pixels[cut])) * zoom**2
    return torch.from_numpy(area)


def slope(loss: Callable[[Tensor], Tensor], points: Tensor, motion: Tensor, step: float) -> Tensor:
    """The derivative [N] of ``loss`` as all points [N V D] begin to move by ``motion``, by central differences."""
    return (loss(points + step * motion) - loss(points - step * motion)) / (2 * step)


def _union(triangles: Tensor) -> shapely.Geometry:
    a, b, c = triangles.unbind(1)
    b, c = b - a, c - a
    flat = b[:, 0] * c[:, 1] == b[:, 1] * c[:, 0]
    return shapely.union_all(shapely.polygons(triangles[~flat].numpy()))
