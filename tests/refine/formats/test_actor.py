"""HumanAct12 and UESTC on small files in the layout of ACTOR's packages."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from refine.formats.actor import (
    HUMANACT_ACTIONS,
    UESTC_ACTIONS,
    UESTC_TRAIN_SUBJECTS,
    is_humanact,
    is_uestc,
    read_humanact,
    read_uestc,
    split_of,
    travel,
    uestc_clips,
    video_of,
)
from refine.formats.files import load_motions
from renderers.checks import UserError

HALF_TURN = np.array([np.pi, 0.0, 0.0])  # someone who stands upright before a camera with y down


def humanact(frames=(5, 3), labels=(1, 9), seed=0) -> dict:
    random = np.random.default_rng(seed)
    poses = [random.normal(0, 0.2, (count, 72)) for count in frames]
    for pose in poses:
        pose[:, :3] = HALF_TURN
    joints = [random.normal([0.3, 0.9, 3.0], 0.1, (count, 24, 3)) for count in frames]
    return {"poses": poses, "oldposes": [], "joints3D": joints, "y": list(labels)}


def uestc(folder: Path, names: list[str], frames: int = 4, limit: int = 100, seed: int = 0, **changes) -> dict:
    random = np.random.default_rng(seed)
    shapes = {"pred_cam": (3,), "orig_cam": (4,), "pose": (72,), "betas": (10,), "joints3d": (49, 3), "bboxes": (4,)}
    stored = {
        key: [random.normal(0, 0.3, (frames, *shape)).astype(np.float32) for _ in names]
        for key, shape in shapes.items()
    }
    for camera in stored["orig_cam"]:
        camera[:, :2] = random.uniform(0.5, 0.8, (frames, 1))
    stored |= {"frame_ids": [np.arange(frames) for _ in names], **changes}
    (folder / "info").mkdir(parents=True)
    (folder / "info" / "names.txt").write_text("".join(f"{name}\n" for name in names))
    (folder / "info" / "num_frames_min.txt").write_text(f"{limit}\n" * len(names))
    (folder / "vibe_cache_refined.pkl").write_bytes(pickle.dumps(stored, protocol=2))
    return stored


@pytest.fixture
def humanact_file(tmp_path):
    def write(data) -> Path:
        path = tmp_path / "humanact12poses.pkl"
        path.write_bytes(pickle.dumps(data, protocol=2))
        return path

    return write


def lowest(motion, rest_joints) -> float:
    return float(motion.joints(rest_joints)[..., 1].min())


# --- HumanAct12 ------------------------------------------------------------------------------------------------------


def test_humanact_labels_lengths_and_sources(humanact_file, rest_joints):
    path = humanact_file(humanact())
    motions = read_humanact(path, rest_joints)
    assert is_humanact(path) and not is_uestc(path)
    assert [(motion.label, len(motion), motion.fps) for motion in motions] == [("walk", 5, 20.0), ("phone", 3, 20.0)]
    assert [motion.source for motion in motions] == ["humanact12poses.pkl/0000", "humanact12poses.pkl/0001"]
    assert len(HUMANACT_ACTIONS) == 12


def test_humanact_stands_upright_on_the_floor(humanact_file, rest_joints):
    """Half a turn about x is what an upright body has there: the identity here. y and z change their signs."""
    data = humanact()
    motion = read_humanact(humanact_file(data), rest_joints)[0]
    torch.testing.assert_close(motion.rotations[:, 0], torch.eye(3).expand(5, 3, 3), atol=1e-6, rtol=0)
    head, pelvis = motion.joints(rest_joints)[0, 15], motion.root[0]
    assert head[1] > pelvis[1] + 0.3
    assert lowest(motion, rest_joints) == pytest.approx(float(rest_joints[:, 1].min()), abs=1e-5)
    path = data["joints3D"][0][:, 0] * [1, -1, -1]
    np.testing.assert_allclose((motion.root - motion.root[0]).numpy(), path - path[0], atol=1e-6)
    np.testing.assert_allclose(motion.root[:, ::2].numpy(), path[:, ::2], atol=1e-6)


def test_humanact_rotations_are_those_of_the_axis_angles(humanact_file, rest_joints):
    data = humanact()
    data["poses"][0][:, :3] += 0.3
    motion = read_humanact(humanact_file(data), rest_joints)[0]
    expected = Rotation.from_rotvec(data["poses"][0].reshape(-1, 3)).as_matrix().reshape(5, 24, 3, 3)
    expected[:, 0] = np.diag([1.0, -1.0, -1.0]) @ expected[:, 0]
    np.testing.assert_allclose(motion.rotations.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"y": [1]}, "is damaged (2 poses, 2 joints3D, 1 y)"),
        ({"y": [1, 12]}, "clip 1: has class 12, not 0 to 11"),
        ({"y": 3}, "is another file than ACTOR's (no list 'y')"),
        ({"poses": [np.zeros((5, 72)), np.zeros((3, 71))]}, "expected shape [T 72]"),
        ({"poses": [np.zeros((5, 72)), "walk"]}, "clip 1: 'poses' is no array of numbers"),
        ({"joints3D": [np.zeros((4, 24, 3)), np.zeros((3, 24, 3))]}, "expected shape [T 24 3] with T=5"),
        ({"poses": [np.full((5, 72), np.nan), np.zeros((3, 72))]}, "value nan at frame 0"),
    ],
)
def test_another_humanact_file_is_refused_in_one_line(humanact_file, rest_joints, change, said):
    with pytest.raises(UserError) as caught:
        read_humanact(humanact_file({**humanact(), **change}), rest_joints)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_what_it_holds_makes_it_humanact(tmp_path, humanact_file, rest_joints):
    """Under any name, through the one table of readers."""
    path = humanact_file(humanact()).rename(tmp_path / "clips.bin")
    assert [motion.label for motion in load_motions(path, rest_joints)] == ["walk", "phone"]


def test_a_list_is_no_humanact_file(humanact_file, rest_joints):
    with pytest.raises(UserError, match="is another file than ACTOR's"):
        read_humanact(humanact_file([1, 2]), rest_joints)


def test_code_in_the_pickle_does_not_run(tmp_path, rest_joints):
    place = tmp_path / "harmed"
    path = tmp_path / "humanact12poses.pkl"
    path.write_bytes(f"cos\nsystem\n(S'touch {place}'\ntR.".encode())
    with pytest.raises(UserError, match="which is not on the list of harmless names"):
        read_humanact(path, rest_joints)
    assert not place.exists()


# --- UESTC -----------------------------------------------------------------------------------------------------------

NAMES = ["a12_d1_p003_c1_color.avi", "a12_d2_p003_c2_color.avi", "a12_d8_p001_c1_color.avi", "a12_d8_p001_c2_color.avi",
         "a1_d3_p113_c2_color.avi"]  # fmt: skip


def test_names_of_videos_are_read():
    assert video_of("a12_d7_p003_c2_color.avi") == ("punching", 7, 3, 2)
    for name in ("a12_d1_p003_c1_color.mp4", "a40_d1_p003_c1_color.avi", "x/a1_d1_p003_c1_color.avi"):
        with pytest.raises(UserError, match="is not the name of a UESTC video"):
            video_of(name)


def test_the_official_lists_have_their_sizes():
    assert len(UESTC_ACTIONS) == len(set(UESTC_ACTIONS)) == 40
    assert len(UESTC_TRAIN_SUBJECTS) == 51 and min(UESTC_TRAIN_SUBJECTS) == 1 and max(UESTC_TRAIN_SUBJECTS) == 113
    numbers = {1: "marking-time-and-knee-lifting", 0: "punching-and-knee-lifting", 5: "left-lunging", 8: "left-kicking",
               4: "forward-lunging", 11: "pulling-chest-expanders", 12: "punching", 16: "elbow-circling",
               22: "shoulder-abduction", 28: "standing-rotation"}  # fmt: skip
    assert {number: UESTC_ACTIONS[number] for number in numbers} == numbers


def test_the_round_view_of_the_second_camera_is_left_out(tmp_path, rest_joints):
    uestc(tmp_path, NAMES)
    assert is_uestc(tmp_path) and not is_humanact(tmp_path)
    assert [clip.source for clip in read_uestc(tmp_path, rest_joints)] == [*NAMES[:3], NAMES[4]]
    front = read_uestc(tmp_path, rest_joints, front_only=True)
    assert [clip.source for clip in front] == [NAMES[0], NAMES[2]]
    chosen = read_uestc(tmp_path, rest_joints, labels=["marking-time-and-knee-lifting"])
    assert [(clip.source, clip.label, clip.fps) for clip in chosen] == [
        (NAMES[4], "marking-time-and-knee-lifting", 30.0)
    ]


def test_subjects_tell_the_split(tmp_path, rest_joints):
    """Of the names above subjects 1 and 113 train and subject 3 tests."""
    assert [split_of(name) for name in NAMES] == ["test", "test", "train", "train", "train"]
    assert split_of(video_of(NAMES[0])) == "test"
    uestc(tmp_path, NAMES)
    sides = {
        side: [clip.source for clip in read_uestc(tmp_path, rest_joints, split=side)] for side in ("train", "test")
    }
    assert sides == {"train": [NAMES[2], NAMES[4]], "test": NAMES[:2]}
    both = read_uestc(tmp_path, rest_joints, labels=["punching"], split="train")
    assert [clip.source for clip in both] == [NAMES[2]]
    with pytest.raises(UserError, match="unknown name 'val'; did you mean train, test"):
        read_uestc(tmp_path, rest_joints, split="val")


def test_clips_come_one_at_a_time(tmp_path, rest_joints):
    """A clip that is broken stops the reading where it stands, and those before it are there."""
    stored = uestc(tmp_path, NAMES[:3])
    stored["pose"][2][0, 0] = np.nan
    (tmp_path / "vibe_cache_refined.pkl").write_bytes(pickle.dumps(stored, protocol=2))
    clips = uestc_clips(tmp_path, rest_joints)
    assert [next(clips).source, next(clips).source] == NAMES[:2]
    with pytest.raises(UserError, match="value nan"):
        next(clips)


def test_lengths_are_those_of_the_shorter_count(tmp_path, rest_joints):
    uestc(tmp_path, NAMES[:1], frames=6, limit=4)
    assert len(read_uestc(tmp_path, rest_joints)[0]) == 4


@pytest.mark.parametrize(("name", "view"), [(NAMES[0], 0), (NAMES[1], 2), (NAMES[4], 3)])
def test_the_second_camera_is_turned_to_the_front(tmp_path, rest_joints, name, view):
    """As ACTOR's loader does it, in its own frame, and then from y down to y up."""
    stored = uestc(tmp_path, [name])
    motion = read_uestc(tmp_path, rest_joints)[0]
    turn = Rotation.from_rotvec([0, -view * np.pi / 4, 0])
    root = turn * Rotation.from_rotvec(stored["pose"][0][:, :3])
    upright = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(motion.rotations[:, 0].numpy(), upright @ root.as_matrix(), atol=1e-6)
    path = (stored["joints3d"][0][:, 8] + path_of(stored, 0)) @ turn.as_matrix().T @ upright
    np.testing.assert_allclose(motion.root[:, ::2].numpy(), path[:, ::2], atol=1e-4, rtol=1e-5)
    np.testing.assert_allclose(motion.root.diff(dim=0).numpy(), np.diff(path, axis=0), atol=1e-4, rtol=1e-5)
    assert lowest(motion, rest_joints) == pytest.approx(float(rest_joints[:, 1].min()), abs=1e-4)


