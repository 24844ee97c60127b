"""AMASS-style files: frames, widths, spellings, round trips."""

import math

import numpy as np
import pytest
import torch

from refine.formats.amass import PELVIS, read_amass, write_amass
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, matrix_to_axis_angle, rotation_about
from renderers.skeleton import JOINTS, forward_kinematics


@pytest.fixture
def motion(generator) -> Motion:
    rotations = axis_angle_to_matrix(torch.randn(7, 24, 3, generator=generator))
    return Motion(rotations, torch.randn(7, 3, generator=generator), 29.97, "wave-both-hands")


@pytest.fixture
def standing() -> dict[str, np.ndarray]:
    """As AMASS has it: z up, a body that stands upright, faces -y and walks that way; the left elbow is bent."""
    poses = np.zeros((3, 156))
    poses[:, 0] = math.pi / 2
    poses[:, 3 * JOINTS["left_elbow"] + 1] = -1.0
    trans = np.array([[0.0, 0.0, 1.0], [0.0, -0.5, 1.0], [0.0, -1.0, 1.0]])
    return {"poses": poses, "trans": trans, "mocap_framerate": np.array(120.0), "betas": np.zeros(16)}


def saved(folder, arrays):
    np.savez(folder / "clip.npz", **arrays)
    return folder / "clip.npz"


def test_a_standing_figure_stays_upright_faces_ahead_and_keeps_its_left(tmp_path, standing, rest_joints):
    motion = read_amass(saved(tmp_path, standing))
    joints = motion.joints(rest_joints)
    torch.testing.assert_close(motion.rotations[:, 0], torch.eye(3).repeat(3, 1, 1), atol=1e-6, rtol=0)
    assert joints[0, JOINTS["head"], 1] > joints[0, 0, 1] + 0.4
    assert joints[0, JOINTS["left_wrist"], 0] > 0.2 > -0.2 > joints[0, JOINTS["right_wrist"], 0]
    assert joints[0, JOINTS["left_wrist"], 2] > joints[0, JOINTS["right_wrist"], 2] + 0.1  # the bent arm reaches ahead
    torch.testing.assert_close(motion.root[2] - motion.root[0], torch.tensor([0.0, 0, 1]), atol=1e-6, rtol=0)
    assert motion.fps == 120


def test_trans_is_the_root_less_smpls_rest_pelvis(tmp_path, standing):
    """SMPL turns about the rest pelvis and then moves by trans, all in the file's frame: joint = pelvis + trans.

    SMPL's pelvis is 2.8 cm before the origin of its T-pose (z), which for an upright figure in the file is height.
    """
    motion = read_amass(saved(tmp_path, standing))
    torch.testing.assert_close(motion.root[1], torch.tensor([-0.0018, 1.0282, 0.5 + 0.2233]))


def test_joints_are_the_file_s_joints_turned_once(tmp_path, motion, rest_joints):
    """What an AMASS reader computes from our file, turned upright, is our joints."""
    write_amass(tmp_path / "a.npz", motion)
    with np.load(tmp_path / "a.npz") as arrays:
        body = torch.from_numpy(arrays["poses"][:, :66]).float().reshape(-1, 22, 3)
        rotations = torch.cat([axis_angle_to_matrix(body), motion.rotations[:, 22:]], dim=1)
        root = torch.from_numpy(arrays["trans"] + PELVIS).float()
    joints = forward_kinematics(rotations, root, rest_joints)[0]
    upright = rotation_about("x", torch.tensor(-math.pi / 2))
    torch.testing.assert_close(joints @ upright.mT, motion.joints(rest_joints), atol=1e-5, rtol=0)


def test_round_trip(tmp_path, motion):
    write_amass(tmp_path / "new" / "a.npz", motion)
    back = read_amass(tmp_path / "new" / "a.npz")
    assert (back.fps, back.label, back.source) == (29.97, "wave-both-hands", str(tmp_path / "new" / "a.npz"))
    torch.testing.assert_close(back.rotations, motion.rotations, atol=1e-6, rtol=0)
    torch.testing.assert_close(back.root, motion.root, atol=1e-6, rtol=0)


