"""Rotations from positions: exact where that can be, hinges that bend as hinges do, no flips, nothing that breaks."""

import math
import time

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from refine import synthetic
from refine.formats.files import load_motion
from refine.motion import Motion
from refine.positions.inverse_kinematics import BLOCK, fit_joints
from refine.positions.joint_layouts import HUMANML3D_LAYOUT, KIT_LAYOUT, LAYOUTS, SMPL_LAYOUT
from renderers.body import Body
from renderers.checks import ShapeError, UserError
from renderers.rotations import axis_angle_to_matrix, heading, matrix_to_axis_angle, rotation_about, rotation_angle
from renderers.skeleton import JOINT_NAMES, JOINTS, MIRRORED, PARENTS, forward_kinematics

REST = Body.free("light").rest_joints
MILLIMETRE = 1e-3


def acted(name: str, frames: int = 60, seed: int = 0) -> Motion:
    return synthetic.perform(synthetic.draw(name, torch.Generator().manual_seed(seed)), frames, REST)


def other_body(seed: int) -> torch.Tensor:
    """[24 3] every kind of bone 0.7 to 1.3 times as long, left as right."""
    random = torch.Generator().manual_seed(seed)
    kinds = [name.removeprefix("left_").removeprefix("right_") for name in JOINT_NAMES]
    factors = {kind: 0.7 + 0.6 * float(torch.rand((), generator=random)) for kind in dict.fromkeys(kinds)}
    rest = REST.double().clone()
    for joint in range(1, 24):
        rest[joint] = rest[PARENTS[joint]] + factors[kinds[joint]] * (REST[joint] - REST[PARENTS[joint]]).double()
    return rest


def largest_step(motion: Motion) -> float:
    """Degrees that any joint turns from one frame to the next."""
    return math.degrees(float(rotation_angle(motion.rotations[:-1].mT @ motion.rotations[1:]).max()))


def stood(motion: Motion, rest: torch.Tensor) -> torch.Tensor:
    return forward_kinematics(motion.rotations.double(), motion.root.double(), rest.double())[0]


# --- Exactness -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [24, 22])
@pytest.mark.parametrize("name", ["walk", "squat", "wave-both-hands", "standing-rotation", "left-kicking"])
def test_the_body_s_own_joints_are_met_where_they_are(name, count):
    motion = acted(name)
    fit = fit_joints(motion.joints(REST)[:, :count], REST, motion.fps, label=name)
    joints = fit.motion.joints(REST)[:, :count]
    torch.testing.assert_close(joints, motion.joints(REST)[:, :count], atol=0.2 * MILLIMETRE, rtol=0)
    assert (fit.scale, fit.lift, fit.swapped, fit.motion.label) == (1.0, 0.0, False, name)
    assert fit.error < 0.1 * MILLIMETRE and fit.errors.shape == (60,) and fit.stretch < 1e-4


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), unit=st.sampled_from([0.01, 1.0, 39.37, 1000.0]))
def test_other_proportions_and_units_give_the_same_posture(seed, unit):
    """Truth: the same rotations on our body, on a path scaled by the legs. Hips differ from pelvis to pelvis, so the
    two stand a constant apart from each other."""
    motion = acted(synthetic.ACTIONS[seed % len(synthetic.ACTIONS)], 40, seed)
    theirs = other_body(seed)
    fit = fit_joints(unit * stood(motion, theirs), REST, motion.fps)
    lengths = [sum(float((rest[b] - rest[a]).norm()) for a, b in ((1, 4), (4, 7))) for rest in (theirs, REST)]
    assert fit.scale == pytest.approx(lengths[1] / lengths[0] / unit, rel=1e-4)
    assert fit.error < 0.1 * MILLIMETRE
    ours = fit.motion.joints(REST)
    truth = Motion(motion.rotations, motion.root * fit.scale * unit, motion.fps).joints(REST)
    apart = (ours - ours[:, :1]) - (truth - truth[:, :1])
    assert float(apart.norm(dim=-1).max()) < MILLIMETRE


