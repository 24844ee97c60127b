"""``refine generate``: motions from a trained generator."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.motion import Motion
    from renderers.body import Body

MOST, DRAWN = 1000, 8  # motions made by one command, and how many of them are drawn


@dataclass(frozen=True)
class Generate:
    """Make motions with a trained model: of labels that it has learned, or of any description.

    --actions asks a generator of `refine train generator` for one action, or several at once. --text asks a model of
    `refine train text` or `refine train text-diffusion` for what a sentence says, or for what several texts say, all at
    once. Writes a BVH for each, and motions.png with the first eight, one row each.

    Example: refine generate --actions walk wave-both-hands -n 8 --model runs/generator -o motions
    Example: refine generate --text "walk while waving with the right hand" --seconds 4 --model runs/text -o motions
    Example: refine generate --text "walk forwards" "wave" "look up" --by parts --model runs/text -o motions
    """

    model: Path
    """Run folder, or .safetensors file."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write; replaced as a whole with --force."""
    actions: tuple[str, ...] = ()
    """Labels that the generator was trained on."""
    text: tuple[str, ...] = ()
    """Any sentence, or one text for each of several actions that are done at once."""
    conjunction: str = "while"
    """How several texts are said in one sentence: while, during, simultaneously, comma, "at the same time", or one that
    training does not draw: "in parallel", whilst, synchronously."""
    by: Literal["sentence", "parts"] = "sentence"
    """Several texts as one sentence; or each made alone, and put together by the parts of the body that it is about."""
    encoder: Path | None = None
    """Local Hugging Face folder of the text encoder that the model was trained with; none takes MiniLM."""
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
        from refine.cli.inputs import body_of
        from refine.drawing import strip
        from refine.formats.files import save_motion
        from renderers.images import contact_sheet, save_png
        from renderers.outputs import refuse_existing, replacing_folder

        if not 1 <= self.count <= MOST:
            raise UserError("-n", f"expected 1 to {MOST}, got {self.count}")
        if bool(self.actions) == bool(self.text):
            raise UserError("refine generate", "takes either --actions or --text", 'such as --text "walk and wave"')
        refuse_existing(self.out, self.force, folder=True)
        body = body_of(None)
        motions = self.described() if self.text else self.named(body)
        rows = [[row] for row in strip(motions[:DRAWN], body, height=180)]
        with replacing_folder(self.out) as partial:
            names = [f"{file_stem(motion.label)}_{number:03d}.bvh" for number, motion in enumerate(motions)]
            for name, motion in zip(names, motions, strict=True):
                save_motion(motion, partial / name, body)
            title = motions[0].label if self.text else " + ".join(self.actions)
            save_png(partial / "motions.png", contact_sheet(rows, title=title))
        said = f"{self.out}  {len(motions)} motions of {self.seconds:g} s, drawn in motions.png"
        values = ({"text": self.text} if self.text else {"actions": self.actions}) | {"seconds": self.seconds}
        return Result(said, tuple(self.out / name for name in ("motions.png", *names)), values)

    def named(self, body: "Body") -> "list[Motion]":
        import torch

        from refine.generator import generate_motions
        from train.generator import load_generator

        random = torch.Generator().manual_seed(self.seed)
        model = load_generator(self.model)
        return generate_motions(model, self.actions, self.count, self.seconds, body.rest_joints, random)

    def described(self) -> "list[Motion]":
        import torch

        from refine.cli.by_parts import labelled_texts
        from refine.text.generation import frames_of, generate_by_parts, generate_described
        from refine.text.sentences import combine
        from train.text_models import encoder_of, load_text_model

        combine(self.text, self.conjunction)  # refuses what cannot be said before anything is read
        model = load_text_model(self.model)
        encoder, random = encoder_of(model, self.encoder), torch.Generator().manual_seed(self.seed)
        texts = [self.text] * self.count
        frames = [frames_of(self.seconds, model.config.fps)] * self.count
        if self.by == "sentence":
            return generate_described(model, encoder, texts, frames, random, self.conjunction)
        parts = [each.parts for each in labelled_texts(self.text)]
        return generate_by_parts(model, encoder, texts, [parts] * self.count, frames, random, self.conjunction)


def file_stem(label: str) -> str:
    """The label as part of a file name; labels come from other people's data."""
    return re.sub(r"[^\w+-]+", "-", label)[:100]
