"""``refine compose``: two clips in, one motion out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from renderers.checks import UserError


@dataclass(frozen=True)
class Compose:
    """Compose two motions into one and refine it.

    Both run from their first frame, at A's frame rate, for as long as the shorter of them.

    Example: refine compose walk.bvh wave.bvh -o both.bvh --report pictures
    """

    a: Positional[str]
    """First clip: a .bvh or .npz file, or the name of a built-in action."""
    b: Positional[str]
    """Second clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, .bvh or .npz."""
    lam: float = 0.5
    """Share of A where both move alike, 0 to 1."""
    steps: int | None = None
    """Refinement steps; 0 only couples, None leaves their number to the engine."""
    body: Path | None = None
    """Your SMPL file (.npz or .pkl) instead of the free body."""
    mae: Path | None = None
    """Weights of `refine train mae` (.safetensors), or an official MAE with its decoder (mae_visualize_*.pth, slow
    without a graphics card), instead of the shipped ones."""
    report: Path | None = None
    """Folder for report.html, pictures of every stage and report.json; replaced as a whole with --force."""
    force: bool = False
    """Replace outputs that are already there."""
    seed: int = 0
    """Of the frames that refinement draws, and of built-in actions."""

    def run(self) -> None:
        from refine.cli.inputs import bar, body_of, check_lam, judge_of, pair_of, refinement_of
        from refine.composition import Composition, compose
        from refine.coupling import couple
        from refine.formats.files import check_suffix, save_motion
        from refine.report import losses, write_report
        from refine.stages import answers_for
        from renderers.outputs import refuse_existing, replacing_folder

        check_suffix(self.out)
        check_lam(self.lam)
        config = refinement_of(self.steps, self.seed)
        refuse_existing(self.out, self.force)
        if self.report:
            if self.out in (self.report, *self.report.parents):
                raise UserError(self.report, f"cannot be a folder while {self.out} is a file", "give --report another")
            refuse_existing(self.report, self.force, folder=True)

        body = body_of(self.body)
        i, j = pair_of(self.a, self.b, body.rest_joints, self.seed)
        if config.steps == 0 and self.report is None:
            coupled = couple(i, j, body.rest_joints, self.lam)
            composition = Composition(i, j, coupled, coupled.motion, made="coupled")
        else:
            with bar(config.steps, "refine") as progress:
                composition = compose(i, j, judge_of(body, self.mae), self.lam, None, config, progress)
        if self.report:  # before the motion, which may be wanted in the very folder that is replaced here
            with replacing_folder(self.report) as partial:
                write_report(partial, composition, body_of(self.body, "full"))
        save_motion(composition.motion, self.out, body, force=True)
        print(f"{self.out}  {len(composition.motion)} frames at {composition.motion.fps:g} fps")
        traces = composition.traces().items()
        if traces:
            print("decoupling loss ", ", ".join(f"{losses(trace)['total']:.6f} {name}" for name, trace in traces))
            references = next(iter(composition.traces().values())).references
            for name, reference in zip(("A", "B"), references, strict=True):
                print(f"{name}{answers_for(reference.owned.answers[0]).removeprefix(',')}")
        if self.report:
            print(self.report / "report.html")