def test_smpl_s_own_posture_is_kept():
    """SMPL's pelvis and spine lie otherwise in its T-pose than ours. What stands straight there stands straight here,
    and limbs point where they point."""
    motion = acted("walk")
    theirs = stood(motion, SMPL_LAYOUT.rest)[:, :22]
    fit = fit_joints(theirs, REST)
    assert fit.motion.fps == HUMANML3D_LAYOUT.fps == 20
    turned = forward_kinematics(fit.motion.rotations, fit.motion.root, REST)[1]
    truth = forward_kinematics(motion.rotations, motion.root, REST)[1]
    for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "left_collar"):
        angle = rotation_angle(turned[:, JOINTS[name]].mT @ truth[:, JOINTS[name]])
        unseen = 3.0 if name in ("neck", "left_collar") else 0.1  # how a single bone is turned about itself
        assert float(angle.max()) < math.radians(unseen), name
    joints = fit.motion.joints(REST).double()
    for start, end in ((1, 4), (4, 7), (16, 18), (18, 20), (17, 19), (19, 21)):
        here, there = (values[:, end] - values[:, start] for values in (joints, theirs))
        assert float(torch.cosine_similarity(here, there, dim=-1).min()) > 1 - 1e-6


def test_what_stands_on_its_joints_stands_on_the_floor():
    """HumanML3D's floor is at the lowest joint; ours is below it by what a foot is thick."""
    motion = acted("walk")
    theirs = stood(motion, other_body(3))
    theirs[..., 1] -= theirs[..., 1].min()
    joints = fit_joints(theirs, REST).motion.joints(REST)
    assert float(joints[..., 1].amin(dim=1).quantile(0.02)) == pytest.approx(float(REST[:, 1].min()), abs=1e-5)


@pytest.mark.parametrize("count", [22, 24])
def test_real_clips(real_clips, count):
    errors = []
    for path in real_clips[::150]:
        motion = load_motion(path, REST)
        fit = fit_joints(stood(motion, other_body(count))[:, :count], REST, motion.fps)
        errors.append(fit.error)
        assert largest_step(fit.motion) < largest_step(motion) + 15
    assert max(errors) < 0.02


# --- KIT -------------------------------------------------------------------------------------------------------------


def kit(motion: Motion) -> torch.Tensor:
    """[T 21 3] in the unit of that data set, on a body of its make."""
    joints = stood(motion, KIT_LAYOUT.rest)
    positions = torch.zeros(len(motion), 21, 3, dtype=joints.dtype)
    for index, joint in enumerate(KIT_LAYOUT.joints):
        if joint >= 0:
            positions[:, index] = joints[:, joint]
    for index, foot in ((14, "right"), (19, "left")):  # half way along the foot
        positions[:, index] = (joints[:, JOINTS[f"{foot}_ankle"]] + joints[:, JOINTS[f"{foot}_foot"]]) / 2
    return 640 * positions


@pytest.mark.parametrize("name", ["walk", "wave-both-hands", "squat", "forward-lunging"])
def test_kit_s_twenty_one_joints(name):
    motion = acted(name)
    fit = fit_joints(kit(motion), REST)
    assert fit.motion.fps == 12.5 and not fit.swapped
    assert fit.error < 0.02 and float(fit.errors.max()) < 0.04
    assert largest_step(fit.motion) < largest_step(motion) + 15
    assert float((heading(fit.motion.rotations[:, 0]) - heading(motion.rotations[:, 0])).abs().max()) < 0.05


def test_layouts_name_every_joint_once():
    for count, layout in LAYOUTS.items():
        known = [joint for joint in layout.joints if joint >= 0]
        assert len(layout.joints) == count and len(set(known)) == len(known)
        across = layout.rest * torch.tensor([-1.0, 1, 1], dtype=torch.float64)
        assert torch.equal(layout.rest[list(MIRRORED)], across)
        assert layout.rest[JOINTS["left_wrist"], 0] > 0 and layout.rest[JOINTS["left_foot"], 2] > 0
    assert KIT_LAYOUT.joints[11] == JOINTS["right_hip"] and KIT_LAYOUT.joints[20] == JOINTS["left_foot"]


def test_sides_that_are_exchanged_are_noticed():
    motion = acted("walk")
    joints = stood(motion, other_body(1))
    fit = fit_joints(joints[:, list(MIRRORED)], REST, motion.fps)
    right = fit_joints(joints, REST, motion.fps)
    assert fit.swapped and not right.swapped
    torch.testing.assert_close(fit.motion.rotations, right.motion.rotations)


# --- Hinges ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["walk", "run", "squat", "punching", "elbow-circling"])
def test_knees_and_elbows_bend_as_hinges(name):
    """A knee turns about +x (heel to seat), the left elbow about -y, the right about +y, and about nothing else."""
    fit = fit_joints(acted(name).joints(REST)[:, :22], REST, 30.0)
    turns = matrix_to_axis_angle(fit.motion.rotations)
    for joint, axis, sign in (("left_knee", 0, 1), ("right_knee", 0, 1), ("left_elbow", 1, -1), ("right_elbow", 1, 1)):
        angle = turns[:, JOINTS[joint]]
        assert float((sign * angle[:, axis]).min()) > -0.15, joint
        others = angle[:, [other for other in range(3) if other != axis]]
        assert float(others.abs().max()) < 0.35, joint


