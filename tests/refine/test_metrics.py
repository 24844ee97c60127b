"""Measures of motions, each on a case whose value is known."""

import pytest
import torch

from refine.metrics import (
    FEET,
    floor_penetration,
    floor_penetrations,
    foot_skate,
    foot_skates,
    jitter,
    jitters,
    joint_errors,
    mean_joint_error,
    motion_errors,
    nearest_true,
    part_errors,
    planted_feet,
)
from renderers.checks import UserError
from renderers.skeleton import DRAWN_PARTS, JOINTS


@pytest.fixture
def joints(generator):
    return torch.rand(30, 24, 3, generator=generator, dtype=torch.float64)


def test_error_ignores_where_the_body_stands(joints):
    assert joint_errors(joints + torch.tensor([3.0, 0.0, -2.0]), joints).max() < 1e-12


def test_error_of_one_arm(joints):
    moved = joints.clone()
    moved[:, DRAWN_PARTS["left_arm"]] += torch.tensor([0.03, 0.04, 0.0])
    assert mean_joint_error(moved, joints) == pytest.approx(0.05 * 5 / 23)
    errors = part_errors(moved, joints)
    assert errors.pop("left_arm") == pytest.approx(0.05)
    assert max(errors.values()) < 1e-12


def test_pelvis_is_not_counted(joints):
    moved = joints.clone()
    moved[:, 1:] += torch.tensor([0.1, 0.0, 0.0])
    assert mean_joint_error(moved, joints) == pytest.approx(0.1)
    assert part_errors(moved, joints)["torso"] == pytest.approx(0.1)


def test_skate_is_the_speed_of_low_feet_only():
    joints = torch.zeros(10, 24, 3)
    joints[:, FEET[:2], 0] = torch.arange(10.0)[:, None] * 0.01
    assert foot_skate(joints, fps=30.0) == pytest.approx(0.15)
    joints[:, FEET[0], 1] = torch.linspace(0.0, 9.0, 10)
    assert foot_skate(joints, fps=30.0) == pytest.approx(0.3 * 1 / 3, rel=1e-4)


def test_a_foot_that_rises_on_the_spot_does_not_skate():
    joints = torch.zeros(10, 24, 3)
    joints[:, FEET, 1] = torch.linspace(0.0, 0.04, 10)[:, None]
    assert foot_skate(joints, fps=30.0) == 0.0


def test_a_foot_that_lands_does_not_skate_on_its_way_down_nor_up():
    joints = torch.zeros(5, 24, 3)
    joints[:, FEET[0], 1] = torch.tensor([0.3, 0.0, 0.0, 0.3, 0.3])
    joints[:, FEET[0], 0] = torch.tensor([0.0, 1.0, 1.0, 2.0, 3.0])  # moves in the air alone
    assert foot_skate(joints, fps=30.0) == 0.0


def test_each_foot_joint_stands_at_its_own_height():
    joints = torch.zeros(4, 24, 3)
    joints[:, JOINTS["left_ankle"], 1] = 0.3
    joints[:, JOINTS["left_ankle"], 0] = torch.arange(4.0) * 0.002
    assert planted_feet(joints, fps=30.0).all()
    assert foot_skate(joints, fps=30.0) == pytest.approx(0.06 / 4)


def test_planted_feet_are_low_and_slow():
    joints = torch.zeros(5, 24, 3)
    joints[:, JOINTS["right_foot"], 1] = torch.tensor([0.0, 0.0, 0.2, 0.2, 0.0])
    joints[:, JOINTS["left_ankle"], 2] = torch.arange(5.0) * 0.1
    planted = planted_feet(joints, fps=30.0)
    assert planted[:, FEET.index(JOINTS["left_ankle"])].tolist() == [False] * 5
    assert planted[:, FEET.index(JOINTS["right_foot"])].tolist() == [True, True, False, False, False]
    assert planted[:, FEET.index(JOINTS["right_ankle"])].all()


def test_jitter_is_the_third_derivative():
    time = torch.arange(40, dtype=torch.float64) / 30
    joints = torch.zeros(40, 24, 3, dtype=torch.float64)
    joints[..., 1] = (2.0 * time**3)[:, None]
    assert jitter(joints, 30.0) == pytest.approx(12.0)
    joints[..., 1] = (5.0 * time**2)[:, None]
    assert jitter(joints, 30.0) < 1e-6
    with pytest.raises(UserError, match="at least 4 frames, got 3"):
        jitter(joints[:3], 30.0)


