"""Files of joint positions and of HumanML3D's features: layouts, rates, the definition of the features, refusals."""

import math

import numpy as np
import pytest
import torch

from refine import synthetic
from refine.formats.files import Reading, load_motion, save_motion
from refine.formats.joints import positions_from_features, read_joints, write_joints
from refine.motion import Motion, resample
from renderers.checks import UserError
from renderers.rotations import heading
from renderers.skeleton import JOINTS


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return synthetic.perform(synthetic.draw("walk", torch.Generator().manual_seed(0)), 40, rest_joints)


def saved(folder, array):
    np.save(folder / "clip.npy", array)
    return folder / "clip.npy"


def test_there_and_back(tmp_path, walk, free_body):
    """Positions come back to a fifth of a millimetre; the frame rate is said, for the file has none."""
    rest = free_body.rest_joints
    save_motion(walk, tmp_path / "walk_01.npy", free_body)
    stored = np.load(tmp_path / "walk_01.npy")
    assert stored.shape == (40, 24, 3) and stored.dtype == np.float32
    torch.testing.assert_close(torch.from_numpy(stored), walk.joints(rest))
    back = load_motion(tmp_path / "walk_01.npy", rest, Reading(fps=29.97))
    assert (back.fps, back.label, back.source, len(back)) == (29.97, "walk", str(tmp_path / "walk_01.npy"), 40)
    torch.testing.assert_close(back.joints(rest), walk.joints(rest), atol=2e-4, rtol=0)


def test_an_existing_file_is_kept(tmp_path, walk, free_body):
    write_joints(tmp_path / "a.npy", walk, free_body)
    with pytest.raises(UserError, match="is already there"):
        save_motion(walk, tmp_path / "a.npy", free_body)
    assert [file.name for file in tmp_path.iterdir()] == ["a.npy"]


@pytest.mark.parametrize(("count", "fps"), [(24, 30.0), (22, 20.0)])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_number_of_joints_tells_the_rate(tmp_path, walk, rest_joints, count, fps, kind):
    joints = walk.joints(rest_joints)[:, :count].numpy().astype(kind)
    assert read_joints(saved(tmp_path, joints), rest_joints).motion.fps == fps
    assert read_joints(saved(tmp_path, joints[None]), rest_joints, 60.0).motion.fps == 60.0


@pytest.mark.parametrize("count", [52, 55])
def test_more_joints_are_smpl_h_s(tmp_path, walk, rest_joints, count):
    joints = walk.joints(rest_joints)[:, :22]
    more = torch.cat([joints, torch.full((40, count - 22, 3), math.nan)], dim=1)  # fingers are not looked at
    fit = read_joints(saved(tmp_path, more.numpy()), rest_joints)
    torch.testing.assert_close(fit.motion.joints(rest_joints)[:, :22], joints, atol=2e-4, rtol=0)
    assert fit.motion.fps == 20.0


def test_z_up_is_turned_where_it_is_said(tmp_path, walk, rest_joints):
    """A body that faces -y with its left at +x, as in AMASS, faces +z."""
    joints = walk.joints(rest_joints).numpy()
    turned = np.stack([joints[..., 0], -joints[..., 2], joints[..., 1]], axis=-1)
    fit = read_joints(saved(tmp_path, turned), rest_joints, 30.0, up="z")
    np.testing.assert_allclose(fit.motion.joints(rest_joints), joints, atol=2e-4)
    back = load_motion(saved(tmp_path, turned), rest_joints, Reading(up="z"))
    assert abs(float(heading(back.rotations[0, 0]) - heading(walk.rotations[0, 0]))) < 0.01
    with pytest.raises(UserError, match="--up: unknown name 'x'"):
        read_joints(saved(tmp_path, turned), rest_joints, up="x")


# --- Features --------------------------------------------------------------------------------------------------------


