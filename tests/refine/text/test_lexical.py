"""What words say of the body: sides, what is moved and what is touched, what is done with what, what is denied."""

import time

import pytest

from refine.text.clauses import DOINGS
from refine.text.examples import examples
from refine.text.labellers import by_words, parts_of
from refine.text.lexical import read
from refine.text.parts import Parts
from refine.text.vocabulary import stems, tokens, vocabulary

LEGS, ARMS, ALL = ("left leg", "right leg"), ("left arm", "right arm"), ("global", "torso")


@pytest.mark.parametrize(
    ("phrase", "names"),
    [
        # whose side a side is
        ("raise the left arm", ["left arm"]),
        ("raise left and right arm", ARMS),
        ("raise the left arm and the right leg", ["left arm", "right leg"]),
        ("left hook", ["left arm"]),
        ("left and right hooks", ARMS),
        ("kick right", ["right leg"]),
        ("left-handed wave", ["left arm"]),
        ("step to the left", ["global", *LEGS]),
        ("raise the right hand to the left", ["right arm"]),
        ("raise one arm", ["right arm"]),
        ("raise both arms", ARMS),
        # what is moved, what is touched, and with what
        ("touch the left ear with the right hand", ["right arm"]),
        ("right hand touches left ear", ["right arm"]),
        ("put the left hand on the right shoulder", ["left arm"]),
        ("hands on hips", ARMS),
        ("put the left foot on a chair", ["left leg"]),
        ("bring the left knee to the right elbow", ["left leg", "right arm"]),
        ("draw a circle with the left foot", ["left leg"]),
        ("touch the floor", ["torso", "right arm"]),
        ("hop on the left leg", ["global", "left leg"]),
        # what else happens
        ("walk with the arms raised", ["global", *ARMS, *LEGS]),
        ("walk with a stick", ["global", "right arm", *LEGS]),
        ("lean back with arms crossed", ["torso", *ARMS]),
        ("walk and wave the left hand", ["global", "left arm", *LEGS]),
        ("drink while standing", ["right arm"]),
        ("raise the left arm and lower it", ["left arm"]),
        ("raise the left arm and wave", ["left arm"]),
        ("wiggle the toes", LEGS),
        # things
        ("lift a cup", ["right arm"]),
        ("lift a barbell", ARMS),
        ("turn the page", ["right arm"]),
        ("take a bottle", ["right arm"]),
        ("take a step", ["global", *LEGS]),
        # what is not done, and how it is done
        ("walk without moving the arms", ["global", *LEGS]),
        ("wave the arms while the legs stay still", ARMS),
        ("dance without moving the arms", [*ALL, *LEGS]),
        ("walk in a circle", ["global", *LEGS]),
        ("move the arms in a swimming motion", ARMS),
        ("flap the arms like a bird", ARMS),
        ("walk like a monkey", [*ALL, *ARMS, *LEGS]),
        # the same word as verb and as noun
        ("box", ARMS),
        ("scratch the back", ["right arm"]),
        ("step back", ["global", *LEGS]),
        ("face left", ["torso"]),
        ("scratch the face", ["right arm"]),
    ],
)
def test_a_phrase_is_read_as_people_mean_it(phrase, names):
    assert parts_of(read(phrase)) == Parts.of(names)


def test_the_examples_are_read_as_they_are_labelled():
    right = total = 0
    for each in examples():
        marked = zip(each.marks, parts_of(read(each.phrase)), strict=True)
        told = [(mark, part) for mark, part in marked if mark is not None]
        right, total = right + sum(mark == part for mark, part in told), total + len(told)
    assert right / total > 0.98


def test_every_word_of_the_examples_is_known():
    unknown = {word for each in examples() for word in read(each.phrase).unknown}
    assert len(unknown) <= 20, unknown


def test_the_vocabulary_says_how_much_of_the_body_each_word_is_about():
    others = {"way", "light", "thing", "large", "low", "plain"}
    for entry, meanings in vocabulary().items():
        assert entry == " ".join(entry.lower().split()), entry
        for meaning in meanings:
            assert meaning.kind in DOINGS or meaning.kind in others or meaning.kind.startswith("body:"), entry
            assert max(meaning.whole, meaning.torso) <= 1 and max(meaning.arms, meaning.legs) <= 2, entry
        assert entry in ("left", "right") or not {"left", "right"} & set(entry.split()), entry


@pytest.mark.parametrize(
    ("form", "word"),
    [("walking", "walk"), ("hopping", "hop"), ("waves", "wave"), ("waving", "wave"), ("threw", "throw"),
     ("toes", "toe"), ("crouched", "crouch"), ("carries", "carry"), ("lying", "lie"), ("boxes", "box"),
     ("shrugged", "shrug")],
)  # fmt: skip
def test_inflected_words_are_known(form, word):
    assert word in list(stems(form))


def test_a_typo_is_read_and_named():
    (found,) = by_words(["strech both elbowws"])
    assert found.parts == Parts.of(ARMS) and set(found.unknown) == {"strech", "elbowws"}


def test_articles_do_not_part_words_that_belong_together():
    assert [token.text for token in tokens("play the guitar, tie his shoes")][-1] == "tie shoe"


def test_long_phrases_take_no_time():
    start = time.perf_counter()
    for phrase in ("the box " * 62, "in a circle " * 40, "walk like a crab " * 29, "left and right " * 33):
        read(phrase)
    assert time.perf_counter() - start < 2