def standing(frames: int) -> torch.Tensor:
    """[T 24 3] of a body at 1 m whose toes are on the floor at 0.2 m and whose ankles 8 cm above it."""
    joints = torch.ones(frames, 24, 3)
    joints[:, FEET[:2], 1], joints[:, FEET[2:], 1] = 0.28, 0.2
    return joints


def test_standing_and_jumping_do_not_reach_into_the_floor():
    joints = standing(30)
    assert floor_penetration(joints) == 0.0
    joints[5:15, :, 1] += 0.3
    assert floor_penetration(joints) == 0.0


def test_penetration_is_the_mean_depth_of_the_lowest_foot():
    joints = standing(30)
    joints[10:13, JOINTS["left_foot"], 1] -= 0.05
    assert floor_penetration(joints) == pytest.approx(0.05 * 3 / 30)
    joints[10:13, JOINTS["right_foot"], 1] -= 0.02
    assert floor_penetration(joints) == pytest.approx(0.05 * 3 / 30)
    assert floor_penetration(joints - torch.tensor([0.0, 7.0, 0.0])) == pytest.approx(0.05 * 3 / 30, abs=1e-6)


def test_penetration_of_a_known_floor():
    joints = standing(10)
    assert floor_penetration(joints, floor=0.3) == pytest.approx(0.1)
    assert floor_penetration(joints, floor=0.1) == 0.0


def test_nearest_true_is_the_least_mean_joint_error(joints, generator):
    references = torch.rand(7, 30, 24, 3, generator=generator, dtype=torch.float64)
    motions = torch.stack([joints, references[4] + 0.01 * joints, references[2] + torch.tensor([5.0, 0.0, 1.0])])
    expected = [min(mean_joint_error(motion, reference) for reference in references) for motion in motions]
    found = nearest_true(motions, references)
    assert found.tolist() == pytest.approx(expected)
    assert found[1] < 0.02 and found[2] < 1e-12
    assert torch.equal(nearest_true(motions, references, values=1), found)
    assert nearest_true(motions.float(), references.float()).dtype == torch.float64


def test_many_clips_at_once_are_each_measured_alone(generator):
    """Clips that differ in how many feet are low, in height and in tremor; one of them never stands."""
    scales = torch.tensor([0.01, 0.05, 0.2, 1.0])[:, None, None, None]
    clips = torch.cat([scales * torch.rand(4, 12, 24, 3, generator=generator), torch.zeros(1, 12, 24, 3)])
    clips[3, :, FEET, 1] = 10.0 ** torch.arange(12)[:, None]
    for many, one in ((foot_skates, foot_skate), (jitters, jitter)):
        assert many(clips, 30.0).tolist() == pytest.approx([one(clip, 30.0) for clip in clips], rel=1e-12)
    assert floor_penetrations(clips).tolist() == pytest.approx([floor_penetration(clip) for clip in clips], rel=1e-12)
    assert foot_skates(clips, 30.0)[0] > 0 == foot_skates(clips, 30.0)[3]
    feet, expected = clips[1][:, FEET], []
    for foot in feet.unbind(1):
        low = [bool(height < foot[:, 1].min() + 0.05) for height in foot[:, 1]]
        expected += [
            30 * float((foot[t + 1] - foot[t])[[0, 2]].norm()) for t in range(11) if low[t] and low[t + 1]
        ]  # fmt: skip
    assert float(foot_skates(clips, 30.0)[1]) == pytest.approx(sum(expected) / len(expected), rel=1e-5)


def test_errors_of_every_motion_to_every_reference(joints, generator):
    references = torch.rand(3, 30, 24, 3, generator=generator, dtype=torch.float64)
    motions = torch.stack([joints, joints.flip(0)])
    expected = [[mean_joint_error(motion, one) for one in references] for motion in motions]
    for found in (motion_errors(motions, references), motion_errors(motions, references, values=1)):
        assert found.shape == (2, 3) and found.tolist() == [pytest.approx(row, rel=1e-12) for row in expected]
    rough = motion_errors(motions.float(), references.float())
    assert rough.dtype == torch.float64 and rough.tolist() == [pytest.approx(row, rel=1e-6) for row in expected]
    assert motion_errors(motions[:0], references).shape == (0, 3)


def test_nearest_true_needs_references_of_the_same_length(joints):
    with pytest.raises(UserError, match="there are no references"):
        nearest_true(joints[None], joints[None][:0])
    with pytest.raises(UserError, match="with T=30"):
        nearest_true(joints[None], joints[None, :20])
