"""APE and AVE: what they must not see, what SINC's heading does, and values by hand."""

import math

import numpy as np
import pytest
import torch

from refine import synthetic
from refine.text.positions import clip_errors, floor_height, mean_errors, place, positional_errors
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import rotation_about

NAMES = ("root", "trajectory", "local", "global")


@pytest.fixture(scope="module")
def walk() -> torch.Tensor:
    """[30 24 3]"""
    rest = Body.free("light").rest_joints.double()
    return synthetic.perform(synthetic.draw("walk", torch.Generator().manual_seed(3)), 30, rest).joints(rest)


def turned(joints: torch.Tensor, degrees: float) -> torch.Tensor:
    return joints @ rotation_about("y", torch.tensor(math.radians(degrees), dtype=torch.float64)).mT


def straight(frames: int = 90, speed: float = 1.2) -> torch.Tensor:
    """A stiff figure that glides to +z at 30 frames a second."""
    rest = Body.free("light").rest_joints.double()
    ahead = torch.arange(frames, dtype=torch.float64) / 30 * speed
    return rest + torch.stack([0 * ahead, 0 * ahead, ahead], dim=-1)[:, None]


def test_place_height_and_heading_of_a_clip_are_not_seen(walk):
    elsewhere = turned(walk, 130) + torch.tensor([3.0, 0.7, -2.0])
    errors = clip_errors(elsewhere, walk)
    assert errors.frames == 30
    assert errors.ape.abs().max() < 1e-9 and errors.ave.abs().max() < 1e-9


def test_a_turn_later_on_is_seen(walk):
    late = torch.stack([turned(frame, 3.0 * number) for number, frame in enumerate(walk)])
    errors = clip_errors(late, walk)
    assert errors.ape[0] > 0.05 and errors.ape[3] > 0.05


@pytest.mark.parametrize("degrees", [30, 90, -75])
def test_legacy_turns_by_twice_the_angle(walk, degrees):
    once, twice = place(walk, "sinc_legacy"), place(turned(walk, degrees), "sinc_legacy")
    for name in ("root", "local", "whole"):
        torch.testing.assert_close(getattr(twice, name), turned(getattr(once, name), 2 * degrees))


@pytest.mark.parametrize(("degrees", "metres"), [(30, 1.78), (90, 3.56)])
def test_legacy_holds_a_walk_against_itself(degrees, metres):
    walk = straight()
    assert float(clip_errors(turned(walk, degrees), walk, "sinc_legacy").ape[0]) == pytest.approx(metres, abs=1e-6)
    assert float(clip_errors(turned(walk, degrees), walk).ape[0]) < 1e-9


def test_the_first_frame_faces_ahead_from_the_origin(walk):
    placed = place(turned(walk, 77) + 5.0)
    right, left = placed.whole[0, [2, 17]].sum(0), placed.whole[0, [1, 16]].sum(0)
    assert left[0] > right[0] and (left - right)[2].abs() < 1e-9
    assert placed.root[0, [0, 2]].abs().max() < 1e-9
    assert placed.root[-1, 2] > 0.5  # walks ahead


def test_one_limb_by_hand(walk):
    """A hand that is lifted, and one that goes up and down; nothing else."""
    lifted = walk.clone()
    lifted[:, 20, 1] += 0.21
    lifted[:, 22:] += 100.0  # the hands do not count
    errors = clip_errors(lifted, walk)
    assert errors.ape.tolist() == pytest.approx([0, 0, 0.21 / 21, 0.21 / 22])
    assert errors.ave.tolist() == pytest.approx([0] * 4, abs=1e-12)

    still = walk[:1].repeat(30, 1, 1)
    wave = 0.1 * np.sin(np.arange(30))
    moved = still.clone()
    moved[:, 20, 1] += torch.tensor(wave)
    expected = wave.var(ddof=1)
    assert clip_errors(moved, still).ave.tolist() == pytest.approx([0, 0, expected / 21, expected / 22])


def test_travel_by_hand():
    """Twice as fast: the distance grows by 4 cm a frame, and the variance of the place is four times as large."""
    errors = clip_errors(straight(11, 2.4), straight(11, 1.2))
    metres = np.arange(11) * 1.2 / 30
    assert errors.ape.tolist() == pytest.approx([metres.mean()] * 2 + [0] + [metres.mean()], abs=1e-9)
    assert errors.ave.tolist() == pytest.approx([3 * metres.var(ddof=1)] * 2 + [0] + [3 * metres.var(ddof=1)], abs=1e-9)


def test_the_floor_is_a_soft_minimum(walk):
    lowest = walk[:, [7, 8, 10, 11], 1].min(1).values.numpy()
    expected = lowest.min() - np.log(0.5 + np.exp(lowest.min() - lowest.max()))
    assert float(floor_height(walk)) == pytest.approx(expected, abs=1e-9)


def test_ape_is_of_frames_and_ave_of_clips():
    short, long = (straight(3, 2.4), straight(3, 1.2)), (straight(9, 1.2), straight(12, 1.2))
    together = positional_errors([short, long])
    alone = [clip_errors(*pair) for pair in (short, long)]
    assert [each.frames for each in alone] == [3, 9]
    assert together == mean_errors(alone) and len(together) == 8
    for index, name in enumerate(NAMES):
        assert together[f"ape_{name}"] == pytest.approx(float(alone[0].ape[index]) * 3 / 12, abs=1e-9)
        assert together[f"ave_{name}"] == pytest.approx(float(alone[0].ave[index]) / 2, abs=1e-9)


def test_what_cannot_be_compared_is_refused(walk):
    with pytest.raises(UserError, match="no clips"):
        positional_errors([])
    with pytest.raises(UserError, match="one frame"):
        clip_errors(walk[:1], walk)
    broken = walk.clone()
    broken[3, 4, 1] = torch.nan
    with pytest.raises(UserError, match="frame 3"):
        clip_errors(broken, walk)
