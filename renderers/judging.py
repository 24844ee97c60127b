"""Our silhouettes beside Mitsuba's: how far apart they are, how much of that is noise, and what it looks like.

Mitsuba does everything twice, with different rays. Ours are compared with the mean of the two; half their difference
tells the noise that is left in it. So what is ours to answer for is what exceeds that noise.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from renderers import raster_mitsuba
from renderers.camera import Camera
from renderers.images import chart, contact_sheet, difference_picture, enlarged, part_picture, save_png
from renderers.mesh import Mesh
from renderers.silhouette import blur, silhouette

# What our own error may be; in brackets what it is for bodies at 32 to 224 px, against 64 scans. On a pixel of the
# outline: in the mean (.0013 to .0034), and at most (.08).
OWN_MEAN, OWN_LARGEST = 0.004, 0.12
# Of the slopes of eight losses at 64 px: along motions of a whole body (up to .007), and of a limb (up to .15).
OWN_SLOPE, OWN_LIMB_SLOPE = 0.02, 0.2
AT_ONCE = 4  # poses between two steps of a progress bar
SHOWN, SIDE, MAGNIFIED = 4, 224, 20  # poses in a sheet, the side of their pictures in pixels, times their difference
RINGS = 4


@dataclass(frozen=True)
class Pair:
    """Images [N C H W] of the same bodies."""

    ours: Tensor
    mitsuba: Tensor  # mean of two renders
    noise: Tensor  # half the difference of the two

    @property
    def size(self) -> int:
        return self.ours.shape[-1]

    @property
    def difference(self) -> Tensor:
        return (self.ours - self.mitsuba).abs()

    @property
    def outline(self) -> Tensor:
        """The pixels [N C H W] that are covered in part."""
        return (self.mitsuba > 0) & (self.mitsuba < 1)


@dataclass(frozen=True)
class Agreement:
    """Differences over all pixels of all images, which are in 0..1."""

    size: int
    images: int  # for each body
    mean: float
    largest: float
    iou: float
    noise: float  # of Mitsuba, mean
    mean_tolerance: float
    largest_tolerance: float

    @property
    def agrees(self) -> bool:
        return self.mean <= self.mean_tolerance and self.largest <= self.largest_tolerance


@dataclass(frozen=True)
class Slope:
    """The slopes of some losses along one motion, by our gradient and by Mitsuba's."""

    motion: str
    error: float  # relative L2
    cosine: float
    noise: float  # of Mitsuba, relative L2
    tolerance: float

    @property
    def agrees(self) -> bool:
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Judgement:
    """All that was compared, of N poses."""

    subject: str
    names: Sequence[str]  # of the poses
    samples: int
    plain: Sequence[Pair]  # of each size
    parts: Sequence[Pair]  # of each size
    slopes: Sequence[Slope]  # none without LLVM
    gradients: str  # what to say about them

    @cached_property
    def agreements(self) -> list[Agreement]:
        return [agreement(pair) for pair in (*self.plain, *self.parts)]

    @property
    def agrees(self) -> bool:
        return all(of.agrees for of in (*self.agreements, *self.slopes))


# --- comparing -------------------------------------------------------------------------------------------------------


