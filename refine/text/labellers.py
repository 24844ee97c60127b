"""What says which parts of the body a phrase is about."""

from collections.abc import Sequence
from difflib import get_close_matches

from refine.text.parts import Labelled, Labeller, Parts
from renderers.checks import UserError

MOVING_ABOUT, BOTH_ARMS = ("global", "left leg", "right leg"), ("left arm", "right arm")

# The phrases of the built-in actions (``refine.text.phrases``), labelled by hand.
KNOWN: dict[str, tuple[str, ...]] = {
    "stand still": ("left leg", "right leg"),
    "march in place, lifting the knees": MOVING_ABOUT,
    "punch with both arms and lift the knees": (*MOVING_ABOUT, *BOTH_ARMS),
    "lunge to the left": MOVING_ABOUT,
    "kick with the left leg": ("left leg",),
    "lunge forwards": MOVING_ABOUT,
    "pull a chest expander with both arms": BOTH_ARMS,
    "punch with both arms": BOTH_ARMS,
    "circle both elbows": BOTH_ARMS,
    "raise both arms sideways": BOTH_ARMS,
    "stand and rotate the torso with the arms stretched out": ("torso", *BOTH_ARMS),
    "walk forwards": MOVING_ABOUT,
    "run forwards": MOVING_ABOUT,
    "squat": MOVING_ABOUT,
    "wave with the left hand": ("left arm",),
    "wave with the right hand": ("right arm",),
    "wave with both hands": BOTH_ARMS,
    "raise the left hand": ("left arm",),
    "drink from a cup": ("right arm",),
    "drink from a cup with the left hand": ("left arm",),
    "drink from a cup with the right hand": ("right arm",),
}


def labeller() -> Labeller:
    """The labeller that is used unless another is asked for; no network and no other package is needed."""
    return known


def known(phrases: Sequence[str]) -> list[Labelled]:
    """What people say of the built-in actions' phrases.

    Raises:
        UserError: a phrase is another; the nearest ones are offered.
    """
    found = []
    for phrase in phrases:
        words = " ".join(phrase.lower().split())
        if words not in KNOWN:
            near = get_close_matches(words, KNOWN, n=3, cutoff=0.4)
            meant = f"; did you mean {', '.join(near)}?" if near else ""
            raise UserError(repr(phrase), "is not a phrase that is known", f"list its parts: torso, right arm{meant}")
        found.append(Labelled(phrase, Parts.of(KNOWN[words]), "table", "labelled by hand"))
    return found
