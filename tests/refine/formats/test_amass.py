"""AMASS-style files: frames, widths, spellings, round trips."""

import math

import numpy as np
import pytest
import torch

from refine.formats.amass import PELVIS, read_amass, write_amass
from refine.formats.files import Reading, load_motion
from refine.motion import Motion, lies
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


@pytest.mark.parametrize("fingers", [True, False])
def test_the_parts_of_smpl_x_are_read_apart(tmp_path, motion, fingers):
    """AMASS's own SMPL-X files hold everything twice."""
    write_amass(tmp_path / "a.npz", motion, "smplx")
    with np.load(tmp_path / "a.npz") as arrays:
        kept = {key: arrays[key] for key in arrays if key != "poses" and (fingers or key != "pose_hand")}
    if fingers:  # none but the middle ones, the second of five in each hand
        kept["pose_hand"] = kept["pose_hand"] * np.repeat(np.arange(30) % 15 == 3, 3)
    back = read_amass(saved(tmp_path, kept))
    last = 24 if fingers else 22
    torch.testing.assert_close(back.rotations[:, :last], motion.rotations[:, :last], atol=1e-6, rtol=0)
    if not fingers:
        torch.testing.assert_close(back.rotations[:, 22:], torch.eye(3).expand(7, 2, 3, 3))


# --- The body's shape ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [10, 16, 300])
@pytest.mark.parametrize(
    "gender", [np.array("female"), np.array(b"female"), np.array(["female"]), np.array("Female "), np.bytes_(b"female")]
)
def test_shape_and_gender_are_kept(tmp_path, standing, count, gender):
    betas = np.linspace(-2, 2, count)
    first = read_amass(saved(tmp_path, {**standing, "betas": betas, "gender": gender}))
    assert first.gender == "female"
    np.testing.assert_allclose(first.betas.numpy(), betas, atol=1e-6)
    write_amass(tmp_path / "b.npz", first)
    back = read_amass(tmp_path / "b.npz")
    assert back.gender == "female" and len(back.betas) == max(16, count)
    np.testing.assert_allclose(back.betas[:count].numpy(), betas, atol=1e-6)
    assert not back.betas[count:].any()


def test_one_shape_a_frame_is_one_shape(tmp_path, standing):
    betas = np.tile(np.linspace(-1, 1, 10), (3, 1))
    np.testing.assert_allclose(read_amass(saved(tmp_path, {**standing, "betas": betas})).betas.numpy(), betas[0])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("betas", np.array(["thin"])),
        ("betas", np.full(10, np.nan)),
        ("betas", np.zeros((0,))),
        ("betas", np.zeros((2, 2, 2))),
        ("betas", np.zeros(5000)),
        ("betas", np.full(10, 1e300)),
        ("betas", np.array([{}])),
        ("gender", np.array("robot")),
        ("gender", np.array(["male", "female"])),
        ("gender", np.array([{}])),
        ("gender", np.array(3)),
        ("gender", np.array(b"\xff")),
    ],
)
def test_a_shape_that_cannot_be_read_is_left_out(tmp_path, standing, key, value):
    motion = read_amass(saved(tmp_path, {**standing, key: value}))
    assert motion.gender == "neutral" and len(motion) == 3
    if key == "betas":
        assert motion.betas is None


# --- Other programs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["smpl", "smplh", "smplx"])
def test_every_layout_comes_back(tmp_path, motion, model, rest_joints):
    write_amass(tmp_path / "a.npz", motion, model)
    back = read_amass(tmp_path / "a.npz")
    torch.testing.assert_close(back.joints(rest_joints), motion.joints(rest_joints), atol=1e-5, rtol=0)
    assert back.fps == motion.fps and len(back) == len(motion)


@pytest.mark.parametrize(("name", "width"), [("walk_stageii.npz", 165), ("walk_poses.npz", 156), ("stageii.npz", 156)])
def test_names_tell_the_layout_as_amass_s_do(tmp_path, motion, name, width):
    write_amass(tmp_path / name, motion)
    with np.load(tmp_path / name) as data:
        assert data["poses"].shape[1] == width


def test_a_layout_that_is_none(tmp_path, motion):
    with pytest.raises(UserError, match="unknown name 'smplq'; did you mean"):
        write_amass(tmp_path / "a.npz", motion, "smplq")
    assert not list(tmp_path.iterdir())


