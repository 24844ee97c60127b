"""``refine generate``: motions from a trained generator."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

MOST, DRAWN = 1000, 8  # motions made by one command, and how many of them are drawn


@dataclass(frozen=True)
class Generate:
    """Make motions of one action, or compositions of several, with a trained generator.

    Writes a BVH for each, named after its actions, and motions.png with the first eight, one row each.

    Example: refine generate --actions walk wave-both-hands -n 8 --model runs/generator -o motions
    """

    actions: tuple[str, ...]
    """Labels that the generator was trained on."""
    model: Path
    """Run folder, or .safetensors file, of `refine train generator`."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write; replaced as a whole with --force."""
    count: Annotated[int, arg(name="n", aliases=["-n"])] = 1
    """How many motions."""
    seconds: float = 2.0
    """Length of each."""
    force: bool = False
    """Replace the folder if something is in it."""
    seed: int = 0
    """Of the latent draws."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        import torch

        from refine.cli.inputs import body_of
        from refine.drawing import strip
        from refine.formats.files import save_motion
        from refine.generator import generate_motions
        from renderers.images import contact_sheet, save_png
        from renderers.outputs import refuse_existing, replacing_folder
        from train.generator import load_generator

        if not 1 <= self.count <= MOST:
            raise UserError("-n", f"expected 1 to {MOST}, got {self.count}")
        refuse_existing(self.out, self.force, folder=True)
        body = body_of(None)
        random = torch.Generator().manual_seed(self.seed)
        motions = generate_motions(
            load_generator(self.model), self.actions, self.count, self.seconds, body.rest_joints, random
        )
        rows = [[row] for row in strip(motions[:DRAWN], body, height=180)]
        with replacing_folder(self.out) as partial:
            names = [f"{file_stem(motion.label)}_{number:03d}.bvh" for number, motion in enumerate(motions)]
            for name, motion in zip(names, motions, strict=True):
                save_motion(motion, partial / name, body)
            save_png(partial / "motions.png", contact_sheet(rows, title=" + ".join(self.actions)))
        said = f"{self.out}  {len(motions)} motions of {self.seconds:g} s, drawn in motions.png"
        values = {"actions": self.actions, "seconds": self.seconds}
        return Result(said, tuple(self.out / name for name in ("motions.png", *names)), values)


def file_stem(label: str) -> str:
    """The label as part of a file name; labels come from other people's data."""
    return re.sub(r"[^\w+-]+", "-", label)[:100]
