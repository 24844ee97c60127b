"""What is made of the differences between our images and Mitsuba's."""

import pytest
import torch

from renderers.judging import OWN_LARGEST, OWN_MEAN, Pair, agreement, ring_means, seeds, slope


def square_pair(wrong: float = 0.0, noise: float = 0.0) -> Pair:
    """A square whose outline, one pixel wide, is half covered; one pixel of the outline, or one inside, is wrong."""
    mitsuba = torch.zeros(1, 1, 20, 20)
    mitsuba[..., 5:15, 5:15] = 0.5
    mitsuba[..., 6:14, 6:14] = 1
    ours = mitsuba.clone()
    ours[0, 0, 5, 9] += wrong
    return Pair(ours, mitsuba, noise * torch.ones_like(mitsuba))


def test_the_noise_and_a_share_of_the_outline_are_allowed():
    outline = 36 / 400
    found = agreement(square_pair(noise=0.01))
    assert (found.mean, found.largest, found.iou) == (0, 0, 1)
    assert found.noise == pytest.approx(0.01)
    assert found.mean_tolerance == pytest.approx(0.01 + OWN_MEAN * outline)
    assert found.largest_tolerance == pytest.approx(0.01 + OWN_LARGEST)


@pytest.mark.parametrize(("wrong", "noise", "agrees"), [(0.1, 0.0, True), (0.13, 0.0, False), (0.13, 0.1, True)])
def test_the_difference_of_a_single_pixel_is_judged(wrong, noise, agrees):
    found = agreement(square_pair(wrong, noise))
    assert found.largest == pytest.approx(wrong)
    assert found.mean == pytest.approx(wrong / 400)
    assert found.iou == pytest.approx(82 / (82 + wrong))
    assert found.agrees is agrees


def test_differences_are_told_by_their_distance_from_the_outline():
    pair = square_pair(wrong=0.36)  # on one of 36 pixels
    pair.ours[0, 0, 0, 5:15] = 0.1  # farther away than is told
    assert ring_means(pair) == pytest.approx([0.01, 0, 0, 0], abs=1e-7)
    pair.ours[0, 0, 3, 3] = 0.72  # one of the 20 and 52 that are two away, inside and outside
    assert ring_means(pair) == pytest.approx([0.01, 0, 0.01, 0], abs=1e-7)


def test_slopes_may_be_off_by_our_own_error_and_twice_the_noise():
    judge = torch.tensor([3.0, -4.0])
    found = slope("x", 0.02, 1.03 * judge, judge, torch.tensor([0.0, 0.05]))
    assert (found.error, found.noise, found.tolerance) == pytest.approx((0.03, 0.01, 0.04))
    assert found.cosine == pytest.approx(1)
    assert found.agrees
    assert not slope("x", 0.02, 1.03 * judge, judge, 0 * judge).agrees
    assert not slope("x", 0.02, -judge, judge, 0 * judge).agrees


def test_no_two_seeds_share_a_render():
    drawn = [seed for given in range(50) for seed in seeds(given)]
    assert len(set(drawn)) == 100
    assert all(0 <= seed < 2**32 for seed in seeds(2**32 - 1))
