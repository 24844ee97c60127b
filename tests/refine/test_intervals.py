"""Intervals against published examples and against repeated sampling."""

import pytest
import torch

from refine.intervals import mean_interval, share_interval


def test_mean_interval_by_hand():
    found = mean_interval([1.0, 2.0, 3.0])
    assert (found["mean"], found["sd"], found["n"]) == (2.0, 1.0, 3)
    assert found["ci95"] == pytest.approx([2 - 1.959964 / 3**0.5, 2 + 1.959964 / 3**0.5])
    assert mean_interval([4.0])["ci95"] == [4.0, 4.0]


def test_share_interval_is_wilsons():
    """Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20 and 1 of 29."""
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        found = share_interval(hits, count)
        assert found["share"] == hits / count
        assert found["ci95"] == pytest.approx([low, high], abs=5e-5)
    assert share_interval(5, 5)["ci95"][1] == pytest.approx(1.0)


def test_share_interval_covers_the_truth_95_times_in_100(generator):
    hits = (torch.rand(2000, 60, generator=generator) < 0.8).sum(1).tolist()
    covered = sum(low <= 0.8 <= high for low, high in (share_interval(hit, 60)["ci95"] for hit in hits))
    assert covered / 2000 == pytest.approx(0.95, abs=0.02)
