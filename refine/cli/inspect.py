"""``refine inspect``: the loop's every stage, to look at."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError


@dataclass(frozen=True)
class Inspect:
    """Show every stage of the loop: joints and energies, attention, kept patches, inpainting, difference.

    Compares the coupled motion with the refined one, or with any other composition of A and B. Writes report.html,
    which explains its pictures, the same pictures as PNG, and report.json with energies, weights and losses.

    Example: refine inspect walk wave-both-hands -o pictures
    """

    a: Positional[str]
    """First clip: a motion file, - for standard input, or the name of a built-in action."""
    b: Positional[str]
    """Second clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write; replaced as a whole with --force."""
    composition: str | None = None
    """A motion to judge in place of the refined one, frame for frame with A and B."""
    frames: int = 4
    """Moments to draw, evenly spread."""
    lam: float = 0.5
    """Share of A where both move alike, 0 to 1."""
    steps: int | None = None
    """Refinement steps; 0 shows the coupled motion alone, None leaves their number to the engine."""
    body: Path | None = None
    """Your SMPL file instead of the free body."""
    mae: Path | None = None
    """Weights of `refine train mae` (.safetensors), or an official MAE with its decoder (mae_visualize_*.pth, slow
    without a graphics card), instead of the shipped ones."""
    force: bool = False
    """Replace the folder if something is in it."""
    seed: int = 0
    """Of the frames that refinement draws, and of built-in actions."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from refine.cli.inputs import bar, body_of, check_lam, clip_of, judge_of, pair_of, refinement_of
        from refine.composition import Composition, compose, judge
        from refine.coupling import couple
        from refine.motion import crop, resample
        from refine.report import write_report
        from renderers.outputs import refuse_existing, replacing_folder

        check_lam(self.lam)
        if not 1 <= self.frames <= 100:
            raise UserError("--frames", f"expected 1 to 100, got {self.frames}")
        config = refinement_of(self.steps, self.seed)
        refuse_existing(self.out, self.force, folder=True)
        body = body_of(self.body)
        i, j = pair_of(self.a, self.b, body.rest_joints, self.seed)
        decoupler = judge_of(body, self.mae)
        if self.composition is None:
            with bar(config.steps, "refine") as progress:
                composition = compose(i, j, decoupler, self.lam, None, config, progress)
        else:
            given = resample(clip_of(self.composition, body.rest_joints, self.seed), i.fps)
            frames = min(len(given), len(i))
            i, j, given = (crop(clip, 0, frames) for clip in (i, j, given))
            coupled = couple(i, j, body.rest_joints, self.lam)
            traces = [judge(motion, i, j, decoupler) for motion in (coupled.motion, given)]
            composition = Composition(i, j, coupled, given, *traces, made="given")
        with replacing_folder(self.out) as partial:
            report = write_report(partial, composition, body_of(self.body, "full"), self.frames)
        page = self.out / "report.html"
        return Result(str(page), (page, self.out / "report.json"), {"decoupling_loss": report["decoupling_loss"]})
