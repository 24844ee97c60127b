"""Motion files of a folder, many at a time, as labelled clips: what `refine data import` does.

Files are read one after the other or on several processes; the result does not depend on how many. What cannot be read
is left out and said, and the rest goes on. Clips are written as they come, so memory holds a few of them.
"""

import hashlib
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor

from refine.formats.actor import UESTC_ACTIONS, is_uestc, uestc_clips
from refine.formats.clips import FRAME_BYTES, MAX_BYTES, Packed, Shards, pack, save_packed
from refine.formats.files import Reading, load_motions
from refine.formats.finding import Job, Plan, plan, sources_in
from refine.formats.labels import Row
from refine.motion import Motion, crop, lies
from refine.workers import Failure, in_order, suitable
from renderers.checks import UserError, check_known
from renderers.outputs import replacing_folder

Progress = Callable[[Sequence[Any]], Iterable[Any]]
PACKED_SUFFIX = ".npz"


@dataclass(frozen=True)
class ImportConfig:
    """What a person says about the files."""

    label_pattern: str | None = None
    """A regular expression for a whole file name without suffix, with a group ``label``."""
    labels_file: Path | None = None
    """A CSV table, see `refine.formats.labels`; files that it does not name are left out."""
    labels: tuple[str, ...] = ()
    """Keep only clips with these labels; none means all."""
    reading: Reading = field(default_factory=Reading)
    workers: int | None = None
    """Processes; none means one a core for many files, and this one alone for few."""


@dataclass(frozen=True)
class Imported:
    """The clips of a folder, and one error for each file that could not be read."""

    motions: list[Motion]
    refused: list[UserError]


@dataclass(frozen=True)
class Summary:
    """What was written and what was not."""

    labels: dict[str, int]  # clips of each
    clips: int
    frames: int
    refused: list[UserError]
    files: int  # that were read
    unlabelled: int = 0  # files that the labels file does not name
    lying: int = 0  # clips in which the body lies, see `refine.motion.lies`


class Read(NamedTuple):
    """What came of a job."""

    clips: list[Motion] | list[Packed]
    refused: list[UserError]
    lying: int = 0  # how many of them, see `refine.motion.lies`


def read_job(job: Job, rest_joints: Tensor, config: ImportConfig) -> Read:
    """The clips of one file, cut and labelled."""
    try:
        motions = load_motions(job.path, rest_joints, config.reading)
    except UserError as error:
        return Read([], [error])
    pattern, largest = compiled(config.label_pattern), MAX_BYTES // FRAME_BYTES
    clips, refused = [], []
    for motion, source in zip(motions, sources_in(job, motions), strict=True):
        if len(motion) > largest:
            refused.append(UserError(job.path, f"has {len(motion):,} frames", f"cut it into clips of {largest:,}"))
        elif job.rows is None:
            match = pattern.fullmatch(Path(source).stem) if pattern else None
            label = match["label"] if match and match["label"] else motion.label
            clips.append(replace(motion, label=label, source=source))
        else:
            pieces, wrong = _pieces(motion, source, job.rows, config.labels_file)
            clips, refused = clips + pieces, refused + wrong
    return Read(clips, refused, sum(map(lies, clips)))


def read_packed(job: Job, rest_joints: Tensor, config: ImportConfig) -> Read:
    """`read_job` in the form in which clips travel between processes and lie on disk."""
    read = read_job(job, rest_joints, config)
    return read._replace(clips=[pack(clip) for clip in read.clips])


def _pieces(
    motion: Motion, source: str, rows: Iterable[Row], labels_file: Path
) -> tuple[list[Motion], list[UserError]]:
    """What the rows of a labels file cut out of a motion, and one error for each row that does not fit it."""
    pieces, refused = [], []
    for row in rows:
        try:
            start, stop = row.frames(len(motion), motion.fps, f"{labels_file}, line {row.line}")
        except UserError as error:
            refused.append(error)
            continue
        name = source if (start, stop) == (0, len(motion)) else f"{source}#{start}-{stop}"
        pieces.append(replace(crop(motion, start, stop), label=row.label, source=name))
    return pieces, refused


def read_jobs(
    jobs: Sequence[Job],
    rest_joints: Tensor,
    config: ImportConfig,
    progress: Progress = iter,
    reading: Callable[..., Read] = read_packed,
) -> Iterator[Read]:
    """The clips of many files in the order of the files, whatever happens to some."""
    workers = suitable(len(jobs)) if config.workers is None else config.workers
    read = partial(reading, rest_joints=rest_joints.detach().cpu(), config=config)
    with closing(in_order(read, jobs, workers)) as results:
        for path, result in zip(progress([job.path for job in jobs]), results, strict=True):
            if isinstance(result, Failure):
                result = Read([], [UserError(path, f"cannot be read ({result.reason})", "leave it out")])
            yield result


def import_folder(
    folder: str | Path, rest_joints: Tensor, label_pattern: str | None = None, progress: Progress = iter
) -> Imported:
    """Read every motion file under a folder, in the order of their names, into memory.

    Args:
        rest_joints: [24 3] T-pose joints in metres.
        label_pattern: see `ImportConfig`.
        progress: wraps the list of files, as ``tqdm`` does.

    Raises:
        UserError: the folder has no motion files, none can be read, or the pattern is not one.
    """
    compiled(label_pattern)
    planned = plan(Path(folder))
    motions, refused = [], list(planned.refused)
    for read in read_jobs(planned.jobs, rest_joints, ImportConfig(label_pattern, workers=1), progress, read_job):
        motions += read.clips
        refused += read.refused
    if not motions:
        raise _none_read(folder, len(planned.jobs), refused)
    return Imported(motions, refused)


