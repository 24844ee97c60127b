"""KIT-ML's and HumanML3D's sentences: stretches, mirror images, splits, and what is left out."""

import json

import numpy as np
import pytest
import torch

from refine.formats.amass_folder import AmassFolder
from refine.formats.tmr import AnnotatedConfig, load_annotated
from renderers.checks import UserError

KICK = "KIT/3/kick_high_left02_poses"
POSE = "Eyes_Japan_Dataset/hamada/pose_poses"


def amass(folder, name, seconds, fps=100):
    """A body that goes one metre a second along x of the file: where it is says what second it is."""
    path = folder / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    trans = np.zeros((seconds * fps, 3))
    trans[:, 0] = np.arange(seconds * fps) / fps
    poses = np.zeros((seconds * fps, 156))
    poses[:, 3 * 18 + 1] = 0.5  # the left elbow is bent
    np.savez(path, poses=poses, trans=trans, mocap_framerate=np.array(float(fps)))


def said(text, start=0.0, end=4.0, name="x"):
    return {"seg_id": name, "text": text, "start": start, "end": end}


@pytest.fixture
def tmr(tmp_path):
    """Writes annotations in TMR's form and the motions, and reads them."""

    def load(annotations, split="train", names=None, **config):
        folder = tmp_path / "kitml"
        (folder / "splits").mkdir(parents=True, exist_ok=True)
        (folder / "annotations.json").write_text(json.dumps(annotations))
        (folder / "splits" / f"{split}.txt").write_text("\n".join(annotations if names is None else names) + "\n")
        amass(tmp_path / "amass", KICK, 20)
        left_out = []
        items = load_annotated(folder, tmp_path / "amass", split, AnnotatedConfig(**config), left_out)
        return {item.key: item for item in items}, left_out

    return load


@pytest.fixture
def humanml3d(tmp_path):
    """Writes texts in HumanML3D's form, an index and the motions, and reads them."""

    def load(texts, split="train", names=None, **config):
        folder = tmp_path / "HumanML3D"
        (folder / "texts").mkdir(parents=True, exist_ok=True)
        for name, lines in texts.items():
            (folder / "texts" / f"{name}.txt").write_text(lines)
        (folder / f"{split}.txt").write_text("\n".join(texts if names is None else names))
        index = ["source_path,start_frame,end_frame,new_name", f"./pose_data/{KICK}.npy,0,117,000000.npy"]
        index += [
            "./pose_data/humanact12/humanact12/P11.npy,0,-1,000001.npy",
            f"./pose_data/{POSE}.npy,40,140,000002.npy",
        ]
        (tmp_path / "index.csv").write_text("\n".join(index) + "\n")
        for name, seconds in ((KICK, 6), ("humanact12/P11", 3), (POSE, 12)):
            amass(tmp_path / "amass", name, seconds)
        left_out = []
        items = load_annotated(folder, tmp_path / "amass", split, AnnotatedConfig(**config), left_out)
        return {item.key: item for item in items}, left_out

    return load


def texts(items):
    return {key: [text for (text,) in item.phrasings] for key, item in items.items()}


def seconds(item):
    """From when to when of its motion a clip is: where the body is says so."""
    begin = item.motion.root[0, 0].item() + 0.0018  # the pelvis stands a little beside SMPL's origin
    return [round(begin, 2), round(begin + item.motion.seconds, 2)]


def test_sentences_about_one_stretch_are_phrasings_of_one_clip(tmr):
    annotations = [said("A man kicks. "), said("He kicks\nhigh."), said("He stands.", 3, 7.5), said("A man kicks.")]
    items, left_out = tmr({"00001": {"path": KICK, "duration": 20.0, "annotations": annotations}})
    assert texts(items) == {"00001": ["A man kicks.", "He kicks high."], "00001-1": ["He stands."]}
    assert [seconds(item) for item in items.values()] == [[0, 4], [3, 7.5]]
    assert {(item.motion.fps, item.split) for item in items.values()} == {(30, "train")}
    assert left_out == []


