"""``refine data texts``: clips and what people say of them, as one folder."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from refine.cli.data import NAMED
from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.text.corpus import Counts
    from refine.text.described import Described

ANNOTATED = ("babel", "kit", "humanml3d")
CLIPS = ("bandai-namco", "labels")
# Which sources a flag is for.
FLAGS = {
    "motions": ANNOTATED,
    "clips": ("builtin",),
    "seconds": ("builtin",),
    "fps": ("builtin", *ANNOTATED),
    "max_actions": ("babel",),
    "alone": ("babel",),
    "extra": ("babel",),
    "nearest_lower": ("babel",),
    "unmirrored": ("kit", "humanml3d"),
}
RANGES = {"clips": (3, 10_000), "seconds": (0.5, 600), "fps": (1, 1000), "max_actions": (1, 100)}
ORDINALS = {1: "of one action", 2: "of two at once"}


@dataclass(frozen=True)
class DataTexts:
    """Put clips together with what people say of them, for text to motion: packed clips, and texts.json beside them.

    builtin performs the built-in actions, alone and truly two at once, and needs nothing. bandai-namco describes that
    data's clips by their names, labels any clips by the words of their labels. babel, kit and humanml3d read
    annotations of AMASS, whose folder --motions names. What is left out is named on stderr.

    Example: refine data texts builtin --out texts

    Example: refine data texts bandai-namco Bandai-Namco-Research-Motiondataset-2 --out texts

    Example: refine data texts babel babel_v1-0_release --motions AMASS --out texts
    """

    name: Positional[Literal["builtin", "bandai-namco", "labels", "babel", "kit", "humanml3d"]]
    """What is put together."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write."""
    sources: Positional[tuple[Path, ...]] = ()
    """Clips: folders of motion files, or what `refine data import` packed. Or one folder of annotations: BABEL's with
    train.json, KIT-ML's or HumanML3D's with annotations.json and splits, HumanML3D's own with texts and index.csv."""
    motions: Path | None = None
    """Folder of AMASS, with ACCAD, BMLmovi, CMU, KIT and so on in it."""
    clips: int = 20
    """Of builtin: clips of each action, of which one in five each is for val and for test."""
    seconds: float = 4.0
    """Of builtin: length of a clip."""
    fps: float = 30.0
    """Frames a second of builtin clips and of those of AMASS; others keep theirs."""
    max_actions: int = 4
    """Of babel: most actions at once; stretches with more are left out."""
    alone: bool = False
    """Of babel: take as single actions only stretches that overlap no other."""
    extra: bool = False
    """Of babel: read extra_train.json and extra_val.json as well."""
    nearest_lower: bool = False
    """Of babel: take every frame from the one before it instead of between two, as SINC's published code does."""
    unmirrored: bool = False
    """Of kit and humanml3d: leave out the mirrored motions, of which there is one for each."""
    force: bool = False
    """Replace the folder, with everything in it, if it is there."""
    seed: int = 0
    """Of builtin performances, and of the split of bandai-namco and labels."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from tqdm import tqdm

        from refine.cli.inputs import say
        from refine.text.corpus import save_corpus
        from renderers.outputs import refuse_existing

        self._check_flags()
        refuse_existing(self.out, self.force, folder=True)
        left_out: list[str] = []
        noted: list[str] = []
        items = tqdm(self._items(left_out, noted), desc="write", unit="clip", disable=None, leave=False)
        counts = save_corpus(self.out, items, self._about(), left_out)
        for line in noted:
            say(f"refine: {line}")
        for line in left_out[:NAMED]:
            say(f"refine: left out {line}")
        if len(left_out) > NAMED:
            say(f"refine: and {len(left_out) - NAMED:,} more, see left_out in {self.out / 'texts.json'}")
        return Result(
            "\n".join(self._lines(counts)), (self.out,), {**counts.values(), "noted": noted, "left_out": left_out}
        )

    def _check_flags(self) -> None:
        default = {field.name: field.default for field in fields(self)}
        for flag, names in FLAGS.items():
            if getattr(self, flag) != default[flag] and self.name not in names:
                word = f"--{flag.replace('_', '-')}"
                raise UserError(word, f"is for {' and '.join(names)}, not for {self.name}", "leave it out")
        for flag, (low, high) in RANGES.items():
            if not low <= (value := getattr(self, flag)) <= high:
                raise UserError(f"--{flag.replace('_', '-')}", f"expected {low} to {high}, got {value}")
        if self.name == "builtin" and self.sources:
            raise UserError(self.name, "is performed, not read", "leave the source out")
        if self.name in CLIPS and not self.sources:
            raise UserError(self.name, "is made of clips that do not ship with Refine", "name their folder")
        if self.name in ANNOTATED and len(self.sources) != 1:
            raise UserError(self.name, "is read from one folder of annotations", "name it")
        if self.name in ANNOTATED and self.motions is None:
            raise UserError(self.name, "annotates motions of AMASS", "say where these are with --motions")
        for path in (*self.sources, *([self.motions] if self.motions else [])):
            if not path.exists():
                raise UserError(path, "does not exist", "check the path")

    def _items(self, left_out: list[str], noted: list[str]) -> "Iterable[Described]":
        from functools import partial

        from tqdm import tqdm

        from refine.cli.inputs import body_of

        progress = partial(tqdm, disable=None, leave=False)
        if self.name == "builtin":
            from refine.text.builtin import builtin_corpus

            performing = partial(progress, desc="perform")
            rest_joints = body_of(None).rest_joints
            return builtin_corpus(rest_joints, self.seed, self.clips, self.fps, self.seconds, performing)
        if self.name == "babel":
            from refine.formats.babel import BabelConfig
            from refine.text.annotated import babel_corpus

            babel = BabelConfig(
                self.fps,
                max_actions=self.max_actions,
                alone=self.alone,
                extra=self.extra,
                nearest_lower=self.nearest_lower,
            )
            return babel_corpus(self.sources[0], self.motions, babel, left_out)
        if self.name in ANNOTATED:
            from refine.formats.tmr import AnnotatedConfig
            from refine.text.annotated import annotated_corpus

            annotated = AnnotatedConfig(self.fps, mirrored=not self.unmirrored)
            return annotated_corpus(self.sources[0], self.motions, annotated, left_out)

        from train.recipes import read_source

        clips = []
        for source in self.sources:
            read = read_source(source, body_of(None).rest_joints, progress=partial(progress, desc="read"))
            clips += read.motions
            left_out += map(str, read.refused)
        if self.name == "labels":
            from refine.text.by_labels import described_by_labels

            return described_by_labels(clips, self.seed, lambda error: left_out.append(str(error)))
        from refine.text.bandai_namco import described_clips

        return described_clips(clips, self.seed, noted)

    def _about(self) -> dict[str, Any]:
        """Where the set is from, without where that lies."""
        flags = {flag: getattr(self, flag) for flag, names in FLAGS.items() if self.name in names and flag != "motions"}
        return {"name": self.name, "sources": [source.name for source in self.sources], "seed": self.seed, **flags}

    def _lines(self, counts: "Counts") -> list[str]:
        lines = []
        for split, shown in counts.by_split.items():
            parts = [f"{shown[n]:,} {ORDINALS.get(n, f'of {n}')}" for n in sorted(shown)]
            if parts:
                lines.append(f"{split:5}  {', '.join(parts)}")
        lines.append(
            f"{self.out}  {counts.clips:,} clips, {counts.frames:,} frames in {counts.seconds / 60:,.1f} minutes, "
            f"{len(counts.texts):,} different descriptions"
        )
        return lines
