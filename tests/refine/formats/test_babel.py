"""BABEL's labels: stretches in which several hold, single ones, what is left out, and what SINC evaluates."""

import json
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from refine.formats.amass_folder import AmassFolder, find_amass, without_between
from refine.formats.babel import BabelConfig, Label, load_babel, simultaneous, unseen_pairs
from refine.motion import Motion
from refine.text.described import Described
from renderers.checks import UserError

labels = st.lists(
    st.builds(
        lambda start, length, text: Label(start, start + length, text),
        st.integers(0, 12),
        st.integers(1, 8),
        st.sampled_from(["walk", "wave", "turn", "sit"]),
    ),
    max_size=7,
)


def amass(path, frames=120, fps=30.0):
    """A body that goes one metre a second to the side: where it is says which frame it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    trans = np.zeros((frames, 3))
    trans[:, 0] = np.arange(frames) / fps
    np.savez(path, poses=np.zeros((frames, 156)), trans=trans, mocap_framerate=np.array(fps))


def entry(feat_p="CMU/CMU/01/01_01_poses.npz", whole="whole", frames=None):
    """As in train.json; ``frames`` are (text, start, end)."""
    labels = [
        {"proc_label": t, "raw_label": t, "seg_id": "x", "act_cat": [t], "start_t": s, "end_t": e}
        for t, s, e in frames or ()
    ]
    return {
        "babel_sid": 1,
        "url": "",
        "feat_p": feat_p,
        "dur": 4.0,
        "seq_ann": {"babel_lid": "a", "anntr_id": "b", "mul_act": True, "labels": [{"proc_label": whole}]},
        "frame_ann": None if frames is None else {"babel_lid": "c", "anntr_id": "d", "mul_act": True, "labels": labels},
    }


@pytest.fixture
def load(tmp_path):
    """Writes entries and one motion, and reads them."""

    def load(entries, split="train", extra=None, motion=True, **config):
        (tmp_path / f"{split}.json").write_text(json.dumps(entries))
        if extra is not None:
            (tmp_path / f"extra_{split}.json").write_text(json.dumps(extra))
        if motion:
            amass(tmp_path / "amass" / "CMU" / "01" / "01_01_poses.npz")
        left_out = []
        config = BabelConfig(extra=extra is not None, **config)
        return {i.key: i for i in load_babel(tmp_path, tmp_path / "amass", split, config, left_out)}, left_out

    return load


def texts(items):
    return {key: item.phrasings for key, item in items.items()}


@given(labels, st.integers(2, 4))
def test_what_holds_together_is_what_holds_in_each_frame(labels, most):
    """Frame by frame, with occurrences told apart; runs of equal frames are the stretches."""
    holding = [frozenset(n for n, one in enumerate(labels) if one.start <= t < one.stop) for t in range(21)]
    expected, begin = [], 0
    for t in range(1, 21):
        if holding[t] != holding[begin]:
            expected.append((begin, t, sorted(labels[n].text for n in holding[begin])))
            begin = t
    expected = [one for one in expected if 2 <= len(one[2]) <= most]
    assert [(start, stop, sorted(texts)) for start, stop, texts in simultaneous(labels, most)] == expected


@given(labels)
def test_the_order_of_labels_does_not_matter(labels):
    assert simultaneous(labels) == simultaneous(labels[::-1])


def test_labels_that_touch_do_not_overlap_and_the_first_to_begin_is_named_first():
    assert simultaneous([Label(0, 10, "walk"), Label(10, 20, "sit")]) == []
    wave = Label(4, 20, "wave")
    found = simultaneous([wave, Label(0, 10, "walk"), Label(10, 20, "walk")])
    assert found == [(4, 10, ("walk", "wave")), (10, 20, ("wave", "walk"))]  # two walks, told apart


def test_labels_of_stretches_give_single_actions_and_pairs(load):
    frames = [("walk", 0.0, 3.0), ("wave with right hand", 1.0, 4.0), ("transition", 0.0, 4.0), ("T-pose", 0, 1)]
    items, left_out = load({"17": entry(frames=frames)})
    assert texts(items) == {
        "seg-17-0": (("walk",),),
        "seg-17-1": (("wave with right hand",),),
        "spatial_pairs-17-0": (("walk", "wave with right hand"),),
    }
    pair = items["spatial_pairs-17-0"].motion
    assert len(pair) == 60 and pair.fps == 30  # 1 s to 3 s
    torch.testing.assert_close(pair.root[:, 0] - pair.root[0, 0], torch.arange(60) / 30)
    assert pair.root[0, 0] - items["seg-17-0"].motion.root[0, 0] == pytest.approx(1)
    assert left_out == ["labels of no action (t-pose, a-pose, transition): 2"]


def test_without_labels_of_stretches_the_first_of_the_whole_counts(load):
    one = entry(whole="tpose")
    items, left_out = load({"3": entry(whole="run in  circles"), "4": one}, split="val")
    assert texts(items) == {"seq-3-0": (("run in circles",),)}
    assert items["seq-3-0"].split == "val" and len(items["seq-3-0"].motion) == 120
    assert left_out == ["labels of no action (t-pose, a-pose, transition): 1"]


def test_short_long_late_and_empty_stretches_are_counted(load):
    frames = [("walk", 0.0, 3.0), ("hop", 0.0, 0.4), ("sit", 5.0, 6.0), ("", 0.0, 2.0), ("turn", 3.5, 9.0)]
    items, left_out = load({"1": entry(frames=frames)}, max_frames=60)
    assert texts(items) == {"seg-1-2": (("turn",),)} and len(items["seg-1-2"].motion) == 15
    assert sorted(left_out) == [
        "empty labels: 1",
        "labels that hold for no frame of their motion: 1",
        "stretches of fewer than 15 frames: 2",  # the hop, and the hop with the walk
        "stretches of more than 60 frames: 1",
    ]


def test_more_actions_at_once_and_only_those_alone(load):
    frames = [("walk", 0, 4), ("wave", 0, 2), ("talk", 0, 2), ("sit", 0, 2), ("nod", 0, 2)]
    assert "spatial_pairs-1-0" not in load({"1": entry(frames=frames)})[0]
    items, _ = load({"1": entry(frames=frames)}, max_actions=5)
    assert items["spatial_pairs-1-0"].phrasings == (("nod", "sit", "talk", "wave", "walk"),)
    frames = [("walk", 0, 2), ("wave", 1, 2), ("sit", 2, 4)]
    assert set(load({"1": entry(frames=frames)}, alone=True)[0]) == {"seg-1-2", "spatial_pairs-1-0"}


def test_extra_labels_of_several_people(load):
    def framed(*frames):
        return entry(frames=frames)["frame_ann"]

    one = entry()
    both = {key: one[key] for key in ("babel_sid", "feat_p", "dur")}
    extra = {
        "5": both | {"seq_anns": [one["seq_ann"]], "frame_anns": [framed(("walk", 0, 4)), framed(("stroll", 0, 4))]},
        "6": both | {"seq_anns": [one["seq_ann"], {"labels": [{"proc_label": "go"}]}], "frame_anns": None},
    }
    items, left_out = load({"5": one}, extra=extra)
    assert texts(items) == {
        "seq-5-0": (("whole",),),
        "seg-5.1-0": (("walk",),),
        "seg-5.2-0": (("stroll",),),  # two people's words for one thing are no pair
        "seq-6.1-0": (("whole",), ("go",)),
    }
    assert left_out == []


def test_bad_annotations_are_named_and_the_rest_is_read(load):
    bad = entry(
        frames=[
            ("walk", 0.0, 4.0),
            ("hop", 2.0, 1.0),
            ("sit", "0", 1.0),
            ("nod", -1.0, 1.0),
            (3, 0.0, 1.0),
            ("now", 1, 1),
        ]
    )
    entries = {
        "1": bad,
        "2": "nothing",
        "3": entry(feat_p="../../etc/passwd"),
        "4": entry(feat_p=None),
        "5": entry() | {"frame_ann": {"labels": {}}},
        "6": entry(feat_p="CMU/CMU/02/02_01_poses.npz"),
        "7": entry(feat_p="ACCAD/ACCAD/x_poses.npz"),
        "8": entry(whole=None),
        "9": entry(frames=[("walk", 0, 1)] * 1001),
    }
    items, left_out = load(entries)
    assert set(items) == {"seg-1-0"}
    assert all("\n" not in line for line in left_out)
    named = [
        "motion 1, label 1: 'hop' ends at 1 s",
        "label 2: 'sit' has no start_t",
        "label 3: 'nod'",
        "label 4: has no",
    ]
    named += ["motion 2: is no annotation", "'../../etc/passwd", "motion 4: names no motion", "motion 5: has frame_ann"]
    named += [
        "label 5: 'now' ends at 1 s, where it starts",
        "motion 8: has no proc_label",
        "motion 9: has 1,001 labels",
    ]
    named += ["motion files that are not there: 2 (CMU/CMU/02/02_01_poses.npz, ACCAD/ACCAD/x_poses.npz)"]
    assert [line for line in named if not any(line.strip("'") in one for one in left_out)] == []
    assert len(left_out) == len(named)


def test_a_damaged_motion_is_named(load, tmp_path):
    path = tmp_path / "amass" / "CMU" / "02" / "02_01_poses.npz"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"no motion")
    items, left_out = load({"1": entry(), "2": entry(feat_p="CMU/CMU/02/02_01_poses.npz")})
    assert set(items) == {"seq-1-0"} and len(left_out) == 1 and "02_01_poses.npz" in left_out[0]


def test_where_nothing_is_there_the_remedy_is_said(load, tmp_path):
    with pytest.raises(UserError, match="motion files that are not there: 1 .*name the folder of AMASS"):
        load({"1": entry()}, motion=False)
    with pytest.raises(UserError, match="BABEL publishes those of train and val"):
        load({"1": entry() | {"seq_ann": None}}, split="test")
    with pytest.raises(UserError, match="unknown name 'exam'"):
        load({"1": entry()}, split="exam")
    with pytest.raises(UserError, match="not BABEL's"):
        load([entry()])
    with pytest.raises(UserError, match="train.json"):
        list(load_babel(tmp_path / "elsewhere", tmp_path, "train", BabelConfig(), []))


def test_spellings_of_a_person(load, tmp_path):
    (tmp_path / "words.json").write_text('{"strectch": "stretch", "tpos": "t-pose"}')
    entries = {"1": entry(whole="strectch arms"), "2": entry(whole="tpos")}
    items, left_out = load(entries, spellings=tmp_path / "words.json")
    assert texts(items) == {"seq-1-0": (("stretch arms",),)} and len(left_out) == 1
    (tmp_path / "words.json").write_text('{"a": 1}')
    with pytest.raises(UserError, match="no JSON object of words"):
        load(entries, spellings=tmp_path / "words.json")


def test_one_motion_is_read_at_a_time(load, tmp_path, monkeypatch):
    read = []
    real = AmassFolder.motion
    monkeypatch.setattr(AmassFolder, "motion", lambda self, name: read.append(name) or real(self, name))
    amass(tmp_path / "amass" / "CMU" / "01" / "01_01_poses.npz")
    (tmp_path / "train.json").write_text(json.dumps({str(n): entry() for n in range(5)}))
    items = load_babel(tmp_path, tmp_path / "amass", "train", BabelConfig(), [])
    assert read == []
    next(items)
    assert len(read) == 1


@pytest.mark.parametrize(
    "name, there",
    [
        ("CMU/CMU/75/75_18_poses.npz", "CMU/75/75_18_poses.npz"),
        ("CMU/CMU/75/75_18_poses.npz", "CMU/CMU/75/75_18_poses.npz"),
        ("CMU/75/75_18_poses", "CMU/CMU/75/75_18_poses.npz"),
        ("CMU/75/75_18_poses", "CMU/75/75_18_stageii.npz"),
        ("BMLrub/BioMotionLab_NTroje/rub001/a_poses.npz", "BioMotionLab_NTroje/rub001/a_poses.npz"),
        ("BMLrub/BioMotionLab_NTroje/rub001/a_poses.npz", "BMLrub/rub001/a_stageii.npz"),
        ("BioMotionLab_NTroje/rub001/a_poses", "BMLrub/BioMotionLab_NTroje/rub001/a_poses.npz"),
        ("MPIHDM05/MPI_HDM05/bd/b_poses.npz", "HDM05/bd/b_poses.npz"),
    ],
)
def test_names_of_any_release(tmp_path, name, there):
    assert find_amass(tmp_path, name) is None
    amass(tmp_path / there, frames=2)
    assert find_amass(tmp_path, name) == tmp_path / there


@pytest.mark.parametrize("name", ["", "/etc/passwd", "a/../../b", "a\\..\\b", "a\0b", "a/" * 30, "a" * 300, "a\nb"])
def test_names_that_lead_elsewhere_are_refused(tmp_path, name):
    with pytest.raises(UserError, match="no name of a motion file"):
        find_amass(tmp_path, name)


def test_files_that_state_a_wrong_rate(tmp_path):
    amass(tmp_path / "BMLhandball" / "S01" / "throw_poses.npz", frames=241, fps=120.0)
    motion = AmassFolder(tmp_path).motion("BMLhandball/S01/throw_poses")
    assert motion.fps == 30 and motion.seconds == pytest.approx(31 / 30)


def test_a_rate_that_would_fill_the_memory_is_refused(tmp_path):
    amass(tmp_path / "CMU" / "a_poses.npz", frames=100, fps=1e-4)
    with pytest.raises(UserError, match="mend its frame rate"):
        AmassFolder(tmp_path).motion("CMU/a_poses")


@given(st.integers(2, 400), st.sampled_from([59, 60, 100, 120, 250]))
def test_without_between_takes_frames_evenly_and_the_one_before(frames, fps):
    motion = Motion(torch.eye(3).expand(frames, 24, 3, 3), torch.arange(frames)[:, None].repeat(1, 3) * 1.0, fps)
    taken = without_between(motion, 30.0)
    at = taken.root[:, 0].long().tolist()
    assert taken.fps == 30 and at[0] == 0
    assert abs(len(at) - frames * Fraction(30, fps)) <= 1 or len(at) == 1
    exact = [Fraction(n * (frames - 1), max(1, len(at) - 1)) for n in range(len(at))]
    assert all(0 <= there - mine <= 1 for there, mine in zip(exact, at, strict=True))


def test_without_between_rounds_as_published(tmp_path):
    """Of 365 frames at 250 a second the 28th lies at 27 * 364 / 42 = 234, which the published code rounds to 233."""
    amass(tmp_path / "CMU" / "a_poses.npz", frames=365, fps=250.0)
    motion = AmassFolder(tmp_path, nearest_lower=True).motion("CMU/a_poses")
    steps = (motion.root[:, 0] - motion.root[0, 0]) * 250
    assert len(motion) == 43 and steps[[1, 2, 27, 42]].tolist() == pytest.approx([8, 17, 233, 364], abs=1e-3)
    smooth = AmassFolder(tmp_path).motion("CMU/a_poses")
    assert ((smooth.root[1, 0] - smooth.root[0, 0]) * 250).item() == pytest.approx(25 / 3, abs=1e-3)


def test_the_published_frames_can_be_asked_for(load, tmp_path):
    amass(tmp_path / "amass" / "CMU" / "02" / "fast_poses.npz", frames=365, fps=250.0)
    one = {"1": entry(feat_p="CMU/CMU/02/fast_poses.npz")}
    steps = {legacy: load(one, nearest_lower=legacy)[0]["seq-1-0"].motion.root[:2, 0] * 250 for legacy in (True, False)}
    assert {legacy: round((b - a).item(), 2) for legacy, (a, b) in steps.items()} == {True: 8.0, False: 8.33}


def test_what_is_evaluated_is_two_actions_that_nothing_learned_shows_together():
    motion = Motion(torch.eye(3).expand(2, 24, 3, 3), torch.zeros(2, 3), 30.0)

    def described(*phrasings):
        return [Described(motion, tuple(one), str(n)) for n, one in enumerate(phrasings)]

    learned = described(
        [("walk", "wave")],
        [("sit",)],
        [("nod", "talk", "sit")],
        [("turn", "run"), ("spin", "jog")],
        [("dance",)],
        [("hop", "clap", "hop")],
    )
    tested = described(
        [("wave", "walk")],  # known in the other order
        [("walk", "sit")],
        [("stand", "point")],
        [("stand up", "point")],
        [("nod", "talk")],  # known only with a third
        [("walk",)],
        [("walk", "wave", "nod")],
        [("jog", "spin")],  # in other words
        [("dance", "dance")],
        [("hop", "clap")],  # known only as three
    )
    assert [item.key for item in unseen_pairs(tested, learned)] == ["1", "3", "4", "8", "9"]
    assert unseen_pairs([], learned) == []