def hanging(bend: torch.Tensor, turn: torch.Tensor | None = None) -> Motion:
    """Arms at the sides, elbows and knees bent by ``bend`` [T], thighs turned about themselves by ``turn`` [T]."""
    angles = torch.zeros(len(bend), 24, 3)
    angles[:, JOINTS["left_shoulder"], 2], angles[:, JOINTS["right_shoulder"], 2] = -1.4, 1.4
    angles[:, JOINTS["left_elbow"], 1], angles[:, JOINTS["right_elbow"], 1] = -bend, bend
    angles[:, [JOINTS["left_knee"], JOINTS["right_knee"]], 0] = bend[:, None]
    if turn is not None:
        angles[:, [JOINTS["left_hip"], JOINTS["right_hip"]], 1] = turn[:, None]
    root = REST[0].expand(len(bend), 3)
    return Motion(axis_angle_to_matrix(angles), root, 30.0)


def straight_limbs(joints: torch.Tensor) -> torch.Tensor:
    """Elbows and knees put onto the line between their neighbours, as straight as floats are."""
    joints = joints.clone()
    for a, b, c in ((1, 4, 7), (2, 5, 8), (16, 18, 20), (17, 19, 21)):
        upper, lower = ((joints[:, y] - joints[:, x]).norm(dim=-1) for x, y in ((a, b), (b, c)))
        joints[:, b] = joints[:, a] + (upper / (upper + lower))[:, None] * (joints[:, c] - joints[:, a])
    return joints


@pytest.mark.parametrize("count", [22, 24])
def test_straight_limbs_have_a_plane_from_the_t_pose(count):
    joints = straight_limbs(hanging(torch.zeros(5)).joints(REST))
    fit = fit_joints(joints[:, :count], REST, 30.0)
    turns = matrix_to_axis_angle(fit.motion.rotations)
    assert float(turns[:, [JOINTS["left_elbow"], JOINTS["left_knee"]]].norm(dim=-1).max()) < 0.2
    assert float(turns[:, JOINTS["left_hip"]].norm(dim=-1).max()) < 0.2  # the thigh is not turned about itself
    torch.testing.assert_close(turns[:, JOINTS["left_shoulder"]], turns.new_tensor([[0, 0, -1.4]]).expand(5, 3),
                               atol=0.05, rtol=0)  # fmt: skip


def test_a_limb_that_straightens_keeps_the_plane_it_had():
    """Elbows bent in a plane turned by 0.8, straight for half a second, bent again: no frame turns the arm back."""
    time_ = torch.linspace(0, 1, 60)
    bend = (time_ * 2 * math.pi).cos().clamp(min=0)
    motion = hanging(bend)
    rotations = motion.rotations.clone()
    twist = rotation_about("x", torch.tensor(-0.8))  # about the left upper arm
    rotations[:, JOINTS["left_shoulder"]] = rotations[:, JOINTS["left_shoulder"]] @ twist
    motion = Motion(rotations, motion.root, 30.0)
    fit = fit_joints(motion.joints(REST)[:, :22], REST, 30.0)
    off = rotation_angle(fit.motion.rotations[:, JOINTS["left_shoulder"]].mT @ rotations[:, JOINTS["left_shoulder"]])
    assert float(off.max()) < 0.15
    assert largest_step(fit.motion) < largest_step(motion) + 2


def test_straight_legs_turn_with_their_feet():
    turn = torch.linspace(0, 0.7, 30)
    motion = hanging(torch.zeros(30), turn)
    fit = fit_joints(straight_limbs(motion.joints(REST))[:, :22], REST, 30.0)
    got = matrix_to_axis_angle(fit.motion.rotations)[:, JOINTS["left_hip"], 1]
    torch.testing.assert_close(got, turn, atol=0.15, rtol=0)