def test_the_smpl_x_add_on_for_blender_takes_it(tmp_path, motion):
    """What the add-on asks for: five keys, a whole rate, text for the gender, 55 joints with their names in order."""
    write_amass(tmp_path / "a.npz", motion, "smplx")
    with np.load(tmp_path / "a.npz") as data:
        assert {"trans", "gender", "betas", "poses"} < set(data) and int(data["mocap_frame_rate"]) == 29
        assert str(data["gender"]) in ("male", "female", "neutral") and data["betas"].ndim == 1
        assert data["poses"].shape == (7, 55 * 3) and data["trans"][0].shape == (3,)
        pose = data["poses"][0].reshape(-1, 3)
        body = matrix_to_axis_angle(motion.rotations[0, 1:22]).numpy()
        np.testing.assert_allclose(pose[1:22], body, atol=1e-5)
        assert not pose[22:25].any()  # jaw and eyes
        left, right = matrix_to_axis_angle(motion.rotations[0, 22:]).numpy()
        np.testing.assert_allclose(pose[[25, 28, 31, 34]], np.tile(left, (4, 1)), atol=1e-5)
        np.testing.assert_allclose(pose[[40, 43, 46, 49]], np.tile(right, (4, 1)), atol=1e-5)
        parts = [data[key] for key in ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")]
        np.testing.assert_array_equal(np.concatenate(parts, axis=1), data["poses"])
        assert str(data["surface_model_type"]) == "smplx"


def test_amass_s_own_programs_take_it(tmp_path, motion):
    """What its notebooks and its preparation of data take: 16 numbers of shape, 8 of soft tissue, body and hands by
    their columns, the rate under its first name."""
    write_amass(tmp_path / "a.npz", motion)
    with np.load(tmp_path / "a.npz") as data:
        frames = len(data["poses"])
        assert data["betas"][:16].shape == (16,) and data["dmpls"][:, :8].shape == (frames, 8)
        assert data["poses"][:, 3:66].shape == (frames, 63) and data["poses"][:, 66:].shape == (frames, 90)
        assert str(data["gender"].astype(str)) == "neutral" and float(data["mocap_framerate"]) == 29.97


# --- Frames ----------------------------------------------------------------------------------------------------------


def test_y_up_is_read_where_it_is_said(tmp_path, standing, rest_joints):
    poses = standing["poses"].copy()
    poses[:, 0] = 0  # upright without a turn
    trans = standing["trans"][:, [0, 2, 1]] * [1, 1, -1]  # walks to +z
    path = saved(tmp_path, {**standing, "poses": poses, "trans": trans})
    motion = load_motion(path, rest_joints, Reading(up="y"))
    joints = motion.joints(rest_joints)
    assert joints[0, JOINTS["head"], 1] > joints[0, 0, 1] + 0.4
    torch.testing.assert_close(motion.rotations[:, 0], torch.eye(3).repeat(3, 1, 1), atol=1e-6, rtol=0)
    torch.testing.assert_close(motion.root[2] - motion.root[0], torch.tensor([0.0, 0, 1]), atol=1e-6, rtol=0)
    assert not lies(motion) and lies(read_amass(path))


def test_standing_and_lying_people_are_told_from_turned_files(tmp_path, standing):
    path = saved(tmp_path, standing)
    assert not lies(read_amass(path))
    lying = standing["poses"].copy()
    lying[:, 0], lying[:, 1] = 0, math.pi / 2  # on its side, head along y of the file: the same, but for the rest
    lying[1:, :3] = [math.pi / 2, 0, 0]
    assert not lies(read_amass(saved(tmp_path, {**standing, "poses": lying})))


def test_a_rate_that_is_missing_may_be_said(tmp_path, standing, rest_joints):
    path = saved(tmp_path, {key: value for key, value in standing.items() if key != "mocap_framerate"})
    assert load_motion(path, rest_joints, Reading(fps=24.0)).fps == 24.0
    assert load_motion(saved(tmp_path, standing), rest_joints, Reading(fps=24.0)).fps == 120.0


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
        (
            lambda arrays: {"root_orient": np.zeros((3, 3)), "pose_body": np.zeros((3, 63)), "pose_hand": np.zeros(3)},
            r"pose_hand has shape \[3\]; give frames by 90",
        ),
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
