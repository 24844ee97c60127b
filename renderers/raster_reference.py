"""The specification: area coverage as plainly as it can be said. To be read and compared with, not to be used.

On each sub-scanline the silhouette is the union of the triangles' spans. Its length inside every pixel is exact along
the scan; across it, ``subscanlines`` scans stand for a pixel. Rows and columns are scanned and averaged. Gradients flow
through the ends of the spans by autograd.
"""

import torch
from torch import Tensor

from renderers.mesh import Mesh


def coverage(points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int = 4) -> Tensor:
    """Covered area of each pixel, 0..1; a channel sees only its own faces.

    Args:
        points: [N V 2] (x, y) in pixels from the top-left corner, any floating dtype.
        size: (height, width).

    Returns:
        [N C H W].
    """
    height, width = size
    images = []
    for frame in points:
        for channel in range(mesh.channels):
            triangles = frame[mesh.faces[mesh.face_channels == channel]]
            rows = scan(triangles, height, width, subscanlines)
            columns = scan(triangles.flip(-1), width, height, subscanlines)
            images.append((rows + columns.T) / 2)
    return torch.stack(images).reshape(len(points), mesh.channels, height, width)


def scan(triangles: Tensor, height: int, width: int, subscanlines: int) -> Tensor:
    """Coverage [H W] of triangles [F 3 2] by horizontal scans."""
    return torch.stack(
        [
            torch.stack(
                [_covered((row + (sub + 0.5) / subscanlines), triangles, width) for sub in range(subscanlines)]
            ).mean(0)
            for row in range(height)
        ]
    )


def _covered(y: float, triangles: Tensor, width: int) -> Tensor:
    """Length [W] that the union of the triangles' spans at height y has in each pixel."""
    spans = _spans(y, triangles)
    spans = spans[spans[:, 0].argsort()]
    # What each span adds to the ones that start left of it: disjoint pieces that sum to the union.
    reached = torch.cat([spans.new_zeros(1), spans[:, 1].cummax(0).values])[:-1]
    start = torch.maximum(spans[:, 0], reached)
    end = torch.maximum(spans[:, 1], start)
    left = torch.arange(width, dtype=triangles.dtype, device=triangles.device)
    return ((end[:, None] - left).clamp(0, 1) - (start[:, None] - left).clamp(0, 1)).sum(0)


def _spans(y: float, triangles: Tensor) -> Tensor:
    """(start, end) [K 2] along the line at height y of the triangles that it crosses.

    A vertex on the line counts as lying before it (smaller y), so that each triangle is crossed twice or never.
    """
    start, end = triangles, triangles.roll(-1, dims=1)
    crossed = (start[..., 1] > y) != (end[..., 1] > y)
    hit = crossed.any(1)
    start, end = start[hit][crossed[hit]], end[hit][crossed[hit]]
    along, across = (end - start).unbind(1)
    place = start[:, 0] + (y - start[:, 1]) / across * along
    # Rows answer for upright edges and columns for level ones, in shares that add up: each alone would be an estimate
    # of the whole gradient, but a wild one where edge and scan are nearly parallel. Twice, as the two are averaged.
    share = (2 * across**2 / (across**2 + along**2)).detach()
    place = place.detach() + share * (place - place.detach())
    return place.view(-1, 2).sort(dim=1).values
