"""``refine data``: a folder of clips as one packed file, and benchmarks."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

NAMED = 40  # clips that are left out and named one by one


@dataclass(frozen=True)
class ImportData:
    """Read motion files, put them on SMPL's joints and pack them: into one file, or for many into a folder of files.

    Labels come from the file names, or from a CSV table that may cut a file into pieces. What cannot be read, holds
    NaN, or is to the last bit another clip of the same label is left out and named on stderr. ACTOR's packages are read
    as well: the file humanact12poses.pkl, and the folder uestc, which needs --labels, being large.

    Example: refine data import clips --out clips.npz
    """

    source: Positional[Path]
    """Folder that is searched, with its subfolders, for motion files; or packed clips, or one of ACTOR's packages."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Packed file to write, .npz; or a folder, for more than a gigabyte."""
    label_pattern: str | None = None
    """Regular expression for a whole file name without suffix, with a group (?P<label>...)."""
    labels_file: Path | None = None
    """CSV table with the headings file,label and, to cut files into pieces, start,end in seconds or
    start_frame,end_frame; files that it does not name are left out."""
    labels: tuple[str, ...] = ()
    """Keep only clips with these labels; none means all."""
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of length; none guesses it from the height of the body, file by file."""
    fps: float | None = None
    """Frame rate, for files that have none."""
    up: Literal["y", "z"] | None = None
    """Axis that points up in the files; none finds it, or takes the format's."""
    mapping: Path | None = None
    """JSON file that says which joint is which, as `refine data inspect --mapping` writes it."""
    workers: int | None = None
    """Processes that read; none means one a core for many files. The result does not depend on it."""
    force: bool = False
    """Replace what is there."""
    seed: int = 0
    """Taken by every verb; importing draws nothing."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from functools import partial

        from tqdm import tqdm

        from refine.cli.inputs import body_of, say
        from refine.formats.files import Reading
        from refine.formats.importing import ImportConfig, import_clips
        from renderers.outputs import refuse_existing

        if self.out.suffix[1:].isalpha() and self.out.suffix.lower() != ".npz":
            raise UserError(self.out, "packed clips are an .npz file, or a folder", "end its name in .npz, or in none")
        refuse_existing(self.out, self.force, folder=self.out.suffix.lower() != ".npz")
        reading = Reading(self.unit, self.fps, self.mapping, self.up)
        config = ImportConfig(self.label_pattern, self.labels_file, self.labels, reading, self.workers)
        progress = partial(tqdm, desc="import", unit="file", disable=None, leave=False)
        done = import_clips(self.source, self.out, body_of(None).rest_joints, config, progress)
        for error in done.refused[:NAMED]:
            say(f"refine: left out {error}")
        if len(done.refused) > NAMED:
            say(f"refine: and {len(done.refused) - NAMED:,} more, {len(done.refused):,} in all")
        if done.unlabelled:
            say(f"refine: left out {done.unlabelled:,} files that {self.labels_file} does not name")
        if done.lying:
            clips = "1 clip lies" if done.lying == 1 else f"{done.lying:,} clips lie"
            say(f"refine: {clips} from beginning to end; if it is another axis that is up, give --up y or --up z")
        lines = [f"{count:5d}  {label}" for label, count in done.labels.items()]
        lines.append(f"{self.out}  {done.clips:,} clips, {done.frames:,} frames")
        values = {"clips": done.clips, "frames": done.frames, "labels": done.labels, "files_read": done.files}
        refused = [str(error) for error in done.refused]
        values |= {"left_out": refused, "unlabelled": done.unlabelled, "lying": done.lying}
        return Result("\n".join(lines), (self.out,), values)


@dataclass(frozen=True)
class BuildBenchmark:
    """Build a frozen set of single actions and of their compositions, with a manifest of files, hashes and windows.

    synth-c needs nothing: ten built-in actions, whose compositions are also performed as true ones. bn-c and bn1-c are
    made of Bandai-Namco's data sets 2 and 1 (a folder of their .bvh files, or what `refine data import` packed),
    humanact-c and uestc-c of ACTOR's packages (humanact12poses.pkl, the folder uestc), custom of any labelled clips.
    The same name, source and seed give the same bytes.

    Example: refine data benchmark synth-c --out synth-c
    """

    name: Positional[Literal["synth-c", "bn-c", "bn1-c", "humanact-c", "uestc-c", "custom"]]
    """Which set."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write."""
    source: Path | None = None
    """The clips; none for synth-c."""
    lower: tuple[str, ...] = ()
    """For custom: labels of the legs' actions."""
    upper: tuple[str, ...] = ()
    """For custom: labels of the actions that go with each of them."""
    per_action: int = 5
    """For custom: clips of each action that are tested; every pair is composed of each with each."""
    force: bool = False
    """Replace the folder, with everything in it, if it is there."""
    seed: int = 0
    """Of the built-in performances, of the split and of the windows."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from functools import partial

        from tqdm import tqdm

        from refine.cli.inputs import body_of, say
        from renderers.outputs import refuse_existing
        from train.building import build_benchmark
        from train.recipes import material_of

        refuse_existing(self.out, self.force, folder=True)
        rest_joints = body_of(None).rest_joints
        progress = partial(tqdm, disable=None, leave=False)
        material = material_of(
            self.name,
            rest_joints,
            self.source,
            self.seed,
            self.lower,
            self.upper,
            self.per_action,
            partial(progress, desc="read"),
            lambda error: say(f"refine: left out {error}"),
        )
        composing = partial(progress, desc="compose")
        benchmark = build_benchmark(self.out, material, rest_joints, self.seed, self.command(), progress=composing)
        manifest = benchmark.manifest
        lines = [
            f"{self.out / name}  {file['clips']:,} clips, {file['frames']:,} frames"
            for name, file in manifest["files"].items()
        ]
        short = ", ".join(f"{count} {split}" for split, count in manifest["shorter_than_window"].items() if count)
        if short:
            lines.append(
                f"shorter than {benchmark.frames} frames, and still in their last pose from there: {short} clips"
            )
        if manifest["padded_compositions"]:
            lines.append(f"with such a clip: {manifest['padded_compositions']:,} compositions")
        for reason, count in manifest["rejected"].items():
            if count:
                lines.append(f"rejected as {reason}: {count:,} compositions")
        pairs, compositions = len(benchmark.pairs), len(manifest["compositions"])
        lines.append(f"{self.out}  {compositions:,} compositions of {pairs} pairs, hash {benchmark.hash[:12]}")
        values = {"hash": benchmark.hash, "compositions": compositions, "pairs": pairs, "clips": manifest["files"]}
        return Result("\n".join(lines), (self.out,), values)

    def command(self) -> str:
        """What builds the same set again, wherever this one lies."""
        import shlex

        words = ["refine", "data", "benchmark", self.name]
        if self.source:
            words += ["--source", str(self.source)]
        if self.name == "custom":
            words += ["--lower", *self.lower, "--upper", *self.upper, "--per-action", str(self.per_action)]
        return shlex.join([*words, "--seed", str(self.seed), "--out", self.name])
