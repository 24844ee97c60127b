"""Draws docs/fold-scan.svg, the drawing of the method in docs/renderer.md, from the rasteriser's own folds and outline.

Run as ``python tools/draw_fold_scan.py``; a second.
"""

from pathlib import Path

import torch
from torch import Tensor

from renderers import raster_fold
from renderers.body import Body
from renderers.camera import frame
from renderers.mesh import Mesh
from renderers.palette import BACKGROUND, FAINT, INK, LINES
from renderers.poses import POSE_NAMES, sixteen_poses

DRAWING = Path(__file__).resolve().parents[1] / "docs" / "fold-scan.svg"
PIXELS, SCALE, GAP, HEAD = 22, 20, 24, 56  # pixels a panel, drawn units a pixel, between panels, above them
RED, BLUE, GOLD = LINES[0], LINES[1], LINES[2]
SCANNED_ROW, SCANNED_COLUMN = 9, 4  # the row and the column of pixels whose scans are shown
SUBSCANLINES = 4


def main(out: Path = DRAWING) -> None:
    points, mesh = crossed_arms()
    folds = raster_fold.find_folds(points, mesh)
    start, end = folds.points.view(2, -1, 2)
    edges = points[0, mesh.edges]
    image = raster_fold.coverage(points, mesh, (PIXELS, PIXELS), SUBSCANLINES)[0, 0]
    rows = raster_fold.find_outline(folds, 1, PIXELS, PIXELS, SUBSCANLINES)
    turned = folds._replace(points=folds.points.flip(-1))
    columns = raster_fold.find_outline(turned, 1, PIXELS, PIXELS, SUBSCANLINES)

    all_edges, fold_lines = lines(edges[:, 0], edges[:, 1]), lines(start, end)
    panels = [
        (
            f"1 · {len(start):,} folds of {len(edges):,} edges",
            path(all_edges, FAINT, 0.5) + path(fold_lines, RED, 1.6),
        ),
        (
            "2 · one scan: the winding numbers add up",
            path(fold_lines, RED, 0.9) + scan(folds),
        ),
        (
            "3 · area, and its gradient at the outline",
            cells(image) + path(fold_lines, RED, 0.5) + arrows(points[0], rows, columns),
        ),
    ]
    width = 3 * PIXELS * SCALE + 4 * GAP
    drawn = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {PIXELS * SCALE + HEAD + GAP}" '
        f'font-family="Helvetica, Arial, sans-serif">',
        f'<rect width="100%" height="100%" fill="{BACKGROUND}"/>',
        f'<clipPath id="panel"><rect width="{PIXELS * SCALE}" height="{PIXELS * SCALE}"/></clipPath>',
    ]
    for place, (title, content) in enumerate(panels):
        left = GAP + place * (PIXELS * SCALE + GAP)
        drawn.append(f'<text x="{left}" y="{HEAD - 20}" font-size="20" fill="{INK}">{title}</text>')
        drawn.append(f'<g transform="translate({left} {HEAD})" clip-path="url(#panel)">{content}')
        drawn.append(f'<rect width="{PIXELS * SCALE}" height="{PIXELS * SCALE}" fill="none" stroke="{INK}"/></g>')
    out.write_text("\n".join([*drawn, "</svg>", ""]))
    print(out)


def crossed_arms() -> tuple[Tensor, Mesh]:
    """The chest of a body with crossed arms: points [1 V 2] in pixels, and the light mesh."""
    body = Body.free("light")
    pose = sixteen_poses()[POSE_NAMES.index("arms crossed")][None]
    with torch.no_grad():
        vertices = body(pose, torch.zeros(1, 3)).vertices.double()
    chest = vertices[:, (vertices[0, :, 1] > 0.02) & (vertices[0, :, 1] < 0.52)]
    camera = frame(chest, (PIXELS, PIXELS), yaw=0.5, margin=0.08)
    return camera.project(vertices), Mesh.build(body.faces)


