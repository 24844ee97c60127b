"""The cross-validation of the default labeller."""

import math

from benchmarks.labellers import accuracy, variants, without
from refine.text.examples import Example
from refine.text.lexical import read
from refine.text.parts import Parts
from refine.text.vocabulary import vocabulary

WAVE = Example("wave", (False, None, False, True, False, False), "a")
RUN = Example("run", (True, None, False, False, True, True), "b")


def test_words_are_lacking_for_a_while_only():
    before = len(vocabulary())
    with without({"jog"}):
        assert not read("jog").about and read("run").about
    assert read("jog").about == ("jog",) and len(vocabulary()) == before


def test_where_people_differ_does_not_count():
    found = accuracy([Parts.of(["torso", "right arm"]), Parts.of(["right leg"])], [WAVE, RUN])
    assert found[0] == 0.5 and math.isnan(found[1]) and found[3] == 1 and found[4] == 0.5 and found[5] == 1


def test_without_an_encoder_spelling_stands_in():
    ways = variants((WAVE, RUN), None)
    assert set(ways) == {"words alone", "spelling alone", "words, else spelling"}
    assert ways["spelling alone"]("runs").whole and not ways["spelling alone"]("waves").whole
    assert ways["words, else spelling"]("nod") == Parts.of(["torso"])
