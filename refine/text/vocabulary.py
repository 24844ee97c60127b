"""The words that the lexical labeller knows, and how a phrase is cut into them."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

SIDES = ("left", "right")
BREAKS = re.compile(r"[^\W\d_]+|[,;:.]")
IRREGULAR = {
    "sat": "sit", "stood": "stand", "lay": "lie", "lying": "lie", "lies": "lie", "lain": "lie", "ran": "run",
    "threw": "throw", "thrown": "throw", "caught": "catch", "went": "go", "gone": "go", "goes": "go",
    "took": "take", "taken": "take", "gave": "give", "given": "give", "held": "hold", "kept": "keep",
    "bent": "bend", "swung": "swing", "spun": "spin", "swam": "swim", "drank": "drink", "ate": "eat",
    "eaten": "eat", "wrote": "write", "written": "write", "drew": "draw", "drawn": "draw", "fell": "fall",
    "fallen": "fall", "knelt": "kneel", "leapt": "leap", "struck": "strike", "shook": "shake",
    "shaken": "shake", "slid": "slide", "brought": "bring", "rose": "rise", "risen": "rise", "rode": "ride",
    "ridden": "ride", "hung": "hang", "wept": "weep", "slept": "sleep", "dove": "dive", "flew": "fly",
    "drove": "drive", "fought": "fight", "blew": "blow", "sang": "sing", "spoke": "speak", "dug": "dig",
    "swept": "sweep", "shot": "shoot", "stuck": "stick", "hid": "hide", "dying": "die", "tying": "tie",
    "feet": "foot", "teeth": "tooth", "knives": "knife", "calves": "calf", "thighs": "thigh",
    "leaves": "leaf", "halves": "half", "men": "man", "women": "woman", "children": "child",
    "lefty": "left", "leftwards": "left", "rightwards": "right", "leftward": "left", "rightward": "right",
}  # fmt: skip
PLURALS = {"feet", "teeth", "biceps", "triceps", "quadriceps", "abs", "glutes", "calves", "thighs"}
ARTICLES, ARTICLES_BETWEEN = {"a", "an", "the", "his", "her", "their", "its", "some"}, 1
CLOSE, SHORTEST = 0.83, 5  # a typo of a word that has so many letters


class Meaning(NamedTuple):
    """One reading of a word: its kind, and how much of the body it is about."""

    kind: str
    whole: int
    torso: int
    arms: int
    legs: int


@dataclass(frozen=True)
class Token:
    """A word, or several that mean one thing."""

    text: str
    meanings: tuple[Meaning, ...]
    plural: bool = False
    misspelt: str = ""
    """How it is written, where it is none of the known words but nearly one."""

    @property
    def known(self) -> bool:
        return bool(self.meanings) and not self.misspelt

    @property
    def said(self) -> str:
        return self.misspelt or self.text

    def kind(self, *kinds: str) -> Meaning | None:
        """Its meaning of one of those kinds, "body" for any part of the body."""
        for meaning in self.meanings:
            if meaning.kind in kinds or ("body" in kinds and meaning.kind.startswith("body:")):
                return meaning
        return None


def rows(name: str) -> Iterator[list[str]]:
    """The cells of each line of a table among the assets, without the comments."""
    text = (resources.files("refine") / "assets" / name).read_text(encoding="utf-8")
    for line in text.splitlines():
        if line and not line.startswith("#"):
            yield line.split("\t")


@lru_cache(maxsize=1)
def vocabulary() -> dict[str, tuple[Meaning, ...]]:
    """Every known word, or words with spaces between, and its meanings."""
    found: dict[str, tuple[Meaning, ...]] = {}
    for kind, marks, words in rows("text_words.tsv"):
        for word in words.split(", "):
            found[word] = (*found.get(word, ()), Meaning(kind, *(int(mark) for mark in marks)))
    return found


@lru_cache(maxsize=1)
def _longest() -> dict[str, int]:
    """For each first word, how many words its longest entry has."""
    longest: dict[str, int] = {}
    for entry in vocabulary():
        words = entry.split()
        longest[words[0]] = max(longest.get(words[0], 1), len(words))
    return longest


def stems(word: str) -> Iterator[str]:
    """What a word may be a form of, itself first.

    >>> list(stems("hopping"))
    ['hopping', 'hopp', 'hoppe', 'hop']
    """
    yield word
    if word in IRREGULAR:
        yield IRREGULAR[word]
    for ending, instead in (("ies", "y"), ("ied", "y"), ("s", ""), ("es", "")):
        if word.endswith(ending) and len(word) > len(ending) + 1 and not word.endswith("ss"):
            yield word[: -len(ending)] + instead
    for ending in ("ing", "ed"):
        stem = word[: -len(ending)]
        if word.endswith(ending) and len(stem) > 1:
            yield stem
            yield stem + "e"
            if stem[-1] == stem[-2]:
                yield stem[:-1]
    if word.endswith("ly") and len(word) > 4:
        yield "slow"  # any adverb of manner


@lru_cache(maxsize=4096)
def _known(word: str) -> str | None:
    return next((stem for stem in stems(word) if stem in vocabulary()), None)


def _entry(words: list[str]) -> str | None:
    """The entry that several words are, whichever of them are inflected."""
    forms = [""]
    for word in words:
        forms = [f"{form} {stem}".strip() for form in forms for stem in dict.fromkeys(stems(word))]
    return next((form for form in forms if form in vocabulary()), None)


def _tokens(words: list[str]) -> Iterator[Token]:
    known, longest, at = vocabulary(), _longest(), 0
    while at < len(words):
        word = words[at]
        reach = max(longest.get(stem, 1) for stem in stems(word))
        reach += ARTICLES_BETWEEN if reach > 1 else 0
        for length in range(min(reach, len(words) - at), 1, -1):
            several = [word, *(each for each in words[at + 1 : at + length] if each not in ARTICLES)]
            if len(several) > 1 and words[at + length - 1] not in ARTICLES and (entry := _entry(several)):
                yield Token(entry, known[entry], words[at + length - 1].endswith("s"))
                at += length
                break
        else:
            entry = _known(word)
            plural = entry is not None and (word in PLURALS or (word != entry and word.endswith("s")))
            misspelt = ""
            if entry is None and len(word) >= SHORTEST:
                near = [each for each in _words() if each[0] == word[0]]
                for entry in get_close_matches(word, near, n=1, cutoff=CLOSE):
                    misspelt, plural = word, word.endswith("s") and not entry.endswith("s")
            yield Token(entry or word, known.get(entry or "", ()), plural, misspelt)
            at += 1


@lru_cache(maxsize=1)
def _words() -> tuple[str, ...]:
    """Single words that a typo may mean."""
    return tuple(entry for entry in vocabulary() if " " not in entry and len(entry) >= SHORTEST - 1)


def words_of(phrase: str) -> list[str]:
    """The words of a phrase, without punctuation."""
    return [word for word in _pieces(phrase) if word.isalpha()]


def legible(words: Sequence[str]) -> float:
    """How much of words looks like words: the share of three letters in a row that known words have as well."""
    known = _in_a_row()
    shares = [sum(each in known for each in found) / len(found) for word in words if (found := _threes(word))]
    return sum(shares) / len(shares) if shares else 0.0


def _threes(word: str) -> list[str]:
    bounded = f"<{word}>"
    return [bounded[at : at + 3] for at in range(len(bounded) - 2)]


@lru_cache(maxsize=1)
def _in_a_row() -> frozenset[str]:
    return frozenset(three for entry in vocabulary() for word in entry.split() for three in _threes(word))


def _pieces(phrase: str) -> list[str]:
    return BREAKS.findall(re.sub(r"['’]s?\b", " ", phrase.lower()))


def tokens(phrase: str) -> list[Token]:
    """A phrase as known words; those that are not known have no meaning. Commas and the like are tokens as well."""
    return list(_tokens(_pieces(phrase)))
