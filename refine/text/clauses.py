"""What is done in a phrase: its actions, each with the parts of the body, sides and things that the words give it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Literal

from refine.text.vocabulary import SIDES, Meaning, Token

Side = Literal["left", "right", "free"]
"""Of a hand or foot; "free" is one that no word gives a side."""
Limbs = frozenset[Side]
NEITHER: Limbs = frozenset()
FREE: Limbs = frozenset({"free"})
BOTH: Limbs = frozenset(SIDES)
Clause = tuple[Token, ...]
OPPOSITE: dict[str, Side] = {"left": "right", "right": "left"}

DOINGS = ("act", "own", "put", "hand", "touch", "hold", "leg", "rest")
JOINING = {"and", "while", "whilst", "then", "as", "during", "but", "before", "after", "or", "when", *",;:."}
TARGET = {
    "on", "onto", "upon", "to", "toward", "towards", "over", "against", "behind", "in", "into", "inside", "at", "near",
    "around", "between", "above", "under", "underneath", "below", "across", "off", "from", "through", "beside", "along",
    "past", "for", "like", "in front of", "in front",
}  # fmt: skip
MEANS = {"with", "using", "by"}
UNMOVED = {"still", "motionless", "stationary"}
EACH = {"both", "two", "each", "all", "alternating", "alternately"}
ONE = {"one", "a", "an", "single", "another"}
OTHER = {"other", "opposite"}
AGAIN = {"it", "them"}
TAKING = {"take", "get"}
MANNER = {"motion", "movement", "manner", "way", "style", "fashion", "pattern"}
POSSESSIVES = {"his", "her", "their", "its", "my", "your"}
DETERMINERS = {"a", "an", "the", "some", "this", "that", "one", "two"} | POSSESSIVES
BEFORE_BACK = {"and", "lower", "upper", "arch", "scratch", "straighten", "rub", "pat", "massage"} | POSSESSIVES
FACING = {
    "left", "right", "to", "toward", "towards", "away", "forward", "forwards", "back", "backward", "backwards", "up",
    "down", "front", "the", "other", "opposite", "each", "another",
}  # fmt: skip
REACHING = {"reach", "reach out", "reach for", "reach forward", "reach up", "point", "extend", "indicate"}
STRIKING = {"punch", "jab", "hook", "uppercut", "wave", "elbow strike", "straight punch", "cross punch", "hook punch"}


@dataclass(frozen=True)
class Part:
    """A named part of the body in a clause."""

    meaning: Meaning
    text: str
    limbs: Limbs
    role: Literal["mover", "with", "target"]
    link: str = ""

    @property
    def side(self) -> str:
        return next(iter(self.limbs)) if len(self.limbs) == 1 else "free"

    def is_a(self, *kinds: str) -> bool:
        return self.meaning.kind.removeprefix("body:") in kinds


@dataclass
class Doing:
    """A verb, or a noun that says an action, and what belongs to it."""

    meaning: Meaning
    text: str
    plural: bool = False
    sides: set[Side] = field(default_factory=set)
    hint: str = ""
    parts: list[Part] = field(default_factory=list)
    things: list[tuple[Meaning, str]] = field(default_factory=list)
    low: bool = False
    again: bool = False
    """With what an action before it was done with: "raise an arm and lower it"."""


def clauses_of(said: Sequence[Token]) -> list[Clause]:
    """One for each thing that is done. What names no action goes with the clause before it, or else after it."""
    starts = [0, *(at for at, token in enumerate(said) if token.text in JOINING and at), len(said)]
    joined: list[Clause] = []
    for start, end in pairwise(starts):
        clause = tuple(said[start:end])
        if joined and (not _acts(clause) or not _acts(joined[-1])) and not keeps_still(clause):
            joined[-1] += clause
        else:
            joined.append(clause)
    return joined


def keeps_still(clause: Clause) -> bool:
    return any(token.text in UNMOVED for token in clause) and any(token.kind("body") for token in clause)


def doings_of(clause: Clause) -> list[Doing]:
    """What is done in a clause, each with its parts and things."""
    doings: list[tuple[int, Doing]] = []
    for at, token in enumerate(clause):
        if (meaning := _doing_of(clause, at)) and not _leads_on(clause, at):
            again = meaning.kind == "own" and at + 1 < len(clause) and clause[at + 1].text in AGAIN
            doings.append((at, Doing(meaning, token.text, token.plural, again=again)))
    if not doings:
        movers = any(_is_part(clause, at) for at in range(len(clause)))
        things = [thing for token in clause if (thing := token.kind("thing"))]
        if not movers and not things:
            return []
        kind = Meaning("own", 0, 0, 0, 0) if movers else Meaning("hand", 0, 0, 1, 0)
        names = [token.text for token in clause if token.kind("body" if movers else "thing")]
        doings = [(-1, Doing(kind, " ".join(names)))]
    role, link, last, used = "mover", "subject" if doings[0][0] >= 0 else "", "", set()
    for at, token in enumerate(clause):
        here = any(at == place for place, _ in doings)
        if here or token.kind("light"):
            role, link = "mover", ""
        elif token.text in MEANS:
            role, link = "with", token.text
        elif token.text in TARGET and not _particle(clause, at):
            role, link = "target", token.text
        if _is_part(clause, at) and not here:
            limbs, words = _limbs_named(clause, at, last)
            used |= words
            meaning = next(each for each in token.meanings if each.kind.startswith("body:"))
            if limbs & BOTH and len(limbs) == 1:
                last = next(iter(limbs))
            how = "with" if token.text in {"handed", "footed"} else role
            _owner(clause, doings, at, how).parts.append(Part(meaning, token.text, limbs, how, link))
        elif doings[0][0] < 0 and (thing := token.kind("thing")):
            doings[0][1].things.append((thing, "mover"))
        elif (thing := token.kind("thing", "large") or _unknown_thing(clause, at)) and role != "target" and not here:
            _owner(clause, doings, at, role).things.append((thing, link if link == "subject" else role))
        elif token.kind("low"):
            _owner(clause, doings, at, role).low = True
    for at, token in enumerate(clause):
        if token.text in SIDES and at not in used:
            _give_side(clause, doings, at)
    return [doing for _, doing in doings]


def _acts(clause: Clause) -> bool:
    return any(_doing_of(clause, at) for at in range(len(clause)))


@lru_cache(maxsize=4096)
def _doing_of(clause: Clause, at: int) -> Meaning | None:
    """The action that a token names in its clause, where it is not the name of a thing or of a part."""
    token = clause[at]
    likened = [each for each in range(at) if clause[each].text == "like"]
    if likened and (way := token.kind("way", "act")):  # "walk like a crab", but not "flap the arms like a bird"
        earlier = [doing for each in range(likened[0]) if (doing := _doing_of(clause, each))]
        return way if not earlier or earlier[-1].whole else None
    follows = clause[at + 1].kind("act") if at + 1 < len(clause) else None
    if follows and follows.whole and (way := token.kind("way")):  # "gorilla walk"
        return way
    doing = token.kind(*DOINGS)
    if token.text in TAKING and _takes(clause[at + 1 :]):
        return Meaning("hand", 0, 0, 1, 0)
    if doing is None or _is_manner(clause, at):
        return None
    before = clause[at - 1].text if at else ""
    if token.kind("body"):
        return doing if not _is_part(clause, at) else None
    if token.kind("thing"):
        earlier = any(_doing_of(clause, each) for each in range(at))
        return None if before in DETERMINERS or before in TARGET | MEANS or earlier else doing
    return doing


def _takes(rest: Clause) -> bool:
    """Whether a thing is taken, and not a step or a hand away."""
    for token in rest:
        if token.text in JOINING or token.kind("body", *DOINGS):
            return False
        if token.kind("thing"):
            return True
    return False


def _is_manner(clause: Clause, at: int) -> bool:
    """Whether a token says how and not what, as in "in a circle" and "in a swimming motion", or where: "on a step"."""
    after = clause[at + 1].text if at + 1 < len(clause) else ""
    if clause[at].text == "step" and at and clause[at - 1].text in TARGET | {"the"}:
        return any(_doing_of(clause, each) for each in range(at))
    within = any(each.text == "in" for each in clause[max(at - 3, 0) : at])
    manner = clause[at].text == "circle" or clause[at].kind("leg") is not None or after in MANNER
    return within and manner and any(_doing_of(clause, each) for each in range(at))


def _is_part(clause: Clause, at: int) -> bool:
    """Whether a token names a part of the body here."""
    token = clause[at]
    if not token.kind("body"):
        return False
    before = clause[at - 1].text if at else ""
    after = clause[at + 1].text if at + 1 < len(clause) else ""
    if token.text == "back":
        return before in BEFORE_BACK or (before == "the" and (at < 2 or clause[at - 2].text not in {"to", "at", "in"}))
    if token.text == "face":
        first = not any(_doing_of(clause, each) or clause[each].text in DETERMINERS for each in range(at))
        return not (first and after in FACING)
    return True


def _leads_on(clause: Clause, at: int) -> bool:
    """Whether a verb says only how another action begins, as in "lower into a squat"."""
    rest = clause[at + 1 :]
    if clause[at].text == "give":  # "give a nod"
        after = [each for each in range(len(rest)) if rest[each].text not in DETERMINERS]
        return bool(after) and _doing_of(rest, after[0]) is not None
    return clause[at].kind("own") is not None and any(
        each.text in {"into", "from"} and any(_doing_of(rest, later) for later in range(place, len(rest)))
        for place, each in enumerate(rest[:2])
    )


def _limbs_named(clause: Clause, at: int, last: str) -> tuple[Limbs, set[int]]:
    """Whose side a named limb is, by the words before it; and which words said so."""
    found: set[str] = set()
    used: set[int] = set()
    count = ""
    each = at - 1
    while each >= 0:
        token = clause[each]
        joins = token.text in {"and", "or", "then"} and found and each and clause[each - 1].text in SIDES
        if token.text in SIDES:
            found.add(token.text)
            used.add(each)
        elif token.text in EACH | ONE | OTHER:
            count = count or token.text
        elif not joins and (token.text in TARGET | MEANS | JOINING or not token.kind("plain", "way")):
            break
        each -= 1
    if found:
        return frozenset(found), used
    if count in OTHER and last in OPPOSITE:
        return frozenset({OPPOSITE[last]}), used
    if count in EACH or (clause[at].plural and count not in ONE):
        return BOTH, used
    return FREE, used


def _unknown_thing(clause: Clause, at: int) -> Meaning | None:
    """A word that is not known is a thing where one is expected: after a verb and an article."""
    if clause[at].meanings or clause[at].text in JOINING or not at:
        return None
    before = clause[at - 1]
    return Meaning("thing", 0, 0, 1, 0) if before.text in DETERMINERS or before.kind("own", "hand") else None


def _particle(clause: Clause, at: int) -> bool:
    """Whether a preposition belongs to a verb here, as in "put a hand in"."""
    return at + 1 == len(clause) or clause[at + 1].text in JOINING


def _owner(clause: Clause, doings: Sequence[tuple[int, Doing]], at: int, role: str) -> Doing:
    """The action that a part or thing belongs to: the one before it; the one right after it in "with arms raised"."""
    before = [doing for place, doing in doings if place < at]
    after = [(place, doing) for place, doing in doings if place > at]
    if not before:
        return after[0][1] if after else doings[0][1]
    if after and role == "with":
        place, doing = after[0]
        between = clause[at + 1 : place]
        if doing.meaning.kind in ("own", "put") and not any(each.text in TARGET | MEANS for each in between):
            return doing
    return before[-1]


def _give_side(clause: Clause, doings: Sequence[tuple[int, Doing]], at: int) -> None:
    """A side that no part has is that of a blow ("left hook", "kick right"), or the way that something goes."""
    before = clause[at - 1].text if at else ""
    end = at + 1
    while end + 1 < len(clause) and clause[end].text in {"and", "or", "then"} and clause[end + 1].text in SIDES:
        end += 2
    for place, doing in doings:
        limb = not doing.meaning.whole and (doing.meaning.arms or doing.meaning.legs)
        blow = doing.meaning.kind == "leg" or doing.text in STRIKING
        turned = any(p == at - 1 and d.meaning.whole + d.meaning.torso for p, d in doings)
        if (place == end and limb and before != "to" and not turned) or (place == at - 1 and blow):
            doing.sides.add(clause[at].text)
            return
    for place, doing in doings:
        if place < at and doing.text in REACHING:
            doing.hint = clause[at].text
