"""Any file in, any file out: by content, with labels, without harming what is there."""

import re

import pytest
import torch

from refine.formats.files import check_suffix, label_from_name, load_motion, save_motion
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix


@pytest.fixture
def motion(generator) -> Motion:
    rotations = axis_angle_to_matrix(torch.randn(6, 24, 3, generator=generator))
    return Motion(rotations, torch.randn(6, 3, generator=generator), 30.0, "walk")


@pytest.mark.parametrize("suffix", [".bvh", ".npz", ".BVH"])
def test_there_and_back(tmp_path, motion, suffix, rest_joints, free_body):
    path = tmp_path / "new" / "folder" / f"walk_01{suffix}"
    save_motion(motion, path, free_body)
    back = load_motion(path, rest_joints)
    assert (back.fps, back.label, back.source) == (30.0, "walk", str(path))
    torch.testing.assert_close(back.rotations, motion.rotations, atol=1e-5, rtol=0)
    torch.testing.assert_close(back.joints(rest_joints), motion.joints(rest_joints), atol=1e-5, rtol=0)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_what_a_file_holds_decides(tmp_path, motion, rest_joints, free_body):
    save_motion(motion, tmp_path / "a.bvh", free_body)
    save_motion(motion, tmp_path / "b.npz", free_body)
    (tmp_path / "a.bvh").rename(tmp_path / "a.npz")
    (tmp_path / "b.npz").rename(tmp_path / "b.txt")
    for name in ("a.npz", "b.txt"):
        torch.testing.assert_close(load_motion(tmp_path / name, rest_joints).root, motion.root, atol=1e-5, rtol=0)


def test_one_frame_is_read(tmp_path, motion, rest_joints, free_body):
    one = Motion(motion.rotations[:1], motion.root[:1], 30.0)
    for name in ("a.bvh", "a.npz"):
        save_motion(one, tmp_path / name, free_body)
        assert len(load_motion(tmp_path / name, rest_joints)) == 1


def test_an_existing_file_is_kept_without_force(tmp_path, motion, free_body):
    path = tmp_path / "a.bvh"
    path.write_text("precious")
    with pytest.raises(UserError, match=r"a.bvh: is already there; .*--force"):
        save_motion(motion, path, free_body)
    assert path.read_text() == "precious"
    save_motion(motion, path, free_body, force=True)
    assert path.read_text().startswith("HIERARCHY")


def test_a_write_that_fails_leaves_the_old_file(tmp_path, motion, monkeypatch, free_body):
    path = tmp_path / "a.npz"
    path.write_text("precious")

    def full_disk(stream, **arrays):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numpy.savez_compressed", full_disk)
    with pytest.raises(UserError, match=r"a.npz: cannot be written \(No space left on device\)"):
        save_motion(motion, path, free_body, force=True)
    assert path.read_text() == "precious" and len(list(tmp_path.iterdir())) == 1


def test_an_unknown_suffix_lists_the_known_ones(tmp_path, motion, free_body):
    message = re.escape("a.fbm: no motion format has the suffix '.fbm'; known are .bvh and .npz")
    with pytest.raises(UserError, match=message):
        save_motion(motion, tmp_path / "a.fbm", free_body)
    with pytest.raises(UserError, match=message):
        check_suffix("a.fbm")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bvh", b"", "a.bvh: is empty"),
        ("a.npz", b" \n", "a.npz: is empty"),
        ("a.bvh", b"\x89PNG\r\n", "is not a motion file"),
        ("a.npz", b"\x89PNG\r\n", "is not a motion file; known are .bvh"),
        ("a.txt", b"hello", "is not a motion file"),
        ("a.npz", b"PK\x03\x04 and no more", r"is damaged \(it is cut short\)"),
    ],
)
def test_other_files_are_one_line(tmp_path, name, content, message, rest_joints):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message) as caught:
        load_motion(tmp_path / name, rest_joints)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders(tmp_path, rest_joints):
    with pytest.raises(UserError, match=r"none.bvh: cannot be read \(No such file"):
        load_motion(tmp_path / "none.bvh", rest_joints)
    with pytest.raises(UserError, match="is a folder, not a file; give a regular file"):
        load_motion(tmp_path, rest_joints)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("dataset-2_walk_active_001.bvh", "walk"),
        ("folder/dataset-1_walk-turn-left_not-confident_012.bvh", "walk-turn-left"),
        ("wave both_02.bvh", "wave both"),
        ("jump12.npz", "jump"),
        ("step-2-left.bvh", "step-2-left"),
        ("001.bvh", "001"),
    ],
)
def test_labels_come_from_names(name, label):
    assert label_from_name(name) == label


def test_a_pattern_goes_before_the_known_ones():
    pattern = re.compile(r"dataset-\d+_\w+_(?P<label>\w+)_\d+")
    assert label_from_name("dataset-2_walk_active_001.bvh", pattern) == "active"
    assert label_from_name("other_3.bvh", pattern) == "other"


def test_real_clips_are_labelled(real_clips, rest_joints):
    path = next(path for path in real_clips if path.name.startswith("dataset-2_wave-both-hands"))
    motion = load_motion(path, rest_joints)
    assert (motion.label, motion.fps, motion.source) == ("wave-both-hands", 30.0, str(path))
