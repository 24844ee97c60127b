"""Draws docs/by-parts.png: a run and a wave, coupled by energies and by parts.

Run as ``python tools/draw_by_parts.py``.
"""

from pathlib import Path

import torch
from PIL import Image

from refine.composition import aligned
from refine.coupling import couple
from refine.coupling_by_parts import couple_by_parts
from refine.drawing import strip
from refine.motion import Motion
from refine.synthetic import draw, perform
from refine.text.parts import Parts
from renderers.body import Body
from renderers.images import contact_sheet, save_png

OUT = Path(__file__).resolve().parents[1] / "docs" / "by-parts.png"
FIRST, SECOND = Parts.of(["global", "left leg", "right leg"]), Parts.of(["right arm"])


def sheet(first: Motion, second: Motion, body: Body, poses: int = 7, height: int = 190) -> torch.Tensor:
    """Both actions, and both compositions, as rows of poses [3 H W]."""
    first, second = aligned(first, second, centred=True)
    rest = Body.free("light").rest_joints
    made = {
        "by energies": couple(first, second, rest).motion,
        "by parts": couple_by_parts(first, second, FIRST, SECOND, rest).motion,
    }
    rows = strip([first, second, *made.values()], body, poses, height)
    return contact_sheet([[row] for row in rows], [first.label, second.label, *made])


def main() -> None:
    rest, generator = Body.free("light").rest_joints, torch.Generator().manual_seed(4)
    clips = [perform(draw(name, generator), 75, rest) for name in ("run", "wave-right-hand")]
    save_png(OUT, sheet(*clips, Body.free("full")))
    with Image.open(OUT) as picture:  # a palette of 256 colours is enough, at a third of the size
        picture.quantize(256).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
