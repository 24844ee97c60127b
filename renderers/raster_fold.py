"""Area coverage by scanning the folds of a mesh: the fast rasteriser, pure PyTorch.

Turn every projected face counter-clockwise, and it winds once about each point it covers. Summed over the faces, the
passages along most edges cancel; what remains are the *folds*, where the mesh turns over or ends. The winding number
of the folds about a point is the number of faces over it, so a scan along a line needs the folds alone: sort its
crossings, add up their windings, and the outline is where the sum leaves zero or comes back to it. No depth buffer, no
faces per pixel. The sum of every line ends at zero, so one running sum serves all lines of all images.

The gradient is the boundary integral over that outline: moving it by its normal sweeps area in the pixels it crosses.
A piece of outline of normal n is seen by rows and by columns; their shares n_x² and n_y² add up to one, and no factor
grows without bound when an edge becomes parallel to the scan.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from renderers.mesh import Mesh

# Areas are summed as whole multiples of 2^-40: sums do not depend on their order, and background is exactly 0.
UNIT = 2.0**-40


class Folds(NamedTuple):
    """The K edges, of all frames, along which the passages of the faces do not cancel."""

    ends: Tensor  # [2 K] where either end stands in the flattened [N V] points
    points: Tensor  # [2 K 2] (x, y) of either end, pixels
    winding: Tensor  # [K] passages from the first end to the second, less those back
    image: Tensor  # [K] which of the N C images


class Outline(NamedTuple):
    """The M places where a scan enters or leaves a silhouette. Columns are seen with x and y exchanged."""

    pixel: Tensor  # [M] in the flattened images
    ends: Tensor  # [2 M] as in Folds
    weight: Tensor  # [M] 0..1, how far from the first end to the second
    sweep: Tensor  # [M 2] area, in pixels, that is won when the place moves by one pixel in x, in y


class Scan(NamedTuple):
    """The area that one direction of scanning finds, float64."""

    area: Tensor  # [N C, H, W] 0..1
    crossings: Tensor  # [N C, H, W] of lines and outline
    outline: Outline


def coverage(points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int = 4) -> Tensor:
    """Covered area of each pixel, 0..1; a channel sees only its own faces.

    The same bits come out on every run. The gradient is that of the exact area, up to the spacing of the scans;
    it can be taken once (there is no second derivative).

    Args:
        points: [N V 2] (x, y) in pixels from the top-left corner, finite, float32 or float64; anywhere, also outside.
        size: (height, width).
        subscanlines: scans for each row and for each column of pixels.

    Returns:
        [N C H W].
    """
    return _Coverage.apply(points, mesh, size, subscanlines)


class _Coverage(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int) -> Tensor:
        height, width = size
        images = len(points) * mesh.channels
        folds = find_folds(points, mesh)
        rows = scan(folds, images, height, width, subscanlines)
        columns = scan(folds._replace(points=folds.points.flip(-1)), images, width, height, subscanlines)
        ctx.points_shape = points.shape
        ctx.save_for_backward(*rows.outline, *columns.outline)
        area = blend(rows.area, columns.area.mT, rows.crossings, columns.crossings.mT)
        return area.to(points.dtype).reshape(len(points), mesh.channels, height, width)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor):
        rows, columns = Outline(*ctx.saved_tensors[:4]), Outline(*ctx.saved_tensors[4:])
        frames, vertices, _ = ctx.points_shape
        pulls = _pulls(rows, gradient, frames * vertices) + _pulls(columns, gradient.mT, frames * vertices).flip(-1)
        return pulls.to(gradient.dtype).reshape(ctx.points_shape), None, None, None


def find_folds(points: Tensor, mesh: Mesh) -> Folds:
    """The folds of every frame of ``points`` [N V 2]."""
    frames, vertices, _ = points.shape
    # Frames last: gathering a vertex or a face then copies one row for all frames.
    by_vertex = points.permute(1, 2, 0).contiguous()
    a, b, c = by_vertex.index_select(0, mesh.faces.T.flatten()).view(3, -1, 2, frames)
    b, c = b - a, c - a
    sign = torch.sign(b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    sign = sign.to(torch.int8 if mesh.edge_faces.shape[1] < 128 else torch.int32)
    passages = torch.cat([sign, -sign, torch.zeros_like(sign[:1])])
    first, *others = (passages.index_select(0, faces) for faces in mesh.edge_faces.T)
    winding = sum(others, start=first)

    edge, frame = winding.nonzero().unbind(1)
    ends = (mesh.edges.T[:, edge] + frame * vertices).flatten()
    return Folds(
        ends=ends,
        points=points.reshape(-1, 2)[ends],
        winding=winding[edge, frame].long(),
        image=frame * mesh.channels + mesh.edge_channels[edge],
    )


def scan(folds: Folds, images: int, height: int, width: int, subscanlines: int) -> Scan:
    """Scan all images along their rows; or along their columns, with x and y (and height and width) exchanged."""
    lines = height * subscanlines
    x, y = folds.points.view(2, -1, 2).unbind(-1)

    # The lines at (line + 1/2) / subscanlines that pass between the ends of an edge. An end that lies on a line counts
    # as below it for all the edges that meet there, so that what goes into a line also comes out of it.
    first, last = (y * subscanlines - 0.5).ceil().clamp(0, lines).long()
    repeats = (last - first).abs()
    edge = torch.repeat_interleave(repeats)
    line = (
        torch.arange(len(edge), device=edge.device) + (torch.minimum(first, last) - repeats.cumsum(0) + repeats)[edge]
    )
    weight = ((line + 0.5).to(y.dtype) / subscanlines - y[0, edge]) / (y[1] - y[0])[edge]
    weight = weight.clamp(0, 1)
    place = torch.lerp(x[0, edge], x[1, edge], weight).clamp(0, width)
    line = line + folds.image[edge] * lines

    order = _order(line, place, images * lines, width)
    covered = (folds.winding * (last - first).sign())[edge[order]].cumsum(0) != 0
    step = torch.diff(covered.long(), prepend=covered.new_zeros(1, dtype=torch.long))
    kept = step.nonzero()[:, 0]
    step, kept = step[kept], order[kept]
    edge, line, place, weight = edge[kept], line[kept], place[kept], weight[kept]

    inside = ((place > 0) & (place < width)).to(place.dtype)
    row, cell = line // subscanlines, place.long()
    past = ((place - cell).double() / UNIT).long() * step
    at = row * (width + 2) + cell
    area = past.new_zeros(images * height * (width + 2))
    area.index_add_(0, at, round(1 / UNIT) * step - past).index_add_(0, at + 1, past)
    area = area.view(images, height, width + 2).cumsum(-1)[..., :width].double() * (UNIT / subscanlines)
    crossings = area.new_zeros(images * height * (width + 2)).index_add_(0, at, inside.double())

    normal = torch.stack([y[1] - y[0], x[0] - x[1]], dim=1)[edge]
    normal = normal / torch.hypot(*normal.unbind(1))[:, None]
    outline = Outline(
        pixel=row * width + cell.clamp(max=width - 1),
        ends=folds.ends.view(2, -1)[:, edge].flatten(),
        weight=weight,
        sweep=(-step * inside / subscanlines * normal[:, 0])[:, None] * normal,
    )
    return Scan(area, crossings.view(images, height, width + 2)[..., :width], outline)


def _order(line: Tensor, place: Tensor, lines: int, width: int) -> Tensor:
    """The order by line, then by place: one sort of whole numbers that hold both."""
    place_bits = 62 - lines.bit_length()
    place = (place * 2.0 ** (place_bits - width.bit_length())).long()
    return ((line << place_bits) + place).argsort(stable=True)


def blend(rows: Tensor, columns: Tensor, row_crossings: Tensor, column_crossings: Tensor) -> Tensor:
    """The mean of two images, weighted by squared crossings; plain where neither scan meets the outline.

    Rows are blind to horizontal outlines and columns to upright ones. The crossings that a piece of outline has with
    either grow as |n_x| and |n_y|, so that their squares are the shares that the gradient uses as well.
    """
    row_weight, column_weight = row_crossings**2, column_crossings**2
    weight = row_weight + column_weight
    share = torch.where(weight > 0, row_weight / weight.clamp(min=1), 0.5)
    return torch.lerp(columns, rows, share)


def _pulls(outline: Outline, gradient: Tensor, vertices: int) -> Tensor:
    """What the picture's ``gradient`` does at the ends of the outline's edges: [V 2] in float64."""
    pull = outline.sweep * gradient.flatten()[outline.pixel, None]
    second = pull * outline.weight[:, None]
    pulls = torch.zeros(vertices, 2, dtype=torch.float64, device=pull.device)
    return pulls.index_put_((outline.ends,), torch.cat([pull - second, second]).double(), accumulate=True)