def test_mirror_images(tmr):
    one = {"path": KICK, "annotations": [said("kicks left")]}
    both = {"1": one, "M1": {"path": f"M/{KICK}", "annotations": [said("kicks right")]}}
    items, _ = tmr(both)
    plain, mirrored = items["1"].motion, items["M1"].motion
    assert items["M1"].phrasings == (("kicks right",),)
    torch.testing.assert_close(mirrored.root, plain.root * torch.tensor([-1.0, 1.0, 1.0]))
    bent = [(motion.rotations[0, [18, 19]] - torch.eye(3)).abs().amax((1, 2)) > 0.1 for motion in (plain, mirrored)]
    assert [one.tolist() for one in bent] == [[True, False], [False, True]]
    assert list(tmr(both, mirrored=False)[0]) == ["1"]


def test_what_is_learned_lasts_two_to_ten_seconds_and_all_is_tested(tmr):
    stretches = [(0, 1.9), (0, 2), (0, 10), (0, 10.5), (1, 1.5)]
    annotations = {"1": {"path": KICK, "annotations": [said(f"{a} to {b}", a, b) for a, b in stretches]}}
    for split in ("train", "val"):
        items, left_out = tmr(annotations, split)
        assert texts(items) == {"1": ["0 to 2"], "1-1": ["0 to 10"]} and items["1"].split == split
        assert left_out == ["sentences about stretches that are not of 2 to 10 s: 3"]
    assert len(tmr(annotations, "test")[0]) == 5
    assert len(tmr(annotations, shortest=0.0, longest=60.0)[0]) == 5


def test_bad_annotations_are_named_and_the_rest_is_read(tmr):
    bad = [said(""), said(None), said("a", "0"), said("b", 3, 2), said("c", -1), said("d" * 1001), "e", said("good")]
    entries = {
        "1": {"path": KICK, "annotations": bad},
        "2": {"path": KICK},
        "3": [],
        "4": {"path": "../../secret", "annotations": [said("a")]},
        "5": {"path": "KIT/9/none_poses", "annotations": [said("a")]},
        "6": {"path": KICK, "annotations": [said("late", 30, 34), said("no time", 1, 1.04)]},
        "7": {"path": "humanact12/P1", "annotations": [said("a")]},
    }
    items, left_out = tmr(entries, names=[*entries, "8", "1"])
    assert texts(items) == {"1": ["good"]}
    for index in range(7):
        assert sum(f"annotations.json, 1, annotation {index}: has no" in line for line in left_out) == 1
    expected = [
        "2: has no path and annotations",
        "3: has no path and",
        "'../../secret",
        "less than two frames of their motion: 2",
    ]
    expected += ["not there: 2 (KIT/9/none_poses, humanact12/P1)", "names in the split that have no annotation: 1"]
    assert [line for line in expected if not any(line.strip("'") in one for one in left_out)] == []
    assert len(left_out) == 7 + len(expected)


def test_files_that_are_not_there_or_something_else(tmr, tmp_path):
    entry = {"path": KICK, "annotations": [said("a")]}
    for name in ("../1", "a\\b", "1" * 101, "1\0"):
        with pytest.raises(UserError, match="names more than IDs"):
            tmr({"1": entry}, names=[name])
    with pytest.raises(UserError, match="no annotations"):
        tmr([entry], names=["1"])
    with pytest.raises(UserError, match="not there: 1 .*name the folder of AMASS"):
        tmr({"1": entry | {"path": "KIT/3/other"}})
    with pytest.raises(UserError, match="val.txt"):
        list(load_annotated(tmp_path / "kitml", tmp_path, "val", AnnotatedConfig(), []))
    with pytest.raises(UserError, match="neither annotations.json nor texts"):
        list(load_annotated(tmp_path, tmp_path, "val", AnnotatedConfig(), []))
    with pytest.raises(UserError, match="expected 5"):
        AnnotatedConfig(shortest=5.0, longest=4.0)


