"""The specification: area coverage as plainly as it can be said. To be read and compared with, not to be used.

On each sub-scanline the silhouette is the union of the triangles' spans. An end of a span stands for its edge from half
a sub-scanline before to half a one after, so it is a stretch as wide as the edge's slope makes it. Rows and columns are
scanned and averaged. Gradients flow through the ends of the spans by autograd: rows measure what outline that moves in
x sweeps, columns what it sweeps in y.
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
                [
                    _covered(row + (sub + 0.5) / subscanlines, triangles, width, subscanlines)
                    for sub in range(subscanlines)
                ]
            ).mean(0)
            for row in range(height)
        ]
    )


def _covered(y: float, triangles: Tensor, width: int, subscanlines: int) -> Tensor:
    """Area [W] that the union of the triangles' spans at height y has in each pixel, if a line is a pixel high."""
    place, half = _spans(y, triangles, width, subscanlines)
    order = place[:, 0].argsort()
    place, half = place[order], half[order]
    # What each span adds to the ones that start left of it: disjoint pieces that sum to the union.
    reached, at = place[:, 1].cummax(0)
    reached = torch.cat([reached.new_full((1,), -1.0), reached])[:-1]
    reached_half = torch.cat([half.new_zeros(1), half[at, 1]])[:-1]
    start, start_half = _farther(place[:, 0], half[:, 0], reached, reached_half)
    end, end_half = _farther(place[:, 1], half[:, 1], start, start_half)
    return (_past(end, end_half, width) - _past(start, start_half, width)).sum(0)


def _spans(y: float, triangles: Tensor, width: int, subscanlines: int) -> tuple[Tensor, Tensor]:
    """Start and end [K 2] of the triangles' spans along the line at height y, and half the widths of their stretches.

    A vertex on the line counts as lying before it (smaller y), so that each triangle is crossed twice or never.
    """
    start, end = triangles, triangles.roll(-1, dims=1)
    crossed = (start[..., 1] > y) != (end[..., 1] > y)
    hit = crossed.any(1)
    start, end = start[hit][crossed[hit]], end[hit][crossed[hit]]
    along, across = (end - start).unbind(1)
    weight = ((y - start[:, 1]) / across).detach()
    place = torch.lerp(start[:, 0], end[:, 0], weight).clamp(-1, width + 1)
    half = ((along / across).abs() / (2 * subscanlines)).clamp(max=0.5).detach()
    # Rows and columns each give one component of the gradient whole; they are averaged.
    place = place.detach() + 2 * (place - place.detach())
    place, order = place.view(-1, 2).sort(dim=1)
    return place, half.view(-1, 2).gather(1, order)


def _farther(place: Tensor, half: Tensor, other: Tensor, other_half: Tensor) -> tuple[Tensor, Tensor]:
    """Whichever of two places [K] lies farther right, and its stretch."""
    ours = place > other
    return torch.where(ours, place, other), torch.where(ours, half, other_half)


def _past(place: Tensor, half: Tensor, width: int) -> Tensor:
    """Mean over a stretch of what it has left behind of each pixel: [K] -> [K W] in 0..1."""
    left = torch.arange(width, dtype=place.dtype, device=place.device)
    offset, half = place[:, None] - left, half[:, None]

    def summed(x: Tensor) -> Tensor:
        """The integral of x clamped to 0..1."""
        return x.clamp(0, 1).square() / 2 + (x - 1).clamp(min=0)

    mean = (summed(offset + half) - summed(offset - half)) / (2 * half)
    return torch.where(half > 1e-6, mean, offset.clamp(0, 1))
