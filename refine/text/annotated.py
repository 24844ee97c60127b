"""Annotated motions of AMASS, all splits one after the other: BABEL's, and those of KIT-ML and HumanML3D."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from refine.formats.babel import BabelConfig, load_babel, unseen_pairs
from refine.formats.tmr import AnnotatedConfig, load_annotated
from refine.motion import Motion
from refine.text.corpus import SPLITS
from refine.text.described import Described


def babel_corpus(annotations: Path, motions: Path, config: BabelConfig, left_out: list[str]) -> Iterator[Described]:
    """What is said in ``train.json``, then in ``val.json``; where one of them is not there, the other alone.

    BABEL publishes no labels of its test set. Two actions at once in ``val.json`` that SINC evaluates, see
    `unseen_pairs`, are for "test" here, and the rest of it for "val".

    Args:
        annotations, motions, config, left_out: see `load_babel`.

    Raises:
        UserError: see `load_babel`.
    """
    there = [split for split in ("train", "val") if (annotations / f"{split}.json").exists()]
    if there == ["val"]:
        left_out.append(f"{annotations / 'train.json'} is not there: each of the pairs of val counts as unseen")
    learned: list[Described] = []
    for split in there or ["train"]:
        for item in load_babel(annotations, motions, split, config, left_out):
            if split == "train" and item.actions == 2:
                learned.append(replace(item, motion=_first_frame(item.motion)))
            tested = split == "val" and item.actions == 2 and unseen_pairs([item], learned)
            yield replace(item, split="test") if tested else item


def annotated_corpus(folder: Path, motions: Path, config: AnnotatedConfig, left_out: list[str]) -> Iterator[Described]:
    """Descriptions of train, val and test, see `load_annotated`."""
    for split in SPLITS:
        yield from load_annotated(folder, motions, split, config, left_out)


def _first_frame(motion: Motion) -> Motion:
    """A copy of it alone, which keeps nothing else in memory."""
    return replace(motion, rotations=motion.rotations[:1].clone(), root=motion.root[:1].clone())
