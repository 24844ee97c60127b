"""Built-in actions: human, planted, repeatable; and true compositions made of them."""

from dataclasses import replace
from itertools import combinations

import pytest
import torch

from refine.motion import Motion
from refine.procedural.curves import keyed
from refine.procedural.gesture import Foot, Gesture, Pelvis
from refine.procedural.posing import pose
from refine.synthetic import ACTIONS, draw, intended, perform, perform_together
from renderers.body import Body
from renderers.checks import ShapeError, UserError
from renderers.rotations import heading, matrix_to_axis_angle, rotation_angle
from renderers.skeleton import JOINTS, LEGS, PARTS

FRAMES, SEEDS = 120, (0, 1, 2)
ANKLES, TOES = [JOINTS["left_ankle"], JOINTS["right_ankle"]], [JOINTS["left_foot"], JOINTS["right_foot"]]
PAIRS = [
    ("walk", "wave-both-hands"),
    ("run", "raise-up-left-hand"),
    ("squat", "punching"),
    ("left-kicking", "standing-rotation"),
    ("forward-lunging", "drink"),
    ("wave-left-hand", "wave-right-hand"),
    ("punching-and-knee-lifting", "punching"),
    ("walk", "squat"),
]
SOLE = list(combinations(("walk", "punching", "wave-right-hand", "standing-rotation", "squat"), 2))


@pytest.fixture(scope="module")
def rest():
    return Body.free().rest_joints


def drawn(name: str, seed: int = 0, fps: float = 30.0):
    return draw(name, torch.Generator().manual_seed(seed), fps)


def performed(name: str, rest, seed: int = 0, frames: int = FRAMES) -> Motion:
    return perform(drawn(name, seed), frames, rest)


def toe_heights(motion: Motion, rest) -> torch.Tensor:
    return motion.joints(rest)[:, TOES, 1] - rest[TOES, 1]


def slide(motion: Motion, rest) -> float:
    """The farthest a ball of the foot moves over the floor in one frame while it touches it (within 5 mm), metres."""
    toes = motion.joints(rest)[:, TOES]
    touching = (toes[..., 1] - rest[TOES, 1]) < 0.005
    steps = (toes[1:] - toes[:-1])[..., [0, 2]].norm(dim=-1)
    return steps[touching[1:] & touching[:-1]].max().item()


def part_energies(motion: Motion, rest) -> dict[str, float]:
    """Mean squared frame-to-frame displacement of each part's joints relative to the root (Eq. 2)."""
    joints = motion.joints(rest)
    relative = joints - joints[:, :1]
    squares = (relative[1:] - relative[:-1]).square().sum(-1).mean(0)
    return {part: squares[list(members)].mean().item() for part, members in PARTS.items()}