def import_clips(
    source: Path, out: Path, rest_joints: Tensor, config: ImportConfig | None = None, progress: Progress = iter
) -> Summary:
    """Read labelled clips and write them to ``out``: one file, where it ends in .npz, or else a folder of `Shards`.

    A clip that is to the last bit another of the same label is left out, and so is one that holds NaN or infinity.

    Args:
        source: a folder of motion files or packed clips, a file, or one of ACTOR's packages.
        rest_joints: [24 3] T-pose joints in metres.
        progress: wraps the list of files, as ``tqdm`` does.

    Raises:
        UserError: nothing can be read, a label that is asked for is not there, or ``out`` cannot be written.
    """
    config = config or ImportConfig()
    if config.workers is not None and not 1 <= config.workers <= 256:
        raise UserError("--workers", f"expected 1 to 256, got {config.workers}")
    if config.label_pattern and config.labels_file:
        raise UserError("--labels-file", "and a pattern for labels exclude each other", "give one of them")
    compiled(config.label_pattern)
    if is_uestc(source):
        if config.labels_file:
            raise UserError(config.labels_file, "does not go with a package that has labels", "leave it out")
        planned = Plan([], [])
        reads = _of_uestc(source, rest_joints, config, progress)
    else:
        planned = plan(source, config.labels_file)
        reads = read_jobs(planned.jobs, rest_joints, config, progress)
    tally = _Tally(planned.refused, config.labels)
    with closing(reads):
        if out.suffix.lower() == PACKED_SUFFIX:
            clips = []
            for clip in tally.taken(reads):
                clips.append(clip)
                if tally.frames * FRAME_BYTES > MAX_BYTES:
                    raise UserError(out, "would be too large for one file", "name a folder, without .npz, for many")
            _check(source, planned, tally, config)
            save_packed(out, clips)
        else:
            with replacing_folder(out) as partial:
                shards = Shards(partial)
                for clip in tally.taken(reads):
                    shards.add(clip)
                _check(source, planned, tally, config)
                shards.close([(_relative(error.where, source), error.problem) for error in tally.refused])
    labels = dict(sorted(tally.labels.items()))
    return Summary(labels, tally.clips, tally.frames, tally.refused, len(planned.jobs), planned.unlabelled, tally.lying)


class _Tally:
    """Counts clips as they pass, and holds back those that are not wanted or were there before."""

    def __init__(self, refused: list[UserError], wanted: tuple[str, ...]):
        self.refused, self.wanted = list(refused), wanted
        self.met: set[str] = set()  # labels, wanted or not
        self.labels: Counter[str] = Counter()
        self.clips = self.frames = self.lying = 0
        self.seen: dict[bytes, str] = {}

    def taken(self, reads: Iterable[Read]) -> Iterator[Packed]:
        for read in reads:
            self.refused += read.refused
            before = self.clips
            for clip in read.clips:
                self.met.add(clip.label)
                if self.wanted and clip.label not in self.wanted:
                    continue
                first = self.seen.setdefault(_digest(clip), clip.source)
                if first != clip.source:
                    problem = f"is the same motion as {first}, with the same label"
                    self.refused.append(UserError(clip.source, problem))
                    continue
                self.labels[clip.label] += 1
                self.clips += 1
                self.frames += clip.frames
                yield clip
            self.lying += min(read.lying, self.clips - before)


def _digest(clip: Packed) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for part in (clip.six.tobytes(), clip.root.tobytes(), repr(clip.fps).encode(), clip.label.encode()):
        digest.update(part)
    return digest.digest()


def _check(source: Path, planned: Plan, tally: _Tally, config: ImportConfig) -> None:
    """Refuse an import of nothing, or without a label that was asked for."""
    if not tally.met:
        raise _none_read(source, len(planned.jobs), tally.refused)
    for label in config.labels:
        check_known(source, label, sorted(tally.met))


def _none_read(source: str | Path, count: int, refused: list[UserError]) -> UserError:
    first = f"the first: {refused[0]}" if refused else ""
    return UserError(source, f"none of its {count} motion files can be read", first)


def _relative(where: str, source: Path) -> str:
    """A place in words, without where the folder lies."""
    return where.removeprefix(f"{source}{os.sep}")


def _of_uestc(source: Path, rest_joints: Tensor, config: ImportConfig, progress: Progress) -> Iterator[Read]:
    for motion in uestc_clips(source, rest_joints, config.labels or UESTC_ACTIONS, progress=progress):
        yield Read([pack(motion)], [])


def compiled(text: str | None) -> re.Pattern[str] | None:
    """A pattern for labels.

    Raises:
        UserError: it is no regular expression, or has no group called label.
    """
    if text is None:
        return None
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise UserError("label pattern", f"'{text}' is not a regular expression ({error})", "mend it") from error
    if "label" not in pattern.groupindex:
        raise UserError("label pattern", f"'{text}' has no group called label", "write (?P<label>...) around the label")
    return pattern
