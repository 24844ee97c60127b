"""Packed clips and the import of folders."""

import shutil

import numpy as np
import pytest
import torch

from refine.formats.bvh import write_bvh
from refine.formats.clips import load_clips, save_clips
from refine.formats.files import save_motion
from refine.formats.importing import import_folder
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix


@pytest.fixture
def clips(generator) -> list[Motion]:
    return [
        Motion(
            axis_angle_to_matrix(torch.randn(frames, 24, 3, generator=generator)),
            torch.randn(frames, 3, generator=generator),
            fps,
            label,
            f"{label}_{frames}.bvh",
        )
        for frames, fps, label in ((3, 30.0, "walk"), (1, 29.97, "wave-both-hands"), (8, 120.0, ""))
    ]


@pytest.fixture
def folder(tmp_path, clips, free_body):
    """Two good clips, one of them in a folder of its own, a broken one, and a file that is no motion."""
    folder = tmp_path / "in"
    save_motion(clips[0], folder / "deep" / "dataset-2_walk_active_001.bvh", free_body)
    save_motion(clips[2], folder / "kick_07.npz", free_body)
    (folder / "broken_01.bvh").write_text("HIERARCHY\nROOT a\n{\n")
    (folder / "notes.txt").write_text("hello")
    return folder


def test_round_trip(tmp_path, clips):
    save_clips(tmp_path / "new" / "clips.npz", clips)
    back = load_clips(tmp_path / "new" / "clips.npz")
    assert [(clip.fps, clip.label, clip.source) for clip in back] == [
        (clip.fps, clip.label, clip.source) for clip in clips
    ]
    for ours, theirs in zip(clips, back, strict=True):
        torch.testing.assert_close(theirs.rotations, ours.rotations, atol=1e-6, rtol=0)
        assert torch.equal(theirs.root, ours.root)
        assert torch.equal(theirs.six, ours.six)
        identity = torch.eye(3).expand_as(theirs.rotations)
        torch.testing.assert_close(theirs.rotations @ theirs.rotations.mT, identity, atol=1e-5, rtol=0)


def test_rows_of_any_length_are_made_rotations(tmp_path, clips):
    save_clips(tmp_path / "clips.npz", clips)
    with np.load(tmp_path / "clips.npz") as arrays:
        np.savez(tmp_path / "scaled.npz", **{**arrays, "six": 3 * arrays["six"]})
    for ours, theirs in zip(clips, load_clips(tmp_path / "scaled.npz"), strict=True):
        torch.testing.assert_close(theirs.rotations, ours.rotations, atol=1e-6, rtol=0)


def test_the_file_needs_no_pickle(tmp_path, clips):
    save_clips(tmp_path / "clips.npz", clips)
    with np.load(tmp_path / "clips.npz", allow_pickle=False) as arrays:
        assert arrays["six"].shape == (12, 24, 6) and arrays["six"].dtype == np.float32
        assert arrays["lengths"].tolist() == [3, 1, 8]
        assert arrays["labels"].tolist() == ["walk", "wave-both-hands", ""]


def test_no_clips_are_refused(tmp_path):
    with pytest.raises(UserError, match="there are no clips to write"):
        save_clips(tmp_path / "clips.npz", [])


def test_more_than_can_be_read_back_is_not_written(tmp_path, clips, monkeypatch):
    monkeypatch.setattr("refine.formats.clips.MAX_BYTES", 12 * 588 - 1)
    with pytest.raises(UserError, match=r"clips.npz: would take 7,056 bytes, more than the 7,055 that are read"):
        save_clips(tmp_path / "clips.npz", clips)
    assert not list(tmp_path.iterdir())


def test_another_npz_is_refused(tmp_path, clips, free_body):
    save_motion(clips[0], tmp_path / "one.npz", free_body)
    with pytest.raises(UserError, match=r"one.npz: is not a file of clips .*'refine data import'"):
        load_clips(tmp_path / "one.npz")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("lengths", np.array([3, 1, 9])),
        ("lengths", np.array([13, -9, 8])),
        ("lengths", np.array([3.0, 1.0, 8.0])),
        ("labels", np.array(["walk"])),
        ("labels", np.array([1, 2, 3])),
        ("root", np.zeros((11, 3), np.float32)),
        ("six", np.zeros((12, 22, 6), np.float32)),
    ],
)
def test_damage_is_one_line(tmp_path, clips, key, value):
    save_clips(tmp_path / "clips.npz", clips)
    with np.load(tmp_path / "clips.npz") as arrays:
        np.savez(tmp_path / "bad.npz", **{**arrays, key: value})
    with pytest.raises(UserError, match=r"bad.npz: is damaged .*import the clips again") as caught:
        load_clips(tmp_path / "bad.npz")
    assert "\n" not in str(caught.value)


def test_import_reads_labels_and_skips_the_broken(folder, clips, rest_joints):
    seen = []
    imported = import_folder(
        folder, rest_joints, progress=lambda paths: (seen.append(path.name) or path for path in paths)
    )
    assert [(clip.label, clip.source) for clip in imported.motions] == [
        ("walk", "deep/dataset-2_walk_active_001.bvh"),
        ("kick", "kick_07.npz"),
    ]
    torch.testing.assert_close(imported.motions[1].root, clips[2].root, atol=1e-6, rtol=0)
    assert len(seen) == 3
    assert [error.where for error in imported.refused] == [f"{folder / 'broken_01.bvh'}, line 3"]


def test_import_takes_a_pattern(folder, rest_joints):
    imported = import_folder(folder, rest_joints, label_pattern=r"(?P<label>[a-z]).*")
    assert [clip.label for clip in imported.motions] == ["d", "k"]


@pytest.mark.parametrize(
    ("pattern", "message"),
    [("(", "is not a regular expression"), (r"(\w+)_\d+", "has no group called label; write")],
)
def test_a_bad_pattern_is_refused(folder, rest_joints, pattern, message):
    with pytest.raises(UserError, match=message):
        import_folder(folder, rest_joints, label_pattern=pattern)


def test_folders_without_motion_are_refused(tmp_path, rest_joints):
    with pytest.raises(UserError, match="has no files that end in .bvh or .npz"):
        import_folder(tmp_path, rest_joints)
    (tmp_path / "a.bvh").write_text("")
    with pytest.raises(UserError, match=r"none of its 1 motion files can be read; the first: .*a.bvh: is empty"):
        import_folder(tmp_path, rest_joints)


def test_import_of_real_clips(real_clips, tmp_path, rest_joints):
    for path in real_clips[::100]:
        shutil.copy(path, tmp_path)
    imported = import_folder(tmp_path, rest_joints)
    assert len(imported.motions) == 6 and not imported.refused
    assert all(clip.label == clip.source.split("_")[1] for clip in imported.motions)


def test_files_for_the_packed_form_come_from_any_unit(tmp_path, clips, rest_joints):
    """A body of half the size writes half the path, and reads back on the full-size body as the full path."""
    half = Motion(clips[0].rotations, clips[0].root / 2, 30.0)
    write_bvh(tmp_path / "walk.bvh", half, rest_joints / 2)
    back = import_folder(tmp_path, rest_joints).motions[0]
    torch.testing.assert_close(back.joints(rest_joints), clips[0].joints(rest_joints), atol=1e-4, rtol=0)
