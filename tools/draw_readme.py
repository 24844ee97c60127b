"""Draws docs/demo.png, the picture at the top of the README: what `refine demo` composes.

Run as ``python tools/draw_readme.py``; about half a minute. ``--mae`` takes other weights than the shipped ones.
"""

import argparse
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mae", type=Path, help="weights of `refine train mae`; default: the shipped ones")
    parser.add_argument("--out", type=Path, default=PICTURE)
    flags = parser.parse_args()

    demo = Demo()
    body, random, frames = body_of(None), torch.Generator().manual_seed(demo.seed), round(demo.seconds * FPS)
    i, j = (perform(draw(name, random, FPS), frames, body.rest_joints) for name in demo.actions)
    made = compose(i, j, judge_of(body, flags.mae)).motions()
    rows = strip([i, j, *made.values()], body_of(None, "full"), poses=8, height=210)
    captions = [*demo.actions, "coupled: blended by energies", "refined: after the loop"]
    save_png(flags.out, contact_sheet([[row] for row in rows], captions))
    with Image.open(flags.out) as picture:  # a palette of 256 colours is enough, at a third of the size
        picture.quantize(256).save(flags.out, optimize=True)


if __name__ == "__main__":
    main()
