"""``refine demo``: the whole loop on two built-in actions, nothing to download."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

FPS, FILM_FPS, FILM_SIZE = 30.0, 15.0, (300, 250)
PRINTED_FILES = ("report.html", "motions.png", "film.mp4", "composition.bvh", "report.json")


@dataclass(frozen=True)
class Demo:
    """Compose and refine two built-in actions; writes pictures, a film, a BVH and numbers.

    Example: refine demo --out refine-demo
    """

    out: Annotated[Path, arg(aliases=["-o"])] = Path("refine-demo")
    """Folder to write; replaced as a whole with --force."""
    actions: tuple[str, str] = ("walk", "wave-left-hand")
    """Any two built-in actions."""
    seconds: float = 3.0
    """Length of the motions."""
    steps: int | None = None
    """Refinement steps; 0 only couples, None leaves their number to the engine."""
    mae: Path | None = None
    """Weights of `refine train mae` (.safetensors), or an official MAE with its decoder (mae_visualize_*.pth, slow
    without a graphics card), instead of the shipped ones."""
    force: bool = False
    """Replace the folder if something is in it."""
    seed: int = 0
    """Of the actions and of refinement."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        import time

        import torch

        from refine.cli.inputs import bar, body_of, check_action, judge_of, refinement_of
        from refine.composition import compose
        from refine.drawing import film
        from refine.formats.files import save_motion
        from refine.metrics import mean_joint_error
        from refine.report import write_report
        from refine.synthetic import draw, perform, perform_together
        from renderers.images import contact_sheet, save_mp4
        from renderers.outputs import refuse_existing, replacing_folder

        if not 0.1 <= self.seconds <= 60:
            raise UserError("--seconds", f"expected 0.1 to 60, got {self.seconds:g}")
        config = refinement_of(self.steps, self.seed)
        refuse_existing(self.out, self.force, folder=True)
        for name in self.actions:
            check_action("--actions", name)
        started = time.monotonic()
        body, drawn_body = body_of(None), body_of(None, "full")
        random, frames = torch.Generator().manual_seed(self.seed), round(self.seconds * FPS)
        draws = [draw(name, random, FPS) for name in self.actions]
        i, j = (perform(drawn, frames, body.rest_joints) for drawn in draws)
        decoupler = judge_of(body, self.mae)
        with bar(config.steps, "refine") as progress:
            composition = compose(i, j, decoupler, refinement=config, progress=progress)

        true = perform_together(*draws, frames, body.rest_joints).joints(body.rest_joints)
        made = composition.motions()
        error = {name: mean_joint_error(motion.joints(body.rest_joints), true) for name, motion in made.items()}
        with bar(round(self.seconds * FILM_FPS), "draw") as progress:
            captions = [*self.actions, *made]
            moments = film([i, j, *made.values()], drawn_body, FILM_SIZE, FILM_FPS, progress=progress)
            pictures = [contact_sheet([moment], column_captions=captions, gap=0) for moment in moments]
        with replacing_folder(self.out) as partial:
            extra = {"metres_from_true_composition": error, "seconds": round(time.monotonic() - started, 1)}
            report = write_report(partial, composition, drawn_body, 3, extra)
            save_mp4(partial / "film.mp4", pictures, FILM_FPS)
            save_motion(composition.motion, partial / "composition.bvh", body)

        seconds, loss = time.monotonic() - started, report["decoupling_loss"]
        lines = [f"{' + '.join(self.actions)}, {frames} frames, {seconds:.0f} s"]
        for name in made:
            lines.append(
                f"{name}: decoupling loss {loss[name]['total']:.6f}, "
                f"{error[name] * 100:.2f} cm from the true composition"
            )
        files = [self.out / name for name in PRINTED_FILES]
        values = {"actions": self.actions, "frames": frames, "decoupling_loss": loss, **extra}
        return Result("\n".join([*lines, *map(str, files)]), tuple(files), values)
