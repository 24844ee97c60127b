"""BABEL: what people say of AMASS's motions, and from when to when (Punnakkal et al. 2021).

``train.json`` and ``val.json`` hold, by BABEL's number of a motion, its AMASS file (``feat_p``), labels of the whole
(``seq_ann``) and labels of stretches (``frame_ann``, or null). ``extra_train.json`` and ``extra_val.json`` hold several
people's labels (``seq_anns``, ``frame_anns``). Stretches overlap: what SINC (Athanasiou et al. 2023) learns and is
tested by is where they do.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from refine.formats.amass_folder import AmassFolder
from refine.formats.untrusted import read_json
from refine.motion import Motion, crop
from refine.text.described import Described, Split
from renderers.checks import UserError, check_known, check_range, printable

MAX_BYTES = 1 << 26
MAX_LABELS = 1000  # of one motion
MAX_LETTERS = 500  # of one label
STAND = "stand"
SPELLINGS = {
    "tpose": "t-pose",
    "tposes": "t-pose",
    "t-poses": "t-pose",
    "t_pose": "t-pose",
    "apose": "a-pose",
    "aposes": "a-pose",
    "a-poses": "a-pose",
    "a_pose": "a-pose",
}
"""Words that are read as others."""
NO_ACTIONS = ("t-pose", "a-pose", "t pose", "a pose", "transition")
"""Labels of what is no action: how recordings begin and end, and what lies between two actions."""


@dataclass(frozen=True)
class BabelConfig:
    """Which stretches of BABEL's motions are taken."""

    fps: float = 30.0
    """Frame rate that motions are brought to."""
    min_frames: int = 15
    """Shortest stretch that is taken, at that rate."""
    max_frames: int | None = None
    """Longest stretch that is taken; SINC's paper says 600, its published code sets no limit."""
    max_actions: int = 4
    """How many actions at once are taken; stretches with more are left out."""
    alone: bool = False
    """Take as single actions only stretches that overlap no other; else every labelled stretch is one, as in SINC."""
    extra: bool = False
    """Read the labels of ``extra_train.json`` and ``extra_val.json`` as well."""
    spellings: Path | None = None
    """A JSON object: words as they stand in the labels, and what they are read as."""
    nearest_lower: bool = False
    """Lower frame rates without interpolation, as SINC's published code does."""

    def __post_init__(self):
        check_range(self, 1, 1000, "fps")
        check_range(self, 2, 1_000_000, "min_frames")
        check_range(self, 1, 100, "max_actions")
        if self.max_frames is not None:
            check_range(self, self.min_frames, inf, "max_frames")


class Label(NamedTuple):
    """A text that holds from one time to another: frames, or seconds; the end is not in it."""

    start: float
    stop: float
    text: str


class Together(NamedTuple):
    """A stretch in which the same labels hold throughout."""

    start: float
    stop: float
    texts: tuple[str, ...]


class Annotation(NamedTuple):
    """What one person said of a motion, or several did of the whole of it."""

    name: str  # of the motion, in keys
    whole: tuple[str, ...]  # ways to say the whole; none where there are labels
    labels: tuple[Label, ...]  # seconds


