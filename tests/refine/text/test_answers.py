"""Answers of language models become the six parts, and are kept in files."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from refine.text.answers import by_answers, parts_for, parts_of_answer, read_answers, write_answers
from refine.text.parts import BODY_PARTS, Labelled, Parts
from renderers.checks import UserError


@pytest.mark.parametrize(
    ("answer", "names"),
    [
        ("Answer: right leg\nleft leg\nbuttocks", ("global", "left leg", "right leg")),
        ("torso\nneck.", ("torso",)),
        ("Shoulders", ("left arm", "right arm")),
        ("shoulders\nright arm", ("right arm",)),
        ("Answer:\nleft shoulder\nhand\nright eye", ("left arm",)),
        ("waist\nglobal orientation", ("global",)),
        ("right wrist\nright side of face\nneck", ("torso",)),
        ("1. Right Arm\n2. Left Arm", ("left arm", "right arm")),
        ("- right arm\n* neck", ("torso", "right arm")),
        ("right arm, left arm and neck", ("torso", "left arm", "right arm")),
        ("<think>A walk needs the torso?\ntorso\n</think>\n\nleft leg", ("left leg",)),
    ],
)
def test_an_answer_lists_parts(answer: str, names: tuple[str, ...]) -> None:
    assert parts_of_answer(answer).names == names


@pytest.mark.parametrize("answer", ["", "I cannot say", "hand\nwrist", "<think>torso\nright arm"])
def test_an_answer_without_a_part_is_refused(answer: str) -> None:
    with pytest.raises(UserError, match="names no part"):
        parts_of_answer(answer)


@pytest.mark.parametrize(
    "label",
    [
        "animal behavior series",
        "bird behavior series",
        "marine animal behavior series",
        "Elephant  behavior series",
        "swim on air",
    ],
)
def test_the_five_void_labels_are_about_everything(label: str) -> None:
    assert parts_for(label, "none of these").names == BODY_PARTS


def nothing(phrases: list[str]) -> list[Labelled]:
    """A default labeller to be told apart."""
    return [Labelled(phrase, Parts.of(()), "default") for phrase in phrases]


@pytest.fixture
def file(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "answers.json"
        path.write_text(text)
        return path

    return write


def test_the_third_answer_of_the_published_list_is_used(file) -> None:
    answers = read_answers(
        file('{"walk": ["torso", "neck", "Answer: left leg\\nright leg"], "nod": ["a", "b", "neck"]}')
    )
    said: list[str] = []
    found = by_answers(answers, nothing, said.append)(["Walk", "nod", "swim", "nod"])
    assert [each.parts.names for each in found] == [("left leg", "right leg"), ("torso",), (), ("torso",)]
    assert [each.by for each in found] == ["answers", "answers", "default", "answers"]
    assert [each.phrase for each in found] == ["Walk", "nod", "swim", "nod"]
    assert len(said) == 1 and "'swim'" in said[0] and "nod" not in said[0]


def test_answers_come_back_as_they_were_written(tmp_path) -> None:
    path = tmp_path / "new" / "answers.json"
    answers = {("walk", "small", "1"): "left leg", ("walk", "large", "1"): "right leg", ("nöd", "", ""): "neck"}
    write_answers(path, answers)
    assert read_answers(path) == answers
    assert [each.name for each in path.parent.iterdir()] == ["answers.json"]
    [found] = by_answers(answers, nothing, pytest.fail)(["walk"])
    assert found.parts.names == ("right leg",)  # the last that was given


def test_phrases_may_stand_with_their_answers_alone(file) -> None:
    assert read_answers(file('{"Sit  down": "left leg, waist"}')) == {("sit down", "", ""): "left leg, waist"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1, 2]", "holds a list"),
        ('{"walk": 3}', "'walk': neither"),
        ('{"walk": ["a", "b"]}', "'walk': neither"),
        ('{"walk": ["a", "b", 3]}', "'walk': neither"),
        ('{"walk": "torso", "walk": "neck"}', "has 'walk' twice"),
        ('{"walk": "torso", "Walk": "neck"}', "two answers for 'walk'"),
        ('{"format": "refine-answers", "version": 2, "answers": []}', "of version 2"),
        ('{"format": "refine-answers", "version": 1, "answers": [3]}', "answer 0"),
        ('{"format": "refine-answers", "version": 1, "answers": [{"phrase": "a"}]}', "lacks"),
        ('{"format": "refine-answers", "version": 1, "answers": [{"phrase": "a", "answers": "b"}]}', "mean answer?"),
        ("{", "is not JSON"),
    ],
)
def test_other_files_are_refused(file, text: str, said: str) -> None:
    with pytest.raises(UserError) as refused:
        read_answers(file(text))
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_huge_files_are_refused_unread(tmp_path) -> None:
    path = tmp_path / "huge.json"
    path.write_text(json.dumps({"walk": "torso " * 3_000_000}))
    with pytest.raises(UserError, match="more than the"):
        read_answers(path)
