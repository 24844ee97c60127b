"""Pictures for people: values in, files out, and what is drawn over or beside them.

A picture is a float tensor [3 H W] in 0..1; [1 H W] and [H W] are taken as grey. Nothing here is differentiable.
"""

import math
import textwrap
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from renderers.checks import ShapeError, UserError, check_shapes
from renderers.outputs import replacing
from renderers.palette import BACKGROUND, FAINT, HEAT, INK, LINES, PARTS, rgb

SMALLEST = 1e-8  # share of the greatest value that a log axis still shows


# --- files -----------------------------------------------------------------------------------------------------------


def save_png(path: str | Path, image: Tensor) -> None:
    """One picture as PNG."""
    with replacing(path) as partial:
        _pil(image).save(partial, format="PNG", optimize=True)


def save_gif(path: str | Path, frames: Tensor | Sequence[Tensor], fps: float) -> None:
    """Frames [N 3 H W] as an endless GIF; GIF counts time in hundredths of a second."""
    first, *others = [_pil(frame).quantize(128, dither=Image.Dither.NONE) for frame in _some(path, frames)]
    duration = max(20, round(100 / fps) * 10)
    with replacing(path) as partial:
        first.save(partial, format="GIF", save_all=True, append_images=others, duration=duration, loop=0)


def save_mp4(path: str | Path, frames: Tensor | Sequence[Tensor], fps: float) -> None:
    """Frames [N 3 H W] as H.264 in yuv420p, which every browser plays; odd sizes get one more row or column."""
    import av

    pictures = [_bytes(frame) for frame in _some(path, frames)]
    height, width = (size + size % 2 for size in pictures[0].shape[:2])
    with (
        replacing(path) as partial,
        av.open(str(partial), "w", format="mp4", options={"movflags": "faststart"}) as movie,
    ):
        stream = movie.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001), options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in pictures:
            padding = ((0, height - picture.shape[0]), (0, width - picture.shape[1]), (0, 0))
            frame = av.VideoFrame.from_ndarray(np.pad(picture, padding, mode="edge"), format="rgb24")
            movie.mux(stream.encode(frame))
        movie.mux(stream.encode())


# --- pictures beside one another -------------------------------------------------------------------------------------