def load_babel(
    annotations: Path, motions: Path, split: Split, config: BabelConfig, left_out: list[str]
) -> Iterator[Described]:
    """Single actions and actions at once of a split, one AMASS file after the other, in the order of the JSON file.

    A motion whose stretches have labels gives ``seg-ID-N`` for each of these and ``spatial_pairs-ID-N`` for each
    stretch in which several hold, see :func:`simultaneous`; another one gives ``seq-ID-0``, the whole by its first
    label. The names are SINC's; those of the extra labels have the person's number behind the ID.

    Args:
        annotations: folder with ``train.json`` and ``val.json``.
        motions: folder of AMASS, see `AmassFolder`.
        split: "train" or "val"; of "test", BABEL publishes no labels.
        left_out: receives a line for each annotation that is bad, and one for each other reason.

    Raises:
        UserError: a file is missing or is no such JSON, there are no labels, or no motion is there.
    """
    check_known("BABEL", split, ("train", "val", "test"))
    spellings = SPELLINGS | _spellings(config.spellings)
    folder = AmassFolder(motions, config.fps, config.nearest_lower)
    reasons: Counter[str] = Counter()
    labelled = 0
    for path in _files(annotations, split, config.extra):
        for number, entry in _entries(path):
            number = printable(number)
            where = f"{path}, motion {number[:40]}"
            try:
                said = list(_annotations(where, number, entry, spellings, left_out, reasons))
                labelled += bool(said)
                motion = folder.motion(_feature_path(where, entry)) if said else None
            except UserError as error:
                left_out.append(str(error))
                continue
            for annotation in said if motion is not None else ():
                yield from _described(annotation, motion, split, config, reasons)
    if not labelled:
        raise UserError(annotations, f"has no labels of '{split}'", "BABEL publishes those of train and val")
    left_out += folder.report()
    left_out += [f"{reason}: {count:,}" for reason, count in reasons.items() if count]


def simultaneous(labels: Sequence[Label], most: int = 4) -> list[Together]:
    """Every longest stretch in which the same labels hold, 2 to ``most`` of them, by their starts.

    The same text twice at once counts as two. Texts come in the order in which they begin.
    """
    found = []
    edges = sorted({edge for label in labels for edge in (label.start, label.stop)})
    for start, stop in pairwise(edges):  # at each edge a label begins or ends
        holding = sorted(label for label in labels if label.start <= start and stop <= label.stop)
        if 2 <= len(holding) <= most:
            found.append(Together(start, stop, tuple(label.text for label in holding)))
    return found


def unseen_pairs(tested: Iterable[Described], learned: Iterable[Described]) -> list[Described]:
    """What SINC evaluates: two actions at once, neither of which is to stand, that nothing learned shows together in
    whichever order. Of BABEL's 1,232 validation stretches 667 are such."""
    known = {_pair(said) for item in learned for said in item.phrasings if item.actions == 2}
    return [
        item
        for item in tested
        if item.actions == 2 and not any(_pair(said) in known or STAND in _pair(said) for said in item.phrasings)
    ]


def _pair(texts: tuple[str, ...]) -> frozenset[str]:
    return frozenset(" ".join(text.lower().split()) for text in texts)


def _described(
    annotation: Annotation, motion: Motion, split: Split, config: BabelConfig, reasons: Counter[str]
) -> Iterator[Described]:
    """The stretches of a motion, at the frame rate of ``config``."""
    if annotation.whole:
        stretches = [("seq", 0, len(motion), tuple((text,) for text in annotation.whole), 0)]
    else:
        labels = [
            Label(int(start * motion.fps), min(int(stop * motion.fps), len(motion)), text)
            for start, stop, text in annotation.labels
        ]
        inside = [label for label in labels if label.start < label.stop]
        reasons["labels that hold for no frame of their motion"] += len(labels) - len(inside)
        stretches = [
            ("seg", label.start, label.stop, ((label.text,),), index)
            for index, label in enumerate(inside)
            if not (config.alone and _overlapped(label, index, inside))
        ] + [
            ("spatial_pairs", start, stop, (texts,), index)
            for index, (start, stop, texts) in enumerate(simultaneous(inside, config.max_actions))
        ]
    for kind, start, stop, phrasings, index in stretches:
        if stop - start < config.min_frames:
            reasons[f"stretches of fewer than {config.min_frames} frames"] += 1
        elif config.max_frames is not None and stop - start > config.max_frames:
            reasons[f"stretches of more than {config.max_frames} frames"] += 1
        else:
            yield Described(crop(motion, start, stop), phrasings, f"{kind}-{annotation.name}-{index}", split)


def _overlapped(label: Label, index: int, among: list[Label]) -> bool:
    return any(other.start < label.stop and label.start < other.stop for n, other in enumerate(among) if n != index)


