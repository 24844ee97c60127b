"""What ``refine compose --by parts`` takes from texts, and what it says of them."""

from collections.abc import Sequence
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

from refine.cli.inputs import say
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.coupling_by_parts import Division
    from refine.motion import Motion
    from refine.text.parts import Labelled, Labeller

MOST = len(ascii_uppercase)


def texts_of(
    clips: Sequence["Motion"], names: Sequence[str], given: Sequence[str | None], flags: Sequence[str]
) -> list[str]:
    """The text of each clip: the one that is given, or what its label says.

    Raises:
        UserError: there is neither, or one is empty or longer than a phrase may be.
    """
    from refine.cli.labelling import check_phrases
    from refine.text.phrases import phrase_of

    texts = []
    for clip, name, text, flag in zip(clips, names, given, flags, strict=True):
        if text is None and not (text := phrase_of(clip.label)):
            raise UserError(name, "has no label to tell what it does", f'say it with {flag}, such as "walk forwards"')
        check_phrases(flag, [text])
        texts.append(text)
    return texts


def labelled_texts(texts: Sequence[str], labeller: "Labeller | None" = None) -> list["Labelled"]:
    """What each text is about. One that lists parts, such as "torso, right arm", is taken at its word.

    The default labeller is asked unless another is given. Words that are not known are said.
    """
    from refine.cli.labelling import say_unknown
    from refine.text.labellers import labeller as default_labeller
    from refine.text.parts import BODY_PARTS, Labelled, Parts

    names = [[name.strip().lower() for name in text.split(",")] for text in texts]
    listed = [set(each) <= set(BODY_PARTS) for each in names]
    asked = [text for text, plain in zip(texts, listed, strict=True) if not plain]
    answers = iter((labeller or default_labeller())(asked) if asked else ())
    found = [
        Labelled(text, Parts.of(each), "the text itself", "lists parts", ()) if plain else next(answers)
        for text, each, plain in zip(texts, names, listed, strict=True)
    ]
    say_unknown(found, ascii_uppercase)
    return found


def say_who_wins(division: "Division") -> None:
    """One line on stderr where actions contradict each other."""
    if division.contests:
        contests = "; ".join(
            f"{_listed([*each.losers, each.winner])} need the {each.what}, {ascii_uppercase[each.winner]} wins"
            for each in division.contests
        )
        say(f"refine: {contests} (fewer parts win over more, of equals the later)")


def lines_of(labelled: Sequence["Labelled"], division: "Division") -> list[str]:
    """For people: what each action is about, and what it gives."""
    return [
        f'{letter} "{each.phrase}" is about {_named(each.parts)}; gives {_named(division.parts_of(number))}'
        for number, (letter, each) in enumerate(zip(ascii_uppercase, labelled, strict=False))
    ]


def values_of(labelled: Sequence["Labelled"], division: "Division") -> dict[str, Any]:
    """For programs: the parts of each action, and the owner of each part."""
    from refine.text.parts import BODY_PARTS

    actions = {
        letter: {"text": each.phrase, "parts": list(each.parts.names), "by": each.by, "why": each.why}
        for letter, each in zip(ascii_uppercase, labelled, strict=False)
    }
    owners = {part: ascii_uppercase[owner] for part, owner in zip(BODY_PARTS, division.owners, strict=True)}
    return {"actions": actions, "owners": owners}


def _named(parts: Any) -> str:
    return ", ".join(parts.names) or "no part"


def _listed(actions: Sequence[int]) -> str:
    letters = [ascii_uppercase[action] for action in sorted(actions)]
    return f"both {' and '.join(letters)}" if len(letters) == 2 else f"{', '.join(letters[:-1])} and {letters[-1]}"
