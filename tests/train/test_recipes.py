"""What the named benchmarks are made of, and what they refuse."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.formats.actor import HUMANACT_ACTIONS, UESTC_ACTIONS, UESTC_TRAIN_SUBJECTS, video_of
from refine.formats.clips import save_clips
from refine.formats.files import save_motion
from refine.motion import Motion
from refine.synthetic import ACTIONS
from renderers.checks import UserError
from train.building import Material
from train.recipes import (
    BN1_LOWER,
    BN1_UPPER,
    BN2_LOWER,
    BN2_UPPER,
    HUMANACT_PAIRS,
    UESTC_LOWER,
    UESTC_UPPER,
    bn1_c,
    bn_c,
    custom,
    humanact_c,
    longest,
    material_of,
    read_source,
    spread,
    style_of,
    synth_c,
    uestc_c,
)


def clip(label: str, source: str, frames: int = 2, fps: float = 30.0) -> Motion:
    return Motion(torch.eye(3).repeat(frames, 24, 1, 1), torch.zeros(frames, 3), fps, label, source)


def bandai_namco(dataset: int, labels: tuple[str, ...], styles: tuple[str, ...], clips: int) -> list[Motion]:
    return [
        clip(label, f"data/dataset-{dataset}_{label}_{style}_{number:03d}.bvh")
        for label in labels
        for style in styles
        for number in range(clips)
    ]


def sources(clips: list[Motion], label: str | None = None) -> list[str]:
    return [motion.source for motion in clips if label in (None, motion.label)]


def disjoint(material: Material) -> bool:
    taken = sources(material.train) + sources(material.test) + sources(material.extra)
    return len(taken) == len(set(taken))


STYLES = ("active", "elderly", "exhausted", "feminine", "masculine", "normal", "youthful")


# --- the sets --------------------------------------------------------------------------------------------------------


def test_synth_c_is_uestc_cs_ten_actions_five_and_five_and_twenty(rest_joints):
    material = synth_c(rest_joints, seconds=0.1)
    assert set(UESTC_LOWER + UESTC_UPPER) <= set(ACTIONS) and set(UESTC_LOWER + UESTC_UPPER) <= set(UESTC_ACTIONS)
    assert [len(clips) for clips in (material.train, material.test, material.extra)] == [50, 50, 200]
    assert len(material.pairs) == len(set(material.pairs)) == 25
    every = [motion for clips in (material.train, material.test, material.extra) for motion in clips]
    assert len({motion.rotations.numpy().tobytes() for motion in every}) == 300
    both = material.together(material.test[0], material.test[-1])
    assert both.label == "marking-time-and-knee-lifting+standing-rotation" and len(both) == 3


def test_bn_c_holds_out_five_clips_of_five_styles():
    motions = bandai_namco(2, (*BN2_LOWER, *BN2_UPPER, "greet"), STYLES, 6) + bandai_namco(1, ("walk",), STYLES, 1)
    material = bn_c(motions, "here")
    assert len(material.pairs) == 24 and len(material.test) == 50 and len(material.train) == 10 * (42 - 5)
    assert disjoint(material) and not material.extra and not material.together
    for label in (*BN2_LOWER, *BN2_UPPER):
        held_out = [motion for motion in material.test if motion.label == label]
        assert len({style_of(motion) for motion in held_out}) == 5
    assert all("dataset-2" in source for source in sources(material.train))
    assert sources(bn_c(motions, "here", seed=1).test) != sources(material.test)
    assert sources(bn_c(motions, "here").test) == sources(material.test)


def test_bn1_c_splits_by_style():
    styles = tuple(f"style{number}" for number in range(15))
    motions = bandai_namco(1, BN1_LOWER + BN1_UPPER, styles, 2)
    material = bn1_c(motions, "here")
    held_out = {style_of(motion) for motion in material.test}
    assert len(held_out) == 5 and not held_out & {style_of(motion) for motion in material.train}
    assert len(material.pairs) == 24 and len(material.test) == 50 and len(material.train) == 10 * 10 * 2
    assert all(source.endswith("_000.bvh") for source in sources(material.test))
    assert all(style in material.rule for style in held_out)


def test_bn1_c_needs_the_test_styles_of_every_action():
    styles = tuple(f"style{number}" for number in range(6))
    motions = bandai_namco(1, BN1_LOWER + BN1_UPPER, styles, 1)
    held_out = style_of(bn1_c(motions, "here").test[0])
    lacking = [motion for motion in motions if (motion.label, style_of(motion)) != ("bow", held_out)]
    with pytest.raises(UserError, match=rf"here: has 0 clips of bow \({held_out}\), 1 are needed"):
        bn1_c(lacking, "here")
    with pytest.raises(UserError, match=r"has 5 styles, at least 6 are needed"):
        bn1_c(bandai_namco(1, BN1_LOWER + BN1_UPPER, styles[:5], 1), "here")


def test_humanact_c_halves_each_class_and_takes_the_longest():
    motions = [
        clip(label, f"humanact12poses.pkl/{60 * index + number:04d}", 10 + number % 12, fps=20.0)
        for index, label in enumerate(HUMANACT_ACTIONS)
        for number in range(24)
    ]
    material = humanact_c(motions, "here")
    assert material.pairs == HUMANACT_PAIRS and len(set(HUMANACT_PAIRS)) == 9 and material.fps == 20.0
    numbers = [(HUMANACT_ACTIONS.index(i), HUMANACT_ACTIONS.index(j)) for i, j in material.pairs]
    assert sorted(numbers) == [(1, 4), (1, 5), (1, 9), (1, 11), (2, 9), (2, 11), (6, 4), (6, 7), (6, 9)]
    assert len(material.train) == 120 and len(material.test) == 80 and len(material.extra) == 24
    assert disjoint(material)
    for label in ("walk", "throw"):
        lengths = {split: [len(motion) for motion in getattr(material, split) if motion.label == label]
                   for split in ("train", "test", "extra")}  # fmt: skip
        assert lengths == {"train": list(range(12, 22)), "test": list(range(12, 22)), "extra": [10, 11]}
        last, first = max(sources(material.train, label)), min(sources(material.test, label))
        assert last < first


def test_uestc_c_splits_by_the_official_subjects():
    subjects = [*sorted(UESTC_TRAIN_SUBJECTS)[:8], 3, 4, 5, 7, 8, 9, 10]
    motions = [
        clip(label, f"a{UESTC_ACTIONS.index(label)}_d{view}_p{subject:03d}_c1_color.avi", 44 if view == 1 else 60)
        for label in UESTC_LOWER + UESTC_UPPER
        for view in (1, 2, 3)
        for subject in subjects
    ]
    material = uestc_c(motions, "here")
    subject_of = {motion.source: video_of(motion.source).subject for motion in motions}
    assert len(material.train) == len(material.test) == 50 and len(material.extra) == 10 * (16 - 5)
    assert disjoint(material) and len(material.pairs) == 25
    for learned in (*material.train, *material.extra):
        assert subject_of[learned.source] in UESTC_TRAIN_SUBJECTS and len(learned) >= 45
    assert {subject_of[source] for source in sources(material.test)} <= {3, 4, 5, 7, 8, 9, 10}
    for split in (material.train, material.test):
        assert len({subject_of[source] for source in sources(split, "punching")}) == 5
    assert any(len(motion) < 45 for motion in material.test)


def test_custom_takes_any_labels_and_pairs_none_with_itself():
    motions = [clip(label, f"{label}_{number}", 30, 15.0) for label in "abc" for number in range(4)]
    material = custom(motions, "here", ("a", "b"), ("b", "c"), 3)
    assert material.pairs == (("a", "b"), ("a", "c"), ("b", "c"))
    assert len(material.test) == 9 and len(material.train) == 3 and disjoint(material)
    assert {(motion.fps, len(motion)) for motion in material.test} == {(30.0, 59)}


# --- choosing --------------------------------------------------------------------------------------------------------


def test_spread_takes_one_of_each_group_before_a_second(generator):
    clips = [clip("walk", f"{group}{number}") for group in "abc" for number in range(5)]
    for count, most in ((2, 1), (3, 1), (4, 2), (7, 3), (15, 5), (99, 5)):
        chosen = spread(clips, lambda motion: motion.source[0], count, generator)
        sizes = [sum(motion.source[0] == group for motion in chosen) for group in "abc"]
        assert len(set(sources(chosen))) == min(count, 15) and max(sizes) == most
        assert max(sizes) - min(sizes) <= 1
    drawn = {spread(clips, lambda motion: "", 1, generator)[0].source for _ in range(200)}
    assert len(drawn) == 15


def test_the_longest_of_equals_is_the_first():
    clips = [clip("walk", "a", 5), clip("walk", "b", 9), clip("walk", "c", 5), clip("walk", "d", 7)]
    assert sources(longest(clips, 3)) == ["a", "b", "d"]


# --- sources ---------------------------------------------------------------------------------------------------------


def test_a_package_a_packed_file_and_a_folder_are_sources(tmp_path, rest_joints):
    packed = tmp_path / "clips.npz"
    save_clips(packed, [clip("walk", "w", 3)])
    assert sources(read_source(packed, rest_joints).motions) == ["w"]
    data = {"poses": [np.zeros((3, 72))], "joints3D": [np.zeros((3, 24, 3))], "y": [1], "oldposes": []}
    package = tmp_path / "humanact12poses.pkl"
    package.write_bytes(pickle.dumps(data, protocol=2))
    assert [motion.label for motion in read_source(package, rest_joints).motions] == ["walk"]
    with pytest.raises(UserError, match=r"humanact12poses.pkl: unknown name 'run'"):
        material_of("humanact-c", rest_joints, tmp_path)


@pytest.mark.parametrize(("recipe", "trained", "styles"), [(bn_c, 370, 7), (bn1_c, 110, 5)], ids=["bn-c", "bn1-c"])
def test_the_names_of_bandai_namcos_files_make_the_sets(recipe, trained, styles, real_clips):
    material = recipe([clip(path.stem.split("_")[1], path.name) for path in real_clips], "here")
    assert (len(material.train), len(material.test), len(material.pairs)) == (trained, 50, 24)
    assert len({style_of(motion) for motion in material.test}) == styles and disjoint(material)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name": "synth"}, "unknown name 'synth'; did you mean synth-c"),
        ({"name": "synth-c", "source": "clips.npz"}, "synth-c: is made of built-in actions; leave out --source"),
        ({"name": "synth-c", "lower": ("walk",)}, "synth-c: has labels of its own"),
        ({"name": "bn-c"}, "bn-c: is made of clips that do not ship with Refine; say where they are with --source"),
        ({"name": "bn-c", "source": "nowhere"}, "nowhere: does not exist"),
        ({"name": "bn-c", "source": "clips.npz"}, "clips.npz: has no clips of Bandai-Namco's data set 2"),
        ({"name": "humanact-c", "source": "clips.npz"}, "clips.npz: is not ACTOR's package"),
        ({"name": "uestc-c", "source": "."}, "is not ACTOR's package (a folder with info/names.txt)"),
        ({"name": "custom", "source": "clips.npz"}, "custom: needs labels to pair; name them with --lower and --upper"),
        ({"name": "custom", "lower": ("walk",), "upper": ("walk",)}, "custom: needs labels to pair"),
        ({"name": "custom", "lower": ("walk", "walk"), "upper": ("wave",)}, "--lower: names walk twice"),
        ({"name": "custom", "lower": ("walk",), "upper": ("other",)}, "--upper: the label 'other' cannot be told"),
        ({"name": "custom", "lower": ("a+b",), "upper": ("wave",)}, "--lower: the label 'a+b' cannot be told"),
        (
            {"name": "custom", "lower": ("wlk",), "upper": ("wave",), "source": "clips.npz"},
            "clips.npz: unknown name 'wlk'; did you mean walk?",
        ),
        (
            {"name": "custom", "lower": ("walk",), "upper": ("wave",), "source": "clips.npz"},
            "clips.npz: has 3 clips of walk, 6 are needed; give more clips of it",
        ),
        (
            {"name": "custom", "lower": ("walk",), "upper": ("wave",), "source": "clips.npz", "per_action": 0},
            "--per-action: expected 1 to 1000, got 0",
        ),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, monkeypatch, rest_joints, arguments, said):
    monkeypatch.chdir(tmp_path)
    save_clips("clips.npz", [clip(label, f"{label}{number}") for label in ("walk", "wave") for number in range(3)])
    if "source" in arguments:
        arguments = {**arguments, "source": Path(arguments["source"])}
    with pytest.raises(UserError) as caught:
        material_of(rest_joints=rest_joints, **arguments)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_told(tmp_path, rest_joints, free_body):
    (tmp_path / "broken_1.bvh").write_text("HIERARCHY\nROOT")
    save_motion(clip("walk", "w", 3), tmp_path / "fine_1.bvh", free_body)
    told = []
    with pytest.raises(UserError, match="has no clips of Bandai-Namco's data set 2"):
        material_of("bn-c", rest_joints, tmp_path, refused=told.append)
    assert len(told) == 1 and "broken_1.bvh" in str(told[0])
