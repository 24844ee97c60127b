"""Coupling by parts against a table written out by hand, and against the five steps of the paper one by one."""

from itertools import product

import pytest
import torch

from refine.composition_by_parts import compose_by_parts
from refine.coupling_by_parts import Contest, compatible, couple_by_parts, divide, random_parts, unclaimed
from refine.decoupling import Decoupler, DecouplingConfig
from refine.mae import MAE, MAEConfig
from refine.motion import Motion, crop, resample
from refine.refinement import RefinementConfig
from refine.synthetic import draw, perform
from refine.text.parts import BODY_PARTS, Parts
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix

# Of SMPL-H's 22 joints as SINC numbers them; the two hands of 24 behind.
TABLE = {
    "global": [0],
    "torso": [3, 6, 9, 12, 15],
    "left arm": [13, 16, 18, 20, 22],
    "right arm": [14, 17, 19, 21, 23],
    "left leg": [1, 4, 7, 10],
    "right leg": [2, 5, 8, 11],
}
WALK = Parts.of(["global", "left leg", "right leg"])
WAVE = Parts.of(["right arm"])
NOTHING = Parts.of([])
EVERY = [Parts(*map(bool, bits)) for bits in product((0, 1), repeat=6)]


@pytest.fixture(scope="module")
def rest_joints() -> torch.Tensor:
    return Body.free("light").rest_joints


def clip(seed: int, frames: int = 6, fps: float = 30.0, label: str = "") -> Motion:
    random = torch.Generator().manual_seed(seed)
    rotations = axis_angle_to_matrix(torch.randn(frames, 24, 3, generator=random))
    return Motion(rotations, torch.randn(frames, 3, generator=random), fps, label, f"clip {seed}")


def five_steps(a: Motion, b: Motion, parts_a: Parts, parts_b: Parts) -> tuple[torch.Tensor, torch.Tensor]:
    """The published procedure, step by step, on clips of one length."""
    marked_a, marked_b = (dict(zip(BODY_PARTS, parts, strict=True)) for parts in (parts_a, parts_b))
    if sum(parts_a) < sum(parts_b):
        a, b, marked_a, marked_b = b, a, marked_b, marked_a
    low = ("left leg", "right leg", "global")
    of_b = any(marked_b[name] for name in low)
    for name in low:
        marked_a[name], marked_b[name] = not of_b, of_b
    for name in BODY_PARTS:
        if not marked_b[name]:
            marked_a[name] = True
    rotations = torch.full_like(a.rotations, torch.nan)
    for motion, marked in ((a, marked_a), (b, marked_b)):
        for name in BODY_PARTS:
            if marked[name]:
                rotations[:, TABLE[name]] = motion.rotations[:, TABLE[name]]
    return rotations, (b if of_b else a).root


def test_every_pair_of_part_vectors_is_composed_by_the_five_steps(rest_joints):
    a, b = clip(0), clip(1)
    kept = [motion.rotations.clone() for motion in (a, b)]
    for parts_a, parts_b in product(EVERY[::3], EVERY[::5]):
        coupled = couple_by_parts(a, b, parts_a, parts_b, rest_joints)
        rotations, root = five_steps(a, b, parts_a, parts_b)
        assert torch.equal(coupled.motion.rotations, rotations), (parts_a, parts_b)
        assert torch.equal(coupled.motion.root, root)
    assert torch.equal(a.rotations, kept[0]) and torch.equal(b.rotations, kept[1])


def test_weights_are_the_first_ones_whatever_the_order(rest_joints):
    one = couple_by_parts(clip(0), clip(1), WALK, WAVE, rest_joints)
    other = couple_by_parts(clip(1), clip(0), WAVE, WALK, rest_joints)
    arm = torch.zeros(24)
    arm[TABLE["right arm"]] = 1
    assert torch.equal(one.weights, 1 - arm) and torch.equal(other.weights, arm)
    assert torch.equal(one.motion.rotations, other.motion.rotations)
    assert torch.equal(one.energies_i, other.energies_j) and one.energies_i.shape == (24,)


def test_longer_clips_are_trimmed_to_their_middle_or_from_their_start(rest_joints):
    a, b = clip(0, frames=11), clip(1, frames=6)
    for centred, start in ((True, 2), (False, 0)):
        coupled = couple_by_parts(a, b, WALK, WAVE, rest_joints, centred)
        assert torch.equal(coupled.motion.root, a.root[start : start + 6])
        assert torch.equal(coupled.motion.rotations[:, 17], b.rotations[:, 17])
    assert torch.equal(couple_by_parts(b, a, WALK, WAVE, rest_joints).motion.rotations[:, 17], a.rotations[2:8, 17])
    assert len(a) == 11


def test_other_rates_and_single_frames_are_refused(rest_joints):
    with pytest.raises(UserError, match="30 fps, clip 1 15"):
        couple_by_parts(clip(0), clip(1, fps=15.0), WALK, WAVE, rest_joints)
    with pytest.raises(UserError, match="frame"):
        couple_by_parts(clip(0), crop(clip(1), 0, 1), WALK, WAVE, rest_joints)


def test_whoever_has_fewer_parts_wins_and_that_is_told():
    kick, bow = Parts.of(["left leg"]), Parts.of(["torso", "global"])
    division = divide([WALK, kick])
    assert division.order == (0, 1) and division.owners == (1, 0, 0, 0, 1, 1)
    assert division.contests == (Contest("legs", 1, (0,)),)
    assert divide([kick, WALK]).contests == (Contest("legs", 0, (1,)),)
    assert divide([WALK, WAVE]).contests == ()
    assert divide([WALK, bow, Parts.of(["torso"])]).contests == (Contest("legs", 1, (0,)), Contest("torso", 2, (1,)))
    assert divide([WAVE, WAVE]).contests == (Contest("right arm", 1, (0,)),)  # ties: the later