def test_the_turn_of_a_straight_limb_does_not_shake_with_its_noise():
    """Limbs bent by two degrees and shaken by a millimetre: their plane is nearly noise."""
    motion = hanging(torch.full((120,), 0.03))
    shaken = motion.joints(REST) + MILLIMETRE * torch.randn(120, 24, 3, generator=torch.Generator().manual_seed(0))
    fit = fit_joints(shaken[:, :22], REST, 30.0)
    limbs = [JOINTS[f"{side}_{joint}"] for side in ("left", "right") for joint in ("hip", "shoulder")]
    step = rotation_angle(fit.motion.rotations[:-1, limbs].mT @ fit.motion.rotations[1:, limbs])
    assert math.degrees(float(step.max())) < 15


# --- Limits ----------------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    frames=st.integers(1, 6),
    count=st.sampled_from([21, 22, 24]),
    gone=st.sets(st.integers(0, 23), max_size=24),
    unit=st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_whatever_the_positions_the_rotations_are_rotations(seed, frames, count, gone, unit):
    """Random points, some of them all at one place: bones without length, pelvis and chest without extent."""
    random = torch.Generator().manual_seed(seed)
    positions = unit * torch.randn(frames, count, 3, generator=random)
    positions[:, [joint for joint in gone if joint < count]] = positions[:, :1].clone()
    try:
        fit = fit_joints(positions, REST, 30.0)
    except UserError as error:
        assert "a leg has no length" in str(error)
        return
    rotations = fit.motion.rotations
    assert bool(rotations.isfinite().all()) and bool(fit.motion.root.isfinite().all())
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand_as(rotations), atol=1e-5, rtol=0)
    assert float((torch.linalg.det(rotations) - 1).abs().max()) < 1e-4
    assert math.isfinite(fit.error) and math.isfinite(fit.stretch)


def test_a_body_that_is_one_point_is_refused():
    with pytest.raises(UserError, match="clip: a leg has no length; give the joint positions of a body"):
        fit_joints(torch.ones(3, 22, 3), REST, source="clip")


def test_an_arm_without_length_leaves_the_rest_alone():
    motion = acted("walk")
    joints = motion.joints(REST)
    for joint in ("left_elbow", "left_wrist", "left_hand"):
        joints[:, JOINTS[joint]] = joints[:, JOINTS["left_shoulder"]]
    fit = fit_joints(joints, REST, 30.0)
    legs = [JOINTS[f"{side}_{joint}"] for side in ("left", "right") for joint in ("hip", "knee", "ankle")]
    off = rotation_angle(fit.motion.rotations[:, legs].mT @ motion.rotations[:, legs])
    assert float(off.max()) < 0.35 and fit.error < MILLIMETRE


def test_long_clips_are_fitted_in_blocks_that_do_not_show(monkeypatch):
    motion = acted("run", 300)
    positions = motion.joints(REST)[:, :22]
    whole = fit_joints(positions, REST, 30.0)
    monkeypatch.setattr("refine.positions.inverse_kinematics.BLOCK", 37)
    parts = fit_joints(positions, REST, 30.0)
    assert BLOCK > 300
    torch.testing.assert_close(parts.motion.rotations, whole.motion.rotations, atol=1e-6, rtol=0)
    torch.testing.assert_close(parts.motion.root, whole.motion.root, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("positions", "fps", "message"),
    [
        (torch.zeros(4, 19, 3), None, r"clip: has 19 joints; known are 24 \(SMPL\), 22 \(HumanML3D\), 21 \(KIT\)"),
        (torch.zeros(0, 22, 3), None, "clip: has no frames"),
        (torch.full((2, 22, 3), math.nan), None, "clip: value nan at frame 0, joint 0, coordinate 0"),
        (torch.rand(2, 22, 3), math.nan, "clip: frame rate nan"),
        (torch.rand(2, 22, 3), 0.0, "clip: frame rate 0.0"),
    ],
)
def test_bad_positions_are_one_line(positions, fps, message):
    with pytest.raises(UserError, match=message) as caught:
        fit_joints(positions, REST, fps, source="clip")
    assert "\n" not in str(caught.value)


def test_shapes_are_checked():
    with pytest.raises(ShapeError, match=r"fit_joints\(positions\)"):
        fit_joints(torch.zeros(4, 22), REST)
    with pytest.raises(UserError, match="has 22 joints"):
        fit_joints(torch.zeros(4, 22, 3), REST, layout=KIT_LAYOUT)


def test_a_thousand_frames_a_second():
    """Everything counted; the benchmark measures several thousand. The best of three, for other work may be running."""
    positions = acted("walk", 1000).joints(REST)[:, :22] * 1.1
    seconds = []
    for _ in range(3):
        start = time.process_time()
        fit_joints(positions, REST, 30.0)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 1.0
