"""The Motion value and the plain operations on it (protocol A.4, B.4 no. 24, G.7, G.8, G.15)."""

import math
from dataclasses import replace

import pytest
import torch

from refine.motion import Motion, canonicalise, crop, cut, from_features, in_place, mirror, resample, to_features
from renderers.checks import ShapeError, UserError
from renderers.rotations import axis_angle_to_matrix, heading, rotation_about
from renderers.skeleton import JOINTS, MIRRORED


@pytest.fixture
def motion(generator) -> Motion:
    """Twenty smooth random frames in float64."""
    frames = torch.linspace(0, 1, 20, dtype=torch.float64)[:, None, None]
    pose, change = 0.8 * torch.randn(2, 24, 3, generator=generator, dtype=torch.float64)
    root = torch.randn(3, generator=generator, dtype=torch.float64) + frames[:, :, 0] * torch.tensor([0.3, 0.1, 1.0])
    return Motion(axis_angle_to_matrix(pose + frames * change), root, 30.0, "walk", "clip.bvh")


def turned(motion: Motion, yaw: float) -> Motion:
    turn = rotation_about("y", torch.tensor(yaw, dtype=torch.float64))
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    return Motion(rotations, motion.root @ turn.mT + torch.tensor([3.0, 0.0, -2.0]), motion.fps)


def test_length_and_seconds(motion):
    assert len(motion) == 20
    assert motion.seconds == pytest.approx(20 / 30)


def test_shapes_must_agree():
    with pytest.raises(ShapeError, match=r"Motion\(root\): expected shape \[T 3\] with T=4, got \[5, 3\]"):
        Motion(torch.eye(3).repeat(4, 24, 1, 1), torch.zeros(5, 3), 30.0)


def test_a_motion_has_frames():
    with pytest.raises(UserError, match=r"^walk.bvh: has no frames; give a clip"):
        Motion(torch.zeros(0, 24, 3, 3), torch.zeros(0, 3), 30.0, source="walk.bvh")


@pytest.mark.parametrize("fps", [0.0, -30.0, math.nan, math.inf])
def test_a_frame_rate_is_positive(fps):
    with pytest.raises(UserError, match="is not a number of frames per second"):
        Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), fps)


def test_a_value_that_is_not_finite_is_named():
    rotations = torch.eye(3).repeat(4, 24, 1, 1)
    rotations[2, JOINTS["left_knee"], 0, 1] = math.nan
    with pytest.raises(UserError, match=r"a.npz: value nan at frame 2, joint left_knee, row 0, column 1"):
        Motion(rotations, torch.zeros(4, 3), 30.0, source="a.npz")


def test_crop_takes_the_frames_asked_for(motion):
    part = crop(motion, 3, 7)
    assert torch.equal(part.root, motion.root[3:7]) and torch.equal(part.rotations, motion.rotations[3:7])
    assert (part.fps, part.label) == (30.0, "walk")
    with pytest.raises(UserError, match="has 20 frames, 5 to 21 asked for"):
        crop(motion, 5, 21)


def test_resample_keeps_the_time_line(motion):
    """At twice the rate every second frame is an old one, and the frame between is the middle of its neighbours."""
    fine = resample(motion, 60.0)
    assert (len(fine), fine.fps) == (39, 60.0)
    torch.testing.assert_close(fine.rotations[::2], motion.rotations, atol=1e-9, rtol=0)
    torch.testing.assert_close(fine.root[1], (motion.root[0] + motion.root[1]) / 2)
    step, half = motion.rotations[0].mT @ motion.rotations[1], motion.rotations[0].mT @ fine.rotations[1]
    torch.testing.assert_close(half @ half, step, atol=1e-9, rtol=0)


def test_resample_to_the_same_rate_changes_nothing(motion):
    same = resample(motion, 30.0)
    assert torch.equal(same.root, motion.root) and torch.equal(same.rotations, motion.rotations)


def test_resample_down_and_back(motion):
    coarse = resample(motion, 10.0)
    assert len(coarse) == 7
    torch.testing.assert_close(coarse.root, motion.root[::3])


@pytest.mark.parametrize("fps", [7.0, 29.97, 30.01, 120.0])
def test_resample_never_runs_past_the_end(motion, fps):
    other = resample(motion, fps)
    assert (len(other) - 1) / fps <= (len(motion) - 1) / motion.fps + 1e-9
    assert (len(other) - 1) / fps > (len(motion) - 1) / motion.fps - 1 / fps - 1e-9


def test_resample_of_less_than_a_frame_s_time_is_one_frame(motion):
    short = resample(crop(motion, 4, 6), 10.0)
    assert torch.equal(short.root, motion.root[4:5])


def test_a_rounding_error_costs_no_frame():
    """55 frames at 29.97 are 44 at 23.976; in floating point a hair less."""
    film = Motion(torch.eye(3).repeat(56, 24, 1, 1), torch.zeros(56, 3), 29.97)
    assert 55 * 23.976 / 29.97 < 44 and len(resample(film, 23.976)) == 45


def test_resample_one_frame(motion):
    one = resample(crop(motion, 4, 5), 60.0)
    assert torch.equal(one.root, motion.root[4:5]) and one.fps == 60.0


def test_resample_refuses_no_rate(motion):
    with pytest.raises(UserError, match="expected a positive frame rate, got 0"):
        resample(motion, 0)