def test_of_many_the_one_with_most_parts_is_the_base():
    nod, both_arms = Parts.of(["torso"]), Parts.of(["left arm", "right arm"])
    division = divide([WAVE, nod, WALK, both_arms])
    assert division.order == (2, 3, 0, 1)
    assert division.owners == (2, 1, 3, 0, 2, 2)
    assert division.parts_of(3).names == ("left arm",)
    assert division.joints_of(1).nonzero().flatten().tolist() == TABLE["torso"]
    assert divide([NOTHING, NOTHING]).owners == (0,) * 6
    with pytest.raises(UserError):
        divide([])


def test_compatible_actions_share_no_part():
    assert compatible(WALK, WAVE) and compatible(NOTHING, WALK)
    assert not compatible(WALK, Parts.of(["left leg"])) and not compatible(WAVE, WAVE)


def test_unclaimed_is_what_no_text_is_about():
    assert unclaimed([WALK, WAVE]).nonzero()[:, 0].tolist() == sorted(TABLE["torso"] + TABLE["left arm"])
    arms = [*TABLE["left arm"], *TABLE["right arm"]]
    assert unclaimed([Parts.of(["torso"]), NOTHING]).nonzero()[:, 0].tolist() == sorted(arms)  # legs are never


def test_random_parts_are_fair_and_seeded():
    drawn = [random_parts(torch.Generator().manual_seed(seed)) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] and all(isinstance(bit, bool) for bit in drawn[0])
    generator = torch.Generator().manual_seed(0)
    share = torch.tensor([random_parts(generator) for _ in range(2000)]).double().mean(0)
    assert (share - 0.5).abs().max() < 0.05  # 4.5 deviations


# --- in one call -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def three(rest_joints) -> list[Motion]:
    random = torch.Generator().manual_seed(1)
    lengths = (("walk", 8), ("wave-right-hand", 12), ("raise-up-left-hand", 9))
    return [perform(draw(name, random), frames, rest_joints) for name, frames in lengths]


RAISE = Parts.of(["left arm"])


def test_three_actions_become_one(three, rest_joints):
    wave, walk, lift = three[1], three[0], three[2]
    made = compose_by_parts([wave, walk, lift], [WAVE, WALK, RAISE], rest_joints)
    assert made.made == "coupled" and made.traces() == {}
    assert torch.equal(made.motion.root, walk.root)
    for motion, start, part in ((walk, 0, "left leg"), (wave, 2, "right arm"), (lift, 0, "left arm")):
        expected = motion.rotations[start : start + 8, TABLE[part]]
        assert torch.equal(made.motion.rotations[:, TABLE[part]], expected)
    assert made.owners == {
        "global": "walk",
        "torso": "walk",
        "left arm": "raise-up-left-hand",
        "right arm": "wave-right-hand",
        "left leg": "walk",
        "right leg": "walk",
    }
    assert made.motion.label == "wave-right-hand+walk+raise-up-left-hand"


def test_the_result_is_refined_from_its_own_sub_actions(three, rest_joints):
    size = MAEConfig(size=32, width=16, depth=1, heads=1, decoder_width=16, decoder_depth=1, decoder_heads=1)
    decoupler = Decoupler(Body.free("light"), MAE(size), DecouplingConfig(views=(0.0,)))
    steps = RefinementConfig(steps=2, frames=2)
    made = compose_by_parts(three[:2], [WALK, WAVE], rest_joints, decoupler, steps, centred=False)
    assert made.made == "refined" and len(made.history["total"]) == 2
    assert (made.i.label, made.j.label) == ("walk", "wave-right-hand")
    assert torch.equal(made.j.rotations, three[1].rotations[:8])
    moved = (made.motion.rotations - made.coupling.motion.rotations).abs().amax((0, 2, 3)) > 1e-6
    assert moved.any() and set(moved.nonzero()[:, 0].tolist()) <= set(TABLE["torso"] + TABLE["left arm"])
    owned = [reference.owned.answers[0].tolist() for reference in made.before.references]
    assert owned == [[1, 1, 1, 0, 1, 1], [1, 1, 1, 1, 0, 0]]  # torso, head, arms, legs
    unrefined = compose_by_parts(three[:2], [WALK, WAVE], rest_joints, centred=False)
    assert torch.equal(made.coupling.motion.rotations, unrefined.motion.rotations)


def test_another_rate_is_brought_to_the_first(three, rest_joints):
    made = compose_by_parts([three[0], resample(three[1], 15.0)], [WALK, WAVE], rest_joints)
    assert (made.motion.fps, len(made.motion)) == (30.0, 8)


def test_an_action_that_is_left_without_a_part_is_refused(three, rest_joints):
    everything = Parts.of(BODY_PARTS)
    with pytest.raises(UserError, match="walk: is left without any part: wave-right-hand take"):
        compose_by_parts(three[:2], [everything, everything], rest_joints)
    with pytest.raises(UserError, match="wave-right-hand: is left"):
        compose_by_parts(three[:2], [WALK, NOTHING], rest_joints)
    with pytest.raises(UserError, match="two actions"):
        compose_by_parts(three[:1], [WALK], rest_joints)
