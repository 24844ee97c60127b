"""Area coverage by scanning the folds of a mesh: the fast rasteriser, pure PyTorch.

Turn every projected face counter-clockwise, and it winds once about each point it covers. Summed over the faces, the
passages along most edges cancel; what remains are the *folds*, where the mesh turns over or ends. The winding number
of the folds about a point is the number of faces over it, so a scan along a line needs the folds alone: sort its
crossings, add up their windings, and the outline is where the sum leaves zero or comes back to it. No depth buffer, no
faces per pixel. The sum of every line ends at zero, so one running sum serves all lines of all images.

A crossing stands for the outline from half a line before it to half a line after: a stretch as wide as its slope makes
it, which may lie in two pixels. A straight outline is measured exactly so, by rows and by columns.

The gradient is the boundary integral over that outline. Where it moves by (u, v) it sweeps u dy - v dx of area; rows
are evenly spaced in y and columns in x, so rows measure the one term and columns the other, without any normals.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from renderers.checks import UserError
from renderers.mesh import Mesh

CHUNK = 32  # frames at once on a CPU: more of them leave its cache, and make memory grow
WIDEST = 1.0  # pixels that a stretch of outline may be wide, so that it lies in two of them at most


class Folds(NamedTuple):
    """The K edges, of all frames, along which the passages of the faces do not cancel."""

    ends: Tensor  # [2 K] where either end stands in the flattened [N V] points
    points: Tensor  # [2 K 2] (x, y) of either end, pixels
    winding: Tensor  # [K] passages from the first end to the second, less those back
    image: Tensor  # [K] which of the N C images


class Outline(NamedTuple):
    """The M places where the lines of a scan enter or leave a silhouette, as stretches in up to two pixels."""

    row: Tensor  # [M] in the flattened [N C H] rows
    column: Tensor  # [M] where the stretch begins, -2..W; the other pixel is the next one
    parts: Tensor  # [2 M] 0..1, how much of either pixel lies before the stretch
    shares: Tensor  # [2 M] 0..1, how much of the stretch lies in either pixel; what lies outside the image is lost
    step: Tensor  # [M] int32, 1 enters, -1 leaves
    ends: Tensor  # [2 M] as in Folds
    weight: Tensor  # [M] 0..1, how far from the first end to the second

    def pixels(self, offset: int, width: int) -> Tensor:
        """[M] in the flattened [N C H W] images, kept in the row."""
        return self.row * width + (self.column + offset).clamp(0, width - 1)


def coverage(points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int = 4) -> Tensor:
    """Covered area of each pixel, 0..1; a channel sees only its own faces.

    The same bits come out on every run. The gradient is that of the exact area, up to the spacing of the scans;
    it can be taken once (there is no second derivative).

    Args:
        points: [N V 2] (x, y) in pixels from the top-left corner, float32 or float64, below 1e18; also outside.
        size: (height, width).
        subscanlines: scans for each row and for each column of pixels.

    Returns:
        [N C H W].
    """
    at_once = CHUNK if points.device.type == "cpu" else max(1, len(points))
    pieces = [_Coverage.apply(some, mesh, size, subscanlines) for some in points.split(at_once)]
    return pieces[0] if len(pieces) == 1 else torch.cat(pieces)


class _Coverage(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int) -> Tensor:
        images, (height, width) = len(points) * mesh.channels, size
        folds = find_folds(points, mesh)
        rows = find_outline(folds, images, height, width, subscanlines)
        folds = folds._replace(points=folds.points.flip(-1))
        columns = find_outline(folds, images, width, height, subscanlines)
        unit, whole = fixed_point(points.dtype, subscanlines)
        row_area = fill(rows, images * height, width, unit, whole)
        column_area = fill(columns, images * width, height, unit, whole)

        # In the pixels that the outline meets the scans are blended; elsewhere they agree.
        by_rows, by_columns = (
            torch.cat([outline.pixels(0, side), outline.pixels(1, side)])
            for outline, side in ((rows, width), (columns, height))
        )
        column_area = pick(column_area, torch.cat([exchange(by_rows, height, width), by_columns]))
        by_columns = exchange(by_columns, width, height)
        touched = torch.cat([by_rows, by_columns])
        row_area, column_area = (area.to(points.dtype).div_(unit * subscanlines) for area in (row_area, column_area))
        met = [outline.shares.ceil().add_(outline.shares.floor()).flatten() for outline in (rows, columns)]
        counts = torch.zeros_like(row_area).index_add_(0, by_rows, met[0])
        row_count = pick(counts, touched)
        column_count = pick(counts.index_add_(0, by_columns, met[1]), touched) - row_count
        row_area[touched] = blend(pick(row_area, touched), column_area, row_count, column_count)

        ctx.subscanlines = subscanlines
        ctx.save_for_backward(
            points,
            torch.cat([by_rows.view(2, -1), by_columns.view(2, -1)], dim=1),
            torch.cat([rows.shares, columns.shares], dim=1),
            torch.cat([rows.step, columns.step]),
            torch.cat([2 * rows.ends, 2 * columns.ends + 1], dim=1),
            torch.cat([rows.weight, columns.weight]),
        )
        return row_area.view(len(points), mesh.channels, height, width)

    @staticmethod
    def backward(ctx, gradient: Tensor):
        points, pixels, shares, step, ends, weight = ctx.saved_tensors
        with torch.no_grad():
            pull = (pick(gradient.flatten(), pixels.flatten()).view(2, -1) * shares).sum(0) * step / -ctx.subscanlines
            second = pull * weight
            pulls = torch.zeros_like(points, dtype=torch.float64).flatten()
            pulls.index_put_((ends.flatten(),), torch.cat([pull - second, second]).double(), accumulate=True)
        return _Once.apply(pulls.to(points.dtype).view(points.shape), points, gradient), None, None, None


class _Once(torch.autograd.Function):
    """The gradient, which depends on points and cotangent in a way that nobody can ask for."""

    @staticmethod
    def forward(ctx, pulls: Tensor, points: Tensor, gradient: Tensor) -> Tensor:
        return pulls

    @staticmethod
    def backward(ctx, gradient: Tensor):
        raise UserError("silhouette", "there is no second derivative", "detach the gradient, or difference it")


def find_folds(points: Tensor, mesh: Mesh) -> Folds:
    """The folds of every frame of ``points`` [N V 2]."""
    frames, vertices, _ = points.shape
    # Frames last: gathering a vertex or a face then copies one row for all frames.
    by_vertex = points.permute(1, 2, 0).contiguous()
    a, b, c = pick(by_vertex, mesh.faces.T.flatten()).view(3, len(mesh.faces), 2, frames)
    b, c = b.sub_(a), c.sub_(a)  # in place: fresh memory costs more than the arithmetic
    sign = (b[:, 0] * c[:, 1]).sub_(b[:, 1] * c[:, 0]).sign_()
    sign = sign.to(torch.int8 if mesh.edge_faces.shape[1] < 128 else torch.int32)
    passages = torch.cat([sign, -sign, torch.zeros_like(sign[:1])])
    first, *others = (pick(passages, faces) for faces in mesh.edge_faces.T)
    winding = sum(others, start=first)

    edge, frame = winding.nonzero().unbind(1)
    ends = (mesh.edges.T.index_select(1, edge) + frame * vertices).flatten()
    return Folds(
        ends=ends,
        points=pick(points.reshape(-1, 2), ends),
        winding=winding[edge, frame].long(),
        image=frame * mesh.channels + pick(mesh.edge_channels, edge),
    )


def find_outline(folds: Folds, images: int, height: int, width: int, subscanlines: int) -> Outline:
    """Scan all images along their rows; or along their columns, with x and y (and height and width) exchanged."""
    lines = height * subscanlines
    x, y = folds.points.view(2, -1, 2).unbind(-1)

    # The lines at (line + 1/2) / subscanlines that pass between the ends of an edge. An end that lies on a line counts
    # as before it (smaller y) for all the edges that meet there, so that what goes into a line also comes out of it.
    first, last = (y * subscanlines - 0.5).ceil().clamp(0, lines).long()
    repeats = (last - first).abs()
    edge = torch.repeat_interleave(repeats)
    before = repeats.cumsum(0) - repeats
    line = torch.arange(len(edge), device=edge.device) + pick(torch.minimum(first, last) - before, edge)
    weight = ((line + 0.5).to(y.dtype) / subscanlines - pick(y[0], edge)) / pick(y[1] - y[0], edge)
    weight = weight.clamp(0, 1)
    place = torch.lerp(pick(x[0], edge), pick(x[1], edge), weight).clamp(-1, width + 1)
    line = line + pick(folds.image * lines, edge)

    order = _order(line, place, images * lines, width)
    winding = pick(folds.winding * (last - first).sign(), pick(edge, order))
    covered = winding.cumsum(0) != 0
    step = torch.diff(covered.int(), prepend=covered.new_zeros(1, dtype=torch.int32))
    kept = ((step != 0) & (pick(place, order) <= width + WIDEST / 2)).nonzero()[:, 0]
    step, kept = pick(step, kept), pick(order, kept)
    edge, line, place, weight = (pick(values, kept) for values in (edge, line, place, weight))

    # The stretch from low to high, counted from the pixel that it begins in, and what of it is over the edge of that.
    slope = pick((x[1] - x[0]) / (y[1] - y[0]), edge).abs()
    half = (slope / (2 * subscanlines)).clamp(max=WIDEST / 2)
    column = (place - half).floor()
    low, high = place - half - column, place + half - column
    over = (high - 1).clamp(min=0)
    beyond = torch.where(over > 0, over / (2 * half), 0)
    part = torch.where(over > 0, 1 - (1 - beyond) * (1 - low) / 2, place - column)
    inside, next_inside = (column >= 0) & (column < width), (column >= -1) & (column < width - 1)
    return Outline(
        row=line // subscanlines,
        column=column.long(),
        parts=torch.stack([part, beyond * over / 2]),
        shares=torch.stack([(1 - beyond) * inside, beyond * next_inside]),
        step=step,
        ends=folds.ends.view(2, -1).index_select(1, edge),
        weight=weight,
    )


def _order(line: Tensor, place: Tensor, lines: int, width: int) -> Tensor:
    """The order by line, then by place (-1 to width + 1): one sort of whole numbers that hold both."""
    place_bits = 62 - lines.bit_length()
    place = ((place + 1) * 2.0 ** (place_bits - (width + 2).bit_length())).long()
    return ((line << place_bits) + place).argsort(stable=True)


def pick(values: Tensor, at: Tensor) -> Tensor:
    """``values[at]``, which on a CPU takes several times as long."""
    return values.index_select(0, at)


def fixed_point(dtype: torch.dtype, subscanlines: int) -> tuple[int, torch.dtype]:
    """Areas are summed as whole multiples of 1 / unit: no sum depends on its order, and background is exactly 0.

    Returns:
        the unit, and whole numbers that hold ``subscanlines`` of it, at a precision beyond ``dtype``'s own.
    """
    spare = subscanlines.bit_length()
    if dtype == torch.float32 and spare < 6:
        return 2 ** (30 - spare), torch.int32
    return 2 ** (62 - max(spare, 10)), torch.int64


def fill(outline: Outline, rows: int, width: int, unit: int, whole: torch.dtype) -> Tensor:
    """The area of each pixel, in units, flattened: lines count from where they enter to where they leave."""
    step = outline.step.to(whole)
    past, next_past = (outline.parts.double() * unit).to(whole) * step
    area = past.new_zeros(rows * width)
    for offset, more in enumerate((unit * step - past, past - next_past, next_past)):
        area.index_add_(0, outline.pixels(offset, width), more * (outline.column + offset < width))
    return area.view(rows, width).cumsum_(-1).view(-1)


def exchange(pixel: Tensor, height: int, width: int) -> Tensor:
    """Flat indices into images [... H W] as flat indices into [... W H], the images with x and y exchanged."""
    row, column = pixel // width, pixel % width
    image, row = row // height, row % height
    return (image * width + column) * height + row


def blend(rows: Tensor, columns: Tensor, row_count: Tensor, column_count: Tensor) -> Tensor:
    """The mean of two areas, weighted by how often either scan meets the outline there.

    Rows are blind to level outlines and columns to upright ones, and each meets the others in proportion to their
    slope. Fourth powers of the counts leave a tenth less error than squares.
    """
    row_weight, column_weight = row_count**4, column_count**4
    weight = row_weight + column_weight
    # Stretches of edges that meet within a line may overlap by a little.
    return torch.where(weight > 0, torch.lerp(columns, rows, row_weight / weight), rows).clamp(0, 1)
