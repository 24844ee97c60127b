"""Draws docs/by-parts.png, a run and a wave coupled by energies and by parts, and docs/by-parts-refined.png, a walk and
punches by parts, before and after refinement.

Run as ``python tools/draw_by_parts.py``.
"""

from pathlib import Path

import torch
from PIL import Image

from refine.composition import aligned
from refine.composition_by_parts import compose_by_parts
from refine.coupling import couple
from refine.coupling_by_parts import couple_by_parts
from refine.decoupling import Decoupler
from refine.drawing import strip
from refine.mae import load_mae
from refine.motion import Motion
from refine.synthetic import draw, perform, perform_together
from refine.text.parts import Parts
from renderers.body import Body
from renderers.images import contact_sheet, save_png

DOCS = Path(__file__).resolve().parents[1] / "docs"
FRAMES = 75
LEGS, WAVING = Parts.of(["global", "left leg", "right leg"]), Parts.of(["right arm"])
PUNCHING = Parts.of(["left arm", "right arm"])


def sheet(motions: dict[str, Motion], body: Body, poses: int = 7, height: int = 190) -> torch.Tensor:
    """Motions as rows of poses with their names [3 H W]."""
    rows = strip([*motions.values()], body, poses, height)
    return contact_sheet([[row] for row in rows], [*motions])


def coupled(first: Motion, second: Motion, rest: torch.Tensor) -> dict[str, Motion]:
    """Both actions, and both couplings."""
    first, second = aligned(first, second, centred=True)
    return {
        first.label: first,
        second.label: second,
        "by energies": couple(first, second, rest).motion,
        "by parts": couple_by_parts(first, second, LEGS, WAVING, rest).motion,
    }


def refined(rest: torch.Tensor) -> dict[str, Motion]:
    """A walk and punches by parts, refined, and performed at once."""
    generator = torch.Generator().manual_seed(2)
    draws = [draw(name, generator) for name in ("walk", "punching")]
    clips = [perform(each, FRAMES, rest) for each in draws]
    made = compose_by_parts(clips, [LEGS, PUNCHING], rest, Decoupler(Body.free("light"), load_mae()))
    return {
        "walk": clips[0],
        "punching": clips[1],
        "by parts": made.coupling.motion,
        "by parts, refined": made.motion,
        "performed at once": perform_together(*draws, FRAMES, rest),
    }


def save(path: Path, picture: torch.Tensor) -> None:
    save_png(path, picture)
    with Image.open(path) as drawn:  # a palette of 256 colours is enough, at a third of the size
        drawn.quantize(256).save(path, optimize=True)


def main() -> None:
    rest, body = Body.free("light").rest_joints, Body.free("full")
    generator = torch.Generator().manual_seed(4)
    clips = [perform(draw(name, generator), FRAMES, rest) for name in ("run", "wave-right-hand")]
    save(DOCS / "by-parts.png", sheet(coupled(*clips, rest), body))
    save(DOCS / "by-parts-refined.png", sheet(refined(rest), body))


if __name__ == "__main__":
    main()
