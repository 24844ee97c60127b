"""Bandai-Namco's clips in words: every file is described, in English, and as what it shows."""

from collections import Counter, defaultdict

import pytest
import torch

from refine.motion import Motion
from refine.text.bandai_namco import CONTENTS, STYLES, content_and_style, describe, described_clips, splits_of
from refine.text.gerunds import as_gerund
from refine.text.labellers import labeller
from renderers.checks import UserError
from renderers.rotations import rotation_about

FIRST = {
    "walk walk-back walk-left walk-right run dash bow bye byebye guide": (
        "normal happy sad angry proud not-confident masculinity feminine childish old tired active musical giant "
        "chimpira"
    ),
    "respond call punch kick slash dance-long dance-short": "normal",
}
SECOND_CONTENTS = (
    "walk walk-turn-left walk-turn-right run wave-both-hands wave-left-hand wave-right-hand raise-up-both-hands "
    "raise-up-left-hand raise-up-right-hand"
)
SECOND_STYLES = "active elderly exhausted feminine masculine normal youthful"
LEGS, ARMS = {"global", "left leg", "right leg"}, {"left arm", "right arm"}
# What each content is about by the clips, and what a labeller may add or leave out.
ABOUT: dict[str, tuple[set[str], set[str]]] = {
    **dict.fromkeys(("walk", "run", "dash", "walk-back", "walk-left", "walk-right"), (LEGS, set())),
    **dict.fromkeys(("walk-turn-left", "walk-turn-right"), (LEGS, {"torso"})),
    **dict.fromkeys(("bye", "guide", "raise-up-right-hand", "wave-right-hand"), ({"right arm"}, set())),
    **dict.fromkeys(("respond", "raise-up-left-hand", "wave-left-hand"), ({"left arm"}, set())),
    **dict.fromkeys(("byebye", "raise-up-both-hands", "wave-both-hands"), (ARMS, set())),
    **dict.fromkeys(("punch", "slash"), (ARMS, {"torso"} | LEGS)),
    "bow": ({"torso"}, set()),
    "call": ({"torso", "right arm"}, set()),
    "kick": ({"right leg"}, LEGS),
    "dance": (LEGS | ARMS, {"torso"}),
}


def names() -> list[str]:
    """Of every pair of content and style that both data sets have."""
    first = [
        f"dataset-1_{content}_{style}_001"
        for contents, styles in FIRST.items()
        for content in contents.split()
        for style in styles.split()
    ]
    return first + [f"dataset-2_{c}_{s}_001" for c in SECOND_CONTENTS.split() for s in SECOND_STYLES.split()]


def test_every_content_and_style_is_described_in_several_ways():
    said = defaultdict(set)
    for name in names():
        content, style = content_and_style(f"some/where/{name}.bvh")
        texts = describe(content, style)
        assert len(set(texts)) == len(texts) >= 7
        for text in texts:
            assert text == " ".join(text.split()) and text[0].islower() and not set("{}") & set(text), text
            article, word = f"{text} .".split()[:2]
            assert article not in ("a", "an") or (article == "an") == (word[0] in "aeiou"), text
            said[text].add((content, style))
    assert {text: of for text, of in said.items() if len(of) > 1} == {}  # none said of two things
    assert {content_and_style(name)[0] for name in names()} == set(CONTENTS)
    assert {content_and_style(name)[1] for name in names()} == set(STYLES)


def test_descriptions_read_as_a_person_would_write_them():
    assert describe("walk-turn-left", "exhausted") == (
        "walk exhaustedly, turning left",
        "turn left, walking exhaustedly",
        "walk like someone exhausted, turning left",
        "turn left, walking like someone exhausted",
        "walk as if worn out, turning left",
        "turn left, walking as if worn out",
        "an exhausted walk, turning left",
    )
    assert describe("walk", "normal")[:2] == ("walk", "walk forwards")
    assert describe("bow", "giant")[-1] == "a giant's bow"
    assert "say goodbye without confidence, waving both hands" in describe("byebye", "not-confident")
    assert as_gerund(describe("raise-up-left-hand", "elderly")[0]) == "raising the left hand like an elderly person"


def test_descriptions_are_about_the_parts_that_the_clips_move():
    texts = {text: content for name in names() for content, style in [content_and_style(name)]
             for text in describe(content, style)}  # fmt: skip
    wrong = []
    for said in labeller()(list(texts)):
        moved, open_ = ABOUT[texts[said.phrase]]
        if set(said.parts.names) - open_ != moved - open_:
            wrong.append((said.phrase, said.parts.names))
    assert len(wrong) <= 0.01 * len(texts), wrong


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("walk_01.bvh", "walk_01.bvh: is not called as Bandai-Namco's clips are"),
        ("dataset-3_walk_active_001", "is not called as"),
        ("dataset-2_wlk_active_001", "unknown name 'wlk'; did you mean walk"),
        ("dataset-2_walk_exhuasted_001", "unknown name 'exhuasted'; did you mean exhausted"),
    ],
)
def test_other_names_are_refused(name, said):
    with pytest.raises(UserError, match=said):
        content_and_style(name)


def test_every_real_file_is_described_and_in_one_split(real_clips):
    files = [path.stem for path in real_clips]
    assert len(files) == 594 and len({content_and_style(name)[0] for name in files}) == 24
    splits = splits_of(files)
    assert splits == splits_of(reversed(files)) and splits != splits_of(files, seed=1)
    assert Counter(splits.values()) == {"train": 408, "val": 93, "test": 93}
    for content in CONTENTS:
        mine = Counter(splits[name] for name in files if content_and_style(name)[0] == content)
        assert mine["val"] == mine["test"] == mine.total() // 6 or mine["val"] - mine["test"] == 1
    by_style = Counter((*content_and_style(name), splits[name]) for name in files if name.startswith("dataset-2_wave"))
    assert set(by_style.values()) == {4, 1} and len(by_style) == 3 * 7 * 3  # of each content and style 4, 1 and 1


def turning(name: str, degrees: float) -> Motion:
    """A clip whose pelvis turns to the left."""
    turns = rotation_about("y", torch.linspace(3.0, 3.0 + degrees / 57.29578, 20))  # crosses the back
    rotations = torch.eye(3).repeat(20, 24, 1, 1)
    rotations[:, 0] = turns
    return Motion(rotations, torch.zeros(20, 3), 30.0, source=f"data/{name}.bvh")


def test_clips_are_described_as_what_they_show():
    right = turning("dataset-2_walk-turn-right_masculine_007", 90)  # as the real one does
    left = turning("dataset-2_walk-turn-left_masculine_007", 90)
    slight = turning("dataset-2_walk-turn-right_masculine_001", 20)
    noted: list[str] = []
    items = {item.key: item for item in described_clips([right, left, slight], noted=noted)}
    assert items["dataset-2_walk-turn-right_masculine_007"].phrasings == items[
        "dataset-2_walk-turn-left_masculine_007"].phrasings  # fmt: skip
    assert items["dataset-2_walk-turn-right_masculine_001"].phrasings[-1] == ("a masculine walk, turning right",)
    assert noted == ["dataset-2_walk-turn-right_masculine_007 turns to the other side, and is described so"]
    assert items["dataset-2_walk-turn-left_masculine_007"].motion is left
    with pytest.raises(UserError, match="masculine_007: is there twice"):
        described_clips([left, turning("dataset-2_walk-turn-left_masculine_007", 90)])
    with pytest.raises(UserError, match="there are no clips"):
        described_clips([])
