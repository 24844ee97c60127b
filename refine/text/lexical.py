"""Which parts of the body a phrase is about, by its words: what is done, with what, on which side.

Sides are told apart only by the words "left" and "right", in the same way, so a phrase and its mirror image are read as
mirror images.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from refine.text.clauses import (
    BOTH,
    FREE,
    JOINING,
    MEANS,
    NEITHER,
    OPPOSITE,
    Clause,
    Doing,
    Limbs,
    Part,
    Side,
    clauses_of,
    doings_of,
    keeps_still,
)  # fmt: skip
from refine.text.vocabulary import tokens

DENYING = {"without", "no", "not", "never"}
ON_ONE_LEG = {
    "hop", "jump", "leap", "skip", "bounce", "bound", "land", "step", "step back", "lunge", "pivot", "kneel",
    "kneel down", "squat", "crouch", "hop on", "jump on", "skip on", "hop with", "jump with", "step with",
    "take step with", "step forward with", "step back with",
}  # fmt: skip
GRABBING = {"grab", "grasp", "grip", "clutch"}
PAIRED = {
    "ear", "eye", "cheek", "shoulder", "hip", "thigh", "leg", "knee", "shin", "ankle", "foot", "heel", "toe",
}  # fmt: skip
SHOWING = {"tap", "point"}  # done with the part that is named, where that is a foot


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


def read(phrase: str) -> Reading:
    """What a phrase is about, by its words."""
    said = tokens(phrase)
    unknown = tuple(dict.fromkeys(token.said for token in said if not token.known and token.text not in JOINING))
    doings, still = [], Reading()
    for clause in clauses_of(said):
        clause, denied = _without_denied(clause)
        still |= denied
        doings += doings_of(clause)
    if not doings:
        doings = [Doing(way, token.text) for token in said if (way := token.kind("way"))]
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


def _without_denied(clause: Clause) -> tuple[Clause, Reading]:
    """A clause without what it says does not happen, and the parts that it says are still."""
    start = next((at for at, token in enumerate(clause) if token.text in DENYING), len(clause))
    if keeps_still(clause):
        before = [at for at, token in enumerate(clause) if token.text in MEANS or token.text in JOINING]
        start = before[-1] if before else 0
    still = Reading()
    for token in clause[start:]:
        if part := token.kind("body"):
            still |= Reading(False, bool(part.torso), BOTH | FREE if part.arms else NEITHER,
                             BOTH | FREE if part.legs else NEITHER)  # fmt: skip
    return clause[:start], still


def _told(doing: Doing, alone: bool) -> Reading:
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


def _moved(parts: Iterable[Part]) -> Reading:
    """The parts themselves."""
    told = Reading()
    for part in parts:
        meaning = part.meaning
        limbs = BOTH if part.is_a("shoulder") and part.limbs == FREE else part.limbs
        told |= Reading(bool(meaning.whole), bool(meaning.torso), limbs if meaning.arms else NEITHER,
                        limbs if meaning.legs else NEITHER)  # fmt: skip
    return told


def _meet(parts: Sequence[Part]) -> bool:
    """Whether an elbow and a knee go to each other, so that both move."""
    return {"knee", "elbow"} <= {part.text for part in parts}


def _own(doing: Doing) -> Reading:
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


def _by_hand(doing: Doing) -> Reading:
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
        touched = [part for part in objects if part.link != "subject"]
        hands += [part for part in objects if part.link == "subject"]
        targets += touched
    else:
        hands += [part for part in objects if part.meaning.arms]
        if doing.text in GRABBING:
            hands += [replace(part, limbs=BOTH) for part in objects if part.meaning.arms and part.link != "subject"]
        legs = [part for part in objects if part.meaning.legs]
        if kind == "hold" or any(part in hands for part in objects):
            others |= _moved(legs)
        elif (kind == "put" and not hands and objects) or (kind == "hand" and legs):
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


def _by_leg(doing: Doing) -> Reading:
    """Legs do something: the one that is named, or those that the verb usually means."""
    legs = [part for part in doing.parts if part.meaning.legs and (part.role != "target" or part.link == "on")]
    legs = [part for part in legs if part.limbs != FREE or part.link != "on"]  # who balances on one leg uses both
    rest = [part for part in doing.parts if part.role != "target" and not part.meaning.legs]
    which = frozenset().union(*(part.limbs for part in legs)) if legs else _count(doing.meaning.legs + doing.plural)
    if doing.sides and not legs:
        which = frozenset(doing.sides)
    told = Reading(bool(doing.meaning.whole), bool(doing.meaning.torso), _count(doing.meaning.arms), which)
    return told | _moved(rest)


def _act(doing: Doing, alone: bool) -> Reading:
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
