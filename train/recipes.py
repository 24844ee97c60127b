"""What the named benchmarks are made of: their actions, their pairs, which clips, and how these are split."""

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from refine.formats.actor import UESTC_TRAIN_SUBJECTS, is_humanact, is_uestc, read_humanact, read_uestc, video_of
from refine.formats.clips import is_shards, load_clips
from refine.formats.importing import import_folder
from refine.motion import Motion, resample
from refine.recogniser import OTHER
from refine.synthetic import draw, perform, perform_together
from renderers.checks import UserError, check_known
from train.building import Material
from train.data import group

FRAMES = 60
FPS = 30.0

UESTC_LOWER = (
    "marking-time-and-knee-lifting",
    "punching-and-knee-lifting",
    "left-lunging",
    "left-kicking",
    "forward-lunging",
)
UESTC_UPPER = ("pulling-chest-expanders", "punching", "elbow-circling", "shoulder-abduction", "standing-rotation")
BN2_LOWER = ("walk", "run", "walk-turn-left", "walk-turn-right")
BN2_UPPER = (
    "raise-up-both-hands",
    "raise-up-left-hand",
    "raise-up-right-hand",
    "wave-both-hands",
    "wave-left-hand",
    "wave-right-hand",
)
BN1_LOWER = ("walk", "walk-back", "walk-left", "walk-right", "run", "dash")
BN1_UPPER = ("bye", "byebye", "guide", "bow")
HUMANACT_LOWER = ("walk", "run", "sit")
HUMANACT_UPPER = ("drink", "phone", "throw", "lift-dumbbell", "eat")
HUMANACT_PAIRS = (
    *(("walk", upper) for upper in ("drink", "phone", "throw", "lift-dumbbell")),
    *(("run", upper) for upper in ("phone", "throw")),
    *(("sit", upper) for upper in ("phone", "eat", "drink")),
)

BANDAI_NAMCO = re.compile(r"dataset-(?P<dataset>\d+)_[^_]+_(?P<style>[^_]+)_\d+")
NAMES = ("synth-c", "bn-c", "bn1-c", "humanact-c", "uestc-c", "custom")


class Read(NamedTuple):
    """The clips of a source, and one error for each file that could not be read."""

    motions: list[Motion]
    refused: list[UserError]


def material_of(
    name: str,
    rest_joints: Tensor,
    source: Path | None = None,
    seed: int = 0,
    lower: tuple[str, ...] = (),
    upper: tuple[str, ...] = (),
    per_action: int = 5,
    progress: Callable[[Sequence[Any]], Iterable[Any]] = iter,
    refused: Callable[[UserError], object] = lambda error: None,
) -> Material:
    """What the benchmark ``name`` is made of.

    Args:
        source: the clips, for all but synth-c.
        lower, upper, per_action: the labels, and how many clips of each are tested; for custom alone.
        progress: wraps the list of what is read, as ``tqdm`` does.
        refused: told of every file of a folder that could not be read.

    Raises:
        UserError: an unknown name, a source that is missing or of another kind, a label that it lacks, or too few
            clips.
    """
    check_known("benchmark", name, NAMES)
    if name == "custom":
        _check_labels(lower, upper, per_action)
    elif lower or upper:
        raise UserError(name, "has labels of its own", "leave out --lower and --upper, or build 'custom'")
    if name == "synth-c":
        if source is not None:
            raise UserError(name, "is made of built-in actions", "leave out --source")
        return synth_c(rest_joints, seed)
    if source is None:
        raise UserError(name, "is made of clips that do not ship with Refine", "say where they are with --source")
    kinds = {"humanact-c": is_humanact, "uestc-c": is_uestc}
    if name == "humanact-c" and source.is_dir():
        source = source / "humanact12poses.pkl"
    if name in kinds and not kinds[name](source):
        wanted = "the file humanact12poses.pkl" if name == "humanact-c" else "a folder with info/names.txt"
        raise UserError(source, f"is not ACTOR's package ({wanted})", "give that")
    labels = UESTC_LOWER + UESTC_UPPER if name == "uestc-c" else lower + upper
    read = read_source(source, rest_joints, labels, name == "uestc-c", progress)
    for error in read.refused:
        refused(error)
    if name == "custom":
        return custom(read.motions, str(source), lower, upper, per_action, seed)
    recipe = {"bn-c": bn_c, "bn1-c": bn1_c, "humanact-c": humanact_c, "uestc-c": uestc_c}[name]
    return recipe(read.motions, str(source), seed)


