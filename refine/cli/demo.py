"""``refine demo``: the whole loop on two built-in actions, nothing to download."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

FPS, FILM_FPS, FILM_SIZE = 30.0, 15.0, (300, 250)


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
    """Refinement steps; none leaves their number to the engine."""
    mae: Path | None = None
    """Weights of `refine train mae` (.safetensors) instead of the shipped ones."""
    force: bool = False
    """Replace the folder if something is in it."""
    seed: int = 0
    """Of the actions and of refinement."""

    def run(self) -> None:
        import time

        import torch

        from refine.cli.inputs import bar, body_of, judge_of, refinement_of
        from refine.composition import compose
        from refine.drawing import film
        from refine.formats.files import save_motion
        from refine.metrics import mean_joint_error
        from refine.report import write_report
        from refine.synthetic import ACTIONS, draw, perform, perform_together
        from renderers.checks import check_known
        from renderers.images import contact_sheet, save_mp4
        from renderers.outputs import refuse_existing, replacing_folder

        config = refinement_of(self.steps, self.seed)
        refuse_existing(self.out, self.force)
        for name in self.actions:
            check_known("--actions", name, ACTIONS)
        started = time.monotonic()
        body, drawn_body = body_of(None), body_of(None, "full")
        random, frames = torch.Generator().manual_seed(self.seed), round(self.seconds * FPS)
        draws = [draw(name, random, FPS) for name in self.actions]
        i, j = (perform(drawn, frames, body.rest_joints) for drawn in draws)
        decoupler = judge_of(body, self.mae)
        with bar(config.steps, "refine") as progress:
            composition = compose(i, j, decoupler, refinement=config, progress=progress)

        true = perform_together(*draws, frames, body.rest_joints).joints(body.rest_joints)
        coupled, refined = composition.coupling.motion, composition.motion
        error = {
            name: mean_joint_error(motion.joints(body.rest_joints), true)
            for name, motion in (("coupled", coupled), ("refined", refined))
        }
        with bar(round(self.seconds * FILM_FPS), "draw") as progress:
            captions = [*self.actions, "coupled", "refined"]
            moments = film([i, j, coupled, refined], drawn_body, FILM_SIZE, FILM_FPS, progress=progress)
            pictures = [contact_sheet([moment], column_captions=captions, gap=0) for moment in moments]
        with replacing_folder(self.out) as partial:
            extra = {"metres_from_true_composition": error, "seconds": round(time.monotonic() - started, 1)}
            report = write_report(partial, composition, drawn_body, 3, extra)
            save_mp4(partial / "film.mp4", pictures, FILM_FPS)
            save_motion(composition.motion, partial / "composition.bvh", body.rest_joints)

        loss = {name: terms["total"] for name, terms in report["decoupling_loss"].items()}
        print(f"{' + '.join(self.actions)}, {frames} frames, {time.monotonic() - started:.0f} s")
        print("                           coupled   refined")
        print(f"decoupling loss            {loss['coupled']:7.5f}   {loss['refined']:7.5f}")
        print(f"cm from true composition   {error['coupled'] * 100:7.2f}   {error['refined'] * 100:7.2f}")
        for name in ("report.html", "motions.png", "film.mp4", "composition.bvh", "report.json"):
            print(self.out / name)
