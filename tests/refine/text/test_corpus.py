"""Sets of described clips: what is written is read, and what was damaged is refused."""

import json
from dataclasses import replace

import pytest
import torch

import refine.formats.clips as clips
from refine.formats.clips import load_clips
from refine.motion import Motion, crop
from refine.synthetic import draw, perform
from refine.text.corpus import about_corpus, counted, load_corpus, save_corpus
from refine.text.described import Described
from renderers.checks import UserError


def described(rest_joints, count: int = 4) -> list[Described]:
    random = torch.Generator().manual_seed(1)
    items = []
    for number in range(count):
        motion = perform(draw("walk", random, 20.0 + number), 16 + number, rest_joints)
        said = (("walk",), ("go «là»",)) if number % 2 else (("walk", "wave"), ("stroll", "greet"), ("go", "hail"))
        split = ("train", "val", "test", "train")[number % 4]
        items.append(Described(replace(motion, source=f"{number}.bvh"), said, f"walk/{number}", split))
    return items


def same(one: Motion, other: Motion) -> bool:
    close = torch.allclose(one.rotations, other.rotations, atol=1e-6) and torch.equal(one.root, other.root)
    return close and (one.fps, one.label, one.source) == (other.fps, other.label, other.source)


def test_what_is_written_is_read(tmp_path, rest_joints):
    items = described(rest_joints)
    left_out = []

    def read():
        yield from items
        left_out.append("b.npz: is broken")

    counts = save_corpus(tmp_path / "set", read(), {"source": "hand", "seed": 3}, left_out)
    assert json.loads((tmp_path / "set" / "texts.json").read_text())["left_out"] == ["b.npz: is broken"]
    read = load_corpus(tmp_path / "set")
    assert all(same(a.motion, b.motion) for a, b in zip(items, read, strict=True))
    assert [(a.phrasings, a.key, a.split) for a in read] == [(a.phrasings, a.key, a.split) for a in items]
    assert about_corpus(tmp_path / "set") == {"source": "hand", "seed": 3}
    assert counts == counted(read) and counts.values() == {
        "clips": 4,
        "frames": 16 + 17 + 18 + 19,
        "seconds": round(16 / 20 + 17 / 21 + 18 / 22 + 19 / 23, 3),
        "texts": 5,
        "splits": {
            "train": {"clips": 2, "singles": 1, "pairs": 1, "more": 0},
            "val": {"clips": 1, "singles": 1, "pairs": 0, "more": 0},
            "test": {"clips": 1, "singles": 0, "pairs": 1, "more": 0},
        },
    }
    assert len(load_clips(tmp_path / "set")) == 4  # as any packed clips


def test_one_split_of_several_files(tmp_path, rest_joints, monkeypatch):
    monkeypatch.setattr(clips, "SHARD_FRAMES", 35)
    items = described(rest_joints, 8)
    save_corpus(tmp_path / "set", items, {})
    assert len(list((tmp_path / "set").glob("clips-*.npz"))) > 2
    read = load_corpus(tmp_path / "set", "train")
    wanted = [item for item in items if item.split == "train"]
    assert [item.key for item in read] == [item.key for item in wanted] and len(read) == 4
    assert all(same(a.motion, b.motion) for a, b in zip(wanted, read, strict=True))
    one = read[0].motion.rotations
    assert one.untyped_storage().nbytes() == one.nbytes  # the clips that are left out are not held in memory
    assert load_corpus(tmp_path / "set", "val")[0].split == "val"


def test_the_same_items_give_the_same_bytes(tmp_path, rest_joints):
    for name in "ab":
        save_corpus(tmp_path / name, described(rest_joints), {"a": 1})
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_nothing_is_left_of_a_set_that_fails(tmp_path, rest_joints):
    first, second, *_ = described(rest_joints)
    save_corpus(tmp_path / "set", [first], {})
    before = {path.name: path.read_bytes() for path in (tmp_path / "set").iterdir()}
    with pytest.raises(UserError, match="two clips called 'walk/0'"):
        save_corpus(tmp_path / "set", [first, replace(second, key=first.key)], {})
    with pytest.raises(UserError, match="no clips; the first that was left out: a.npz: is missing"):
        save_corpus(tmp_path / "set", [], {}, ["a.npz: is missing"])
    assert {path.name: path.read_bytes() for path in (tmp_path / "set").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_texts_may_be_mended_by_hand(tmp_path, rest_joints):
    save_corpus(tmp_path / "set", described(rest_joints), {})
    path = tmp_path / "set" / "texts.json"
    lines = path.read_text().splitlines()
    assert sum('"walk/' in line for line in lines) == 4  # one line each
    path.write_text(path.read_text().replace('["stroll", "greet"]', '["amble", "greet"]'))
    assert load_corpus(tmp_path / "set")[0].phrasings[1] == ("amble", "greet")


def change(**values):
    return lambda content: content.update(values)


def change_clip(**values):
    return lambda content: content["clips"]["walk/1"].update(values)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (change(kind="clips"), "is no file of texts"),
        (change(about=None), "is no file of texts"),
        (change(schema=2), "is of schema 2; this Refine reads schema 1"),
        (change(clips=[]), "has no list of clips"),
        (change(hash="0"), "is of other clips than those that lie beside it"),
        (lambda content: content["clips"].pop("walk/0"), "describes fewer clips than there are"),
        (lambda content: content["clips"].update(more=content["clips"]["walk/0"]), "describes more clips than"),
        (change_clip(split="dev"), "'walk/1' is of no split; choose among train, val, test"),
        (change_clip(phrasings="walk"), "no lists of texts"),
        (change_clip(phrasings=["walk"]), "no lists of texts"),
        (change_clip(phrasings=[["walk", 3]]), "no lists of texts"),
        (change_clip(phrasings=[]), "phrasings must name actions"),
        (change_clip(phrasings=[["walk"], ["walk", "wave"]]), "all equally many"),
        (change_clip(phrasings=[[" "]]), "has an empty description"),
    ],
)
def test_damaged_texts_are_refused(tmp_path, rest_joints, damage, said):
    save_corpus(tmp_path / "set", described(rest_joints), {})
    path = tmp_path / "set" / "texts.json"
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(UserError, match=said):
        load_corpus(tmp_path / "set")


def test_what_is_no_set_is_refused(tmp_path, rest_joints):
    with pytest.raises(UserError, match="does not exist"):
        load_corpus(tmp_path / "nothing")
    with pytest.raises(UserError, match="holds no described clips"):
        load_corpus(tmp_path)
    items = described(rest_joints)
    save_corpus(tmp_path / "set", items, {})
    save_corpus(tmp_path / "other", [replace(item, motion=crop(item.motion, 0, 9)) for item in items], {})
    (tmp_path / "set" / "clips-00000.npz").write_bytes((tmp_path / "other" / "clips-00000.npz").read_bytes())
    with pytest.raises(UserError, match="was changed since it was written"):
        load_corpus(tmp_path / "set")
