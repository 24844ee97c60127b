"""Bandai-Namco's clips in words: what their file names say is done, and in which style.

Names are ``dataset-1_walk-left_happy_001``: data set, content, style, number. Which hand or leg a content takes where
its name does not say so was seen in the clips themselves.
"""

import math
import re
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import NamedTuple

from refine.motion import Motion
from refine.text.described import Described, Split
from refine.text.splits import stratified
from renderers.checks import UserError, check_known
from renderers.rotations import heading

NAME = re.compile(r"dataset-(?P<dataset>[12])_(?P<content>[^_]+)_(?P<style>[^_]+)_(?P<number>\d+)")
WRONG_WAY = math.radians(45)  # a turn by more than this against the name is described as it is


class Content(NamedTuple):
    """What is done."""

    named: str
    """It by a noun; {a} stands for "an exhausted"."""
    says: tuple[str, ...]
    """Ways to ask for it; {how} is where the manner goes."""


class Style(NamedTuple):
    """In which style."""

    a: str
    """Article and adjective, or a genitive, in front of a noun."""
    how: tuple[str, ...]
    """Manners behind a verb."""


CONTENTS: dict[str, Content] = {
    "walk": Content("{a} walk", ("walk{how}", "walk forwards{how}")),
    "run": Content("{a} run", ("run{how}", "run forwards{how}")),
    "dash": Content("{a} dash", ("dash{how}", "sprint{how}")),
    "walk-back": Content("{a} walk backwards", ("walk backwards{how}", "go backwards{how}")),
    "walk-left": Content("{a} walk to the left", ("walk to the left{how}", "walk left{how}")),
    "walk-right": Content("{a} walk to the right", ("walk to the right{how}", "walk right{how}")),
    "walk-turn-left": Content("{a} walk, turning left", ("walk{how}, turning left", "turn left, walking{how}")),
    "walk-turn-right": Content("{a} walk, turning right", ("walk{how}, turning right", "turn right, walking{how}")),
    "bow": Content("{a} bow", ("bow{how}", "take a bow{how}")),
    "bye": Content(
        "{a} wave goodbye with the right hand",
        ("wave goodbye with the right hand{how}", "say goodbye{how}, waving the right hand"),
    ),
    "byebye": Content(
        "{a} wave goodbye with both hands",
        ("wave goodbye with both hands{how}", "say goodbye{how}, waving both hands"),
    ),
    "guide": Content(
        "{a} gesture with the right hand to show the way",
        ("show the way with the right hand{how}", "point the way with the right arm{how}"),
    ),
    "respond": Content(
        "{a} response with a raise of the left hand",
        ("respond{how}, raising the left hand", "answer by raising the left hand{how}"),
    ),
    "call": Content(
        "{a} bow with a beckoning of the right hand",
        ("bend forwards and beckon with the right hand{how}", "lean forwards{how}, calling with the right hand"),
    ),
    "punch": Content("{a} series of punches", ("punch with both fists{how}", "throw punches with both arms{how}")),
    "kick": Content(
        "{a} series of kicks with the right leg", ("kick with the right leg{how}", "do kicks with the right leg{how}")
    ),
    "slash": Content(
        "{a} slash of a sword with both hands",
        ("swing a sword with both hands{how}", "slash with a sword in both hands{how}"),
    ),
    "dance": Content("{a} dance", ("dance{how}", "perform a dance{how}")),
    "raise-up-both-hands": Content("{a} raise of both hands", ("raise both hands{how}", "lift both hands up{how}")),
    "raise-up-left-hand": Content(
        "{a} raise of the left hand", ("raise the left hand{how}", "lift the left hand up{how}")
    ),
    "raise-up-right-hand": Content(
        "{a} raise of the right hand", ("raise the right hand{how}", "lift the right hand up{how}")
    ),
    "wave-both-hands": Content("{a} wave with both hands", ("wave with both hands{how}", "wave both hands{how}")),
    "wave-left-hand": Content(
        "{a} wave with the left hand", ("wave with the left hand{how}", "wave the left hand{how}")
    ),
    "wave-right-hand": Content(
        "{a} wave with the right hand", ("wave with the right hand{how}", "wave the right hand{how}")
    ),
}
SAME_CONTENT = {"dance-short": "dance", "dance-long": "dance"}

