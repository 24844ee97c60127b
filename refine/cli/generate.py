"""``refine generate``: motions from a trained generator."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from renderers.checks import UserError


@dataclass(frozen=True)
class Generate:
    """Make motions of one action, or compositions of several, with a trained generator.

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

    def run(self) -> None:
        import torch

        from refine.cli.inputs import body_of
        from refine.drawing import strip
        from refine.formats.files import save_motion
        from refine.generator import generate_motions
        from renderers.images import contact_sheet, save_png
        from renderers.outputs import refuse_existing, replacing_folder
        from train.generator import load_generator

        if self.count < 1:
            raise UserError("-n", f"expected 1 or more, got {self.count}")
        refuse_existing(self.out, self.force)
        body = body_of(None)
        random = torch.Generator().manual_seed(self.seed)
        motions = generate_motions(
            load_generator(self.model), self.actions, self.count, self.seconds, body.rest_joints, random
        )
        rows = [[row] for row in strip(motions[:8], body, height=180)]
        with replacing_folder(self.out) as partial:
            for number, motion in enumerate(motions):
                save_motion(motion, partial / f"{number:03d}.bvh", body.rest_joints)
            save_png(partial / "motions.png", contact_sheet(rows, title=" + ".join(self.actions)))
        print(f"{self.out}  {len(motions)} motions of {self.seconds:g} s, drawn in motions.png")
