"""Which parts of the body a phrase is about, by labelled phrases that resemble it.

Kernel ridge regression on their similarity. Sides are taken out of all phrases beforehand, so nothing depends on them:
it says how many arms and legs, not which.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from refine.text.examples import Example, examples, plain

if TYPE_CHECKING:
    from refine.text.encoder import TextEncoder

LENGTHS = (3, 4, 5)  # of the pieces of words that are compared where there is no encoder
RIDGE = 0.3
SHARPNESS = {"embedding": 2, "spelling": 1}  # similarities are raised to this power
OPEN = 0.4  # how much a part is marked where people differ
AT_ONCE = 128

Vectors = Callable[[Sequence[str]], np.ndarray]


class Guess(NamedTuple):
    """What resembling phrases say."""

    whole: bool
    torso: bool
    arms: int
    legs: int
    nearest: str
    similarity: float
    """Of the nearest one: a cosine."""


@dataclass(frozen=True)
class Nearest:
    """The examples, compared by an encoder's embeddings; by the spelling of their words where there is none."""

    encoder: "TextEncoder | None" = None
    known: tuple[Example, ...] = ()

    @property
    def by(self) -> str:
        return "embedding" if self.encoder else "spelling"

    def __call__(self, phrase: str) -> Guess:
        vectors, phrases, weights, means = self._fitted
        similarity = vectors([sideless(phrase)])[0] @ self._known_vectors.T
        scores = means + np.clip(similarity, 0, 1) ** SHARPNESS[self.by] @ weights
        whole, torso, arm, arms, leg, legs = (scores > 0.5).tolist()
        nearest = int(similarity.argmax())
        return Guess(
            whole, torso, arm + (arm and arms), leg + (leg and legs), phrases[nearest], float(similarity.max())
        )

    @cached_property
    def _fitted(self) -> tuple[Vectors, list[str], np.ndarray, np.ndarray]:
        known = self.known or examples()
        phrases = [each.phrase for each in known]
        vectors = self._embeddings if self.encoder else _spelling([sideless(each) for each in phrases])
        rows = vectors([sideless(each) for each in phrases])
        object.__setattr__(self, "_known_vectors", rows)
        wanted = np.array([relative(each) for each in known], float)
        kernel = np.clip(rows @ rows.T, 0, 1) ** SHARPNESS[self.by]
        means = wanted.mean(0)
        weights = np.linalg.solve(kernel + RIDGE * np.eye(len(kernel)), wanted - means)
        return vectors, phrases, weights, means

    def _embeddings(self, phrases: Sequence[str]) -> np.ndarray:
        """[B E]; in order of length, as a batch takes as long as its longest."""
        order = sorted(range(len(phrases)), key=lambda at: len(phrases[at]))
        found = np.zeros((len(phrases), self.encoder.width), np.float32)
        for start in range(0, len(order), AT_ONCE):
            batch = order[start : start + AT_ONCE]
            found[batch] = self.encoder.sentences([phrases[at] for at in batch]).numpy()
        return found


def sideless(phrase: str) -> str:
    """A phrase without the words that tell sides.

    >>> sideless("Wave with the left hand!")
    'wave with the hand'
    """
    return " ".join(re.sub(r"\b(left|right)\b", " ", plain(phrase)).split()) or "side"


def relative(example: Example) -> list[float]:
    """How much it is about: global, torso, an arm, both arms, a leg, both legs."""
    whole, torso, *limbs = (OPEN if mark is None else float(mark) for mark in example.marks)
    arms, legs = limbs[:2], limbs[2:]
    return [whole, torso, max(arms), min(arms), max(legs), min(legs)]


def _pieces(phrase: str) -> set[str]:
    words = [f"<{word}>" for word in phrase.split()]
    return {word[at : at + size] for word in words for size in LENGTHS for at in range(len(word) - size + 1)}


def _spelling(known: Sequence[str]) -> Vectors:
    """Vectors of unit length from the pieces of words, rare ones counting more."""
    columns = {piece: at for at, piece in enumerate(sorted(set().union(*map(_pieces, known))))}
    often = np.zeros(len(columns))
    for phrase in known:
        often[[columns[piece] for piece in _pieces(phrase)]] += 1
    weight = np.log(len(known) / often)

    def vectors(phrases: Sequence[str]) -> np.ndarray:
        found = np.zeros((len(phrases), len(columns)), np.float32)
        for row, phrase in zip(found, phrases, strict=True):
            here = [columns[piece] for piece in _pieces(phrase) if piece in columns]
            row[here] = weight[here]
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)

    return vectors