def path_of(stored: dict, clip: int) -> np.ndarray:
    """Frame by frame, in plain loops."""
    path = []
    for (scale, _, x, y), joints in zip(stored["orig_cam"][clip].astype(float), stored["joints3d"][clip], strict=True):
        flat = joints[:, :2].astype(float)
        drawn = (scale * (flat + np.array([x, y])) + 1) * 0.5 * 540
        sizes = [np.linalg.norm(points.max(0) - points.min(0)) for points in (flat, drawn)]
        path.append([x, y, 500 * sizes[0] / sizes[1]])
    return np.array(path) - path[0]


def test_someone_twice_as_far_is_half_as_large():
    """Scale s in a picture of 540 pixels and focal length 500: depth 500 / (270 s)."""
    cameras = np.array([[0.5, 0.5, 0.0, 0.0], [0.25, 0.25, 0.1, -0.2]])
    joints = np.zeros((2, 49, 3))
    joints[:, 1] = [0.4, 1.7, 0.2]
    np.testing.assert_allclose(travel(cameras, joints), [[0, 0, 0], [0.1, -0.2, 500 / 270 / 0.25 - 500 / 270 / 0.5]])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pose": [np.zeros((4, 72), np.float32)]}, "is damaged (1 pose, 2 orig_cam, 2 joints3d)"),
        ({"orig_cam": None}, "no list 'orig_cam'"),
        ({"joints3d": [np.zeros((4, 24, 3)), np.zeros((4, 49, 3))]}, "expected shape [T 49 3]"),
        ({"joints3d": [np.zeros((4, 49, 3)), np.ones((4, 49, 3))]}, "value nan at frame 0"),
    ],
)
def test_another_uestc_file_is_refused_in_one_line(tmp_path, rest_joints, changes, said):
    uestc(tmp_path, NAMES[:2], **changes)
    with pytest.raises(UserError) as caught:
        read_uestc(tmp_path, rest_joints)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_missing_and_broken_lists_are_named(tmp_path, rest_joints):
    uestc(tmp_path, NAMES[:2])
    lengths = tmp_path / "info" / "num_frames_min.txt"
    lengths.write_text("100\nmany\n")
    with pytest.raises(UserError, match=r"num_frames_min.txt, line 2: is no number: 'many'"):
        read_uestc(tmp_path, rest_joints)
    lengths.write_text(f"100\n{'9' * 5000}\n")
    with pytest.raises(UserError, match=r"num_frames_min.txt, line 2: is no number: '999"):
        read_uestc(tmp_path, rest_joints)
    lengths.write_text("100\n")
    with pytest.raises(UserError, match="holds 2 clips for 2 names and 1 lengths"):
        read_uestc(tmp_path, rest_joints)
    lengths.unlink()
    with pytest.raises(UserError, match=r"num_frames_min.txt: is missing"):
        read_uestc(tmp_path, rest_joints)
    with pytest.raises(UserError, match=r"unknown name 'punchng'; did you mean punching"):
        read_uestc(tmp_path, rest_joints, labels=["punchng"])
