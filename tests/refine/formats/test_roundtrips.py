"""Every pair of formats that keep rotations, whatever the frame rate; and which way a figure stands in each.

The figure of the second half stands at the origin facing +z, holds its left arm straight up, and goes one metre ahead.
Beside each reading stands a wrong one, by hand, so that nobody takes the wrong one for right.
"""

import json
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from refine.formats.files import Reading, load_motion, save_motion
from refine.motion import Motion
from refine.synthetic import draw, perform
from renderers.rotations import rotation_about
from renderers.skeleton import JOINTS

KEEP_ROTATIONS = (".bvh", ".npz", ".glb", ".json")
HALF_MILLIMETRE = 5e-4


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return perform(draw("walk", torch.Generator().manual_seed(5), 30.0), 40, rest_joints)


def through(motion: Motion, path, body, reading: Reading | None = None) -> Motion:
    save_motion(motion, path, body)
    return load_motion(path, body.rest_joints, reading)


@pytest.mark.parametrize(("first", "second"), [*permutations(KEEP_ROTATIONS, 2)])
def test_any_two_formats_keep_a_motion(tmp_path, walk, free_body, first, second):
    between = through(walk, tmp_path / f"walk{first}", free_body)
    back = through(between, tmp_path / f"walk{second}", free_body)
    rest = free_body.rest_joints
    assert (back.joints(rest) - walk.joints(rest)).norm(dim=-1).max() < HALF_MILLIMETRE / 10
    assert (back.fps, len(back), back.label) == (walk.fps, len(walk), walk.label)


@pytest.mark.parametrize("suffix", KEEP_ROTATIONS)
@pytest.mark.parametrize("fps", [12.5, 15.0, 20.0, 23.976, 24000 / 1001, 29.97, 59.94, 100.0, 119.88, 120.0, 240.0])
def test_frame_rates_are_exact(tmp_path, walk, free_body, suffix, fps):
    """In BVH to a thousandth of a hertz: it stores the time of a frame, and other programs store few digits of it."""
    motion = replace(walk, rotations=walk.rotations[:7], root=walk.root[:7], fps=fps)
    back = through(motion, tmp_path / f"walk{suffix}", free_body)
    assert back.fps == (round(fps, 3) if suffix == ".bvh" else fps) and len(back) == 7
    assert through(back, tmp_path / f"again{suffix}", free_body).fps == back.fps


@pytest.mark.parametrize("suffix", KEEP_ROTATIONS)
def test_a_clip_goes_round_twenty_times_as_well_as_once(tmp_path, walk, free_body, suffix):
    """Nothing drifts: what is written again is what was read."""
    motion = replace(walk, rotations=walk.rotations[:5], root=walk.root[:5])
    for turn in range(20):
        motion = through(motion, tmp_path / f"{turn}{suffix}", free_body)
    rest = free_body.rest_joints
    assert (motion.joints(rest) - walk.joints(rest)[:5]).norm(dim=-1).max() < HALF_MILLIMETRE


# --- which way is up, ahead and left --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def golden(rest_joints) -> Motion:
    rotations = torch.eye(3).repeat(11, 24, 1, 1)
    rotations[:, JOINTS["left_shoulder"]] = rotation_about("z", torch.tensor(torch.pi / 2))
    root = torch.zeros(11, 3)
    root[:, 1], root[:, 2] = rest_joints[0, 1], torch.linspace(0, 1, 11)
    return Motion(rotations, root, 10.0, "stand")


def ways(motion: Motion, rest_joints) -> dict[str, list[float]]:
    """Where the head is from the pelvis, the left wrist from its shoulder, and where it all goes."""
    joints = motion.joints(rest_joints)
    first = {name: joints[0, JOINTS[name]] for name in ("head", "pelvis", "left_wrist", "left_shoulder")}
    found = {"head": first["head"] - first["pelvis"], "hand": first["left_wrist"] - first["left_shoulder"]}
    return {name: way.tolist() for name, way in (found | {"path": joints[-1, 0] - joints[0, 0]}).items()}