def read_source(
    path: Path,
    rest_joints: Tensor,
    labels: Collection[str] = (),
    front_only: bool = False,
    progress: Callable[[Sequence[Any]], Iterable[Any]] = iter,
    label_pattern: str | None = None,
) -> Read:
    """Clips from a folder of motion files, packed clips, or one of ACTOR's packages.

    Args:
        labels: of UESTC, the actions to read; none means all.
        front_only: of UESTC, the first camera alone.
        label_pattern: of a folder of motion files, as ``import_folder`` takes it.

    Raises:
        UserError: there is no such source, or it cannot be read.
    """
    if is_humanact(path):
        return Read(read_humanact(path, rest_joints), [])
    if is_uestc(path):
        wanted = {"labels": labels} if labels else {}
        return Read(read_uestc(path, rest_joints, front_only=front_only, progress=progress, **wanted), [])
    if path.is_dir() and not is_shards(path):
        imported = import_folder(path, rest_joints, label_pattern, progress)
        return Read(imported.motions, imported.refused)
    return Read(load_clips(path), [])


def product(lower: tuple[str, ...], upper: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """All pairs of different labels, the first ones slowest."""
    return tuple((i, j) for i in lower for j in upper if i != j)


def synth_c(
    rest_joints: Tensor, seed: int = 0, train: int = 5, test: int = 5, extra: int = 20, seconds: float = 4.0
) -> Material:
    """The ten sub-actions of LFCA's UESTC-C, as the built-in generator performs them: ``train``, ``test`` and ``extra``
    sequences of each, no two alike, and both at once for the true compositions."""
    frames = round(seconds * FPS)
    draws, splits = {}, {"train": [], "test": [], "extra": []}
    for index, label in enumerate(UESTC_LOWER + UESTC_UPPER):
        random = torch.Generator().manual_seed(seed * 1009 + index)
        for split, count in (("train", train), ("test", test), ("extra", extra)):
            for number in range(count):
                source = f"{split}/{label}_{number:03d}"
                draws[source] = draw(label, random, FPS)
                splits[split].append(replace(perform(draws[source], frames, rest_joints), source=source))

    def together(i: Motion, j: Motion) -> Motion:
        return perform_together(draws[i.source], draws[j.source], frames, rest_joints)

    return Material(
        name="synth-c",
        version=1,
        fps=FPS,
        frames=FRAMES,
        lower=UESTC_LOWER,
        upper=UESTC_UPPER,
        pairs=product(UESTC_LOWER, UESTC_UPPER),
        rule=f"built-in actions, {seconds:g} s each: of every action the first {train} draws train, the next {test} "
        f"test, the next {extra} are extra",
        together=together,
        **splits,
    )


def bn_c(motions: list[Motion], where: str, seed: int = 0, test: int = 5) -> Material:
    """Bandai-Namco's second data set: gaits and what hands do meanwhile. ``test`` clips of each action, each of another
    style, are held out; all others train."""
    clips = _labelled(_of_bandai_namco(motions, where, "2"), where, BN2_LOWER + BN2_UPPER)
    random = torch.Generator().manual_seed(seed)
    splits = {"train": [], "test": []}
    for label, of_label in clips.items():
        chosen = spread(_enough(of_label, test + 1, where, label), style_of, test, random)
        splits["test"] += chosen
        splits["train"] += _without(of_label, chosen)
    return _clips_material(
        "bn-c",
        BN2_LOWER,
        BN2_UPPER,
        **splits,
        rule=f"of every action {test} clips test, drawn one of each style in a random order of the styles; all others "
        "train",
    )


def bn1_c(motions: list[Motion], where: str, seed: int = 0, test: int = 5) -> Material:
    """Bandai-Namco's first data set: gaits and greetings. ``test`` styles are held out, of which each action's first
    clip is taken; all clips of the other styles train."""
    clips = _labelled(_of_bandai_namco(motions, where, "1"), where, BN1_LOWER + BN1_UPPER)
    styles = sorted({style_of(clip) for of_label in clips.values() for clip in of_label})
    if len(styles) <= test:
        problem = f"has {len(styles)} styles, at least {test + 1} are needed ({test} to test)"
        raise UserError(where, problem, "give the whole data set")
    order = torch.randperm(len(styles), generator=torch.Generator().manual_seed(seed)).tolist()
    held_out = {styles[index] for index in order[:test]}
    splits = {"train": [], "test": []}
    for label, of_label in clips.items():
        for style in sorted(held_out):
            of_style = [clip for clip in of_label if style_of(clip) == style]
            splits["test"] += _enough(of_style, 1, where, label, style)[:1]
        splits["train"] += [clip for clip in of_label if style_of(clip) not in held_out]
    return _clips_material(
        "bn1-c",
        BN1_LOWER,
        BN1_UPPER,
        **splits,
        rule=f"the styles {', '.join(sorted(held_out))} test, with the first clip of each action; all clips of the "
        "other styles train",
    )


def humanact_c(motions: list[Motion], where: str, seed: int = 0, count: int = 10) -> Material:
    """LFCA's HumanAct-C: 120 training clips of twelve classes, 9 pairs of 10 x 10 test clips; no clip is drawn.

    No split of HumanAct12 is published and its package names no performer. Within a class its order is that of the
    original file names, which begin with the performer, so the halves of a class share one performer at most.
    """
    splits = {"train": [], "test": [], "extra": []}
    composed = {label for pair in HUMANACT_PAIRS for label in pair}
    for label, of_label in _labelled(motions, where, HUMANACT_LOWER + HUMANACT_UPPER, others=True).items():
        half = len(of_label) // 2
        if label in composed:
            _enough(of_label, 2 * count, where, label)
            splits["test"] += longest(of_label[half:], count)
        splits["train"] += longest(of_label[:half], count)
        splits["extra"] += _without(of_label[:half], longest(of_label[:half], count))
    return Material(
        name="humanact-c",
        version=1,
        fps=motions[0].fps,
        frames=FRAMES,
        lower=HUMANACT_LOWER,
        upper=HUMANACT_UPPER,
        pairs=HUMANACT_PAIRS,
        **splits,
        rule=f"each class is halved in the order of the file, which is that of performers; the {count} longest clips "
        f"of the first half train, its others are extra, the {count} longest of the second half test",
    )


def uestc_c(motions: list[Motion], where: str, seed: int = 0, count: int = 5, extra: int = 20) -> Material:
    """LFCA's UESTC-C: ``count`` training and test clips of ten actions by the official subjects, from the front."""
    random = torch.Generator().manual_seed(seed)
    shortest = FRAMES * 3 // 4  # ACTOR trains on nothing shorter, and tests on everything
    splits = {"train": [], "test": [], "extra": []}
    for label, of_label in _labelled(motions, where, UESTC_LOWER + UESTC_UPPER).items():
        learned = [clip for clip in of_label if _learned(clip) and len(clip) >= shortest]
        tested = [clip for clip in of_label if not _learned(clip)]
        train = spread(_enough(learned, count, where, label, "training subjects"), _subject, count, random)
        splits["test"] += spread(_enough(tested, count, where, label, "test subjects"), _subject, count, random)
        splits["train"] += train
        splits["extra"] += spread(_without(learned, train), _subject, extra, random)
    return Material(
        name="uestc-c",
        version=1,
        fps=motions[0].fps,
        frames=FRAMES,
        lower=UESTC_LOWER,
        upper=UESTC_UPPER,
        pairs=product(UESTC_LOWER, UESTC_UPPER),
        **splits,
        rule=f"clips of the first camera; of every action {count} of the official training subjects train, {extra} "
        f"more are extra, {count} of the official test subjects test, each of another subject as far as there are "
        f"enough; nothing shorter than {shortest} frames trains",
    )


def custom(
    motions: list[Motion], where: str, lower: tuple[str, ...], upper: tuple[str, ...], test: int, seed: int = 0
) -> Material:
    """Any labels: ``test`` clips of each, drawn at random, are held out; all others train."""
    random = torch.Generator().manual_seed(seed)
    splits = {"train": [], "test": []}
    for label, of_label in _labelled(motions, where, (*lower, *upper)).items():
        chosen = spread(_enough(of_label, test + 1, where, label), lambda clip: "", test, random)
        splits["test"] += chosen
        splits["train"] += _without(of_label, chosen)
    rule = f"of every action {test} clips test, drawn at random; all others train"
    return _clips_material("custom", lower, upper, **splits, rule=rule)


def spread(clips: list[Motion], key: Callable[[Motion], object], count: int, random: torch.Generator) -> list[Motion]:
    """At most ``count`` clips at random, from as many groups as there are: one of each before a second of any."""
    order = [clips[index] for index in torch.randperm(len(clips), generator=random).tolist()]
    groups: dict[object, int] = {}
    rounds = []
    for clip in order:
        rounds.append(groups.setdefault(key(clip), 0))
        groups[key(clip)] += 1
    places = sorted(range(len(order)), key=rounds.__getitem__)
    return sorted((order[place] for place in places[:count]), key=lambda clip: clip.source)


def longest(clips: list[Motion], count: int) -> list[Motion]:
    """The longest clips, the earlier of two equally long ones, in the order of their sources."""
    return sorted(sorted(clips, key=len, reverse=True)[:count], key=lambda clip: clip.source)


def style_of(clip: Motion) -> str:
    """The style that the name of one of Bandai-Namco's files tells."""
    return BANDAI_NAMCO.fullmatch(Path(clip.source).stem)["style"]


def _of_bandai_namco(motions: list[Motion], where: str, dataset: str) -> list[Motion]:
    matches = [(BANDAI_NAMCO.fullmatch(Path(clip.source).stem), clip) for clip in motions]
    clips = [clip for match, clip in matches if match and match["dataset"] == dataset]
    if not clips:
        raise UserError(where, f"has no clips of Bandai-Namco's data set {dataset}", "its files keep their names")
    return clips


def _labelled(
    motions: list[Motion], where: str, labels: tuple[str, ...], others: bool = False
) -> dict[str, list[Motion]]:
    """The clips of each label (and of ``others``) in the order they came, labels in alphabetical order."""
    clips = group(motions)
    for label in labels:
        check_known(where, label, clips)
    return {label: clips[label] for label in clips if others or label in labels}


def _enough(clips: list[Motion], count: int, where: str, label: str, of: str = "") -> list[Motion]:
    if len(clips) < count:
        kind = f"{label} ({of})" if of else label
        raise UserError(where, f"has {len(clips)} clips of {kind}, {count} are needed", "give more clips of it")
    return clips


def _without(clips: list[Motion], chosen: list[Motion]) -> list[Motion]:
    taken = {id(clip) for clip in chosen}
    return [clip for clip in clips if id(clip) not in taken]


def _clips_material(
    name: str, lower: tuple[str, ...], upper: tuple[str, ...], train: list[Motion], test: list[Motion], rule: str
) -> Material:
    """All pairs of the labels, at the frame rate of this module."""
    train, test = ([resample(clip, FPS) for clip in clips] for clips in (train, test))
    return Material(name, 1, FPS, FRAMES, lower, upper, product(lower, upper), train, test, [], rule)


def _check_labels(lower: tuple[str, ...], upper: tuple[str, ...], per_action: int) -> None:
    if not product(lower, upper):
        raise UserError("custom", "needs labels to pair", "name them with --lower and --upper")
    for flag, labels in (("--lower", lower), ("--upper", upper)):
        for label in labels:
            if labels.count(label) > 1:
                raise UserError(flag, f"names {label} twice", "name every label once")
            if label == OTHER or "+" in label:
                problem = f"the label {label!r} cannot be told from others in names of compositions"
                raise UserError(flag, problem, "import the clips under another label")
    if not 1 <= per_action <= 1000:
        raise UserError("--per-action", f"expected 1 to 1000, got {per_action}")


def _subject(clip: Motion) -> int:
    return video_of(clip.source).subject


def _learned(clip: Motion) -> bool:
    return _subject(clip) in UESTC_TRAIN_SUBJECTS
