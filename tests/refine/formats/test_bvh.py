"""BVH: hand-computed files, wrong readings, round trips of any hierarchy, and files that are not well."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from refine.formats import bvh as bvh_module
from refine.formats.bvh import UNITS, Bvh, bvh_text, motion_to_bvh, read_bvh, world, write_bvh
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, euler_to_matrix, rotation_about
from renderers.skeleton import JOINT_NAMES, JOINTS

ARM = """HIERARCHY
ROOT shoulder
{
  OFFSET 10 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT elbow
  {
    OFFSET 60 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 40 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 100 0 90 0 0 0 0 0
0 100 0 20 30 40 0 0 90
"""


def written(folder, text, name="clip.bvh"):
    path = folder / name
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return path


def radians(*degrees):
    return torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))


def test_reads_the_numbers_of_the_file(tmp_path):
    bvh = read_bvh(written(tmp_path, ARM))
    assert bvh.names == ("shoulder", "elbow") and bvh.parents == (-1, 0)
    assert (bvh.fps, bvh.unit, len(bvh)) == (30.0, "cm", 2)
    assert bvh.channels[1] == ("Zrotation", "Xrotation", "Yrotation")
    assert bvh.ends == ((1, (0.4, 0.0, 0.0)),)
    torch.testing.assert_close(bvh.offsets[1], torch.tensor([0.6, 0, 0], dtype=torch.float64))


def test_position_channels_replace_the_offset(tmp_path):
    joints = world(read_bvh(written(tmp_path, ARM)))[0]
    assert joints[0, 0].tolist() == [0.0, 1.0, 0.0]  # not (0.1, 1, 0)


def test_a_right_angle_about_z_lifts_the_arm(tmp_path):
    joints = world(read_bvh(written(tmp_path, ARM)))[0]
    torch.testing.assert_close(joints[0, 1], torch.tensor([0.0, 1.6, 0.0], dtype=torch.float64))


def test_channels_multiply_in_their_order(tmp_path):
    """Z X Y means Rz @ Rx @ Ry (protocol A.8); read backwards, the elbow is somewhere else."""
    joints, rotations = world(read_bvh(written(tmp_path, ARM)))
    expected = euler_to_matrix(radians(20, 30, 40), "zxy")
    torch.testing.assert_close(rotations[1, 0], expected)
    torch.testing.assert_close(rotations[1, 1], expected @ rotation_about("y", radians(90)[0]))
    bone = torch.tensor([0.6, 0, 0], dtype=torch.float64)
    torch.testing.assert_close(joints[1, 1] - joints[1, 0], expected @ bone)
    backwards = euler_to_matrix(radians(40, 30, 20), "yxz") @ bone
    assert (joints[1, 1] - joints[1, 0] - backwards).norm() > 0.1


def test_format_is_forgiving_about_space_and_case(tmp_path):
    text = (
        ARM.replace("\n{", " {")
        .replace("Zrotation", "ZROTATION")
        .replace("\n", "\r\n")
        .replace("Frames: ", "Frames:\t")
    )
    joints = world(read_bvh(written(tmp_path, "\ufeff" + text)))[0]
    torch.testing.assert_close(joints, world(read_bvh(written(tmp_path, ARM)))[0])


@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_is_guessed_from_the_size(tmp_path, unit, rest_joints):
    still = Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0)
    bvh = motion_to_bvh(still, rest_joints)
    path = written(tmp_path, bvh_text(Bvh(**{**vars(bvh), "unit": unit})))
    back = read_bvh(path)
    assert back.unit == unit
    torch.testing.assert_close(back.offsets[[0, 3]], bvh.offsets[[0, 1]][:, :], atol=1, rtol=0)
    assert read_bvh(path, unit="m").unit == "m"


@pytest.mark.parametrize(
    ("frame_time", "fps"), [("0.0333333", 30), ("0.00833333", 120), ("0.0333667", 29.97), ("2", 0.5)]
)
def test_frame_rate(tmp_path, frame_time, fps):
    assert read_bvh(written(tmp_path, ARM.replace("0.0333333", frame_time))).fps == pytest.approx(fps, abs=2e-4)


def test_our_files_keep_world_joints(tmp_path, generator, rest_joints):
    """Within 0.1 mm asked for, within 5 micrometres found; leaves have end sites, names are smplx's."""
    rotations = axis_angle_to_matrix(2 * torch.randn(30, 24, 3, generator=generator))
    motion = Motion(rotations, 3 * torch.randn(30, 3, generator=generator), 24.0)
    write_bvh(tmp_path / "both.bvh", motion, rest_joints)
    bvh = read_bvh(tmp_path / "both.bvh")
    assert sorted(bvh.names) == sorted(JOINT_NAMES) and (bvh.unit, bvh.fps) == ("cm", 24.0)
    assert {bvh.names[joint] for joint, _ in bvh.ends} == {"head", "left_hand", "right_hand", "left_foot", "right_foot"}
    order = [bvh.names.index(name) for name in JOINT_NAMES]
    assert (world(bvh)[0][:, order] - motion.joints(rest_joints)).abs().max() < 5e-6


def test_gimbal_lock_is_written_right(tmp_path, rest_joints):
    rotations = torch.eye(3).repeat(1, 24, 1, 1)
    locked = euler_to_matrix(radians(25, 90, -40), "zxy").float()
    rotations[0, JOINTS["left_shoulder"]] = locked
    write_bvh(tmp_path / "a.bvh", Motion(rotations, torch.zeros(1, 3), 30.0), rest_joints)
    bvh = read_bvh(tmp_path / "a.bvh")
    torch.testing.assert_close(bvh.rotations[0, bvh.names.index("left_shoulder")].float(), locked, atol=1e-6, rtol=0)


@st.composite
def files(draw) -> Bvh:
    """Any tree with any channel orders; parents come before children, in the order of a depth-first walk."""
    count = draw(st.integers(1, 7))
    parents, path = [-1], [0]
    for joint in range(1, count):
        path = path[: draw(st.integers(1, len(path)))]
        parents.append(path[-1])
        path.append(joint)
    axes = st.permutations("XYZ")
    turning = st.builds(lambda order: tuple(f"{axis}rotation" for axis in order), axes)
    moving = st.builds(lambda order: tuple(f"{axis}position" for axis in order), axes)
    mixed = st.builds(lambda a, b: a + b, moving, turning) | st.builds(lambda a, b: b + a, moving, turning)
    channels = tuple(draw(turning | mixed) for _ in range(count))
    seeded = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    frames = draw(st.integers(1, 4))
    offsets = torch.randn(count, 3, generator=seeded, dtype=torch.float64)
    positions = offsets.repeat(frames, 1, 1)
    moved = torch.tensor([len(names) == 6 for names in channels])
    positions[:, moved] = torch.randn(frames, int(moved.sum()), 3, generator=seeded, dtype=torch.float64)
    leaves = [joint for joint in range(count) if joint not in parents]
    return Bvh(
        names=tuple(f"joint {joint}" for joint in range(count)),
        parents=tuple(parents),
        offsets=offsets,
        channels=channels,
        ends=tuple((leaf, (0.1, 0.0, -0.2)) for leaf in leaves),
        rotations=axis_angle_to_matrix(2 * torch.randn(frames, count, 3, generator=seeded, dtype=torch.float64)),
        positions=positions,
        fps=draw(st.sampled_from([24.0, 29.97, 30.0, 60.0, 120.0])),
        unit=draw(st.sampled_from(sorted(UNITS))),
    )


@settings(max_examples=60, deadline=None)
@given(files())
def test_any_hierarchy_goes_there_and_back(tmp_path_factory, bvh):
    back = read_bvh(written(tmp_path_factory.getbasetemp(), bvh_text(bvh)), unit=bvh.unit)
    assert (back.names, back.parents, back.channels) == (bvh.names, bvh.parents, bvh.channels)
    assert back.fps == bvh.fps
    torch.testing.assert_close(back.rotations, bvh.rotations, atol=1e-6, rtol=0)
    for ours, theirs in zip(world(bvh), world(back), strict=True):
        torch.testing.assert_close(theirs, ours, atol=2e-5, rtol=0)


BROKEN = {
    "empty": ("  \n", r"clip.bvh: is empty"),
    "binary": (b"HIERARCHY\0\1\2", "is not a BVH file"),
    "another format": ("ply\nformat ascii 1.0\n", "does not begin with HIERARCHY"),
    "no motion": (ARM[: ARM.index("MOTION")], "line 15: the file ends inside its HIERARCHY"),
    "cut in the hierarchy": (ARM[:90], "line 5: CHANNELS promises 6 channels and lists"),
    "cut after MOTION": (ARM[: ARM.index("Frames")], "ends before its 'Frames:' line"),
    "cut between frames": (ARM[: ARM.index("0 100 0 20")], "line 19: holds 1 frames, its Frames line claims 2"),
    "cut inside a frame": (ARM[:-10], r"line 20 \(frame 1\): has \d values, the hierarchy has 9 channels"),
    "too many frames": (
        ARM + "0 0 0 0 0 0 0 0 0\n",
        "line 21: holds more frames than the 2 that its Frames line claims",
    ),
    "no frames": (ARM.replace("Frames: 2", "Frames: 0"), "has 0 frames"),
    "frames in words": (
        ARM.replace("Frames: 2", "Frames: two"),
        "line 17: expected 'Frames: number', got 'Frames: two'",
    ),
    "nan": (ARM.replace("20 30 40", "20 nan 40"), "value nan at frame 1, channel shoulder Xrotation"),
    "a word": (ARM.replace("30 40", "3o 40"), r"line 20 \(frame 1\): '3o' is not a number \(shoulder Xrotation\)"),
    "no time": (ARM.replace("0.0333333", "0"), "Frame Time 0.0 is not a time"),
    "duplicate": (ARM.replace("JOINT elbow", "JOINT shoulder"), "line 6: a second joint is called 'shoulder'"),
    "unknown channel": (ARM.replace("3 Zrotation", "3 Wrotation"), "line 9: unknown or repeated channel"),
    "no channels": (
        ARM.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS three"),
        "line 9: CHANNELS promises three",
    ),
    "offset": (ARM.replace("OFFSET 60 0 0", "OFFSET 60 0"), "line 8: OFFSET takes three numbers, got '60 0'"),
    "offset nan": (ARM.replace("OFFSET 60 0 0", "OFFSET 60 0 nan"), "line 8: OFFSET 60 0 nan is not finite"),
    "two roots": (ARM.replace("MOTION", "ROOT other\n{\n}\nMOTION"), "line 16: 'ROOT other' does not belong here"),
    "stray brace": (ARM.replace("MOTION", "}\nMOTION"), "line 16: '}' does not belong here, 0 braces deep"),
    "vast": (ARM.replace("Frames: 2", "Frames: 99999999999"), "claims 99999999999 frames of 2 joints"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_one_line(tmp_path, case):
    content, message = BROKEN[case]
    with pytest.raises(UserError, match=message) as caught:
        read_bvh(written(tmp_path, content))
    assert "clip.bvh" in str(caught.value) and "\n" not in str(caught.value) and caught.value.remedy


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(UserError, match=r"none.bvh: cannot be read \(No such file or directory\); check the path"):
        read_bvh(tmp_path / "none.bvh")


def test_limits_are_met_before_memory_is_taken(tmp_path, monkeypatch):
    deep = "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n" for i in range(300))
    with pytest.raises(UserError, match="'{' does not belong here, 256 braces deep"):
        read_bvh(written(tmp_path, deep))
    wide = "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n}}\n" for i in range(1100))
    with pytest.raises(UserError, match="more than 1024 joints"):
        read_bvh(written(tmp_path, wide))
    monkeypatch.setattr(bvh_module, "MAX_MOTION_TEXT", 100)
    with pytest.raises(UserError, match=r"has \d+ bytes, more than the 100"):
        read_bvh(written(tmp_path, ARM))


def test_a_failed_write_leaves_nothing(tmp_path, rest_joints):
    (tmp_path / "file").write_text("")
    still = Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0)
    with pytest.raises(UserError, match="cannot be written"):
        write_bvh(tmp_path / "file" / "a.bvh", still, rest_joints)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_degrees_not_radians(tmp_path):
    rotation = read_bvh(written(tmp_path, ARM)).rotations[0, 0]
    assert math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) == pytest.approx(90)