def along(way: list[float], axis: str, cosine: float = 0.97) -> bool:
    """Whether a way leads along "+x", "-x" and so on."""
    way = np.array(way) / np.linalg.norm(way)
    return bool(way["xyz".index(axis[1])] * (1 if axis[0] == "+" else -1) > cosine)


@pytest.mark.parametrize("suffix", [*KEEP_ROTATIONS, ".npy"])
def test_it_stands_holds_its_left_hand_up_and_goes_ahead(tmp_path, golden, free_body, suffix):
    back = through(golden, tmp_path / f"a{suffix}", free_body, Reading(fps=10.0) if suffix == ".npy" else None)
    found = ways(back, free_body.rest_joints)
    assert along(found["head"], "+y") and along(found["hand"], "+y") and along(found["path"], "+z"), found
    left, right = (back.joints(free_body.rest_joints)[0, JOINTS[name], 0] for name in ("left_hip", "right_hip"))
    assert left > 0.03 > -0.03 > right
    assert np.linalg.norm(found["path"]) == pytest.approx(1.0, abs=HALF_MILLIMETRE)


@pytest.mark.parametrize(
    ("suffix", "reading", "head", "path"),
    [
        # z is up in AMASS's files, and bodies face -y in them: taken for y up they lie on their back and sink.
        (".npz", Reading(up="y"), "+z", "-y"),
        # y is up in all others: taken for z up, bodies lie on their back and rise.
        (".bvh", Reading(up="z"), "-z", "+y"),
        (".glb", Reading(up="z"), "-z", "+y"),
        (".npy", Reading(up="z", fps=10.0), "-z", "+y"),
    ],
)
def test_with_the_wrong_axis_it_lies(tmp_path, golden, free_body, suffix, reading, head, path):
    found = ways(through(golden, tmp_path / f"a{suffix}", free_body, reading), free_body.rest_joints)
    assert along(found["head"], head) and along(found["path"], path), found


def test_bvh_is_in_centimetres_and_degrees(tmp_path, golden, free_body, rest_joints):
    save_motion(golden, tmp_path / "a.bvh", free_body)
    lines = (tmp_path / "a.bvh").read_text().splitlines()
    last = np.array(lines[-1].split(), dtype=float)
    np.testing.assert_allclose(last[:3], [0, 100 * rest_joints[0, 1], 100], atol=1e-3)
    assert sorted(np.abs(last[3:]).round(3))[-2:] == [0, 90]
    with_metres = ways(load_motion(tmp_path / "a.bvh", rest_joints, Reading(unit="m")), rest_joints)
    # A path is scaled by the legs, and these would be 80 m long: the unit says nothing about it.
    assert np.linalg.norm(with_metres["path"]) == pytest.approx(1.0, abs=HALF_MILLIMETRE)


def test_amass_turns_the_root_to_z_up(tmp_path, golden, free_body, rest_joints):
    save_motion(golden, tmp_path / "a.npz", free_body)
    with np.load(tmp_path / "a.npz") as found:
        root, path = Rotation.from_rotvec(found["poses"][0, :3]), found["trans"][-1] - found["trans"][0]
        arm = Rotation.from_rotvec(found["poses"][0, 3 * JOINTS["left_shoulder"] :][:3])
    np.testing.assert_allclose(root.apply([0, 1, 0]), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(path, [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(arm.apply([1, 0, 0]), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(arm.inv().apply([1, 0, 0]), [0, -1, 0], atol=1e-6)  # the wrong way round: it hangs


def test_quaternions_of_json_begin_with_w(tmp_path, golden, free_body, rest_joints):
    save_motion(golden, tmp_path / "a.json", free_body)
    found = json.loads((tmp_path / "a.json").read_text())
    half = 0.5**0.5
    np.testing.assert_allclose(found["rotations"][0][JOINTS["left_shoulder"]], [half, 0, 0, half], atol=1e-6)
    found["rotations"] = np.array(found["rotations"])[..., [1, 2, 3, 0]].tolist()
    (tmp_path / "a.json").write_text(json.dumps(found))
    wrong = ways(load_motion(tmp_path / "a.json", rest_joints), rest_joints)
    assert np.linalg.norm(wrong["head"]) < 0.1 and np.linalg.norm(wrong["hand"]) < 0.1  # each joint turns back
