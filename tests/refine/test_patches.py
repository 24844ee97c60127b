"""Patch grids and masks (protocol G.6, G.13)."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from refine.patches import grid_of, keep_random, keep_top, paste, patch_means, patchify, unpatchify
from renderers.checks import ShapeError


@given(st.integers(1, 3), st.integers(1, 6), st.integers(1, 4), st.integers(1, 4), st.sampled_from([1, 2, 8]))
def test_round_trip(n, channels, rows, columns, patch):
    images = torch.rand(n, channels, rows * patch, columns * patch)
    patches = patchify(images, patch)
    assert patches.shape == (n, rows * columns, patch * patch * channels)
    assert torch.equal(unpatchify(patches, patch, (rows * patch, columns * patch)), images)


def test_order_is_row_column_channel_and_patches_run_by_rows():
    images = torch.arange(2 * 4 * 6).reshape(1, 2, 4, 6)
    patches = patchify(images, 2)
    assert patches[0, 1].tolist() == [2, 26, 3, 27, 8, 32, 9, 33]
    assert patches[0, 3, 0] == images[0, 0, 2, 0]
    channel_first = images[0, :, 0:2, 2:4].flatten().tolist()
    assert patches[0, 1].tolist() != channel_first


def test_means_follow_the_grid():
    maps = torch.zeros(1, 4, 6)
    maps[0, 2:, 4:] = torch.tensor([[1.0, 2.0], [3.0, 6.0]])
    assert patch_means(maps, 2).tolist() == [[0, 0, 0, 0, 0, 3.0]]


@given(st.integers(0, 10_000))
def test_every_kept_score_beats_every_dropped(seed):
    scores = torch.randn(3, 196, generator=torch.Generator().manual_seed(seed))
    kept = keep_top(scores, 1 / 3)
    assert kept.sum(1).tolist() == [65, 65, 65]
    for row in range(3):
        assert scores[row][kept[row]].min() >= scores[row][~kept[row]].max()


def test_ties_still_keep_the_exact_count():
    assert keep_top(torch.zeros(2, 64), 1 / 3).sum(1).tolist() == [21, 21]
    assert keep_top(torch.zeros(1, 2), 0.1).sum() == 1


def test_the_count_is_rounded_down_but_for_rounding_errors():
    assert keep_top(torch.zeros(1, 8), 1 / 3).sum() == 2
    assert keep_top(torch.zeros(1, 100), 0.29).sum() == 29 and 100 * 0.29 < 29


def test_random_masks_differ_and_are_fair(generator):
    kept = keep_random(4000, 9, 1 / 3, generator)
    assert (kept.sum(1) == 3).all()
    assert (kept.float().mean(0) - 1 / 3).abs().max() < 0.03


def test_paste():
    visible, predicted = torch.ones(1, 3, 2), torch.zeros(1, 3, 2)
    kept = torch.tensor([[True, False, True]])
    assert paste(visible, predicted, kept)[0, :, 0].tolist() == [1, 0, 1]


def test_refuses_broken_grids():
    with pytest.raises(ShapeError, match="65 x 64 px has no whole patches of 8"):
        grid_of((65, 64), 8)
    with pytest.raises(ShapeError, match=r"expected shape \[N 4 D\].*got \[1, 5, 12\]"):
        unpatchify(torch.zeros(1, 5, 12), 2, (4, 4))