def features(joints: np.ndarray, yaw: np.ndarray, count: int) -> np.ndarray:
    """HumanML3D's features of T + 1 frames for T, written down from their definition, frame by frame."""
    rows = []
    for t in range(len(joints) - 1):
        seen = turn_about_y(-yaw[t])  # the world as the body of frame t sees it
        under = joints[t, 0] * [1, 0, 1]
        local = (joints[t, 1:] - under) @ seen.T
        step = (joints[t + 1, 0] - joints[t, 0]) @ turn_about_y(-yaw[t + 1]).T
        half = math.asin(math.sin((yaw[t + 1] - yaw[t]) / 2))
        # Their turn is that from the world to the body, whose sense is the other one.
        rows.append([-half, step[0], step[2], joints[t, 0, 1], *local.ravel(), *np.zeros(9 * count - 2)])
    return np.array(rows)


def turn_about_y(angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])


@pytest.mark.parametrize("count", [22, 21])
def test_features_are_undone(count):
    """A path with turns: the first frame faces +z at x = z = 0, as HumanML3D's clips do."""
    random = np.random.default_rng(0)
    yaw = np.concatenate([[0], np.cumsum(random.normal(0, 0.3, 12))])
    joints = random.normal(0, 0.5, (13, count, 3))
    joints[0, 0, ::2] = 0
    decoded = positions_from_features(torch.from_numpy(features(joints, yaw, count)))
    np.testing.assert_allclose(decoded.numpy(), joints[:-1], atol=1e-12)


def test_a_file_of_features_is_a_motion(tmp_path, walk, rest_joints):
    slow = resample(walk, 20.0)
    joints = slow.joints(rest_joints).double().numpy()[:, :22]
    joints = (joints - joints[0, 0] * [1, 0, 1]) @ turn_about_y(-float(heading(slow.rotations[0, 0]))).T
    yaw = heading(slow.rotations[:, 0]).double().numpy()
    vectors = features(joints, yaw - yaw[0], 22).astype(np.float32)
    assert vectors.shape[1] == 263
    fit = read_joints(saved(tmp_path, vectors), rest_joints)
    np.testing.assert_allclose(fit.motion.joints(rest_joints)[:, :22].numpy(), joints[:-1], atol=2e-4)
    assert fit.motion.fps == 20.0 and fit.error < 1e-4
    head, pelvis = fit.motion.joints(rest_joints)[0, [JOINTS["head"], 0]]
    assert head[1] > pelvis[1] + 0.5 and abs(float(heading(fit.motion.rotations[0, 0]))) < 0.1


def test_standardised_features_are_no_body(tmp_path, walk, rest_joints):
    joints = walk.joints(rest_joints).double().numpy()[:, :22]
    vectors = features(joints, heading(walk.rotations[:, 0]).double().numpy(), 22)
    vectors = (vectors - vectors.mean(axis=0)) / vectors.std(axis=0).clip(1e-2)
    with pytest.raises(UserError, match=r"holds no body: its bones change their lengths by \d+%; .*standardised"):
        read_joints(saved(tmp_path, vectors), rest_joints)


def test_features_of_another_width():
    with pytest.raises(UserError, match="expected 263 or 251 features, got 260"):
        positions_from_features(torch.zeros(3, 260))


# --- Refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 19, 3)), r"has shape \[4, 19, 3\]; give positions"),
        (np.zeros((4, 66)), r"has shape \[4, 66\]"),
        (np.zeros((2, 4, 22, 3)), r"has shape \[2, 4, 22, 3\]"),
        (np.zeros(263), r"has shape \[263\]"),
        (np.zeros((0, 22, 3)), "has no frames"),
        (np.zeros((200_001, 22, 3), np.int8), "has 200,001 frames, more than the 200,000 that are read; cut it"),
        (np.array(1.0), r"has shape \[\]"),
        (np.full((4, 22, 3), np.nan), "value nan at frame 0, joint 0, coordinate 0"),
        (np.full((4, 263), np.inf), "value inf at frame 0, feature 0"),
        (np.array([["a"]]), "holds <U1, not numbers"),
        (np.zeros((4, 22, 3)), "a leg has no length"),
        (np.array([{}], dtype=object), "holds Python objects, which are never loaded"),
    ],
)
def test_bad_files_are_one_line(tmp_path, array, message, rest_joints):
    with pytest.raises(UserError, match=message) as caught:
        read_joints(saved(tmp_path, array), rest_joints)
    assert "clip.npy" in str(caught.value) and "\n" not in str(caught.value)
