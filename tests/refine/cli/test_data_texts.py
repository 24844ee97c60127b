"""``refine data texts``: what each source becomes, what is said of it, and what is refused."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from refine.cli.main import main
from refine.formats.amass import write_amass
from refine.formats.bvh import write_bvh
from refine.formats.clips import load_clips, save_clips
from refine.motion import mirror
from refine.synthetic import draw, perform
from refine.text.corpus import about_corpus, load_corpus
from renderers.rotations import rotation_about


@pytest.fixture(scope="module")
def performed(rest_joints):
    """A clip of an action, of so many frames at 60 a second."""

    def performed(action: str = "walk", frames: int = 240, seed: int = 1):
        return perform(draw(action, torch.Generator().manual_seed(seed), 60.0), frames, rest_joints)

    return performed


def made(capsys, *words) -> tuple[list[str], list[str]]:
    """What is printed, on stdout and on stderr."""
    assert main(["data", "texts", *map(str, words)]) == 0
    said = capsys.readouterr()
    return said.out.splitlines(), said.err.splitlines()


def refused(capsys, *words) -> str:
    """The one line that a mistake costs."""
    assert main(list(map(str, words))) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    return said


def test_builtin_actions(tmp_path, capsys):
    out, err = made(capsys, "builtin", "-o", tmp_path / "set", "--clips", 3, "--seconds", 0.5, "--fps", 10)
    items = load_corpus(tmp_path / "set")
    counts = {split: [sum(i.split == split and i.actions == n for i in items) for n in (1, 2)]
              for split in ("train", "val", "test")}  # fmt: skip
    assert counts["train"][0] == counts["val"][0] == counts["test"][0] == 19 and min(map(min, counts.values())) > 0
    assert out[:3] == [f"{s:5}  {a} of one action, {b} of two at once" for s, (a, b) in counts.items()]
    texts = {said for item in items for said in item.phrasings}
    size = f"{len(items)} clips, {5 * len(items):,} frames in {len(items) / 120:.1f} minutes"
    assert out[3:] == [f"{tmp_path / 'set'}  {size}, {len(texts):,} different descriptions"] and err == []
    assert about_corpus(tmp_path / "set") == {
        "name": "builtin", "sources": [], "seed": 0, "clips": 3, "seconds": 0.5, "fps": 10.0}  # fmt: skip
    assert {len(item.motion) for item in items} == {5} and {item.motion.fps for item in items} == {10.0}


def test_bandai_namcos_clips_from_files_and_from_what_was_imported(tmp_path, capsys, performed, rest_joints):
    for folder, name in (("a", "dataset-1_bow_giant_001"), ("a", "dataset-2_walk-turn-left_exhausted_004")):
        (tmp_path / folder).mkdir(exist_ok=True)
        write_bvh(tmp_path / folder / f"{name}.bvh", performed(frames=20), rest_joints)
    (tmp_path / "a" / "dataset-2_walk_active_001.bvh").write_text("HIERARCHY\nnothing")
    out, err = made(capsys, "bandai-namco", tmp_path / "a", "--out", tmp_path / "set")
    assert len(err) == 1 and err[0].startswith(f"refine: left out {tmp_path}/a/dataset-2_walk_active_001.bvh, line")
    items = load_corpus(tmp_path / "set")
    assert [item.key for item in items] == ["dataset-1_bow_giant_001", "dataset-2_walk-turn-left_exhausted_004"]
    assert items[1].phrasings[-1] == ("an exhausted walk, turning left",) and out[0] == "train  2 of one action"
    assert main(["data", "import", str(tmp_path / "a"), "-o", str(tmp_path / "clips.npz"), "--quiet"]) == 0
    made(capsys, "bandai-namco", tmp_path / "clips.npz", "--out", tmp_path / "again")
    again = load_corpus(tmp_path / "again")
    assert [(i.key, i.phrasings, i.split) for i in again] == [(i.key, i.phrasings, i.split) for i in items]
    torch.testing.assert_close(again[0].motion.rotations, items[0].motion.rotations)


def test_a_clip_that_does_not_show_what_its_name_says(tmp_path, capsys, performed):
    turning = performed(frames=20)
    rotations = turning.rotations.clone()
    rotations[:, 0] = rotation_about("y", torch.linspace(0, 1.5, 20)) @ rotations[:, 0]
    name = "dataset-2_walk-turn-right_masculine_007"
    save_clips(tmp_path / "clips.npz", [replace(turning, rotations=rotations, source=f"{name}.bvh")])
    _, err = made(capsys, "bandai-namco", tmp_path / "clips.npz", "--out", tmp_path / "set")
    assert err == [f"refine: {name} turns to the other side, and is described so"]
    assert load_corpus(tmp_path / "set")[0].phrasings[-1] == ("a masculine walk, turning left",)


def test_labels_become_words(tmp_path, capsys, performed):
    labels = ["walk", "lift_dumbbell", "walk+drink", "--", *["spin round"] * 12]
    clips = [replace(performed(frames=8), label=label, source=f"{n % 14}.bvh") for n, label in enumerate(labels)]
    save_clips(tmp_path / "clips.npz", clips)
    values = json.loads("\n".join(made(capsys, "labels", tmp_path / "clips.npz", "-o", tmp_path / "set", "--json")[0]))
    items = load_corpus(tmp_path / "set")
    assert [item.phrasings[0] for item in items[:3]] == [
        ("walk forwards",), ("lift dumbbell",), ("walk forwards", "drink from a cup")]  # fmt: skip
    assert [item.key for item in items[-3:]] == ["13.bvh", "0.bvh#2", "1.bvh#2"]
    assert values["splits"]["train"] == {"clips": 11, "singles": 10, "pairs": 1, "more": 0}
    assert values["splits"]["val"] == values["splits"]["test"] == {"clips": 2, "singles": 2, "pairs": 0, "more": 0}
    assert values["left_out"] == ["3.bvh: has a label without words ('--'); give it one"]
    assert json.loads((tmp_path / "set" / "texts.json").read_text())["left_out"] == values["left_out"]
    made(capsys, "labels", tmp_path / "clips.npz", "-o", tmp_path / "set", "--force", "--seed", 5)
    moved = {item.key: item.split for item in load_corpus(tmp_path / "set")}
    assert moved != {item.key: item.split for item in items}
    assert len(load_clips(tmp_path / "set")) == 15  # other verbs read it as packed clips


@pytest.fixture
def amass(tmp_path, performed) -> Path:
    """Three motions of four seconds."""
    for number in (1, 2, 3):
        path = tmp_path / "AMASS" / "CMU" / "01" / f"01_0{number}_poses.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_amass(path, performed(seed=number))
    return tmp_path / "AMASS"


def babel(number: int, *labels: tuple[str, float, float]) -> dict:
    frames = [{"proc_label": text, "start_t": start, "end_t": end} for text, start, end in labels]
    whole = {"labels": [{"proc_label": "walk"}]}
    return {"feat_p": f"CMU/CMU/01/01_0{number}_poses.npz", "seq_ann": whole, "frame_ann": {"labels": frames}}


def test_babel(tmp_path, capsys, amass, performed):
    labels = tmp_path / "babel"
    labels.mkdir()
    train = {"7": babel(1, ("walk", 0, 4), ("wave", 1, 3)), "8": {**babel(9), "frame_ann": None}}
    val = {
        "9": babel(2, ("wave", 0, 4), ("walk", 2, 4), ("drink", 0, 2)),  # wave with walk is learned, with drink not
        "10": babel(3, ("stand", 0, 4), ("drink", 0, 2), ("transition", 2, 4)),  # someone who stands does not count
    }
    (labels / "train.json").write_text(json.dumps(train))
    (labels / "val.json").write_text(json.dumps(val))
    out, err = made(capsys, "babel", labels, "--motions", amass, "--out", tmp_path / "set")
    items = {item.key: item for item in load_corpus(tmp_path / "set")}
    pairs = {key: (item.split, item.phrasings) for key, item in items.items() if item.actions == 2}
    assert pairs == {
        "spatial_pairs-7-0": ("train", (("walk", "wave"),)),
        "spatial_pairs-9-0": ("test", (("drink", "wave"),)),
        "spatial_pairs-9-1": ("val", (("wave", "walk"),)),
        "spatial_pairs-10-0": ("val", (("drink", "stand"),)),
    }
    assert {item.split for key, item in items.items() if item.actions == 1} == {"train", "val"}
    assert out[2] == "test   1 of two at once" and about_corpus(tmp_path / "set")["nearest_lower"] is False
    assert any("CMU/CMU/01/01_09_poses.npz" in line for line in err) and any("transition" in line for line in err)
    pair = items["spatial_pairs-7-0"].motion
    assert pair.fps == 30 and len(pair) == 60
    whole = performed(seed=1)
    torch.testing.assert_close(pair.rotations[:, 1:22], whole.rotations[60:180:2, 1:22], atol=1e-4, rtol=0)
    torch.testing.assert_close(pair.root, whole.root[60:180:2], atol=1e-4, rtol=0)
    (labels / "train.json").unlink()
    _, err = made(capsys, "babel", labels, "--motions", amass, "--out", tmp_path / "val")
    assert any("train.json is not there: each of the pairs of val counts as unseen" in line for line in err)
    assert sum(item.split == "test" for item in load_corpus(tmp_path / "val")) == 2


def test_what_is_taken_of_babel(tmp_path, capsys, amass):
    labels = [("walk", 0, 4), ("wave", 0, 2), ("talk", 0, 2), ("nod", 0, 2), ("look up", 0, 2), ("turn", 2, 4)]
    (tmp_path / "train.json").write_text(json.dumps({"7": babel(1, *labels), "8": babel(2, ("sit", 0, 4))}))
    extra = {"9": {"feat_p": "CMU/CMU/01/01_03_poses.npz", "seq_anns": [{"labels": [{"proc_label": "hop"}]}]}}
    (tmp_path / "extra_train.json").write_text(json.dumps(extra))

    def taken(*flags):
        made(capsys, "babel", tmp_path, "--motions", amass, "-o", tmp_path / "set", "--force", *flags)
        return {item.key: item for item in load_corpus(tmp_path / "set")}

    usual = taken()
    assert {item.actions for item in usual.values()} == {1, 2} and len(usual) == 8
    assert {item.actions for item in taken("--max-actions", 5).values()} == {1, 2, 5}
    assert {key for key, item in taken("--alone").items() if item.actions == 1} == {"seg-8-0"}
    assert {item.phrasings for item in taken("--extra").values()} - {item.phrasings for item in usual.values()} == {
        (("hop",),)
    }
    lower = taken("--nearest-lower")["seg-8-0"].motion.root
    between = usual["seg-8-0"].motion.root
    assert len(lower) == 120 and torch.equal(lower[0], between[0])
    assert not torch.allclose(lower[-1], between[-1], atol=1e-3)  # its last frame is the file's last one
    assert len(taken("--fps", 20)["seg-8-0"].motion) == 80


def test_kit_ml(tmp_path, capsys, amass, performed):
    folder = tmp_path / "kitml"
    (folder / "splits").mkdir(parents=True)
    said = [("a person walks", 0.0, 4.0), ("someone strolls", 0.0, 4.0), ("a step", 0.0, 1.0)]
    texts = [{"seg_id": str(n), "text": text, "start": start, "end": end} for n, (text, start, end) in enumerate(said)]
    path = "CMU/01/01_0{}_poses"
    annotations = {
        name: {"path": place.format(number), "duration": 4.0, "annotations": texts}
        for name, place, number in (("1", path, 1), ("M1", f"M/{path}", 1), ("2", path, 2), ("3", path, 3))
    }
    (folder / "annotations.json").write_text(json.dumps(annotations))
    for split, names in {"train": "1\nM1\n", "val": "2\n", "test": "3\n"}.items():
        (folder / "splits" / f"{split}.txt").write_text(names)
    out, _ = made(capsys, "kit", folder, "--motions", amass, "--out", tmp_path / "set")
    items = {item.key: item for item in load_corpus(tmp_path / "set")}
    assert {key: (item.split, len(item.phrasings)) for key, item in items.items()} == {
        "1": ("train", 2), "M1": ("train", 2), "2": ("val", 2), "3": ("test", 2), "3-1": ("test", 1)}  # fmt: skip
    assert out[0] == "train  2 of one action" and len(items["3-1"].motion) == 30
    torch.testing.assert_close(mirror(items["1"].motion).rotations, items["M1"].motion.rotations, atol=1e-4, rtol=0)
    made(capsys, "humanml3d", folder, "--motions", amass, "--out", tmp_path / "set", "--unmirrored", "--force")
    assert "M1" not in {item.key for item in load_corpus(tmp_path / "set")}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["builtin", "HERE"], "builtin: is performed, not read; leave the source out"),
        (["builtin", "--clips", "2"], "--clips: expected 3 to 10000, got 2"),
        (["builtin", "--fps", "nan"], "--fps: expected 1 to 1000, got nan"),
        (["builtin", "--motions", "HERE"], "--motions: is for babel and kit and humanml3d, not for builtin"),
        (["babel", "HERE", "--motions", "HERE", "--clips", "5"], "--clips: is for builtin, not for babel"),
        (["kit", "HERE", "--motions", "HERE", "--alone"], "--alone: is for babel, not for kit"),
        (["bandai-namco"], "bandai-namco: is made of clips that do not ship with Refine; name their folder"),
        (["labels", "nowhere.npz"], "nowhere.npz: does not exist"),
        (["babel"], "babel: is read from one folder of annotations; name it"),
        (["kit", "HERE"], "kit: annotates motions of AMASS; say where these are with --motions"),
        (["kit", "HERE", "--motions", "nowhere"], "nowhere: does not exist"),
        (["bandai-namco", "HERE"], "has no files that end in"),
        (["babel", "HERE", "--motions", "HERE"], "train.json: cannot be read"),
        (["kit", "HERE", "--motions", "HERE"], "has neither annotations.json nor texts"),
    ],
)
def test_a_mistake_costs_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    words = ["here" if word == "HERE" else word for word in words]
    assert said in refused(capsys, "data", "texts", *words, "--out", "set")
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


def test_a_set_that_is_there_is_refused_without_force(tmp_path, capsys, performed):
    save_clips(tmp_path / "clips.npz", [performed(frames=8)])
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "note").write_text("mine")
    said = refused(capsys, "data", "texts", "labels", tmp_path / "clips.npz", "--out", tmp_path / "set")
    assert "set: is already there" in said and (tmp_path / "set" / "note").read_text() == "mine"


def test_where_no_motion_is_there_nothing_is_written(tmp_path, capsys):
    (tmp_path / "train.json").write_text(json.dumps({"7": babel(1, ("walk", 0, 4))}))
    words = ["data", "texts", "babel", tmp_path, "--motions", tmp_path, "--out", tmp_path / "set"]
    assert re.search("name the folder of AMASS", refused(capsys, *words)) and not (tmp_path / "set").exists()