def steps(poses: int) -> int:
    """How often `compare` calls ``progress``."""
    return 2 * -(-poses // AT_ONCE)


def seeds(seed: int) -> tuple[int, int]:
    """Of the two renders; no other below 2**31 has either of them."""
    return 2 * seed % 2**32, (2 * seed + 1) % 2**32


def compare(
    vertices: Tensor, mesh: Mesh, camera: Camera, samples: int, seed: int, progress: Callable[[], object]
) -> Pair:
    """The silhouettes of vertices [N V 3] before N cameras, by us and by Mitsuba."""
    with torch.no_grad():
        ours = silhouette(vertices, mesh, camera)
    renders = []
    for again in seeds(seed):
        images = []
        for some in torch.arange(len(vertices)).split(AT_ONCE):
            images.append(raster_mitsuba.silhouette(vertices[some], mesh, camera[some], samples, again))
            progress()
        renders.append(torch.cat(images))
    first, second = renders
    return Pair(ours, (first + second) / 2, (first - second) / 2)


def agreement(pair: Pair) -> Agreement:
    noise = pair.noise.abs()
    either = torch.maximum(pair.ours, pair.mitsuba).sum().clamp(min=1e-9)
    return Agreement(
        size=pair.size,
        images=pair.ours.shape[1],
        mean=pair.difference.mean().item(),
        largest=pair.difference.max().item(),
        iou=(torch.minimum(pair.ours, pair.mitsuba).sum() / either).item(),
        noise=noise.mean().item(),
        mean_tolerance=(noise.mean() + OWN_MEAN * pair.outline.float().mean()).item(),
        largest_tolerance=noise.max().item() + OWN_LARGEST,
    )


def compare_gradients(
    vertices: Tensor,
    motions: dict[str, tuple[Tensor, float]],
    mesh: Mesh,
    camera: Camera,
    samples: int,
    seed: int,
) -> list[Slope]:
    """Our gradients and those of Mitsuba's projective integrator, along motions.

    A loss is a silhouette weighted by a smooth random picture, another one for each frame.

    Args:
        vertices: [N V 3].
        motions: [N V 3] each, and what our own error may be: `OWN_SLOPE` or `OWN_LIMB_SLOPE`.
        camera: N of them.
    """
    generator = torch.Generator().manual_seed(seed)
    weights = torch.randn(len(vertices), mesh.channels, *camera.size, generator=generator)
    weights = blur(weights, min(camera.size) / 8)
    weights = weights / weights.std()
    moved = vertices.detach().requires_grad_()
    [ours] = torch.autograd.grad(silhouette(moved, mesh, camera), moved, weights)
    first, second = (raster_mitsuba.gradient(vertices, mesh, camera, weights, samples, again) for again in seeds(seed))
    gradients = (ours, (first + second) / 2, (first - second) / 2)
    return [
        slope(name, own, *((pulls * motion).sum((1, 2)) for pulls in gradients))
        for name, (motion, own) in motions.items()
    ]


def slope(motion: str, own: float, ours: Tensor, mitsuba: Tensor, noise: Tensor) -> Slope:
    """Compare the slopes [N] of some losses; ``own`` is what our own error may be, relative."""
    length = mitsuba.norm()
    noisy = (noise.norm() / length).item()
    return Slope(
        motion=motion,
        error=((ours - mitsuba).norm() / length).item(),
        cosine=(ours @ mitsuba / (ours.norm() * length)).item(),
        noise=noisy,
        tolerance=own + 2 * noisy,
    )


# --- telling ---------------------------------------------------------------------------------------------------------


def write(folder: Path, judgement: Judgement) -> None:
    """Write table.md, check.json and sheet.png."""
    heading = f"Silhouettes beside Mitsuba's: {judgement.subject}"
    page = [f"# {heading}", tables(judgement), explanation(judgement.samples), judgement.gradients]
    (folder / "table.md").write_text("\n\n".join(page) + "\n")
    (folder / "check.json").write_text(json.dumps(numbers(judgement), indent=1))
    save_png(folder / "sheet.png", sheet(judgement, heading))


def numbers(judgement: Judgement) -> dict[str, Any]:
    """All of it, as JSON knows it."""
    return {
        "agrees": judgement.agrees,
        "subject": judgement.subject,
        "poses": list(judgement.names),
        "samples": judgement.samples,
        "images": [asdict(of) | {"agrees": of.agrees} for of in judgement.agreements],
        "gradients": [asdict(of) | {"agrees": of.agrees} for of in judgement.slopes],
        "gradients_by": judgement.gradients,
    }


def tables(judgement: Judgement) -> str:
    """The numbers in Markdown."""
    head = ("size", "images", "mean", "tolerance", "largest", "tolerance", "IoU", "Mitsuba's noise", "verdict")
    rows = [
        (
            f"{of.size} px",
            "body" if of.images == 1 else f"{of.images} parts",
            f"{of.mean:.2e}",
            f"{of.mean_tolerance:.2e}",
            f"{of.largest:.3f}",
            f"{of.largest_tolerance:.3f}",
            f"{of.iou:.5f}",
            f"{of.noise:.2e}",
            _verdict(of.agrees),
        )
        for of in judgement.agreements
    ]
    made = [_markdown(head, rows)]
    if judgement.slopes:
        head = ("gradient along", "relative error", "tolerance", "cosine", "Mitsuba's noise", "verdict")
        rows = [
            (
                of.motion,
                f"{of.error:.4f}",
                f"{of.tolerance:.4f}",
                f"{of.cosine:.5f}",
                f"{of.noise:.4f}",
                _verdict(of.agrees),
            )
            for of in judgement.slopes
        ]
        made.append(_markdown(head, rows))
    return "\n\n".join(made)


def explanation(samples: int) -> str:
    """Where the numbers of the table come from."""
    return (
        "Differences of coverage (0..1) over all pixels of all poses; IoU of areas, nothing rounded. Mitsuba is the "
        f"mean of two renders with {samples} stratified rays a pixel each, its noise half their difference. The mean "
        f"difference may be that noise and {OWN_MEAN:g} on pixels of the outline, the largest difference the largest "
        f"noise and {OWN_LARGEST:g}. Slopes may be off by twice their noise and {OWN_SLOPE:g} along motions of a "
        f"body, {OWN_LIMB_SLOPE:g} along those of a limb."
    )


def _verdict(agrees: bool) -> str:
    return "agrees" if agrees else "DIFFERS"


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = [head, ["-" * width for width in widths], *rows]
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    )


