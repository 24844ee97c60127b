"""KIT-ML and HumanML3D: sentences about AMASS's motions, in TMR's form or HumanML3D's own.

TMR's form (Petrovich et al. 2023) is a folder with ``annotations.json``, which holds by ID the AMASS ``path`` without
``.npz`` and ``annotations``, each with ``text``, ``start`` and ``end`` in seconds, and with ``splits/train.txt`` and so
on, an ID a line. A path that begins with ``M/`` is mirrored, as its texts already are.

HumanML3D's form (Guo et al. 2022) is a folder with ``texts/ID.txt``, ``train.txt`` and so on, and ``index.csv`` in it
or beside it. A line of a text file is ``caption#words and their kinds#start#end``, in seconds from where the index cuts
the motion; 0 and 0 mean the whole of it. IDs that begin with ``M`` are mirrored.
"""

import csv
import io
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from refine.formats.amass_folder import AmassFolder
from refine.formats.untrusted import MAX_TABLE, read_bytes, read_json
from refine.motion import Motion, crop, mirror
from refine.text.described import Described, Split
from renderers.checks import UserError, check_known, check_range, printable

ANNOTATIONS, TEXTS, INDEX, SPLITS = "annotations.json", "texts", "index.csv", "splits"
MAX_BYTES = 1 << 26
MIN_FRAMES = 2
MAX_NAME = 100  # letters of an ID
MAX_LETTERS = 1000  # of one text
MAX_TEXTS = 1000  # of one motion
MIRRORED = "M/"
INDEX_FPS = 20  # of the frames in HumanML3D's index
COLUMNS = ("source_path", "start_frame", "end_frame", "new_name")
LEAD_IN = {
    "Eyes_Japan_Dataset": 3.0,
    "MPI_HDM05": 3.0,
    "TotalCapture": 1.0,
    "MPI_Limits": 1.0,
    "Transitions_mocap": 0.5,
}
"""Seconds that HumanML3D leaves out before the first frame of its index, by the subset."""


@dataclass(frozen=True)
class AnnotatedConfig:
    """Which annotated stretches are taken."""

    fps: float = 30.0
    """Frame rate that motions are brought to."""
    shortest: float = 2.0
    """Seconds; shorter ones are left out of train and val."""
    longest: float = 10.0
    """Seconds; longer ones are left out of train and val. All that is annotated is tested."""
    mirrored: bool = True
    """Take the mirrored motions as well, of which there is one for each."""

    def __post_init__(self):
        check_range(self, 1, 1000, "fps")
        check_range(self, 0, 3600, "shortest")
        check_range(self, self.shortest, 3600, "longest")


class Said(NamedTuple):
    """A sentence about a stretch of a motion, in seconds; no end is that of the motion."""

    text: str
    start: float = 0.0
    end: float | None = None


class Annotated(NamedTuple):
    """A motion and what is said of it."""

    key: str
    path: str  # of the AMASS file, without .npz
    mirrored: bool
    said: list[Said]


def load_annotated(
    folder: Path, motions: Path, split: Split, config: AnnotatedConfig, left_out: list[str]
) -> Iterator[Described]:
    """Described stretches of a split, one AMASS file after the other, of which each is read once.

    Sentences about the same stretch are phrasings of one clip, whose key is the ID, and ``ID-N`` for the other
    stretches of a motion. The order is that in which the split first names a motion or its mirror image.

    Args:
        folder: with ``annotations.json`` and ``splits``, or with ``texts``, the splits and ``index.csv``.
        motions: folder of AMASS, see `AmassFolder`.
        left_out: receives a line for each annotation that is bad, and one for each other reason.

    Raises:
        UserError: a file is missing or is none of these, or no motion is there.
    """
    check_known("annotations", split, ("train", "val", "test"))
    reasons: Counter[str] = Counter()
    by_path = defaultdict(list)
    read = read_tmr if (folder / ANNOTATIONS).exists() else read_humanml3d
    for one in read(folder, split, left_out, reasons):
        if config.mirrored or not one.mirrored:
            by_path[one.path].append(one)
    amass = AmassFolder(motions, config.fps)
    for path, several in by_path.items():
        try:
            motion = amass.motion(path)
        except UserError as error:
            left_out.append(str(error))
            continue
        for one in several if motion is not None else ():
            yield from _described(one, motion, split, config, reasons)
    left_out += amass.report()
    left_out += [f"{reason}: {count:,}" for reason, count in reasons.items()]


def _described(
    one: Annotated, motion: Motion, split: Split, config: AnnotatedConfig, reasons: Counter[str]
) -> Iterator[Described]:
    """The stretches of a motion of which something is said."""
    shown = mirror(motion) if one.mirrored else motion
    stretches: dict[tuple[int, int], dict[tuple[str], None]] = {}
    for text, start, end in one.said:
        end = motion.seconds if end is None else end
        first, stop = int(start * motion.fps), min(int(end * motion.fps), len(motion))
        if stop - first < MIN_FRAMES:
            reasons["sentences about less than two frames of their motion"] += 1
        elif split != "test" and not config.shortest <= end - start <= config.longest:
            reasons[f"sentences about stretches that are not of {config.shortest:g} to {config.longest:g} s"] += 1
        else:
            stretches.setdefault((first, stop), {})[text,] = None
    for number, ((first, stop), texts) in enumerate(stretches.items()):
        yield Described(crop(shown, first, stop), tuple(texts), f"{one.key}-{number}" if number else one.key, split)


