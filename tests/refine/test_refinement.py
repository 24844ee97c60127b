"""Refinement: what it may move, what it must leave, and that it repairs a limb that coupling left half-blended."""

from dataclasses import replace

import pytest
import torch

from refine.decoupling import Decoupler, DecouplingConfig
from refine.mae import MAE, MAEConfig
from refine.metrics import joint_errors
from refine.motion import Motion, crop
from refine.ownership import Divided
from refine.refinement import BY_PARTS, Problem, RefinementConfig, gaussian_rows, refine_motion, spread_frames
from refine.seeing import Clips
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, slerp
from renderers.skeleton import JOINTS, PARTS

FRAMES = 12
QUICK = RefinementConfig(steps=12, frames=4)


@pytest.fixture(scope="module")
def decoupler():
    """With an inpainter that knows nothing: what is repaired here is repaired by the visible patches."""
    torch.manual_seed(0)
    mae = MAE(MAEConfig(width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1, decoder_heads=2))
    torch.nn.init.zeros_(mae.decoder_pred.weight)
    return Decoupler(Body.free("light"), mae, DecouplingConfig(views=(0.0,)))


def standing(**swings):
    """Arms down; each named joint turns about z by up to the given angle and back."""
    pose = torch.zeros(FRAMES, 24, 3)
    pose[:, JOINTS["left_shoulder"], 2], pose[:, JOINTS["right_shoulder"], 2] = -1.3, 1.3
    wave = torch.sin(torch.linspace(0, 3.14, FRAMES))
    for name, angle in swings.items():
        pose[:, JOINTS[name], 2] += angle * wave
    return Motion(axis_angle_to_matrix(pose), torch.tensor([0.0, 0.9, 0.0]).repeat(FRAMES, 1), 30.0)


@pytest.fixture(scope="module")
def pair():
    """i moves the right leg, j raises the left arm; in the composition the arm is raised half way."""
    i, j = standing(right_hip=-0.5), standing(left_shoulder=1.6)
    truth = i.rotations.clone()
    arm = list(PARTS["left_arm"])
    truth[:, arm] = j.rotations[:, arm]
    half = truth.clone()
    half[:, arm] = slerp(i.rotations[:, arm], j.rotations[:, arm], torch.full((FRAMES, len(arm)), 0.6))
    return i, j, replace(i, rotations=half), replace(i, rotations=truth)


def error(motion, truth, decoupler):
    rest = decoupler.body.rest_joints
    return joint_errors(motion.joints(rest), truth.joints(rest))[:, list(PARTS["left_arm"])].mean()


def test_repairs_a_half_blended_arm(pair, decoupler):
    i, j, composed, truth = pair
    refined = refine_motion(composed, i, j, decoupler, replace(QUICK, steps=40))
    assert refined.after.loss < refined.before.loss
    assert error(refined.motion, truth, decoupler) < 0.5 * error(composed, truth, decoupler)


def test_leaves_root_and_heading_and_stays_a_rotation(pair, decoupler):
    i, j, composed, _ = pair
    motion = refine_motion(composed, i, j, decoupler, QUICK).motion
    assert torch.equal(motion.root, composed.root) and torch.equal(motion.rotations[:, 0], composed.rotations[:, 0])
    identity = motion.rotations @ motion.rotations.mT
    assert torch.allclose(identity, torch.eye(3).expand_as(identity), atol=1e-5)
    assert len(motion) == len(composed) and motion.fps == composed.fps


def test_no_steps_change_nothing(pair, decoupler):
    i, j, composed, _ = pair
    refined = refine_motion(composed, i, j, decoupler, replace(QUICK, steps=0))
    assert torch.allclose(refined.motion.rotations, composed.rotations, atol=1e-6) and refined.history == {}
    assert float(refined.after.loss) == pytest.approx(float(refined.before.loss), rel=1e-3)


def test_seed_decides(pair, decoupler):
    i, j, composed, _ = pair
    one, two, other = (
        refine_motion(composed, i, j, decoupler, replace(QUICK, steps=3, seed=seed)).motion.rotations
        for seed in (1, 1, 2)
    )
    assert torch.equal(one, two) and not torch.equal(one, other)


def test_staying_near_holds(pair, decoupler):
    i, j, composed, _ = pair
    moved = [
        refine_motion(composed, i, j, decoupler, replace(QUICK, stay=stay)).motion.rotations - composed.rotations
        for stay in (0.0, 100.0)
    ]
    assert moved[1].norm() < 0.3 * moved[0].norm()


def test_history_and_progress(pair, decoupler):
    i, j, composed, _ = pair
    seen = []
    config = replace(QUICK, steps=3)
    refined = refine_motion(composed, i, j, decoupler, config, lambda step, terms: seen.append((step, terms)))
    assert [step for step, _ in seen] == [0, 1, 2]
    for name in ("total", "decoupling", "stay", "smooth", "feet"):
        assert refined.history[name] == [terms[name] for _, terms in seen]
    assert seen[0][1]["total"] == pytest.approx(sum(value for name, value in seen[0][1].items() if name != "total"))


def test_refuses_sub_actions_that_do_not_fit(pair, decoupler):
    i, j, composed, _ = pair
    with pytest.raises(UserError, match="8 frames at 30 fps cannot judge 12 at 30 fps; resample and crop"):
        refine_motion(composed, crop(i, 0, 8), j, decoupler, QUICK)
    with pytest.raises(UserError, match="at 60 fps cannot judge"):
        refine_motion(composed, i, replace(j, fps=60.0), decoupler, QUICK)


