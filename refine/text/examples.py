"""Phrases that are labelled by hand, one side of each; the other side is its mirror image."""

import re
from functools import lru_cache
from typing import NamedTuple

from refine.motion import other_side
from refine.text.vocabulary import rows

Mark = bool | None
"""None where people differ: the part may be marked or not."""


class Example(NamedTuple):
    """A phrase and, for each of ``BODY_PARTS``, whether it is one of those that the phrase is about."""

    phrase: str
    marks: tuple[Mark, ...]
    group: str
    """Phrases of one group are related: whoever measures leaves out a whole group."""

    def mirrored(self) -> "Example":
        whole, torso, left_arm, right_arm, left_leg, right_leg = self.marks
        return Example(other_side(self.phrase), (whole, torso, right_arm, left_arm, right_leg, left_leg), self.group)


@lru_cache(maxsize=1)
def examples() -> tuple[Example, ...]:
    """The stored ones."""
    marks = {"1": True, "0": False, "?": None}
    return tuple(Example(phrase, tuple(marks[each] for each in said), group) for group, said, phrase in rows(TABLE))


TABLE = "text_parts.tsv"


def plain(phrase: str) -> str:
    """A phrase without capitals, punctuation and double spaces.

    >>> plain("  Walk, then   wave!")
    'walk then wave'
    """
    return " ".join(re.findall(r"[^\W_]+", phrase.lower()))


@lru_cache(maxsize=1)
def labelled() -> dict[str, Example]:
    """Examples and their mirror images by their plain words."""
    found = {plain(each.phrase): each for each in (example.mirrored() for example in examples())}
    return found | {plain(each.phrase): each for each in examples()}