def read_tmr(folder: Path, split: str, left_out: list[str], reasons: Counter[str]) -> Iterator[Annotated]:
    """What TMR's files say of the motions of a split.

    Raises:
        UserError: a file is missing or is none of TMR's.
    """
    path = folder / ANNOTATIONS
    found = read_json(path, MAX_BYTES)
    if not isinstance(found, dict):
        raise UserError(path, "is JSON, but no annotations", "give TMR's annotations.json")
    for key in _names(folder / SPLITS / f"{split}.txt"):
        if key not in found:
            reasons["names in the split that have no annotation"] += 1
            continue
        where, entry = f"{path}, {key}", found[key]
        annotations = entry.get("annotations") if isinstance(entry, dict) else None
        name = entry.get("path") if isinstance(entry, dict) else None
        if not isinstance(annotations, list) or not isinstance(name, str):
            left_out.append(str(UserError(where, "has no path and annotations", "mend it")))
            continue
        said = []
        for index, annotation in enumerate(annotations[:MAX_TEXTS]):
            try:
                values = annotation if isinstance(annotation, dict) else {}
                said.append(_said(*(values.get(name) for name in ("text", "start", "end"))))
            except ValueError as error:
                left_out.append(str(UserError(f"{where}, annotation {index}", str(error), "mend it")))
        yield Annotated(key, name.removeprefix(MIRRORED), name.startswith(MIRRORED), said)


def read_humanml3d(folder: Path, split: str, left_out: list[str], reasons: Counter[str]) -> Iterator[Annotated]:
    """What HumanML3D's own files say of the motions of a split.

    Raises:
        UserError: a file is missing or is none of HumanML3D's.
    """
    if not (folder / TEXTS).is_dir():
        raise UserError(folder, f"has neither {ANNOTATIONS} nor {TEXTS}", "give a folder of annotations")
    index = _index(next((one for one in (folder, folder.parent) if (one / INDEX).exists()), folder) / INDEX)
    for key in _names(folder / f"{split}.txt"):
        path, texts = index.get(key.removeprefix("M")), folder / TEXTS / f"{key}.txt"
        if path is None or not texts.exists():
            reasons["names in the split that have no line in the index, or no text"] += 1
            continue
        try:
            lines = read_bytes(texts, MAX_TABLE).decode("utf-8", "replace").splitlines()
        except UserError as error:
            left_out.append(str(error))
            continue
        name, first, last = path
        said = []
        for number, line in enumerate(lines[:MAX_TEXTS], start=1):
            try:
                if line.strip():
                    said.append(_placed(_of_line(line), first, last))
            except ValueError as error:
                left_out.append(str(UserError(f"{texts}, line {number}", str(error), "mend it")))
        yield Annotated(key, name, key.startswith("M"), said)


def _of_line(line: str) -> Said:
    """Of a text file; no end means the whole. An end before its start is one that was exchanged with it."""
    cells = line.rsplit("#", 3)
    if len(cells) < 4:
        raise ValueError("is not caption#words#start#end")
    start, end = sorted(0.0 if cell.strip().lower() == "nan" else float(cell) for cell in cells[2:])
    return _said(cells[0], start, end) if start < end else _said(cells[0])


def _placed(said: Said, first: float, last: float | None) -> Said:
    """Counted from the start of the AMASS file, of which the index takes ``first`` to ``last`` seconds."""
    if said.end is None:
        return Said(said.text, first, last)
    ends = [first + said.end] + [last] * (last is not None)
    return Said(said.text, first + said.start, min(ends))


def _said(text: Any, start: Any = 0.0, end: Any = None) -> Said:
    """A sentence of a file, checked.

    Raises:
        ValueError: it is none.
    """
    if not isinstance(text, str) or not text.strip() or len(text) > MAX_LETTERS:
        raise ValueError(f"has no text of up to {MAX_LETTERS:,} letters")
    times = [start] if end is None else [start, end]
    if not all(type(time) in (int, float) and 0 <= time < 1e6 for time in times) or (end is not None and start >= end):
        raise ValueError("has no start and a later end, in seconds")
    return Said(printable(" ".join(text.split())), start, end)


def _index(path: Path) -> dict[str, tuple[str, float, float | None]]:
    """By ID: the AMASS file, and from when to when it is taken, in seconds."""
    table = csv.DictReader(io.StringIO(read_bytes(path, MAX_TABLE).decode("utf-8-sig", "replace")))
    if not set(COLUMNS) <= set(table.fieldnames or ()):
        raise UserError(path, f"is no table of {', '.join(COLUMNS)}", "give HumanML3D's index.csv")
    index = {}
    try:
        for row in table:
            source, first, last, name = (row[column] or "" for column in COLUMNS)
            source = source.removeprefix("./").removeprefix("pose_data/").removesuffix(".npy")
            lead = next((seconds for subset, seconds in LEAD_IN.items() if subset in source), 0.0)
            start, end = lead + int(first) / INDEX_FPS, lead + int(last) / INDEX_FPS
            index[name.removesuffix(".npy")] = source, start, end if int(last) >= 0 else None
    except (ValueError, OverflowError, csv.Error) as error:
        raise UserError(f"{path}, line {table.line_num}", f"is no line of the index ({error})", "mend it") from error
    return index


def _names(path: Path) -> Iterator[str]:
    """IDs, one a line, each once."""
    lines = read_bytes(path, MAX_TABLE).decode("utf-8-sig", "replace").splitlines()
    names = dict.fromkeys(line.strip() for line in lines)
    if any(set(name) & set("/\\") or not name.isprintable() or len(name) > MAX_NAME for name in names):
        raise UserError(path, "names more than IDs", "give one ID a line, without a folder")
    return (name for name in names if name)
