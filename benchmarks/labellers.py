"""What the default labeller makes of actions that it knows nothing of, by cross-validation over its own examples.

    python benchmarks/labellers.py

Each group of related examples is left out in turn, and with it the verbs that no other group has.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from refine.text import clauses, vocabulary
from refine.text.encoder import TextEncoder, has_default, load_encoder
from refine.text.examples import Example, examples
from refine.text.labellers import as_guessed, parts_of
from refine.text.lexical import read
from refine.text.nearest import Nearest
from refine.text.parts import BODY_PARTS, Parts

Labels = Callable[[str], Parts]


@contextlib.contextmanager
def without(words: set[str]) -> Iterator[None]:
    """The vocabulary lacks these for a while."""
    lacking = {entry: meanings for entry, meanings in vocabulary.vocabulary().items() if entry not in words}
    known, vocabulary.vocabulary = vocabulary.vocabulary, lambda: lacking
    caches = (vocabulary._longest, vocabulary._words, vocabulary._known, clauses._doing_of)
    try:
        for cache in caches:
            cache.cache_clear()
        yield
    finally:
        vocabulary.vocabulary = known
        for cache in caches:
            cache.cache_clear()


@dataclass(frozen=True)
class Remembering:
    """An encoder that is asked once for each text."""

    encoder: TextEncoder
    memory: dict

    @property
    def width(self) -> int:
        return self.encoder.width

    def sentences(self, texts):
        import torch

        new = [text for text in texts if text not in self.memory]
        self.memory.update(zip(new, self.encoder.sentences(new) if new else (), strict=True))
        return torch.stack([self.memory[text] for text in texts])


def variants(known: tuple[Example, ...], encoder: TextEncoder | None) -> dict[str, Labels]:
    """Ways to label, with these examples."""
    found: dict[str, Labels] = {"words alone": lambda phrase: parts_of(read(phrase))}
    for name, by in {"embedding": encoder, "spelling": None}.items():
        if name == "spelling" or encoder:
            nearest = Nearest(by, known)

            def alone(phrase: str, nearest: Nearest = nearest) -> Parts:
                return parts_of(as_guessed(phrase, nearest(phrase)))

            def both(phrase: str, alone: Labels = alone) -> Parts:
                reading = read(phrase)
                return parts_of(reading) if reading.about else alone(phrase)

            found |= {f"{name} alone": alone, f"words, else {name}": both}
    return found


def accuracy(answers: list[Parts], wanted: list[Example]) -> np.ndarray:
    """[6] for each part, how often an answer is right where people agree."""
    marks = np.array([[np.nan if mark is None else mark for mark in each.marks] for each in wanted], float)
    told = ~np.isnan(marks)
    right = (np.array(answers, float) == marks) & told
    return np.where(told.any(0), right.sum(0) / np.maximum(told.sum(0), 1), np.nan)


def main() -> None:
    encoder = Remembering(load_encoder(), {}) if has_default() else None
    everything = examples()
    about = {each.phrase: set(read(each.phrase).about) for each in everything}
    answers: dict[str, list[Parts]] = {}
    asked: list[Example] = []
    for group in sorted({each.group for each in everything}):
        left_out = [each for each in everything if each.group == group]
        known = tuple(each for each in everything if each.group != group)
        own = set().union(*(about[each.phrase] for each in left_out))
        own -= set().union(*(about[each.phrase] for each in known))
        with without(own):
            for name, label in variants(known, encoder).items():
                answers.setdefault(name, []).extend(label(each.phrase) for each in left_out)
        asked += left_out
    print(f"| | {' | '.join(BODY_PARTS)} | mean |\n|---|{'---|' * 7}")
    for name, found in answers.items():
        each = accuracy(found, asked)
        print(f"| {name} | {' | '.join(f'{part:.3f}' for part in each)} | {each.mean():.3f} |")


if __name__ == "__main__":
    main()
