"""Gerunds are English, and sentences say all of their descriptions."""

import pytest
import torch

from refine.text.gerunds import as_gerund, base_of, gerund
from refine.text.sentences import TEMPLATES, UNSEEN, combine, combine_randomly
from renderers.checks import UserError

GERUNDS = {
    "walk": "walking", "take": "taking", "wave": "waving", "run": "running", "sit": "sitting", "step": "stepping",
    "jog": "jogging", "hop": "hopping", "swim": "swimming", "put": "putting", "lie": "lying", "tie": "tying",
    "die": "dying", "see": "seeing", "flee": "fleeing", "tiptoe": "tiptoeing", "dye": "dyeing", "be": "being",
    "box": "boxing", "throw": "throwing", "play": "playing", "fix": "fixing", "carry": "carrying", "ski": "skiing",
    "open": "opening", "lift": "lifting", "lean": "leaning", "bend": "bending", "clap": "clapping",
    "squat": "squatting",
    "begin": "beginning", "mimic": "mimicking", "quit": "quitting", "stretch": "stretching", "kneel": "kneeling",
    "sing": "singing", "bring": "bringing", "swing": "swinging", "waving": "waving", "yell": "yelling",
    "yawn": "yawning",
    "sidestep": "sidestepping", "visit": "visiting", "juggle": "juggling", "side-step": "side-stepping",
    "Run": "Running",
    "use": "using", "go": "going", "do": "doing",
}  # fmt: skip


def test_the_spelling_of_gerunds():
    assert {verb: gerund(verb) for verb in GERUNDS} == GERUNDS


@pytest.mark.parametrize(
    ("phrase", "expected"),
    [
        ("walk, wave and turn left", "walking, waving and turning left"),
        ("wave left and right", "waving left and right"),
        ("raise arms and legs", "raising arms and legs"),
        ("jump up and down", "jumping up and down"),
        ("pick up the box and put it down", "picking up the box and putting it down"),
        ("march in place, lifting the knees", "marching in place, lifting the knees"),
        ("slowly walk backwards", "slowly walking backwards"),
        ("a man is walking slowly and raises his arms", "walking slowly and raising his arms"),
        ("the person turns and throws a ball", "turning and throwing a ball"),
        ("someone sits, then stands up.", "sitting, then standing up"),
        ("left jab", "doing left jab"),
        ("an exhausted walk", "doing an exhausted walk"),
        ("shadow boxing", "doing shadow boxing"),
        ("keep walking", "keeping walking"),
        ("feed the dog", "feeding the dog"),
    ],
)
def test_descriptions_go_on(phrase, expected):
    assert as_gerund(phrase) == expected
    assert as_gerund(expected.removeprefix("doing ")) in (expected, f"doing {expected}") or "doing" in expected


def test_third_persons_lose_their_ending():
    assert [base_of(verb) for verb in ("waves", "does", "crosses", "is")] == ["wave", "do", "cross", "be"]


@pytest.mark.parametrize("conjunction", TEMPLATES | UNSEEN)
def test_every_template_says_all_of_them_in_order(conjunction):
    sentence = combine(["walk", "wave", "bow"], conjunction)
    places = [sentence.index(stem) for stem in ("walk", "wav", "bow")]
    assert places == sorted(places)
    assert ("waving" in sentence) == (conjunction in ("while", "during", "whilst"))
    assert combine(["walk"], conjunction) == "walk"


def test_templates_are_drawn_alike():
    random = torch.Generator().manual_seed(0)
    drawn = [combine_randomly(["walk", "take a bow"], random) for _ in range(2000)]
    counts = {sentence: drawn.count(sentence) for sentence in set(drawn)}
    assert set(counts) == {combine(["walk", "take a bow"], name) for name in TEMPLATES}
    assert all(abs(count - 400) < 80 for count in counts.values())


def test_what_cannot_be_joined():
    with pytest.raises(UserError, match="no text"):
        combine([])
    with pytest.raises(UserError, match="because"):
        combine(["walk", "wave"], "because")
