"""SMPL's tree: names, sides, parts and forward kinematics."""

import math

import pytest
import torch

from renderers.checks import ShapeError
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import (
    DRAWN_PARTS,
    JOINT_NAMES,
    JOINTS,
    MIRRORED,
    PARENTS,
    PARTS,
    forward_kinematics,
    part_of_joint,
)


def at_rest(frames=1):
    return torch.eye(3).repeat(frames, 24, 1, 1)


def test_names_are_smplx_names():
    """As far as smplx's list goes on SMPL's joints; its hands have fingers where SMPL's have one joint."""
    from smplx.joint_names import JOINT_NAMES as SMPLX_NAMES

    assert list(JOINT_NAMES[:22]) == SMPLX_NAMES[:22]
    assert JOINT_NAMES[22:] == ("left_hand", "right_hand")


def test_parents_come_first():
    assert PARENTS[0] == -1
    assert all(parent < joint for joint, parent in enumerate(PARENTS))


def test_mirrored_swaps_the_sides_and_keeps_the_tree():
    assert MIRRORED[JOINTS["left_wrist"]] == JOINTS["right_wrist"]
    assert MIRRORED[JOINTS["spine2"]] == JOINTS["spine2"]
    assert all(MIRRORED[MIRRORED[joint]] == joint for joint in range(24))
    assert all(MIRRORED[PARENTS[joint]] == PARENTS[MIRRORED[joint]] for joint in range(1, 24))


def test_parts_are_protocols():
    """Protocol B.4 no. 7: five parts that hold every joint but the pelvis once."""
    assert sorted(joint for joints in PARTS.values() for joint in joints) == list(range(1, 24))
    assert PARTS["left_arm"] == (13, 16, 18, 20, 22) and PARTS["right_leg"] == (2, 5, 8, 11)
    assert sorted(joint for joints in DRAWN_PARTS.values() for joint in joints) == list(range(24))


def test_part_of_joint():
    owner = part_of_joint(PARTS)
    assert owner[JOINTS["pelvis"]] == -1
    assert tuple(PARTS)[owner[JOINTS["left_elbow"]]] == "left_arm"


def test_rest_pose_is_the_rest_joints_moved(rest_joints):
    root = torch.tensor([[1.0, 2.0, 3.0]])
    joints, world = forward_kinematics(at_rest(), root, rest_joints)
    torch.testing.assert_close(joints[0], rest_joints - rest_joints[0] + root)
    torch.testing.assert_close(world, at_rest())


def test_an_elbow_moves_what_hangs_on_it(rest_joints):
    """Turning the left elbow by 90 degrees about y swings the forearm from left to the back; nothing else moves."""
    rotations = at_rest()
    rotations[0, JOINTS["left_elbow"]] = rotation_about("y", torch.tensor(math.pi / 2))
    joints = forward_kinematics(rotations, torch.zeros(1, 3), rest_joints)[0][0]
    still = forward_kinematics(at_rest(), torch.zeros(1, 3), rest_joints)[0][0]
    moved = (joints - still).norm(dim=1) > 1e-6
    assert [name for name, there in zip(JOINT_NAMES, moved, strict=True) if there] == ["left_wrist", "left_hand"]
    bone = rest_joints[JOINTS["left_wrist"]] - rest_joints[JOINTS["left_elbow"]]
    turned = torch.stack([bone[2], bone[1], -bone[0]])
    torch.testing.assert_close(joints[JOINTS["left_wrist"]] - joints[JOINTS["left_elbow"]], turned)


def test_rotations_multiply_from_the_root(rest_joints, generator):
    rotations = axis_angle_to_matrix(torch.randn(2, 24, 3, generator=generator))
    world = forward_kinematics(rotations, torch.zeros(2, 3), rest_joints)[1]
    chain = rotations[:, 0] @ rotations[:, 1] @ rotations[:, 4]
    torch.testing.assert_close(world[:, 4], chain)
    assert (world[:, 4] - rotations[:, 4] @ rotations[:, 1] @ rotations[:, 0]).abs().max() > 0.1


def test_bones_keep_their_length(rest_joints, generator):
    rotations = axis_angle_to_matrix(torch.randn(5, 24, 3, generator=generator))
    joints = forward_kinematics(rotations, torch.randn(5, 3, generator=generator), rest_joints)[0]
    parents = list(PARENTS[1:])
    expected = (rest_joints[1:] - rest_joints[parents]).norm(dim=-1)
    torch.testing.assert_close((joints[:, 1:] - joints[:, parents]).norm(dim=-1), expected.expand(5, -1))


def test_shapes_are_checked(rest_joints):
    with pytest.raises(ShapeError, match=r"rest_joints\): expected shape \[24 3\], got \[22, 3\]"):
        forward_kinematics(at_rest(), torch.zeros(1, 3), rest_joints[:22])
