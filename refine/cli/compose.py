"""``refine compose``: two clips in, one motion out."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.composition import Composition


@dataclass(frozen=True)
class Compose:
    """Compose two motions into one and refine it.

    Both run from their first frame, at A's frame rate, for as long as the shorter of them.

    Example: refine compose walk.bvh wave.bvh -o both.bvh --report pictures
    Example: refine compose - wave-left-hand -o - < walk.bvh > both.bvh
    """

    a: Positional[str]
    """First clip: a motion file, - for standard input, or the name of a built-in action."""
    b: Positional[str]
    """Second clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, its format by its suffix (.bvh, .npz and more); - writes BVH to standard output, -.npz another."""
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
    output: Printed = AS_LINES

    def run(self) -> Result:
        from refine.cli.inputs import (
            bar,
            body_of,
            check_lam,
            check_motion_output,
            judge_of,
            output_path,
            pair_of,
            refinement_of,
        )
        from refine.composition import Composition, compose
        from refine.coupling import couple
        from refine.formats.files import save_motion
        from refine.report import write_report
        from renderers.outputs import refuse_existing, replacing_folder

        check_lam(self.lam)
        config = refinement_of(self.steps, self.seed)
        check_motion_output(self.out, self.force)
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
        with output_path(self.out) as path:
            save_motion(composition.motion, path, body_of(self.body, "full"), force=True)
        return self._result(composition)

    def _result(self, composition: "Composition") -> Result:
        from refine.report import losses
        from refine.stages import answers_for

        motion, traces = composition.motion, composition.traces()
        values: dict[str, Any] = {"made": composition.made, "frames": len(motion), "fps": motion.fps}
        lines, files = [f"{self.out}  {len(motion)} frames at {motion.fps:g} fps"], [self.out]
        if traces:
            values["decoupling_loss"] = {name: losses(trace)["total"] for name, trace in traces.items()}
            totals = (f"{loss:.6f} {name}" for name, loss in values["decoupling_loss"].items())
            lines.append("decoupling loss  " + ", ".join(totals))
            references = next(iter(traces.values())).references
            for name, reference in zip(("A", "B"), references, strict=True):
                owned = answers_for(reference.owned.answers[0]).removeprefix(", ")
                lines.append(f"{name} {owned}".strip())
                values[name.lower()] = owned
        if self.report:
            lines.append(str(self.report / "report.html"))
            files.append(self.report / "report.html")
        return Result("\n".join(lines), tuple(files), values)
