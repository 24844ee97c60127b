"""Table 1's row by both rules of counting, and the labels by hand that it is counted against."""

import json
import math
from pathlib import Path

import pytest

from refine.text.accuracy import PUBLISHED, accuracy, read_labels, report
from refine.text.labellers import labeller
from refine.text.parts import BODY_PARTS, Parts
from renderers.checks import UserError

WALK, WAVE = Parts.of(["global", "left leg", "right leg"]), Parts.of(["right arm"])


def test_optional_labels_are_left_out_or_count_as_wrong() -> None:
    labels = [(1, 0, 0.5, 0.5, 1, 1), (0, 1, 0.5, 1, 0, 0), (0, 0, 0.5, 1, 0, 0)]
    found = accuracy(["walk", "wave", "wave twice"], labels, [WALK, WAVE, WALK])
    by_hand = {  # right, of those that are not optional; right of all three
        "global": (2 / 3, 2 / 3),
        "torso": (2 / 3, 2 / 3),
        "left arm": (math.nan, 0.0),
        "right arm": (1 / 2, 1 / 3),
        "left leg": (2 / 3, 2 / 3),
        "right leg": (2 / 3, 2 / 3),
    }
    for name, (share, strict) in by_hand.items():
        assert found.parts[name].accuracy == pytest.approx(share, nan_ok=True)
        assert found.parts[name].strict == pytest.approx(strict)
    assert found.mean == pytest.approx((4 * 2 / 3 + 1 / 2) / 5)
    assert found.mean_strict == pytest.approx((4 * 2 / 3 + 1 / 3) / 6)
    assert [each.n for each in found.parts.values()] == [3, 3, 0, 2, 3, 3]
    assert [(each.phrase, each.parts) for each in found.wrong] == [
        ("wave twice", ("global", "right arm", "left leg", "right leg")),
        ("wave", ("torso",)),
    ]


def test_values_for_programs_have_the_promised_keys() -> None:
    values = accuracy(["walk"], [(1, 0, 0.5, 0, 1, 0)], [WALK]).values()
    assert {"mean", "mean_strict", "parts", "wrong"} <= set(values)
    assert list(values["parts"]) == list(BODY_PARTS)
    assert values["parts"]["right leg"] == {"accuracy": 0.0, "strict": 0.0, "n": 1}
    assert values["wrong"] == [{"phrase": "walk", "parts": ["right leg"]}]


def test_the_printed_means_are_those_of_the_printed_parts() -> None:
    """But for rounding, and two hundredths in the first row."""
    for row in PUBLISHED.values():
        assert sum(row[:6]) / 6 == pytest.approx(row[6], abs=0.02)


def test_people_see_their_rows_the_papers_and_the_worst() -> None:
    shown = report(accuracy(["walk", "wave"], [(1, 0, 0, 0, 0, 0), (0, 0, 0, 1, 0, 0)], [WALK, WAVE]), "lexical")
    lines = shown.splitlines()
    assert len({len(line) for line in lines[:8]}) == 1
    assert [cell.strip() for cell in lines[2].split("|")[2:-1]] == ["1.000"] * 4 + ["0.500"] * 2 + ["0.833"]
    assert '"walk": left leg, right leg' in shown and '"wave"' not in shown
    assert "paper: part velocity" in shown


@pytest.fixture
def file(tmp_path: Path):
    def write(content: str) -> Path:
        path = tmp_path / "labels.json"
        path.write_text(content)
        return path

    return write


def test_labels_are_read(file) -> None:
    assert read_labels(file('{"walk": [1, 0, 0.5, 0.5, 1.0, 1]}')) == {"walk": (1, 0, 0.5, 0.5, 1, 1)}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ([], "holds no labels"),
        ({}, "holds no labels"),
        ({"walk": [1, 0, 0, 0, 1]}, "'walk' has not six"),
        ({"walk": "100011"}, "'walk' has not six"),
        ({"walk": [1, 0, 0, 0, 1, 0.7]}, "'walk' has 0.7"),
        ({"walk": [1, 0, 0, 0, 1, "1"]}, "'walk' has '1'"),
        ({"walk": [1, 0, 0, 0, 1, True]}, "'walk' has True"),
        ({"walk": [1, 0, 0, 0, 1, [1]]}, "'walk' has [1]"),
        ({" ": [1, 0, 0, 0, 1, 1]}, "empty phrase"),
    ],
)
def test_labels_of_another_shape_are_refused(file, content, said: str) -> None:
    with pytest.raises(UserError) as refused:
        read_labels(file(json.dumps(content)))
    assert said in str(refused.value)


def test_a_phrase_with_two_labels_is_refused(file) -> None:
    with pytest.raises(UserError, match="'walk' twice"):
        read_labels(file('{"walk": [1, 0, 0, 0, 1, 1], "walk": [1, 0, 0, 0, 1, 0]}'))


def test_the_default_labeller_on_phrases_that_it_was_not_made_from() -> None:
    """304 phrases in the style of BABEL and HumanML3D, written by somebody who had not seen its words or examples."""
    labels = read_labels(Path(__file__).parent / "labels.json")
    found = labeller()(list(labels))
    unseen = [number for number, each in enumerate(found) if each.by != "examples"]
    assert len(labels) >= 200 and len(unseen) >= 150
    phrases, values, parts = list(labels), list(labels.values()), [each.parts for each in found]
    assert accuracy(phrases, values, parts).mean > 0.93
    alone = accuracy(*([column[number] for number in unseen] for column in (phrases, values, parts)))
    assert alone.mean > 0.92  # of the phrases that no example happens to be
    decided = [tuple(value if value != 0.5 else 0.0 for value in label) for label in values]
    assert accuracy(phrases, decided, parts).mean > 0.88  # were all that is optional not part of it


def test_nothing_cannot_be_counted() -> None:
    with pytest.raises(UserError, match="nothing to compare"):
        accuracy([], [], [])
