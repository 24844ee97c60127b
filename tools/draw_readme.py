"""Draws docs/demo.png, the picture at the top of the README: what `refine demo` composes.

Run as ``python tools/draw_readme.py``; about half a minute.
"""

from pathlib import Path

import torch
from PIL import Image

from refine.cli.demo import FPS, Demo
from refine.cli.inputs import body_of, judge_of
from refine.composition import compose
from refine.drawing import strip
from refine.synthetic import draw, perform
from renderers.images import contact_sheet, save_png

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "demo.png"


def main() -> None:
    demo = Demo()
    body, random, frames = body_of(None), torch.Generator().manual_seed(demo.seed), round(demo.seconds * FPS)
    i, j = (perform(draw(name, random, FPS), frames, body.rest_joints) for name in demo.actions)
    both = compose(i, j, judge_of(body)).motion
    rows = strip([i, j, both], body_of(None, "full"), poses=8, height=250)
    save_png(PICTURE, contact_sheet([[row] for row in rows], [*demo.actions, "both, refined"]))
    with Image.open(PICTURE) as picture:  # a palette of 256 colours is enough, at a third of the size
        picture.quantize(256).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