def assert_human(motion: Motion, rest) -> None:
    """Hinges bend one way and only so far; shoulders, hips, spine and head stay in human ranges."""
    degrees = torch.rad2deg(matrix_to_axis_angle(motion.rotations))
    for side, sign in (("left", -1), ("right", 1)):
        elbow = sign * degrees[:, JOINTS[f"{side}_elbow"]]
        assert elbow[:, [0, 2]].abs().max() < 0.01
        assert elbow[:, 1].min() > 1.9 and elbow[:, 1].max() < 150.1
        hip, knee, ankle = (JOINTS[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
        assert degrees[:, knee, 1:].abs().max() < 0.01
        assert degrees[:, knee, 0].max() < 150
        assert rotation_angle(motion.rotations[:, hip]).max() < 2.2
        assert (knee_ahead(motion, rest, hip, knee, ankle) > -1e-4).all()
    for name, most in (("spine1", 24), ("neck", 33), ("left_wrist", 66), ("right_collar", 30), ("left_ankle", 72)):
        assert degrees[:, JOINTS[name]].norm(dim=-1).max() < most, name


def knee_ahead(motion: Motion, rest, hip: int, knee: int, ankle: int) -> torch.Tensor:
    """How far the knee is ahead of the line from hip to ankle, metres, where ahead is the thigh's own front."""
    joints = motion.joints(rest)
    front = (motion.rotations[:, 0] @ motion.rotations[:, hip])[..., 2]
    line = torch.nn.functional.normalize(joints[:, ankle] - joints[:, hip], dim=-1)
    thigh = joints[:, knee] - joints[:, hip]
    return ((thigh - (thigh * line).sum(-1, keepdim=True) * line) * front).sum(-1)


def test_the_actions_that_are_promised_are_there():
    uestc_legs = "marking-time-and-knee-lifting punching-and-knee-lifting left-lunging left-kicking forward-lunging"
    uestc_arms = "pulling-chest-expanders punching elbow-circling shoulder-abduction standing-rotation"
    others = "walk run squat wave-left-hand wave-right-hand wave-both-hands raise-up-left-hand drink stand"
    assert set(ACTIONS) == set(f"{uestc_legs} {uestc_arms} {others}".split())


@pytest.mark.parametrize("name", ACTIONS)
def test_an_action_is_a_clip_of_a_human_on_the_floor(name, rest):
    for seed in SEEDS:
        motion = performed(name, rest, seed)
        assert (len(motion), motion.fps, motion.label) == (FRAMES, 30.0, name)
        assert heading(motion.rotations[0, 0]).abs() < 0.3
        assert slide(motion, rest) < 0.005
        joints = motion.joints(rest)
        assert (joints[:, TOES, 1] - rest[TOES, 1]).min() > -0.01
        assert (joints[:, ANKLES, 1] - rest[ANKLES, 1]).min() > -0.01
        assert_human(motion, rest)


@pytest.mark.parametrize("name", ACTIONS)
def test_a_body_keeps_its_smoothness_between_frames(name, rest):
    for seed in SEEDS:
        joints = performed(name, rest, seed).joints(rest)
        acceleration = (joints[2:] - 2 * joints[1:-1] + joints[:-2]).norm(dim=-1) * 30**2
        assert acceleration.max() < (160 if name == "run" else 120)


@pytest.mark.parametrize("name", [name for name in ACTIONS if name != "stand"])
def test_energy_is_highest_in_what_the_action_intends(name, rest):
    for seed in SEEDS:
        one = drawn(name, seed)
        energies = part_energies(perform(one, FRAMES, rest), rest)
        assert max(energies, key=energies.get) in intended(one)


@pytest.mark.parametrize("name", ACTIONS)
def test_a_draw_gives_one_motion_and_another_draw_another(name, rest):
    generator = torch.Generator().manual_seed(7)
    first, second = draw(name, generator), draw(name, generator)
    assert draw(name, torch.Generator().manual_seed(7)) == first != second
    motion = perform(first, FRAMES, rest)
    again = perform(first, FRAMES, rest)
    assert torch.equal(again.rotations, motion.rotations) and torch.equal(again.root, motion.root)
    apart = (motion.joints(rest) - perform(second, FRAMES, rest).joints(rest)).norm(dim=-1).mean()
    assert apart > 0.01


def test_a_longer_clip_continues_a_shorter_one_and_a_finer_one_passes_through_it(rest):
    one = drawn("walk")
    short, long = perform(one, 40, rest), perform(one, 80, rest)
    torch.testing.assert_close(long.root[:40], short.root)
    fine = perform(replace(one, fps=60.0), 80, rest)
    torch.testing.assert_close(fine.rotations[::2], short.rotations, atol=1e-5, rtol=0)


def test_a_repetition_is_not_the_copy_of_the_last_one(rest):
    one = replace(drawn("left-kicking"), tempo=0.5)
    foot = perform(one, 240, rest).joints(rest)[:, JOINTS["left_foot"], 1]
    highest = foot.reshape(4, 60).max(dim=1).values
    assert highest.diff().abs().min() > 0.002


def test_walking_speed_is_stride_over_time(rest):
    one = replace(drawn("walk"), tempo=1.0, amplitude=1.0)
    motion = perform(one, 301, rest)
    toe = motion.joints(rest)[:, JOINTS["left_foot"], 2]
    planted = toe_heights(motion, rest)[:, 0] < 0.002
    prints = torch.unique((toe[planted] * 20).round() / 20)
    strides = prints.diff()[prints.diff() > 0.5]
    speed = (motion.root[-1, 2] - motion.root[0, 2]) / 10
    assert speed == pytest.approx(strides.mean().item(), rel=0.03)
    assert 1.0 < speed < 1.5


def test_a_run_flies_and_is_faster_and_a_walk_does_not_fly(rest):
    for seed in SEEDS:
        run, walk = performed("run", rest, seed), performed("walk", rest, seed)
        assert toe_heights(run, rest).min(dim=1).values.max() > 0.03
        assert toe_heights(walk, rest).min(dim=1).values.max() < 0.02
        assert run.root[-1, 2] - run.root[0, 2] > 1.5 * (walk.root[-1, 2] - walk.root[0, 2])


def test_the_pelvis_goes_where_the_action_needs_it(rest):
    squat, kick, lunge = (performed(name, rest) for name in ("squat", "left-kicking", "forward-lunging"))
    assert rest[0, 1] - squat.root[:, 1].min() > 0.2
    foot = kick.joints(rest)[:, JOINTS["left_foot"], 1]
    assert kick.root[foot.argmax(), 0] < 0.35 * rest[JOINTS["right_ankle"], 0]
    assert lunge.root[:, 2].max() > 0.25 and lunge.root[:, 2].min() > -0.06


def test_a_kick_strikes_with_a_straight_leg_and_a_drink_reaches_the_mouth(rest):
    kick = performed("left-kicking", rest)
    height = kick.joints(rest)[:, JOINTS["left_ankle"], 1]
    knee = rotation_angle(kick.rotations[:, JOINTS["left_knee"]])
    assert knee[height > height.max() - 0.1].min() < 0.5 < knee.max()
    one = drawn("drink")
    joints = perform(one, 200, rest).joints(rest)
    to_head = (joints[:, JOINTS[f"{one.hand}_hand"]] - joints[:, JOINTS["head"]]).norm(dim=-1)
    assert 0.08 < to_head.min() < 0.22 and to_head.max() > 0.35


@pytest.mark.parametrize(("i", "j"), PAIRS)
def test_a_composition_is_a_human_on_the_floor_whichever_comes_first(i, j, rest):
    draw_i, draw_j = drawn(i, 3), drawn(j, 4)
    both = perform_together(draw_i, draw_j, FRAMES, rest)
    swapped = perform_together(draw_j, draw_i, FRAMES, rest)
    assert torch.equal(both.rotations, swapped.rotations) and torch.equal(both.root, swapped.root)
    assert both.label == swapped.label == "+".join(sorted((i, j), key=ACTIONS.index))
    assert slide(both, rest) < 0.005
    assert toe_heights(both, rest).min() > -0.01
    assert_human(both, rest)


@pytest.mark.parametrize(("i", "j"), SOLE)
def test_what_only_one_intends_is_done_as_it_does_it_alone(i, j, rest):
    draw_i, draw_j = drawn(i, 5), drawn(j, 6)
    both = perform_together(draw_i, draw_j, FRAMES, rest)
    for mine, other in ((draw_i, draw_j), (draw_j, draw_i)):
        alone = perform(mine, FRAMES, rest)
        sole = intended(mine) - intended(other)
        for part in sole:
            torch.testing.assert_close(
                both.rotations[:, PARTS[part]], alone.rotations[:, PARTS[part]], atol=1e-4, rtol=0
            )
        if sole.issuperset(LEGS):
            torch.testing.assert_close(both.root, alone.root)
            torch.testing.assert_close(both.rotations[:, 0], alone.rotations[:, 0])


def test_a_walk_that_waves_swings_only_the_free_arm(rest):
    draw_i, draw_j = drawn("walk"), drawn("wave-right-hand")
    together = part_energies(perform_together(draw_i, draw_j, FRAMES, rest), rest)
    walking, waving = (part_energies(perform(one, FRAMES, rest), rest) for one in (draw_i, draw_j))
    assert together["left_arm"] == pytest.approx(walking["left_arm"], rel=0.15)
    assert together["right_arm"] == pytest.approx(waving["right_arm"], rel=0.35)


def test_two_actions_that_want_one_arm_meet_half_way_and_both_move_it(rest):
    raised, circling = drawn("shoulder-abduction"), drawn("wave-both-hands")
    both = perform_together(raised, circling, 300, rest)
    hand = JOINTS["left_hand"]

    def height(motion):
        joints = motion.joints(rest)
        return joints[:, hand, 1] - joints[:, 0, 1]

    low, high = sorted(height(perform(one, 300, rest)).mean() for one in (raised, circling))
    assert low < height(both).mean() < high
    assert height(both).std() > 0.8 * height(perform(raised, 300, rest)).std()


def test_standing_adds_next_to_nothing(rest):
    walk = drawn("walk")
    alone, with_stand = perform(walk, FRAMES, rest), perform_together(walk, drawn("stand"), FRAMES, rest)
    assert (alone.joints(rest) - with_stand.joints(rest)).norm(dim=-1).mean() < 0.03
    torch.testing.assert_close(with_stand.root, alone.root)


def test_a_performance_fits_any_body(rest):
    tall = performed("walk", rest * 1.2)
    assert slide(tall, rest * 1.2) < 0.006
    torch.testing.assert_close(tall.root, performed("walk", rest).root * 1.2, atol=1e-4, rtol=0)
    assert performed("walk", rest.double()).root.dtype == torch.float64


def test_drink_draws_either_hand_and_intends_it(rest):
    draws = [drawn("drink", seed) for seed in range(12)]
    assert {one.hand for one in draws} == {"left", "right"}
    assert all(intended(one) == {f"{one.hand}_arm"} for one in draws)


def test_the_pelvis_sinks_until_feet_on_the_floor_are_reached(rest):
    apart = torch.linspace(0, 0.6, 20)
    gesture = Gesture(pelvis=Pelvis(y=0.1), left_foot=Foot(ahead=apart), right_foot=Foot(aside=apart))
    rotations, root = pose(gesture, rest)
    motion = Motion(rotations, root, 30.0)
    assert toe_heights(motion, rest).abs().max() < 1e-4
    assert (root[:, 1].diff() < 0).all() and root[0, 1] - root[-1, 1] > 0.1


def test_keyed_curves_pass_their_keys_without_overshoot():
    phase = torch.linspace(-1, 2, 601, dtype=torch.float64)
    times, values = (0.1, 0.3, 0.5, 0.9), (0.0, 1.0, 3.0, 3.0)
    curve = keyed(phase, times, values)
    torch.testing.assert_close(keyed(torch.tensor(times, dtype=torch.float64), times, values), curve.new_tensor(values))
    assert curve.min() > -1e-9 and curve.max() < 3 + 1e-9
    torch.testing.assert_close(curve[:201], curve[200:401], atol=1e-9, rtol=0)
    assert curve.diff(2).abs().max() < 0.02


def test_mistakes_are_named(rest, generator):
    with pytest.raises(UserError, match="did you mean.*walk"):
        draw("wlak", generator)
    with pytest.raises(UserError, match="positive frame rate, got 0"):
        draw("walk", generator, fps=0)
    with pytest.raises(UserError, match="at least one frame, got 0"):
        perform(drawn("walk"), 0, rest)
    with pytest.raises(ShapeError, match=r"expected shape \[24 3\]"):
        perform(drawn("walk"), 5, rest[:22])
    with pytest.raises(UserError, match="30.0 and 25.0 differ"):
        perform_together(drawn("walk"), drawn("squat", fps=25.0), 5, rest)
