"""Which parts of the body a phrase is about, by its words: what is done, with what, on which side.

Hands and feet that no word gives a side are "free". Sides are told apart only by the words "left" and "right", in the
same way, so a phrase and its mirror image are read as mirror images.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from refine.text.vocabulary import SIDES, Meaning, Token, tokens

Side = Literal["left", "right", "free"]
Limbs = frozenset[Side]
NEITHER: Limbs = frozenset()
FREE: Limbs = frozenset({"free"})
BOTH: Limbs = frozenset(SIDES)
OPPOSITE: dict[str, Side] = {"left": "right", "right": "left"}

DOINGS = ("act", "own", "put", "hand", "touch", "hold", "leg", "rest")
JOINING = {"and", "while", "whilst", "then", "as", "during", "but", "before", "after", "or", "when", *",;:."}
TARGET = {
    "on", "onto", "upon", "to", "toward", "towards", "over", "against", "behind", "in", "into", "inside", "at", "near",
    "around", "between", "above", "under", "underneath", "below", "across", "off", "from", "through", "beside", "along",
    "past", "for", "like", "in front of", "in front",
}  # fmt: skip
MEANS = {"with", "using", "by"}
DENYING = {"without", "no", "not", "never"}
UNMOVED = {"still", "motionless", "stationary"}
EACH = {"both", "two", "each", "all", "alternating", "alternately"}
ONE = {"one", "a", "an", "single", "another"}
OTHER = {"other", "opposite"}
AGAIN = {"it", "them"}
TAKING = {"take", "get"}
MANNER = {"motion", "movement", "manner", "way", "style", "fashion", "pattern"}
DETERMINERS = {"a", "an", "the", "his", "her", "their", "its", "my", "your", "some", "this", "that", "one", "two"}
BEFORE_BACK = {
    "and",
    "his",
    "her",
    "their",
    "its",
    "lower",
    "upper",
    "arch",
    "scratch",
    "straighten",
    "rub",
    "pat",
    "massage",
}
ON_ONE_LEG = {
    "hop", "jump", "leap", "skip", "bounce", "bound", "land", "step", "step back", "lunge", "pivot", "kneel",
    "kneel down", "squat", "crouch", "hop on", "jump on", "skip on", "hop with", "jump with", "step with",
    "take step with", "step forward with", "step back with",
}  # fmt: skip
REACHING = {"reach", "reach out", "reach for", "reach forward", "reach up", "point", "extend", "indicate"}
GRABBING = {"grab", "grasp", "grip", "clutch"}
PAIRED = {
    "ear", "eye", "cheek", "shoulder", "hip", "thigh", "leg", "knee", "shin", "ankle", "foot", "heel", "toe",
}  # fmt: skip
SHOWING = {"tap", "point"}  # done with the part that is named, where that is a foot
STRIKING = {"punch", "jab", "hook", "uppercut", "wave", "elbow strike", "straight punch", "cross punch", "hook punch"}


@dataclass(frozen=True)
class Reading:
    """What a phrase is about.

    Attributes:
        whole, torso: whether it is about these.
        arms, legs: which of them; "free" is one that no word gives a side.
        about: the words that say so; none where nothing was understood.
        unknown: words that are not known.
    """

    whole: bool = False
    torso: bool = False
    arms: Limbs = NEITHER
    legs: Limbs = NEITHER
    about: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    def __or__(self, other: "Reading") -> "Reading":
        return Reading(
            self.whole or other.whole,
            self.torso or other.torso,
            self.arms | other.arms,
            self.legs | other.legs,
            self.about + other.about,
            self.unknown + other.unknown,
        )


@dataclass(frozen=True)
class _Part:
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
class _Doing:
    """A verb, or a noun that says an action, and what belongs to it."""

    meaning: Meaning
    text: str
    plural: bool = False
    sides: set[Side] = field(default_factory=set)
    hint: str = ""
    parts: list[_Part] = field(default_factory=list)
    things: list[tuple[Meaning, str]] = field(default_factory=list)
    low: bool = False
    again: bool = False
    """With what an action before it was done with: "raise an arm and lower it"."""


def read(phrase: str) -> Reading:
    """What a phrase is about, by its words."""
    said = tokens(phrase)
    unknown = tuple(dict.fromkeys(token.said for token in said if not token.known and token.text not in JOINING))
    doings, still = [], Reading()
    for clause in _clauses(said):
        clause, denied = _without_denied(clause)
        still |= denied
        doings += _doings(clause)
    if not doings:
        doings = [_Doing(way, token.text) for token in said if (way := token.kind("way"))]
    moving = [doing for doing in doings if doing.meaning.kind != "rest"]
    told = Reading(unknown=unknown)
    for number, doing in enumerate(doings):
        if number and doing.again and (told.arms or told.legs):
            continue
        told |= replace(_told(doing, alone=not moving), about=(doing.text,))
    arms, legs = _settled(told.arms - still.arms), _settled(told.legs - still.legs)
    return replace(told, torso=told.torso and not still.torso, arms=arms, legs=legs)


def _settled(limbs: Limbs) -> Limbs:
    """A free one is the one with a side, where there is one."""
    return limbs - FREE if limbs & BOTH else limbs


def _clauses(said: Sequence[Token]) -> list[list[Token]]:
    """One for each thing that is done. What names no action goes with the clause before it, or else after it."""
    clauses: list[list[Token]] = [[]]
    for token in said:
        if token.text in JOINING:
            clauses.append([token])
        else:
            clauses[-1].append(token)
    joined: list[list[Token]] = []
    for clause in clauses:
        if joined and (not _acts(clause) or not _acts(joined[-1])) and not _still(clause):
            joined[-1] = joined[-1] + clause
        else:
            joined.append(clause)
    return joined


def _acts(clause: Sequence[Token]) -> bool:
    return any(_doing_of(clause, at) for at in range(len(clause)))


def _still(clause: Sequence[Token]) -> bool:
    return any(token.text in UNMOVED for token in clause) and any(token.kind("body") for token in clause)


def _without_denied(clause: list[Token]) -> tuple[list[Token], Reading]:
    """A clause without what it says does not happen, and the parts that it says are still."""
    start = next((at for at, token in enumerate(clause) if token.text in DENYING), len(clause))
    if _still(clause):
        before = [at for at, token in enumerate(clause) if token.text in MEANS or token.text in JOINING]
        start = before[-1] if before else 0
    still = Reading()
    for token in clause[start:]:
        if part := token.kind("body"):
            still |= Reading(False, bool(part.torso), BOTH | FREE if part.arms else NEITHER,
                             BOTH | FREE if part.legs else NEITHER)  # fmt: skip
    return clause[:start], still


def _doing_of(clause: Sequence[Token], at: int) -> Meaning | None:
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


def _takes(rest: Sequence[Token]) -> bool:
    """Whether a thing is taken, and not a step or a hand away."""
    for token in rest:
        if token.text in JOINING or token.kind("body", *DOINGS):
            return False
        if token.kind("thing"):
            return True
    return False


def _is_manner(clause: Sequence[Token], at: int) -> bool:
    """Whether a token says how and not what, as in "in a circle" and "in a swimming motion", or where: "on a step"."""
    after = clause[at + 1].text if at + 1 < len(clause) else ""
    if clause[at].text == "step" and at and clause[at - 1].text in TARGET | {"the"}:
        return any(_doing_of(clause, each) for each in range(at))
    within = any(each.text == "in" for each in clause[max(at - 3, 0) : at])
    return within and any(_doing_of(clause, each) for each in range(at)) and (
        clause[at].text == "circle" or after in MANNER
    )  # fmt: skip


def _is_part(clause: Sequence[Token], at: int) -> bool:
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
        ways = {*SIDES, "to", "toward", "towards", "away", "forward", "forwards", "back", "backward", "backwards",
                "the", "other", "front", "opposite", "each", "another", "up", "down"}  # fmt: skip
        return not (first and after in ways)
    return True


def _limbs_named(clause: Sequence[Token], at: int, last: str) -> tuple[Limbs, set[int]]:
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


def _doings(clause: Sequence[Token]) -> list[_Doing]:
    """What is done in a clause, each with its parts and things."""
    doings: list[tuple[int, _Doing]] = []
    for at, token in enumerate(clause):
        if (meaning := _doing_of(clause, at)) and not _leads_on(clause, at):
            again = meaning.kind == "own" and at + 1 < len(clause) and clause[at + 1].text in AGAIN
            doings.append((at, _Doing(meaning, token.text, token.plural, again=again)))
    if not doings:
        movers = any(_is_part(clause, at) for at in range(len(clause)))
        things = [thing for token in clause if (thing := token.kind("thing"))]
        if not movers and not things:
            return []
        kind = Meaning("own", 0, 0, 0, 0) if movers else Meaning("hand", 0, 0, 1, 0)
        names = [token.text for token in clause if token.kind("body" if movers else "thing")]
        doings = [(-1, _Doing(kind, " ".join(names)))]
    role, link, last, used = "mover", "subject" if doings[0][0] >= 0 else "", "", set()
    for at, token in enumerate(clause):
        if any(at == place for place, _ in doings) or token.kind("light"):
            role, link = "mover", ""
        elif token.text in MEANS:
            role, link = "with", token.text
        elif token.text in TARGET and not _particle(clause, at):
            role, link = "target", token.text
        if _is_part(clause, at) and not any(at == place for place, _ in doings):
            limbs, words = _limbs_named(clause, at, last)
            used |= words
            meaning = next(each for each in token.meanings if each.kind.startswith("body:"))
            if limbs & BOTH and len(limbs) == 1:
                last = next(iter(limbs))
            how = "with" if token.text in {"handed", "footed"} else role
            _owner(clause, doings, at, how).parts.append(_Part(meaning, token.text, limbs, how, link))
        elif (
            (thing := token.kind("thing", "large") or _unknown_thing(clause, at))
            and not any(at == place for place, _ in doings)
            and (role != "target" or doings[0][0] < 0)
        ):
            _owner(clause, doings, at, role).things.append((thing, link if link == "subject" else role))
        elif token.kind("low"):
            _owner(clause, doings, at, role).low = True
    for at, token in enumerate(clause):
        if token.text in SIDES and at not in used:
            _give_side(clause, doings, at)
    return [doing for _, doing in doings]


def _unknown_thing(clause: Sequence[Token], at: int) -> Meaning | None:
    """A word that is not known is a thing where one is expected: after a verb and an article."""
    if clause[at].meanings or clause[at].text in JOINING or not at:
        return None
    before = clause[at - 1]
    return Meaning("thing", 0, 0, 1, 0) if before.text in DETERMINERS or before.kind("own", "hand") else None


def _leads_on(clause: Sequence[Token], at: int) -> bool:
    """Whether a verb says only how another action begins, as in "lower into a squat"."""
    rest = clause[at + 1 :]
    if clause[at].text == "give":  # "give a nod"
        after = [each for each in range(len(rest)) if rest[each].text not in DETERMINERS]
        return bool(after) and _doing_of(rest, after[0]) is not None
    return clause[at].kind("own") is not None and any(
        each.text in {"into", "from"} and any(_doing_of(rest, later) for later in range(place, len(rest)))
        for place, each in enumerate(rest[:2])
    )


def _particle(clause: Sequence[Token], at: int) -> bool:
    """Whether a preposition belongs to a verb here, as in "put a hand in"."""
    return at + 1 == len(clause) or clause[at + 1].text in JOINING


def _owner(clause: Sequence[Token], doings: Sequence[tuple[int, _Doing]], at: int, role: str) -> _Doing:
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


def _give_side(clause: Sequence[Token], doings: Sequence[tuple[int, _Doing]], at: int) -> None:
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


def _told(doing: _Doing, alone: bool) -> Reading:
    """What one action is about."""
    kind, meaning = doing.meaning.kind, doing.meaning
    if kind == "own":
        return _own(doing)
    if kind == "leg":
        return _by_leg(doing)
    if kind in ("put", "hand", "touch", "hold") or (meaning.arms and not meaning.whole and not meaning.legs):
        return _by_hand(doing)
    return _act(doing, alone)


def _count(number: int, sides: Iterable[Side] = ()) -> Limbs:
    if not number:
        return NEITHER
    return BOTH if number > 1 else frozenset(sides) or FREE


def _moved(parts: Iterable[_Part]) -> Reading:
    """The parts themselves."""
    told = Reading()
    for part in parts:
        meaning = part.meaning
        limbs = BOTH if part.is_a("shoulder") and part.limbs == FREE else part.limbs
        told |= Reading(bool(meaning.whole), bool(meaning.torso), limbs if meaning.arms else NEITHER,
                        limbs if meaning.legs else NEITHER)  # fmt: skip
    return told


def _meet(parts: Sequence[_Part]) -> bool:
    """Whether an elbow and a knee go to each other, so that both move."""
    return {"knee", "elbow"} <= {part.text for part in parts}


def _own(doing: _Doing) -> Reading:
    """Parts move: those that are named, or those that the verb usually means."""
    meaning = doing.meaning
    movers = [part for part in doing.parts if part.role == "mover"]
    means = [part for part in doing.parts if part.role == "with"]
    if not movers and (meaning.arms or meaning.legs) and not meaning.whole:
        movers = [part for part in means if part.meaning.arms or part.meaning.legs]
    if movers:
        told = _moved(doing.parts if _meet(doing.parts) else movers + means)
        turned = bool(meaning.whole) and any(part.text == "body" for part in movers)
        return told | Reading(turned, doing.low and bool(told.arms), legs=_count(meaning.legs) if turned else NEITHER)
    things = [thing.arms for thing, role in doing.things if role == "mover"]
    sides = doing.sides or {doing.hint} - {""}
    default = Reading(
        bool(meaning.whole), bool(meaning.torso), _count(meaning.arms, sides), _count(meaning.legs, sides)
    )
    if things and (meaning.arms or meaning.whole):
        default = Reading(torso=doing.low or doing.text == "swing", arms=_count(max(things), sides))
    return default | _moved(means)


def _by_hand(doing: _Doing) -> Reading:
    """Hands do something: those that are named, or one, or both for what is large."""
    kind, meaning = doing.meaning.kind, doing.meaning
    objects = [part for part in doing.parts if part.role == "mover"]
    means = [part for part in doing.parts if part.role == "with" or (part.link in ("in", "from") and part.is_a("arm"))]
    passed = any(part.link == "from" for part in means)
    hands = [part for part in means if part.meaning.arms]
    feet = [part for part in means if part.meaning.legs and not part.meaning.arms]
    if feet and not hands:  # "draw a circle with the left foot"
        return _moved(feet)
    hands += [part for part in doing.parts if passed and part.link == "to" and part.is_a("arm")]
    targets = [part for part in doing.parts if part.role == "target" and part not in hands]
    others = _moved(part for part in means if not part.meaning.arms and part.meaning.legs)
    if doing.text in SHOWING and (feet := [part for part in objects if part.meaning.legs]):
        return _moved(feet) | others
    if kind == "touch" and _meet(doing.parts):
        return _moved(doing.parts)
    if kind == "touch":
        touched = [part for part in objects if not _is_subject(doing, part)]
        hands += [part for part in objects if _is_subject(doing, part)]
        targets += touched
    else:
        hands += [part for part in objects if part.meaning.arms]
        if doing.text in GRABBING:
            hands += [replace(part, limbs=BOTH) for part in objects if part.meaning.arms and part.link != "subject"]
        legs = [part for part in objects if part.meaning.legs]
        if kind == "hold" or any(part in hands for part in objects):
            others |= _moved(legs)
        elif kind == "put" and not hands and objects:
            return _moved(objects) | others
    bends = bool(meaning.torso) or doing.low or any(part.is_a("foot") for part in targets)
    if hands:
        arms = frozenset().union(*(part.limbs for part in hands))
    elif doing.sides:
        arms = frozenset(doing.sides)
    else:
        size = max([thing.arms for thing, role in doing.things if role == "mover"] or [0]) if kind != "touch" else 0
        arms = _count(max(meaning.arms, size), {doing.hint} - {""})
        for part in targets if arms == FREE else ():
            if part.limbs == BOTH and part.text in PAIRED:
                arms = BOTH
            elif part.is_a("arm"):
                arms = BOTH if part.limbs & BOTH else arms
            elif part.side in OPPOSITE:
                arms = frozenset({OPPOSITE[part.side] if part.is_a("shoulder") else part.side})
    return Reading(False, bends, arms) | others


def _is_subject(doing: _Doing, part: _Part) -> bool:
    """Whether a part is what touches ("left hand touches the nose") and not what is touched."""
    return part.link == "subject"


def _by_leg(doing: _Doing) -> Reading:
    """Legs do something: the one that is named, or those that the verb usually means."""
    legs = [part for part in doing.parts if part.meaning.legs and (part.role != "target" or part.link == "on")]
    legs = [part for part in legs if part.limbs != FREE or part.link != "on"]  # who balances on one leg uses both
    rest = [part for part in doing.parts if part.role != "target" and not part.meaning.legs]
    which = frozenset().union(*(part.limbs for part in legs)) if legs else _count(doing.meaning.legs + doing.plural)
    if doing.sides and not legs:
        which = frozenset(doing.sides)
    told = Reading(bool(doing.meaning.whole), bool(doing.meaning.torso), _count(doing.meaning.arms), which)
    return told | _moved(rest)


def _act(doing: _Doing, alone: bool) -> Reading:
    """A whole action, and what else is named with it."""
    meaning = doing.meaning
    named = [part for part in doing.parts if part.role != "target" or (part.link == "in" and part.is_a("arm"))]
    on = [part for part in doing.parts if part.meaning.legs and part.link in ("on", "onto", "with", "", "subject")]
    legs = _count(meaning.legs)
    one = doing.text in ON_ONE_LEG or meaning.kind == "rest"
    if one and on and (which := frozenset().union(*(part.limbs for part in on))) & BOTH:
        legs, named = which, [part for part in named if not part.meaning.legs]
    if meaning.kind == "rest" and not alone:
        legs = NEITHER
    told = Reading(bool(meaning.whole), bool(meaning.torso), _count(meaning.arms), legs)
    held = [thing.arms for thing, role in doing.things if role == "with" and thing.kind == "thing"]
    if held and meaning.whole:
        told |= Reading(arms=_count(max(held)))
    return told | _moved(named)