# --- showing ---------------------------------------------------------------------------------------------------------


def sheet(judgement: Judgement, title: str) -> Tensor:
    """The poses that differ most, at the middle one of the sizes, and profiles through outlines: a picture [3 H W]."""
    plain, names = judgement.plain, judgement.names
    body, split = (pairs[len(pairs) // 2] for pairs in (plain, judgement.parts))
    apart = body.difference.mean((1, 2, 3))
    worst = apart.argsort(descending=True)[:SHOWN].tolist()
    rows = [[picture for pair in (body, split) for picture in _beside(pair, k)] for k in worst]
    captions = [f"{names[k]}: differs by {apart[k]:.1e} in the mean, at {body.size} px" for k in worst]
    titles = ["ours", "Mitsuba", f"difference x {MAGNIFIED}"]
    pictures = contact_sheet(rows, captions, [*titles, *(f"{title} (parts)" for title in titles)], title)
    width = (pictures.shape[2] - 4 * 8) // 3
    notes = (
        f"Red: ours cover more; blue: ours cover less; full colour at {1 / MAGNIFIED:g} of a pixel. Profiles: "
        f"{names[worst[0]]}, along the row and the column of pixels that cross the most outline; ring 1 are the pixels "
        "of the outline, ring 2 those beside them, and so on; where no line is drawn, there is no difference."
    )
    profiles = contact_sheet([_profiles(plain, worst[0], width)], notes=[notes])
    return contact_sheet([[pictures], [profiles]], gap=0)


def _beside(pair: Pair, k: int) -> list[Tensor]:
    factor = max(1, round(SIDE / pair.size))
    pictures = [
        part_picture(pair.ours[k]),
        part_picture(pair.mitsuba[k]),
        difference_picture(MAGNIFIED * pair.ours[k], MAGNIFIED * pair.mitsuba[k]),
    ]
    return [enlarged(picture, factor) for picture in pictures]


def _profiles(pairs: Sequence[Pair], k: int, width: int) -> list[Tensor]:
    """Charts: coverage along the row and the column with most outline of pose ``k``, mean differences by distance."""
    pair, charts, size = pairs[0], [], (width * 5 // 8, width)
    for word, across in (("row", 1), ("column", 0)):
        line = int(pair.outline[k, 0].sum(across).argmax())
        ours, mitsuba = (image[k, 0].select(1 - across, line) for image in (pair.ours, pair.mitsuba))
        curves = {"ours": ours, "Mitsuba": mitsuba, f"difference x {MAGNIFIED}": MAGNIFIED * (ours - mitsuba)}
        curves = {name: values.tolist() for name, values in curves.items()}
        charts.append(chart(curves, f"Coverage along {word} {line + 1} of {pair.size}", size, log=False))
    curves = {f"{pair.size} px": ring_means(pair) for pair in pairs}
    return [*charts, chart(curves, "Mean difference by ring around the outline", size)]


def ring_means(pair: Pair) -> list[float]:
    """The mean difference on the outline, on the pixels beside it, on those beside them, ..."""
    inside, means = pair.outline.float(), []
    ring = inside
    for _ in range(RINGS):
        means.append(((pair.difference * ring).sum() / ring.sum().clamp(min=1)).item())
        wider = max_pool2d(inside, 3, stride=1, padding=1)
        inside, ring = wider, wider - inside
    return means
