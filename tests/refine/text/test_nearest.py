"""Phrases whose words are not known are labelled as those that are most alike."""

import numpy as np
import pytest

from refine.motion import other_side
from refine.text.encoder import has_default, load_encoder
from refine.text.examples import Example
from refine.text.labellers import labeller
from refine.text.nearest import Nearest, relative, sideless
from refine.text.parts import Parts

KNOWN = (
    Example("glide along", (True, False, False, False, True, True), "a"),
    Example("glide away", (True, None, False, False, True, True), "a"),
    Example("plonk the glockenspiel", (False, False, True, True, False, False), "b"),
    Example("plonk the left key", (False, False, True, False, False, False), "b"),
)


def test_by_spelling_a_phrase_is_as_those_with_the_same_words():
    nearest = Nearest(None, KNOWN)
    guess = nearest("glided")
    assert (guess.whole, guess.torso, guess.arms, guess.legs) == (True, False, 0, 2)
    assert guess.nearest.startswith("glide") and 0 < guess.similarity < 1
    guess = nearest("plonk the glockenspiel")
    assert (guess.arms, guess.legs) == (2, 0) and guess.similarity == pytest.approx(1)
    assert nearest("left key plonk").arms == 1


def test_sides_do_not_matter():
    nearest = Nearest(None, KNOWN)
    for phrase in ("plonk left key", "glide to the left, right away"):
        assert nearest(phrase) == nearest(other_side(phrase))
    assert sideless("Wave the LEFT hand, right?") == "wave the hand"


def test_counts_and_open_marks():
    assert relative(KNOWN[3]) == [0, 0, 1, 0, 0, 0]
    assert relative(KNOWN[1])[1] == pytest.approx(0.4)


class Told:
    """An encoder of two meanings."""

    name, width = "told", 2

    def sentences(self, texts):
        import torch

        return torch.tensor([[1.0, 0.0] if "i" in text else [0.0, 1.0] for text in texts])


def test_an_encoder_decides_where_no_word_is_known():
    (found,) = labeller(Told())(["frobbing"])
    assert found.by == "embedding" and found.unknown == ("frobbing",) and "most alike" in found.why
    guess = Nearest(Told(), KNOWN)("mingle")
    assert (guess.whole, guess.arms, guess.legs) == (True, 0, 2) and guess.similarity == pytest.approx(1)


@pytest.mark.skipif(not has_default(), reason="needs the text extra")
def test_meanings_count_where_the_encoder_is_installed():
    nearest = Nearest(load_encoder(), (KNOWN[0], Example("punch", (False, False, None, True, False, False), "c")))
    assert nearest("a promenade through the meadow").nearest == "glide along"
    assert nearest("hit somebody with a fist").nearest == "punch"
    assert labeller()(["saltation"])[0].by == "embedding"


def test_the_same_phrase_gives_the_same_answer():
    asked = ["frobnicate", "walk frobnicatingly"]
    assert labeller(Told())(asked) == labeller(Told())(asked)
    assert np.isfinite(Nearest(None, KNOWN)("zzzz").similarity)


def test_words_that_say_enough_need_no_encoder():
    class Never:
        name, width = "never", 1

        def sentences(self, texts):
            raise AssertionError("was asked")

    assert labeller(Never())(["walk", "nod at a wibble"])[0].parts == Parts.of(("global", "left leg", "right leg"))