def test_frames_are_spread_over_the_clip(generator):
    for _ in range(50):
        frames = spread_frames(40, 8, generator)[0]
        assert (frames // 5).tolist() == list(range(8))
    assert spread_frames(3, 8, generator).tolist() == [[0, 1, 2]]


def test_smoothing_keeps_constants_and_damps_shaking():
    rows = gaussian_rows(30, 2.0)
    assert torch.allclose(rows.sum(1), torch.ones(30, dtype=torch.float64))
    shaking = torch.tensor([1.0, -1.0], dtype=torch.float64).repeat(15)
    assert (rows @ shaking)[5:-5].abs().max() < 0.01


def test_a_part_that_nobody_answers_for_stays_exactly(pair, decoupler):
    i, j, composed, _ = pair
    judge = Decoupler(decoupler.body, decoupler.mae, DecouplingConfig(views=(0.0,)))
    motion = refine_motion(composed, i, j, judge, QUICK).motion
    moved = (motion.rotations - composed.rotations).abs().amax((0, 2, 3))
    assert (moved[list(PARTS["left_arm"])] > 1e-3).any()
    assert moved[[*PARTS["right_arm"], *PARTS["torso"], *PARTS["left_leg"]]].max() < 1e-5


def test_two_frames_are_enough(pair, decoupler):
    i, j, composed, _ = (crop(clip, 5, 7) for clip in pair)
    refined = refine_motion(composed, i, j, decoupler, replace(QUICK, steps=3))
    assert torch.isfinite(refined.motion.rotations).all() and refined.after.loss <= refined.before.loss


def test_heading_stays_though_the_sub_actions_face_apart(pair, decoupler):
    i, j, composed, _ = pair
    turned = j.rotations.clone()
    turned[:, 0] = axis_angle_to_matrix(torch.tensor([0.0, 0.8, 0.0]))
    judge = Decoupler(decoupler.body, decoupler.mae, DecouplingConfig(views=(0.0,), ownership="none"))
    motion = refine_motion(composed, i, replace(j, rotations=turned), judge, QUICK).motion
    assert torch.equal(motion.rotations[:, 0], composed.rotations[:, 0])
    assert (motion.rotations[:, 1:] - composed.rotations[:, 1:]).abs().max() > 1e-3


def test_a_view_is_compared_with_the_references_of_its_own_frames(pair, decoupler):
    i, j, composed, _ = pair
    judge = Decoupler(decoupler.body, decoupler.mae, DecouplingConfig(views=(0.0, 90.0)))
    problem = Problem.build(composed, i, j, judge, QUICK)
    frames = torch.tensor([[3, 7]])
    seen = problem.compare(composed.rotations, frames, slice(1, 2)).references[0].seen
    clips = Clips(i.rotations[None], i.root[None])
    assert torch.allclose(seen.pictures, judge.see(clips, frames, problem.cameras[1:]).pictures, atol=1e-4)


@pytest.fixture(scope="module")
def by_parts():
    """i moves the right leg and has the torso for want of a better one; j raises the left arm and leans with it."""
    i, j = standing(right_hip=-0.5), standing(left_shoulder=1.6, spine1=-0.04, spine2=-0.04)
    arm, torso = (torch.tensor([joint in PARTS[name] for joint in range(24)]) for name in ("left_arm", "torso"))
    composed = torch.where(arm[:, None, None], j.rotations, i.rotations)
    return i, j, replace(i, rotations=composed), Divided(~arm, torso)


def test_what_nobody_claims_takes_up_the_others_movement(by_parts, decoupler):
    i, j, composed, divided = by_parts
    refined = refine_motion(composed, i, j, decoupler, replace(QUICK, steps=40, stay=0, free_rate=0), divided=divided)
    spine = JOINTS["spine1"]
    movement = (j.six - j.six.mean(0))[:, spine]
    moved = (refined.motion.six - composed.six)[:, spine]
    share = float((moved * movement).sum() / movement.square().sum())
    assert 0.2 < share < 0.8  # i's picture asks for 0 and j's for 1
    assert (moved - share * movement).norm() < 0.1 * movement.norm()
    assert refined.after.loss < refined.before.loss


def test_claimed_parts_stay(by_parts, decoupler):
    i, j, composed, divided = by_parts
    motion = refine_motion(composed, i, j, decoupler, QUICK, divided=divided).motion
    moved = (motion.rotations - composed.rotations).abs().amax((0, 2, 3))
    assert moved[~divided.unclaimed].max() < 1e-6
    assert moved[divided.unclaimed].max() > 1e-3


def test_an_inpainter_without_parts_can_be_asked_too(by_parts):
    i, j, composed, divided = by_parts
    mae = MAE(MAEConfig(channels=1, width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1, decoder_heads=2))
    refined = refine_motion(composed, i, j, Decoupler(Body.free("light"), mae), replace(QUICK, steps=2), None, divided)
    moved = (refined.motion.rotations - composed.rotations).abs().amax((0, 2, 3))
    assert moved[~divided.unclaimed].max() < 1e-6


def test_by_parts_small_losses_are_followed(by_parts, decoupler):
    """Without a configuration the one for compositions by parts is taken, which lets shares go far."""
    assert BY_PARTS.stay < RefinementConfig().stay and BY_PARTS.free_rate < RefinementConfig().free_rate
    i, j, composed, divided = (*(crop(clip, 4, 8) for clip in by_parts[:3]), by_parts[3])
    plain, named = (
        refine_motion(composed, i, j, decoupler, config, divided=divided).motion.rotations
        for config in (None, BY_PARTS)
    )
    assert torch.equal(plain, named)
