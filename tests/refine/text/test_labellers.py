"""What the default labeller says of phrases."""

import random

import pytest

from refine.motion import other_side
from refine.text.examples import examples, labelled, plain
from refine.text.labellers import as_guessed, labeller, parts_of
from refine.text.lexical import read
from refine.text.nearest import Guess
from refine.text.parts import Parts
from refine.text.phrases import PHRASES
from refine.text.vocabulary import vocabulary
from renderers.checks import UserError

MOVING_ABOUT, BOTH_ARMS = ("global", "left leg", "right leg"), ("left arm", "right arm")
BUILT_IN = {
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


def parts(phrase):
    return labeller()([phrase])[0].parts


def test_the_builtin_actions_are_labelled_as_by_hand():
    assert set(PHRASES.values()) <= set(BUILT_IN)
    for phrase, names in BUILT_IN.items():
        assert parts(phrase) == Parts.of(names), phrase
    assert [each.phrase for each in labeller()(["squat", "sit"])] == ["squat", "sit"]


def test_there_are_many_examples_each_once_and_with_something_marked():
    assert len(examples()) >= 400
    assert len({plain(each.phrase) for each in examples()}) == len(examples())
    for each in examples():
        assert len(each.marks) == 6 and any(mark is not False for mark in each.marks), each.phrase
        assert plain(each.mirrored().phrase) in labelled()


def test_the_mirror_image_of_an_example_is_labelled_as_its_mirror_image():
    for each in examples():
        if {"left", "right"} & set(plain(each.phrase).split()) and "free" not in _limbs(each.phrase):
            assert parts(other_side(each.phrase)) == parts(each.phrase).mirrored(), each.phrase


def test_the_mirror_image_of_any_sentence_is_read_as_its_mirror_image():
    words = (
        "left right arm leg hand foot both the with to on and while raise kick wave walk turn touch hold knee face put"
    )
    draw = random.Random(0)
    for number in range(3000):
        known = words.split() if number % 2 else [*["left", "right"] * 300, *vocabulary()]
        phrase = " ".join(draw.choices(known, k=draw.randint(2, 9)))
        reading, other = read(phrase), read(other_side(phrase))
        exchanged = {"left": "right", "right": "left", "free": "free"}
        assert {exchanged[side] for side in reading.arms} == other.arms, phrase
        assert {exchanged[side] for side in reading.legs} == other.legs, phrase
        assert (reading.whole, reading.torso) == (other.whole, other.torso), phrase


def _limbs(phrase):
    reading = read(phrase)
    return reading.arms | reading.legs


def test_a_hand_without_a_side_is_the_right_one():
    assert parts("drink from the mug") == Parts.of(["right arm"])
    assert parts_of(read("salute")) == Parts.of(["right arm"])


@pytest.mark.parametrize("phrase", ["", "   ", "?!", "walk " * 200])
def test_nothing_and_too_much_are_refused(phrase):
    with pytest.raises(UserError) as refused:
        labeller()([phrase])
    assert "\n" not in str(refused.value)


def test_only_gibberish_is_refused():
    with pytest.raises(UserError, match="no word that is known"):
        labeller()(["xqzt vvbnm"])


def test_a_phrase_of_unknown_words_is_guessed_on_the_side_that_it_names():
    guess = Guess(False, False, 1, 0, "wave", 0.5)
    assert parts_of(as_guessed("left wibbling", guess)) == Parts.of(["left arm"])
    assert parts_of(as_guessed("wibbling", guess)) == Parts.of(["right arm"])


def test_words_that_are_not_known_are_named_and_the_rest_is_read():
    (found,) = labeller()(["walk zqorg"])
    assert found.unknown == ("zqorg",) and found.parts == Parts.of(MOVING_ABOUT)