def test_a_motion_is_read_once_and_only_when_it_is_wanted(tmr, tmp_path, monkeypatch):
    entries = {name: {"path": path, "annotations": [said("a")]} for name, path in (("1", KICK), ("M1", f"M/{KICK}"))}
    assert len(tmr(entries)[0]) == 2
    read = []
    real = AmassFolder.motion
    monkeypatch.setattr(AmassFolder, "motion", lambda self, name: read.append(name) or real(self, name))
    items = load_annotated(tmp_path / "kitml", tmp_path / "amass", "train", AnnotatedConfig(), [])
    assert read == []
    assert len(list(items)) == 2 and read == [KICK]


def test_humanml3d_as_it_is_published(humanml3d):
    """The index counts 20 frames a second behind a lead-in that depends on the subset."""
    lines = {
        "000000": "a man kicks # once.#a/DET man/NOUN kick/VERB#0.0#0.0\nhe stands.#he/PRON#3.0#1.0\n\n",
        "M000000": "a man kicks right.#x#0.0#nan\n",
        "000001": "he drinks.#x#nan#nan\n",
        "000002": "poses.#x#0.0#0.0\nholds still.#x#1.0#4.0\nto the end.#x#2.0#9.0\none frame.#x#2.0#2.0\n",
    }
    items, left_out = humanml3d(lines)
    assert texts(items) == {
        "000000": ["a man kicks # once."],
        "000000-1": ["he stands."],
        "M000000": ["a man kicks right."],
        "000001": ["he drinks."],
        "000002": ["poses.", "one frame."],
        "000002-1": ["holds still."],
        "000002-2": ["to the end."],
    }
    expected = {"000000": [0, 5.85], "000000-1": [1, 3], "000001": [0, 3]}
    expected |= {"000002": [5, 10], "000002-1": [6, 9], "000002-2": [7, 10]}
    found = {key: seconds(items[key]) for key in expected}
    assert found == {key: pytest.approx(value, abs=1 / 29) for key, value in expected.items()}
    assert items["M000000"].motion.root[-1, 0] < -5 and left_out == []


def test_humanml3d_takes_a_time_that_is_no_number_for_zero(humanml3d):
    items, _ = humanml3d({"000000": "a#x#3.0#nan\nb#x#nan#2.0\n"}, "test")
    assert {key: seconds(item) for key, item in items.items()} == {"000000": [0, 3], "000000-1": [0, 2]}


def test_lines_of_humanml3d_that_are_none_are_named(humanml3d):
    lines = {"000000": "no cells\na#x#zero#0\n#x#0#0\nb#x#-1#3\nkicks.#x#0#0\n", "000009": "a#x#0#0", "000002": " \n"}
    items, left_out = humanml3d(lines, names=[*lines, "000001"])
    assert texts(items) == {"000000": ["kicks."]}
    for number in range(1, 5):
        assert sum(f"000000.txt, line {number}: " in line for line in left_out) == 1
    assert "names in the split that have no line in the index, or no text: 2" in left_out
    assert any("000002.txt" in line and "is empty" in line for line in left_out) and len(left_out) == 6


@pytest.mark.parametrize(
    "index, problem",
    [
        ("a,b\n1,2\n", "is no table of source_path"),
        ("source_path,start_frame,end_frame,new_name\nx.npy,a,2,0.npy\n", "line 2: is no line of the index"),
        (f"source_path,start_frame,end_frame,new_name\nx.npy,0,{'9' * 400},0.npy\n", "line 2: is no line of the index"),
        ("source_path,start_frame,end_frame,new_name\nx.npy\n", "line 2: is no line of the index"),
    ],
)
def test_an_index_that_is_none(humanml3d, tmp_path, index, problem):
    humanml3d({"000000": "a#x#0#0"})
    (tmp_path / "index.csv").write_text(index)
    with pytest.raises(UserError, match=problem):
        list(load_annotated(tmp_path / "HumanML3D", tmp_path / "amass", "train", AnnotatedConfig(), []))