STYLES: dict[str, Style] = {
    "normal": Style("a normal", ("", "normally", "in a normal way")),
    "happy": Style("a happy", ("happily", "like someone happy", "in a happy mood")),
    "sad": Style("a sad", ("sadly", "like someone sad", "in a sad mood")),
    "angry": Style("an angry", ("angrily", "like someone angry", "in an angry mood")),
    "proud": Style("a proud", ("proudly", "like someone proud", "in a proud way")),
    "not-confident": Style("a timid", ("timidly", "without confidence", "like someone who is not confident")),
    "masculine": Style("a masculine", ("in a masculine way", "in a manly way", "like a man")),
    "feminine": Style("a feminine", ("in a feminine way", "in a ladylike way", "like a woman")),
    "childish": Style("a childish", ("childishly", "like a child", "in a childish way")),
    "old": Style("an old person's", ("like an old person", "like someone very old", "the way old people do")),
    "elderly": Style(
        "an elderly person's", ("like an elderly person", "like someone elderly", "the way the elderly do")
    ),
    "tired": Style("a tired", ("wearily", "like someone tired", "in a tired way")),
    "exhausted": Style("an exhausted", ("exhaustedly", "like someone exhausted", "as if worn out")),
    "active": Style("an energetic", ("energetically", "actively", "with much energy")),
    "youthful": Style("a youthful", ("youthfully", "like a young person", "in a youthful way")),
    "musical": Style("a rhythmical", ("rhythmically", "in a rhythmical way", "in a musical way")),
    "giant": Style("a giant's", ("like a giant", "as if huge and heavy", "the way giants do")),
    "chimpira": Style("a thug's", ("like a thug", "like a street hoodlum", "the way thugs do")),
}
SAME_STYLE = {"masculinity": "masculine"}  # in data set 1


def content_and_style(name: str) -> tuple[str, str]:
    """The keys in ``CONTENTS`` and ``STYLES`` of a file name, whichever folders are before it.

    Raises:
        UserError: it is no name of such a clip, or its content or style is not known.
    """
    found = NAME.fullmatch(PurePosixPath(name).stem)
    if not found:
        raise UserError(name, "is not called as Bandai-Namco's clips are", "dataset-2_walk_active_001 is such a name")
    content, style = (
        same.get(found[key], found[key]) for key, same in (("content", SAME_CONTENT), ("style", SAME_STYLE))
    )
    check_known(name, content, CONTENTS)
    check_known(name, style, STYLES)
    return content, style


def describe(content: str, style: str) -> tuple[str, ...]:
    """Ways to say that a content is done in a style, first those that ask for it.

    >>> describe("walk-turn-left", "exhausted")[0], describe("walk-turn-left", "exhausted")[-1]
    ('walk exhaustedly, turning left', 'an exhausted walk, turning left')
    """
    what, which = CONTENTS[content], STYLES[style]
    manners = (f" {how}" if how else "" for how in which.how)
    said = [text.format(how=how) for how in manners for text in what.says]
    return (*dict.fromkeys(said), what.named.format(a=which.a))


def described_clips(motions: Iterable[Motion], seed: int = 0, noted: list[str] | None = None) -> list[Described]:
    """Bandai-Namco's clips, by the names that their ``source`` ends in, each in several ways.

    Of each content one clip in six is for "val" and one for "test", spread over the styles.

    Args:
        seed: of the split.
        noted: receives a line for each clip that is described otherwise than its name says.

    Raises:
        UserError: there are no clips, one has another name, or is there twice.
    """
    named: dict[str, Motion] = {}
    for motion in motions:
        if named.setdefault(name := PurePosixPath(motion.source).stem, motion) is not motion:
            raise UserError(name, "is there twice", "give one copy of each clip")
    if not named:
        raise UserError("Bandai-Namco", "there are no clips to describe", "give the folder of the BVH files")
    splits = splits_of(named, seed)
    items = []
    for name in sorted(named):
        content, style = content_and_style(name)
        motion = named[name]
        if (shown := _shown(content, motion)) != content:
            content = shown
            if noted is not None:
                noted.append(f"{name} turns to the other side, and is described so")
        texts = tuple((text,) for text in describe(content, style))
        items.append(Described(motion, texts, name, splits[name]))
    return items


def splits_of(names: Iterable[str], seed: int = 0) -> dict[str, Split]:
    """What each clip is used for, by its name; the order of the names does not matter.

    Raises:
        UserError: see `content_and_style`.
    """
    return stratified({name: content_and_style(name) for name in names}, seed)


def _shown(content: str, motion: Motion) -> str:
    """The content, but the other turn where the body clearly turns to the other side."""
    if content not in ("walk-turn-left", "walk-turn-right"):
        return content
    steps = heading(motion.rotations[:, 0]).diff()
    turned = float(((steps + math.pi) % (2 * math.pi) - math.pi).sum())  # to the left
    if abs(turned) < WRONG_WAY:
        return content
    return "walk-turn-left" if turned > 0 else "walk-turn-right"