@pytest.mark.parametrize("yaw", [math.radians(degrees) for degrees in (-170, -30, 30, 60, 90, 150)])
def test_canonicalise_removes_any_yaw_whole(motion, yaw, rest_joints):
    """Protocol G.15: whatever the yaw and the place, the same clip comes out, facing +z at x = z = 0."""
    canonical = canonicalise(turned(motion, yaw))
    assert heading(canonical.rotations[0, 0]).item() == pytest.approx(0, abs=1e-9)
    assert canonical.root[0, [0, 2]].abs().max() < 1e-9
    torch.testing.assert_close(canonical.rotations, canonicalise(motion).rotations, atol=1e-9, rtol=0)
    torch.testing.assert_close(canonical.root, canonicalise(motion).root, atol=1e-9, rtol=0)


def test_canonicalise_is_rigid(motion, rest_joints):
    """Heights stay, later turns stay, and joints keep their distances."""
    canonical = canonicalise(motion)
    torch.testing.assert_close(canonical.root[:, 1], motion.root[:, 1])
    before, after = (clip.joints(rest_joints.double()).reshape(-1, 3) for clip in (motion, canonical))
    torch.testing.assert_close(torch.cdist(after, after), torch.cdist(before, before), atol=1e-6, rtol=0)


def test_mirror_reflects_the_joints(motion, rest_joints):
    """On a symmetric skeleton, mirroring swaps the joints of the sides and negates x."""
    rest = rest_joints.double()
    rest = (rest + rest[list(MIRRORED)] * torch.tensor([-1.0, 1.0, 1.0])) / 2
    expected = motion.joints(rest)[:, list(MIRRORED)] * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(mirror(motion).joints(rest), expected)
    torch.testing.assert_close(mirror(mirror(motion)).rotations, motion.rotations)


@pytest.mark.parametrize(
    ("label", "mirrored"),
    [
        ("wave-left-hand", "wave-right-hand"),
        ("turn_right 02", "turn_left 02"),
        ("leftHand to Right", "rightHand to Left"),
        ("standing upright, bright leftover", "standing upright, bright leftover"),
        ("", ""),
    ],
)
def test_mirror_exchanges_the_sides_in_the_label(motion, label, mirrored):
    assert mirror(replace(motion, label=label)).label == mirrored
    assert mirror(mirror(replace(motion, label=label))).label == label


def test_features_are_actors(motion):
    """Protocol A.4 and G.7: 24 rows of 6D by rows, then the path from the first frame and zeros."""
    features = to_features(motion.six, motion.root)
    assert features.shape == (20, 25, 6)
    torch.testing.assert_close(features[:, 5], motion.rotations[:, 5, :2].reshape(20, 6))
    assert features[0, 24].abs().max() == 0 and features[:, 24, 3:].abs().max() == 0
    torch.testing.assert_close(features[7, 24, :3], motion.root[7] - motion.root[0])


def test_features_round_trip(motion):
    rotations, path = from_features(to_features(motion.six, motion.root))
    torch.testing.assert_close(rotations, motion.rotations)
    torch.testing.assert_close(path, motion.root - motion.root[0])


def test_features_take_batches(motion):
    six, root = motion.six.expand(4, 20, 24, 6), motion.root.expand(4, 20, 3)
    torch.testing.assert_close(to_features(six, root)[2], to_features(motion.six, motion.root))
    with pytest.raises(ShapeError, match=r"root\): expected shape \[\.\.\. T 3\] with T=20, got \[19, 3\]"):
        to_features(motion.six, motion.root[1:])


# --- stretches and places -------------------------------------------------------------------------------------------


def test_a_stretch_is_cut_at_the_nearest_frames(generator):
    motion = Motion(torch.eye(3).expand(30, 24, 3, 3), torch.arange(90.0).reshape(30, 3), 10.0)
    assert torch.equal(cut(motion).root, motion.root)
    assert torch.equal(cut(motion, 0.52, 1.0).root, motion.root[5:15])
    assert torch.equal(cut(motion, 2.0).root, motion.root[20:])
    assert len(cut(motion, 0.0, 3.04)) == 30  # the nearest frame is the last one
    for start, seconds in ((0.0, 3.06), (2.5, 0.6), (3.0, None), (-0.1, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, math.inf)):
        with pytest.raises(UserError, match=r"lasts 3 s|were asked for; ask for at most"):
            cut(motion, start, seconds)


def test_from_any_start_a_cut_goes_to_the_last_frame():
    for frames, fps in ((29, 30.0), (30, 29.97), (91, 24.0), (100, 119.88)):
        motion = Motion(torch.eye(3).expand(frames, 24, 3, 3), torch.arange(3.0 * frames).reshape(frames, 3), fps)
        for half in range(2 * frames - 2):
            assert torch.equal(cut(motion, half / 2 / fps).root[-1], motion.root[-1]), (fps, half)


def test_in_place_takes_out_the_travel_alone(generator):
    rotations = axis_angle_to_matrix(torch.randn(5, 24, 3, generator=generator))
    motion = Motion(rotations, torch.randn(5, 3, generator=generator), 30.0)
    still = in_place(motion)
    assert torch.equal(still.root[:, 1], motion.root[:, 1]) and torch.equal(still.rotations, motion.rotations)
    assert torch.equal(still.root[:, [0, 2]], motion.root[:1, [0, 2]].expand(5, 2))