def contact_sheet(
    rows: Sequence[Sequence[Tensor]],
    row_captions: Sequence[str] = (),
    column_captions: Sequence[str] = (),
    title: str = "",
    gap: int = 8,
    notes: Sequence[str] = (),
) -> Tensor:
    """Rows of pictures of any sizes, with a caption above each column and over each row.

    Args:
        rows: pictures [3 H W]; rows may differ in length.
        row_captions: one a row, written over it.
        column_captions: one a column, written above the first row.
        notes: paragraphs of explanation, written small under the last row.

    Returns:
        [3 H W] in 0..1.
    """
    if not any(len(row) for row in rows):
        raise UserError("contact_sheet", "there are no pictures to lay out")
    cells = [[_pil(image) for image in row] for row in rows]
    columns = max(map(len, cells))
    widths = [max((row[k].width for row in cells if k < len(row)), default=0) for k in range(columns)]
    heights = [max((cell.height for cell in row), default=0) for row in cells]
    size = max(11, min(18, min(heights) // 9))
    line = round(1.6 * size)
    top = gap + (round(1.4 * line) if title else 0) + (line if column_captions else 0)
    over = line if row_captions else 0
    caption_width = max((_text_width(caption, size) for caption in row_captions), default=0)
    width = max(sum(widths) + gap * (columns + 1), caption_width + 2 * gap, _text_width(title, size + 3) + 2 * gap)
    letters = max(20, round(width / _text_width("n", size - 3)))
    lines = [text for note in notes for text in textwrap.wrap(note, letters)]
    height = top + sum(heights) + (gap + over) * len(rows) + line * len(lines)

    sheet = Image.new("RGB", (width, height), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    draw.text((gap, gap), title, INK, font=_font(size + 3))
    lefts = [gap + sum(widths[:k]) + gap * k for k in range(columns)]
    for left, span, caption in zip(lefts, widths, column_captions, strict=False):
        draw.text((left + span / 2, top - line), caption, INK, font=_font(size), anchor="ma")
    y = top
    for index, (row, tall) in enumerate(zip(cells, heights, strict=True)):
        if over:
            draw.text((gap, y + 2), row_captions[index], INK, font=_font(size))
        for left, span, cell in zip(lefts, widths, row, strict=False):
            sheet.paste(cell, (left + (span - cell.width) // 2, y + over))
        y += over + tall + gap
    for number, text in enumerate(lines):
        draw.text((gap, y + line * number), text, INK, font=_font(size - 3))
    return _tensor(sheet)


def enlarged(image: Tensor, factor: int) -> Tensor:
    """Every pixel ``factor`` times as wide and high, unsmoothed, so that small pictures can be read."""
    return _tensor(_pil(image)).repeat_interleave(factor, dim=1).repeat_interleave(factor, dim=2)


# --- what the loop sees ----------------------------------------------------------------------------------------------


def part_picture(parts: Tensor) -> Tensor:
    """Silhouettes [C H W] in 0..1 -> colour picture [3 H W], one colour a part (dark ink when there is only one)."""
    check_shapes("part_picture", parts=(parts, "C H W"))
    colours = [INK] if len(parts) == 1 else [PARTS[part % len(PARTS)] for part in range(len(parts))]
    palette = torch.tensor([rgb(colour) for colour in colours])
    parts = parts.detach().cpu().float().clamp(0, 1)
    total = parts.sum(0)
    mixed = torch.einsum("chw,cd->dhw", parts / total.clamp(min=1), palette)
    return mixed + (1 - total.clamp(max=1)) * torch.tensor(rgb(BACKGROUND))[:, None, None]


def with_joints(image: Tensor, joints: Tensor, energies: Tensor, scale: float = 1.0) -> Tensor:
    """Circles at joints [24 2] (pixels x, y), their areas and warmth by energies [24] relative to the greatest.

    ``scale`` multiplies the pixel coordinates, for a picture that was enlarged.
    """
    check_shapes("with_joints", joints=(joints, "J 2"), energies=(energies, "J"))
    strength = (energies.detach().cpu() / energies.max().clamp(min=1e-12).cpu()).clamp(0, 1).tolist()
    picture = _pil(image)
    big = picture.resize((picture.width * 2, picture.height * 2))
    draw = ImageDraw.Draw(big)
    unit = min(big.size) / 320
    circles = zip(strength, (joints.detach().cpu() * scale * 2).tolist(), strict=True)
    for energy, (x, y) in sorted(circles):  # the strongest on top
        radius = unit * (3 + 13 * math.sqrt(energy))
        box = (x - radius, y - radius, x + radius, y + radius)
        colour = tuple(round(255 * level) for level in heat(torch.tensor(energy)).tolist())
        draw.ellipse(box, fill=colour, outline="white", width=max(1, round(unit)))
    return _tensor(big.resize(picture.size, Image.Resampling.LANCZOS))


def heat(values: Tensor) -> Tensor:
    """Values [...] in 0..1 -> colours [... 3] from pale cream over orange to deep purple, ever darker."""
    stops = torch.tensor([rgb(colour) for colour in HEAT])
    at = values.detach().cpu().float().clamp(0, 1) * (len(stops) - 1)
    low = at.floor().long().clamp(max=len(stops) - 2)
    return torch.lerp(stops[low], stops[low + 1], (at - low)[..., None])


def heat_map(image: Tensor, field: Tensor, opacity: float = 0.75) -> Tensor:
    """A field [h w], scaled by its greatest value and stretched over the picture [3 H W], laid over it."""
    picture = _tensor(_pil(image))
    field = field.detach().cpu().float()
    colours = heat(field / field.max().clamp(min=1e-12)).permute(2, 0, 1)
    stretched = torch.nn.functional.interpolate(colours[None], size=picture.shape[1:], mode="nearest")[0]
    return torch.lerp(picture, stretched, opacity)


def kept_patches(image: Tensor, kept: Tensor) -> Tensor:
    """The picture with the patches that are not kept [h w] bool hatched away and the grid drawn."""
    check_shapes("kept_patches", kept=(kept, "h w"))
    picture = _tensor(_pil(image))
    _, height, width = picture.shape
    rows, columns = kept.shape
    row = torch.arange(height) * rows // height
    column = torch.arange(width) * columns // width
    visible = kept.detach().cpu().bool()[row][:, column]
    hatched = (torch.arange(height)[:, None] + torch.arange(width)) % 6 < 2
    curtain = torch.where(hatched, 0.72, 0.80).expand(3, -1, -1)
    picture = torch.where(visible, picture, curtain)
    lines = torch.zeros(height, width, dtype=torch.bool)
    lines[1:] |= (row[1:] != row[:-1])[:, None]
    lines[:, 1:] |= (column[1:] != column[:-1])[None]
    return torch.where(lines, 0.93, picture)


def difference_picture(first: Tensor, second: Tensor) -> Tensor:
    """Where two pictures [C H W] differ: red where the first has more, blue where the second has -> [3 H W]."""
    check_shapes("difference_picture", first=(first, "C H W"), second=(second, "C H W"))
    signed = (first - second).detach().cpu().float()
    more, less = signed.clamp(min=0).amax(0).clamp(max=1), (-signed).clamp(min=0).amax(0).clamp(max=1)
    return torch.stack([1 - less, 1 - torch.maximum(more, less), 1 - more])


# --- charts ----------------------------------------------------------------------------------------------------------


def chart(series: dict[str, list[float]], title: str, size: tuple[int, int] = (360, 640), log: bool = True) -> Tensor:
    """Lines over the step number, with numbers on both axes and a legend.

    Args:
        series: one list a line; values that cannot be drawn leave gaps: those that are not finite and, on a log axis,
            those below a hundred-millionth of the greatest.
        size: (height, width) in pixels.

    Returns:
        [3 H W] in 0..1.
    """
    height, width = (2 * side for side in size)  # drawn twice as large, then reduced: smooth lines
    canvas = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(canvas)
    small, left, right, top, bottom = _font(24), 130, width - 30, 100, height - 60
    draw.text((left, 14), title, INK, font=_font(30))

    height_of = (lambda value: math.log10(value)) if log else (lambda value: value)

    finite = [value for values in series.values() for value in values if math.isfinite(value)]
    floor = max([0.0, *finite]) * SMALLEST if log else -math.inf

    def fits(value: float) -> bool:
        return math.isfinite(value) and value > floor

    drawable = [value for value in finite if fits(value)]
    if not drawable:
        draw.text(((left + right) / 2, (top + bottom) / 2), "nothing to draw", INK, font=small, anchor="mm")
        return _tensor(canvas.resize((width // 2, height // 2), Image.Resampling.LANCZOS))
    steps = max(len(values) for values in series.values())
    ticks = _log_ticks(min(drawable), max(drawable)) if log else _ticks(min(drawable), max(drawable))
    low = min(height_of(min(drawable)), height_of(ticks[0]))
    high = max(height_of(max(drawable)), height_of(ticks[-1]))

    def place(step: float, value: float) -> tuple[float, float]:
        across = left + (right - left) * (step - 1) / max(steps - 1, 1)
        return across, bottom - (bottom - top) * (height_of(value) - low) / max(high - low, 1e-12)

    for tick in ticks:
        y = place(1, tick)[1]
        draw.line((left, y, right, y), FAINT, 2)
        draw.text((left - 12, y), f"{tick:.4g}", INK, font=small, anchor="rm")
    for tick in _ticks(1, steps):
        if 1 <= tick <= steps and tick == int(tick):
            draw.text((place(tick, drawable[0])[0], bottom + 12), f"{int(tick):,}", INK, font=small, anchor="ma")
    legend = left
    for (name, values), colour in zip(series.items(), _cycle(LINES, len(series)), strict=True):
        _polyline(draw, [place(k + 1, v) if fits(v) else None for k, v in enumerate(values)], colour)
        draw.line((legend, 74, legend + 36, 74), colour, 6)
        draw.text((legend + 46, 74), name, INK, font=small, anchor="lm")
        legend += 80 + small.getlength(name)
    return _tensor(canvas.resize((width // 2, height // 2), Image.Resampling.LANCZOS))


def _polyline(draw: ImageDraw.ImageDraw, points: list[tuple[float, float] | None], colour: str) -> None:
    run: list[tuple[float, float]] = []
    for point in [*points, None]:
        if point is not None:
            run.append(point)
            continue
        if len(run) > 1:
            draw.line(run, colour, 4, joint="curve")
        elif run:
            x, y = run[0]
            draw.ellipse((x - 5, y - 5, x + 5, y + 5), colour)
        run = []


def _ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers that cover low..high, about five of them."""
    span = max(high - low, abs(high) * 1e-9, 1e-12)
    unit = 10 ** math.floor(math.log10(span / about))
    step = next(factor * unit for factor in (1, 2, 5, 10) if span / (factor * unit) <= about)
    first = math.floor(low / step)
    return [round(k * step, 12) for k in range(first, math.ceil(high / step) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten that cover low..high; 1-2-5 steps when fewer than two decades are covered."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    if last - first > 2:
        return [10.0**power for power in range(first, last + 1, max(1, (last - first) // 6))]
    steps = [factor * 10.0**power for power in range(first, last + 1) for factor in (1, 2, 5)]
    below = max((step for step in steps if step <= low * (1 + 1e-9)), default=steps[0])
    above = min((step for step in steps if step >= high * (1 - 1e-9)), default=steps[-1])
    return [step for step in steps if below <= step <= above]


# --- conversions -----------------------------------------------------------------------------------------------------


def _cycle(colours: Sequence[str], count: int) -> list[str]:
    return [colours[k % len(colours)] for k in range(count)]


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


def _text_width(text: str, size: int) -> int:
    return math.ceil(_font(size).getlength(text))


def _some(path: str | Path, frames: Tensor | Sequence[Tensor]) -> Tensor | Sequence[Tensor]:
    if len(frames) == 0:
        raise UserError(path, "there are no frames to write", "give at least one")
    return frames


def _bytes(image: Tensor) -> np.ndarray:
    """[3 H W], [1 H W] or [H W] in 0..1 -> [H W 3] uint8."""
    image = image.detach().cpu().float()
    image = image[None] if image.ndim == 2 else image
    if image.ndim != 3 or image.shape[0] not in (1, 3):
        raise ShapeError("picture", f"expected shape [3 H W], [1 H W] or [H W], got {list(image.shape)}")
    levels = (image.nan_to_num(0).clamp(0, 1) * 255).round().to(torch.uint8)
    return levels.expand(3, -1, -1).permute(1, 2, 0).contiguous().numpy()


def _pil(image: Tensor) -> Image.Image:
    return Image.fromarray(_bytes(image))


def _tensor(picture: Image.Image) -> Tensor:
    return torch.from_numpy(np.asarray(picture, dtype=np.float32) / 255).permute(2, 0, 1)
