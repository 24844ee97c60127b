"""The labeller that is used unless another is asked for: by the words, and by labelled phrases where those fail."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

from refine.text.clauses import BOTH, FREE, NEITHER, Limbs
from refine.text.examples import Example, labelled, plain
from refine.text.lexical import Reading, read
from refine.text.parts import Labelled, Labeller, Parts
from refine.text.vocabulary import SIDES, legible, words_of
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.text.encoder import TextEncoder
    from refine.text.nearest import Guess, Nearest

LONGEST = 500  # characters of a phrase
LEGIBLE = 0.4  # the least share of common spellings at which a phrase of unknown words alone is still guessed


def labeller(encoder: "TextEncoder | None" = None) -> Labeller:
    """The labeller that is used unless another is asked for. Nothing is loaded before it is needed; no network is.

    Args:
        encoder: compares phrases whose words do not say enough with the labelled ones. None = the one of the extra
            ``[text]`` where it is installed, else their spelling.
    """

    def label(phrases: Sequence[str]) -> list[Labelled]:
        return [_labelled(phrase, encoder) for phrase in phrases]

    return label


def by_words(phrases: Sequence[str]) -> list[Labelled]:
    """What the words alone say, see ``refine.text.lexical``; no part where they say nothing.

    Raises:
        UserError: a phrase is empty or too long.
    """
    found = []
    for phrase in phrases:
        reading = read(_checked(phrase))
        found.append(Labelled(phrase, parts_of(reading), "words", _why(reading), reading.unknown))
    return found


def parts_of(reading: Reading) -> Parts:
    """The parts of a reading. A hand or foot that is free is the right one."""
    return Parts(reading.whole, reading.torso, *_sides(reading.arms), *_sides(reading.legs))


def _sides(limbs: Limbs) -> tuple[bool, bool]:
    return "left" in limbs, "right" in limbs or "free" in limbs


def _checked(phrase: str) -> str:
    if not plain(phrase):
        raise UserError("text", "is empty", 'describe an action, such as "walk forwards"')
    if len(phrase) > LONGEST:
        raise UserError("text", f"has {len(phrase):,} characters", f"describe the action in at most {LONGEST}")
    return phrase


def _labelled(phrase: str, encoder: "TextEncoder | None") -> Labelled:
    reading = read(_checked(phrase))
    if example := labelled().get(plain(phrase)):
        return Labelled(phrase, _as_marked(example, parts_of(reading)), "examples", "labelled by hand")
    if reading.about:
        return Labelled(phrase, parts_of(reading), "words", _why(reading), reading.unknown)
    words = words_of(phrase)
    if not words or (len(reading.unknown) == len(words) and legible(words) < LEGIBLE):
        remedy = "say it otherwise, or list its parts: torso, right arm"
        raise UserError(repr(phrase), "has no word that is known", remedy)
    nearest = _nearest(encoder)
    guess = nearest(phrase)
    told = as_guessed(phrase, guess)
    why = f'as "{guess.nearest}", the most alike by {nearest.by} ({guess.similarity:.2f})'
    return Labelled(phrase, parts_of(told), nearest.by, why, reading.unknown)


def as_guessed(phrase: str, guess: "Guess") -> Reading:
    """What resembling phrases say of a phrase, on the side that it names where it names one."""
    sides = frozenset(SIDES).intersection(words_of(phrase))
    limbs = (NEITHER, sides if len(sides) == 1 else FREE, BOTH)
    return Reading(guess.whole, guess.torso, limbs[guess.arms], limbs[guess.legs])


def _why(reading: Reading) -> str:
    return f"by {', '.join(dict.fromkeys(reading.about))}" if reading.about else "no word says which"


def _as_marked(example: Example, otherwise: Parts) -> Parts:
    """As labelled by hand; where people differ, as the words say."""
    return Parts(*(other if mark is None else mark for mark, other in zip(example.marks, otherwise, strict=True)))


@lru_cache(maxsize=2)
def _nearest(encoder: "TextEncoder | None") -> "Nearest":
    from refine.text.nearest import Nearest

    if encoder is None:
        from refine.text.encoder import has_default, load_encoder

        encoder = load_encoder() if has_default() else None
    return Nearest(encoder)