def scan(folds: raster_fold.Folds) -> str:
    """One scan line with its crossings, the sum between them, and what is covered of it."""
    start, end = folds.points.view(2, -1, 2)
    y = SCANNED_ROW + 0.5
    hit = (start[:, 1] > y) != (end[:, 1] > y)
    start, end, winding = start[hit], end[hit], folds.winding[hit]
    x = start[:, 0] + (y - start[:, 1]) / (end - start)[:, 1] * (end - start)[:, 0]
    order = x.argsort()
    x, winding = x[order], (winding * (end - start)[:, 1].sign().long())[order]
    sums = winding.cumsum(0)
    height = y * SCALE
    drawn = [f'<line x1="0" x2="{PIXELS * SCALE}" y1="{height}" y2="{height}" stroke="{INK}" stroke-width=".8"/>']
    for left, right, total in zip(x[:-1] * SCALE, x[1:] * SCALE, sums[:-1].tolist(), strict=True):
        if total:
            drawn.append(
                f'<line x1="{left:.1f}" x2="{right:.1f}" y1="{height}" y2="{height}" stroke="{BLUE}" stroke-width="5"/>'
            )
        if right - left > 0.9 * SCALE:
            drawn.append(
                f'<text x="{(left + right) / 2:.1f}" y="{height - 9}" font-size="17" font-weight="bold" '
                f'text-anchor="middle" fill="{INK}" stroke="{BACKGROUND}" stroke-width="4" paint-order="stroke">'
                f"{abs(total)}</text>"
            )
    drawn += [f'<circle cx="{at:.1f}" cy="{height}" r="3.4" fill="{RED}"/>' for at in x * SCALE]
    return "".join(drawn)


def cells(image: Tensor) -> str:
    """The covered area of every pixel as a shade of grey."""
    return "".join(
        f'<rect x="{column * SCALE}" y="{row * SCALE}" width="{SCALE}" height="{SCALE}" fill="{INK}" '
        f'fill-opacity="{0.75 * area:.3f}" stroke="{FAINT}" stroke-width=".4"/>'
        for row, areas in enumerate(image.tolist())
        for column, area in enumerate(areas)
    )


def arrows(points: Tensor, rows: raster_fold.Outline, columns: raster_fold.Outline) -> str:
    """The scans of one row and one column of pixels; each says how area grows when its outline moves along it."""
    drawn = []
    for axis, (outline, scanned) in enumerate(((rows, SCANNED_ROW), (columns, SCANNED_COLUMN))):
        for sub in range(SUBSCANLINES):
            at, far = (scanned + (sub + 0.5) / SUBSCANLINES) * SCALE, PIXELS * SCALE
            ends = [torch.tensor([0.0, at]), torch.tensor([float(far), at])]
            drawn.append(path([tuple(end.roll(axis) for end in ends)], GOLD, 1))
        first, second = points[outline.ends]
        places = torch.lerp(first, second, outline.weight[:, None])
        for row, place, step in zip(outline.row, places, outline.step, strict=True):
            if row == scanned:
                tip = place.clone()
                tip[axis] -= 1.2 * step
                drawn.append(path([(place * SCALE, tip * SCALE)], BLUE, 2.2))
                drawn.append(f'<circle cx="{tip[0] * SCALE:.1f}" cy="{tip[1] * SCALE:.1f}" r="3.2" fill="{BLUE}"/>')
    return "".join(drawn)


def lines(start: Tensor, end: Tensor) -> list[tuple[Tensor, Tensor]]:
    """The edges that may be seen in a panel, in drawn units."""
    seen = ((torch.maximum(start, end) > 0) & (torch.minimum(start, end) < PIXELS)).all(1)
    return list(zip(start[seen] * SCALE, end[seen] * SCALE, strict=True))


def path(lines: list[tuple[Tensor, Tensor]], colour: str, width: float) -> str:
    steps = " ".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in lines)
    return f'<path d="{steps}" stroke="{colour}" stroke-width="{width}" stroke-linecap="round" fill="none"/>'


if __name__ == "__main__":
    main()
