"""``refine compose``: two clips in, or more, one motion out."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from refine.cli.by_parts import MOST
from refine.cli.labelling import BY_DEFAULT, Chosen
from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.composition import Composition
    from refine.refinement import RefinementConfig

Told = tuple[list[str], dict[str, Any]]  # lines for people and values for programs, of texts


@dataclass(frozen=True)
class Compose:
    """Compose two motions into one and refine it.

    Both run at A's frame rate, for as long as the shorter of them.

    Example: refine compose walk.bvh wave.bvh -o both.bvh --report pictures
    Example: refine compose - wave-left-hand -o - < walk.bvh > both.bvh
    Example: refine compose a.bvh b.bvh --by parts --text-a "walk forwards" --text-b "wave with the right hand" -o c.bvh
    Example: refine compose walk wave-left-hand --by parts --more nod.bvh --text-more "nod the head" -o three.bvh
    """

    a: Positional[str]
    """First clip: a motion file, - for standard input, or the name of a built-in action."""
    b: Positional[str]
    """Second clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, its format by its suffix (.bvh, .npz and more); - writes BVH to standard output, -.npz another."""
    by: Literal["energies", "parts"] = "energies"
    """How they become one: each joint blended by how much either moves it, or each body part whole from the action
    whose text is about it, where the action that is about fewer parts wins."""
    text_a: str | None = None
    """With --by parts: what A does, such as "walk forwards", or its parts themselves, such as "torso, right arm";
    unless given, what its label says."""
    text_b: str | None = None
    """The same of B."""
    more: tuple[str, ...] = ()
    """With --by parts: a third clip, a fourth and so on, to be composed with A and B."""
    text_more: tuple[str, ...] = ()
    """What each of --more does, in their order; unless given, what their labels say."""
    labelling: Chosen = BY_DEFAULT
    trim: Literal["start", "middle"] | None = None
    """What is kept of longer clips: from their first frames, or their middles; none is the start by energies and the
    middle by parts."""
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
            body_of,
            check_lam,
            check_motion_output,
            output_path,
            refinement_of,
        )
        from refine.formats.files import save_motion
        from refine.report import write_report
        from renderers.outputs import refuse_existing, replacing_folder

        check_lam(self.lam)
        self._check_by()
        refinement = refinement_of(self.steps, self.seed)
        check_motion_output(self.out, self.force)
        if self.report:
            if self.out in (self.report, *self.report.parents):
                raise UserError(self.report, f"cannot be a folder while {self.out} is a file", "give --report another")
            refuse_existing(self.report, self.force, folder=True)

        composition, told = (self._by_parts if self.by == "parts" else self._by_energies)(refinement)
        if self.report:  # before the motion, which may be wanted in the very folder that is replaced here
            with replacing_folder(self.report) as partial:
                write_report(partial, composition, body_of(self.body, "full"))
        with output_path(self.out) as path:
            save_motion(composition.motion, path, body_of(self.body, "full"), force=True)
        return self._result(composition, told)

    def _check_by(self) -> None:
        """Refuse flags that the other way of composing has."""
        if self.by == "parts" and self.lam != 0.5:
            raise UserError("--lam", "weighs energies, and parts are not weighed", "leave it out, or --by parts")
        if self.by == "energies":
            texts = {"--text-a": self.text_a, "--text-b": self.text_b, "--text-more": self.text_more}
            given = [flag for flag, value in {"--more": self.more, **texts}.items() if value]
            for flag in [*given, *self.labelling.given()]:
                raise UserError(flag, "is for composing by parts", "add --by parts, or leave it out")
        if self.text_more and len(self.text_more) != len(self.more):
            problem = f"{len(self.text_more)} texts for the {len(self.more)} clips of --more"
            raise UserError("--text-more", problem, "give one for each, or none")

        if len(self.more) > MOST - 2:
            raise UserError("--more", f"{len(self.more)} clips", f"give at most {MOST - 2}")

    def _by_energies(self, refinement: "RefinementConfig") -> tuple["Composition", Told]:
        from refine.cli.inputs import bar, body_of, clips_of, judge_of
        from refine.composition import Composition, compose
        from refine.coupling import couple

        body = body_of(self.body)
        i, j = clips_of((self.a, self.b), body.rest_joints, self.seed, self.trim == "middle")
        if refinement.steps == 0 and self.report is None:
            coupled = couple(i, j, body.rest_joints, self.lam)
            return Composition(i, j, coupled, coupled.motion, made="coupled"), ([], {})
        with bar(refinement.steps, "refine") as progress:
            return compose(i, j, judge_of(body, self.mae), self.lam, None, refinement, progress), ([], {})

    def _by_parts(self, refinement: "RefinementConfig") -> tuple["Composition", Told]:
        from refine.cli.by_parts import labelled_texts, lines_of, say_who_wins, texts_of, values_of
        from refine.cli.inputs import bar, body_of, clips_of, judge_of
        from refine.composition_by_parts import compose_by_parts
        from refine.coupling_by_parts import divide
        from refine.refinement import BY_PARTS

        refinement = replace(BY_PARTS, steps=refinement.steps, seed=refinement.seed)
        body, centred = body_of(self.body), self.trim != "start"
        names = (self.a, self.b, *self.more)
        clips = clips_of(names, body.rest_joints, self.seed, centred)
        given = (self.text_a, self.text_b, *(self.text_more or [None] * len(self.more)))
        flags = ("--text-a", "--text-b", *["--text-more"] * len(self.more))
        labelled = labelled_texts(texts_of(clips, names, given, flags), self.labelling.labeller())
        division = divide([each.parts for each in labelled])
        say_who_wins(division)
        judge = judge_of(body, self.mae) if refinement.steps or self.report else None
        with bar(refinement.steps * (len(clips) - 1), "refine") as progress:
            parts = [each.parts for each in labelled]
            made = compose_by_parts(clips, parts, body.rest_joints, judge, refinement, centred, progress)
        return made, (lines_of(labelled, division), values_of(labelled, division))

    def _result(self, composition: "Composition", told: Told) -> Result:
        from refine.report import losses
        from refine.stages import answers_for

        motion, traces = composition.motion, composition.traces()
        values: dict[str, Any] = {"made": composition.made, "by": self.by, "frames": len(motion), "fps": motion.fps}
        lines, files = [f"{self.out}  {len(motion)} frames at {motion.fps:g} fps", *told[0]], [self.out]
        values |= told[1]
        if traces:
            values["decoupling_loss"] = {name: losses(trace)["total"] for name, trace in traces.items()}
            totals = (f"{loss:.6f} {name}" for name, loss in values["decoupling_loss"].items())
            lines.append("decoupling loss  " + ", ".join(totals))
            references = next(iter(traces.values())).references
            sides = (composition.i.label, composition.j.label) if self.more else ("A", "B")
            for key, name, reference in zip(("a", "b"), sides, references, strict=True):
                owned = answers_for(reference.owned.answers[0]).removeprefix(", ")
                lines.append(f"{name} {owned}".strip())
                values[key] = owned
        if self.report:
            lines.append(str(self.report / "report.html"))
            files.append(self.report / "report.html")
        return Result("\n".join(lines), tuple(files), values)