def _annotations(
    where: str, number: str, entry: Any, spellings: dict[str, str], left_out: list[str], reasons: Counter[str]
) -> Iterator[Annotation]:
    """What people said of a motion; nothing where that is no action.

    Raises:
        UserError: the entry is none of BABEL's.
    """
    if not isinstance(entry, dict):
        raise UserError(where, "is no annotation", "mend it")
    extra = "seq_anns" in entry or "frame_anns" in entry
    framed = _people(where, entry, "frame_anns" if extra else "frame_ann", extra)
    for person, labels in enumerate(framed, start=1):
        name = f"{number}.{person}" if extra else number
        found = tuple(_timed(where, labels, spellings, left_out, reasons))
        if found:
            yield Annotation(name, (), found)
    if framed:
        return
    whole = []
    for labels in _people(where, entry, "seq_anns" if extra else "seq_ann", extra):
        text = _text(where, labels[0], spellings)
        if _is_action(text, reasons):
            whole.append(text)
    if whole:
        yield Annotation(f"{number}.1" if extra else number, tuple(dict.fromkeys(whole)), ())


def _people(where: str, entry: dict, key: str, several: bool) -> list[list]:
    """The labels of each person who gave any."""
    found = entry.get(key)
    people = ([] if found is None else found) if several else [found]
    if not isinstance(people, list):
        raise UserError(where, f"has {key} that is no list", "mend it")
    labels = [one.get("labels") if isinstance(one, dict) else one for one in people]
    for some in labels:
        if some is not None and not isinstance(some, list):
            raise UserError(where, f"has {key} without a list of labels", "mend it")
        if some and len(some) > MAX_LABELS:
            raise UserError(where, f"has {len(some):,} labels, up to {MAX_LABELS:,} are read", "mend it")
    return [some for some in labels if some]


def _timed(
    where: str, labels: list, spellings: dict[str, str], left_out: list[str], reasons: Counter[str]
) -> Iterator[Label]:
    for index, label in enumerate(labels):
        place = f"{where}, label {index}"
        try:
            text = _text(place, label, spellings)
            start, stop = label.get("start_t"), label.get("end_t")
            if not all(type(time) in (int, float) and 0 <= time < 1e6 for time in (start, stop)):
                raise UserError(place, f"'{text}' has no start_t and end_t in seconds", "mend it")
            if start >= stop:
                raise UserError(place, f"'{text}' ends at {stop:g} s, where it starts or before", "mend it")
        except UserError as error:
            left_out.append(str(error))
            continue
        if _is_action(text, reasons):
            yield Label(start, stop, text)


def _text(where: str, label: Any, spellings: dict[str, str]) -> str:
    """What a label says, word by word in known spelling; empty where it says nothing."""
    text = label.get("proc_label") if isinstance(label, dict) else None
    if not isinstance(text, str) or len(text) > MAX_LETTERS:
        raise UserError(where, f"has no proc_label of up to {MAX_LETTERS} letters", "mend it")
    return printable(" ".join(spellings.get(word, word) for word in text.split()))


def _is_action(text: str, reasons: Counter[str]) -> bool:
    if not text:
        reasons["empty labels"] += 1
    elif text.lower() in NO_ACTIONS:
        reasons["labels of no action (t-pose, a-pose, transition)"] += 1
        return False
    return bool(text)


def _feature_path(where: str, entry: dict) -> str:
    name = entry.get("feat_p")
    if not isinstance(name, str) or not name:
        raise UserError(where, "names no motion file (feat_p)", "mend it")
    return name


def _files(annotations: Path, split: Split, extra: bool) -> list[Path]:
    return [annotations / f"{split}.json"] + [annotations / f"extra_{split}.json"] * extra


def _entries(path: Path) -> Iterable[tuple[str, Any]]:
    found = read_json(path, MAX_BYTES)
    if not isinstance(found, dict):
        raise UserError(path, "is JSON, but not BABEL's", "give the folder that has BABEL's train.json in it")
    return found.items()


def _spellings(path: Path | None) -> dict[str, str]:
    if path is None:
        return {}
    found = read_json(path)
    if not isinstance(found, dict) or not all(isinstance(word, str) for word in found.values()):
        raise UserError(path, "is no JSON object of words", 'write {"strectch": "stretch"}')
    return found