def test_writing_leaves_the_motion_alone(tmp_path, motion):
    double = motion.to(torch.float64)
    before = double.rotations.clone()
    write_amass(tmp_path / "a.npz", double)
    assert torch.equal(double.rotations, before)


def test_the_layout_is_smpl_h(tmp_path, motion):
    write_amass(tmp_path / "a.npz", motion)
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["poses"].shape == (7, 156) and arrays["trans"].shape == (7, 3)
        assert arrays["betas"].tolist() == [0] * 16 and str(arrays["gender"]) == "neutral"
        assert float(arrays["mocap_framerate"]) == float(arrays["mocap_frame_rate"]) == 29.97
        hand = matrix_to_axis_angle(motion.rotations[:, JOINTS["left_hand"]]).double().numpy()
        for finger in (22, 25, 28, 31):  # SMPL-H: index1, middle1, pinky1, ring1 of the left hand
            np.testing.assert_allclose(arrays["poses"][:, 3 * finger : 3 * finger + 3], hand, atol=1e-6)


@pytest.mark.parametrize("width", [72, 156, 165])
def test_widths_share_their_body(tmp_path, standing, width):
    expected = read_amass(saved(tmp_path, standing)).rotations
    poses = np.zeros((3, width))
    poses[:, :66] = standing["poses"][:, :66]
    back = read_amass(saved(tmp_path, {**standing, "poses": poses}))
    torch.testing.assert_close(back.rotations, expected)


@pytest.mark.parametrize(("width", "middle"), [(72, (22, 23)), (156, (25, 40)), (165, (28, 43))])
def test_a_hand_turns_as_its_middle_finger(tmp_path, standing, width, middle):
    poses = np.zeros((3, width))
    for joint, angle in zip(middle, (0.4, -0.7), strict=True):
        poses[:, 3 * joint] = angle
    hands = read_amass(saved(tmp_path, {**standing, "poses": poses})).rotations[0, [22, 23]]
    torch.testing.assert_close(hands, rotation_about("x", torch.tensor([0.4, -0.7])))


def test_smpl_x_spelling(tmp_path, standing):
    expected = read_amass(saved(tmp_path, standing))
    arrays = {
        "root_orient": standing["poses"][:, :3],
        "pose_body": standing["poses"][:, 3:66],
        "trans": standing["trans"],
        "mocap_frame_rate": np.array(60.0),
        "markers_latent_vids": np.array([{}]),  # such files hold objects that we do not need
    }
    back = read_amass(saved(tmp_path, arrays))
    assert back.fps == 60
    torch.testing.assert_close(back.rotations, expected.rotations)


def changed(**arrays):
    return lambda standing: {**standing, **arrays}


def without(*keys):
    return lambda standing: {key: value for key, value in standing.items() if key not in keys}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("poses"), "has no array of numbers 'root_orient'"),
        (without("trans"), "has no array of numbers 'trans'"),
        (without("mocap_framerate"), r"has no frame rate \(mocap_framerate or mocap_frame_rate\)"),
        (changed(mocap_framerate=np.array(0.0)), "has no frame rate"),
        (changed(mocap_framerate=np.array("fast")), "has no frame rate"),
        (changed(trans=np.zeros((2, 3))), r"trans has shape \[2, 3\], poses have 3 frames"),
        (changed(poses=np.zeros((3, 100))), r"poses have shape \[3, 100\]; give frames by one of 72, 156, 165"),
        (changed(poses=np.array(["a"])), "has no array of numbers 'poses'"),
        (changed(poses=np.full((3, 72), np.nan)), "value nan at frame 0, joint pelvis, coordinate 0"),
        (changed(trans=np.full((3, 3), np.inf)), "value inf at frame 0, coordinate 0"),
        (lambda arrays: {"root_orient": np.zeros((3, 3)), "pose_body": np.zeros(4)}, r"pose_body \[4\] do not fit"),
        (changed(poses=np.zeros((0, 72)), trans=np.zeros((0, 3))), "has no frames"),
    ],
)
def test_bad_files_are_one_line(tmp_path, standing, change, message):
    with pytest.raises(UserError, match=message) as caught:
        read_amass(saved(tmp_path, change(standing)))
    assert "clip.npz" in str(caught.value) and "\n" not in str(caught.value)
