"""Oddities: each is found in a clip that has it, and only it; none in what is sound."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from refine.formats.bvh import read_bvh
from refine.motion import Motion, mirror, resample
from refine.oddities import BENT, FASTEST_PELVIS, FLOOR_OFF, FROZEN, LEAP, SHORTEST, find
from refine.skeletons.retarget import retarget
from refine.synthetic import ACTIONS, draw, perform
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import JOINTS

FRAMES = 90


@pytest.fixture(scope="module")
def act(rest_joints) -> Callable[[str], Motion]:
    def perform_one(name: str, seed: int = 3, fps: float = 30.0) -> Motion:
        return perform(draw(name, torch.Generator().manual_seed(seed), fps), round(FRAMES * fps / 30), rest_joints)

    return perform_one


def names(motion: Motion, rest_joints, bones=None) -> list[str]:
    return [oddity.name for oddity in find(motion, rest_joints, bones)]


def moved(motion: Motion, by: torch.Tensor) -> Motion:
    """With [T 3] metres added to its path."""
    return replace(motion, root=motion.root + by)


def turned(motion: Motion, joint: str, frames: slice, vector: tuple[float, float, float]) -> Motion:
    """With a joint turned further, by an axis times an angle, in some frames."""
    rotations = motion.rotations.clone()
    rotations[frames, JOINTS[joint]] = rotations[frames, JOINTS[joint]] @ axis_angle_to_matrix(torch.tensor(vector))
    return replace(motion, rotations=rotations)


@pytest.mark.parametrize("name", ACTIONS)
def test_nothing_is_odd_about_built_in_actions(act, rest_joints, name):
    for fps in (20.0, 30.0, 120.0):
        assert find(act(name, fps=fps), rest_joints) == []


def test_few_real_clips_are_odd(real_clips, rest_joints):
    """Two of the 594 are, and rightly: they turn left and are called right."""
    known = [path for path in real_clips if "walk-turn-right_masculine_00" in path.name][4:7]
    for path in [*real_clips[::60], *known]:
        motion = retarget(read_bvh(path), rest_joints, label=path.stem.split("_")[1])
        wrong = path.stem.endswith(("right_masculine_006", "right_masculine_007"))
        assert names(motion, rest_joints) == (["other side"] if wrong else []), path.name


def test_a_clip_too_short(act, rest_joints):
    frames, seconds = SHORTEST
    walk = act("walk")
    for count in (1, 2, frames - 1):
        short = replace(walk, rotations=walk.rotations[:count], root=walk.root[:count])
        assert names(short, rest_joints) == ["too short"]
    quick = resample(walk, 120.0)
    count = round(seconds * 120) - 1
    assert names(replace(quick, rotations=quick.rotations[:count], root=quick.root[:count]), rest_joints) == [
        "too short"
    ]


@pytest.mark.parametrize(("fps", "odd"), [(29.97, False), (59.94006, False), (37.0, True), (1.0, True)])
def test_a_frame_rate_that_no_camera_has(act, rest_joints, fps, odd):
    motion = resample(act("walk"), fps)
    assert ("odd frame rate" in names(motion, rest_joints)) == odd


def test_a_teleport_and_a_glitch(act, rest_joints):
    walk = act("walk")
    by = torch.zeros(FRAMES, 3)
    by[40:, 0] = 2 * FASTEST_PELVIS / 30
    [oddity] = find(moved(walk, by), rest_joints)
    assert (oddity.name, oddity.frame) == ("jump", 40) and oddity.text.startswith("pelvis moves")
    by = torch.zeros(FRAMES, 3)
    by[50] = torch.tensor([0.0, 0.0, 2 * LEAP])  # one frame elsewhere, slower than a sprint
    assert [(o.name, o.frame) for o in find(moved(walk, by), rest_joints)] == [("jump", 50)]


def test_a_limb_that_flips(act, rest_joints):
    flipped = turned(act("walk"), "left_shoulder", slice(30, 31), (0.0, 0.0, 1.5))
    [oddity] = find(flipped, rest_joints)
    assert (oddity.name, oddity.frame) == ("jump", 30) and "left_" in oddity.text
    assert "in 2 frames" in oddity.text  # there and back


def test_a_fast_kick_is_no_jump(act, rest_joints):
    """A shank that swings at 1,200 degrees a second, up and down again."""
    angle = torch.zeros(FRAMES)
    angle[40:46] = torch.linspace(0, 4.2, 6) * -0.5
    angle[46:52] = torch.linspace(4.2, 0, 6) * -0.5
    walk = act("walk")
    rotations = walk.rotations.clone()
    rotations[:, JOINTS["right_hip"]] = axis_angle_to_matrix(angle[:, None] * torch.tensor([1.0, 0, 0]))
    assert "jump" not in names(replace(walk, rotations=rotations), rest_joints)


@pytest.mark.parametrize("copies", [2, 4])
def test_a_rate_that_was_made_by_copying(act, rest_joints, copies):
    motion = resample(act("walk"), 30.0)
    index = torch.arange(FRAMES) // copies * copies
    [oddity] = find(replace(motion, rotations=motion.rotations[index], root=motion.root[index]), rest_joints)
    assert oddity.name == "copied frames" and oddity.frame == 1
    count = FRAMES - (FRAMES - 1) // copies - 1 - ((FRAMES - 1) % copies)  # the run at the end is no copy amid movement
    assert oddity.text.startswith(f"{count} frames")


def test_a_frozen_tail_and_a_still_clip(act, rest_joints):
    walk = act("walk")
    frozen = round(FROZEN * 30) + 1
    index = torch.arange(FRAMES).clamp(max=FRAMES - 1 - frozen)
    [oddity] = find(replace(walk, rotations=walk.rotations[index], root=walk.root[index]), rest_joints)
    assert (oddity.name, oddity.frame) == ("frozen tail", FRAMES - frozen)
    still = replace(walk, rotations=walk.rotations[:1].expand_as(walk.rotations), root=walk.root[:1].expand(FRAMES, 3))
    assert names(still, rest_joints) == ["still"]


def test_a_body_that_is_pushed_along(act, rest_joints):
    """Somebody who waves on the spot is carried at 1.2 m/s."""
    along = torch.arange(FRAMES)[:, None] * torch.tensor([1.2 / 30, 0.0, 0.0])
    assert names(moved(act("wave-left-hand"), along), rest_joints) == ["sliding feet"]


@pytest.mark.parametrize("degrees", [90.0, -90.0])
def test_a_walk_that_lies(act, rest_joints, degrees):
    """A walk of which y and z are exchanged, laid down so that its back is on the floor."""
    walk = act("walk")
    turn = rotation_about("x", torch.tensor(math.radians(degrees)))
    rotations = walk.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    lying = replace(walk, rotations=rotations, root=walk.root @ turn.mT)
    lift = torch.tensor([0.0, 0.02 - float(lying.joints(rest_joints)[..., 1].min()), 0.0])
    assert "wrong up axis" in names(moved(lying, lift), rest_joints)
    bow = act("squat")  # one who stands, and one who lies still, are as they should be
    assert "wrong up axis" not in names(bow, rest_joints)
    asleep = replace(lying, rotations=rotations[:1].expand_as(rotations), root=lying.root[:1].expand(FRAMES, 3))
    assert "wrong up axis" not in names(asleep, rest_joints)


def test_a_body_upside_down(act, rest_joints):
    walk = act("walk")
    turn = rotation_about("z", torch.tensor(math.pi))
    rotations = walk.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    text = [o.text for o in find(replace(walk, rotations=rotations), rest_joints) if o.name == "wrong up axis"]
    assert text == ["the body is upside down"]


@pytest.mark.parametrize(("joint", "axis"), [("left_knee", (-1.0, 0.0, 0.0)), ("right_elbow", (0.0, -1.0, 0.0))])
def test_joints_that_bend_backwards(act, rest_joints, joint, axis):
    walk = act("walk")
    rotations = walk.rotations.clone()
    bend = math.radians(BENT + 10)
    rotations[:, JOINTS[joint]] = axis_angle_to_matrix(torch.tensor(axis) * bend)
    [oddity] = [o for o in find(replace(walk, rotations=rotations), rest_joints) if o.name == "bends backwards"]
    assert oddity.text == f"{joint.replace('_', ' ')} mostly the wrong way"
    rotations[:, JOINTS[joint]] = axis_angle_to_matrix(-torch.tensor(axis) * bend)
    assert "bends backwards" not in names(replace(walk, rotations=rotations), rest_joints)


@pytest.mark.parametrize("name", ["walk", "squat", "elbow-circling"])
def test_left_and_right_exchanged(act, rest_joints, name):
    """The rotations of left joints given to the right ones and the other way round, without a reflection."""
    exchanged = [JOINTS[other(name)] for name in JOINTS]
    motion = act(name)
    [oddity] = find(replace(motion, rotations=motion.rotations[:, exchanged]), rest_joints)
    assert (oddity.name, oddity.text) == ("bends backwards", "left elbow and right elbow mostly the wrong way")


def other(name: str) -> str:
    side = {"left": "right", "right": "left"}
    head, _, tail = name.partition("_")
    return f"{side[head]}_{tail}" if head in side else name


def test_legs_that_stay_crossed(act, rest_joints):
    crossed = turned(act("wave-left-hand"), "left_hip", slice(None), (0.0, 0.0, -0.35))
    crossed = turned(crossed, "right_hip", slice(None), (0.0, 0.0, 0.35))
    assert names(crossed, rest_joints) == ["crossed legs"]


def test_a_label_that_names_the_other_side(act, rest_joints):
    wave = act("wave-left-hand")
    assert names(wave, rest_joints) == []
    assert names(replace(mirror(wave), label=wave.label), rest_joints) == ["other side"]
    assert names(mirror(wave), rest_joints) == []
    assert names(replace(mirror(wave), label="wave"), rest_joints) == []
    kick = act("left-kicking")
    assert names(kick, rest_joints) == []
    assert names(replace(mirror(kick), label="kick_LEFT_leg"), rest_joints) == ["other side"]


@pytest.mark.parametrize(("label", "odd"), [("walk-turn-left", False), ("walk-turn-right", True)])
def test_a_turn_to_the_other_side(act, rest_joints, label, odd):
    walk = act("walk")
    turn = rotation_about("y", torch.linspace(0, math.radians(200), FRAMES))  # anticlockwise from above: left; the walk
    # itself sways by a degree
    rotations = walk.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    motion = Motion(rotations, (turn @ walk.root[..., None])[..., 0], 30.0, label)
    found = [o for o in find(motion, rest_joints) if o.name == "other side"]
    assert [o.text for o in found] == (["turns left by 201 degrees"] if odd else [])


@pytest.mark.parametrize(("by", "odd"), [(0.2, False), (-0.2, False), (0.4, True), (-90.0, True)])
def test_a_floor_far_off(act, rest_joints, by, odd):
    assert abs(by) > FLOOR_OFF or not odd
    raised = moved(act("walk"), torch.tensor([0.0, by, 0.0]))
    assert names(raised, rest_joints) == (["floor far off"] if odd else [])


@pytest.mark.parametrize(
    ("bones", "said"),
    [
        ({"height": 1.75, "left_knee": 0.40, "right_knee": 0.41}, []),
        ({"height": 17.5}, ["it would stand 17.50 m high"]),
        ({"height": 0.07}, ["it would stand 0.07 m high"]),
        (
            {"height": 1.7, "left_knee": 0.40, "right_knee": 0.30},
            ["0.400 m to the left knee, 0.300 m on the other side"],
        ),
        ({"left_elbow": 0.0, "right_elbow": 0.3}, ["0.000 m to the left elbow, 0.300 m on the other side"]),
        ({"left_elbow": 0.2}, []),
    ],
)
def test_bodies_that_nobody_has(act, rest_joints, bones, said):
    assert [oddity.text for oddity in find(act("walk"), rest_joints, bones)] == said
