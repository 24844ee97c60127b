"""Intervals against published examples, scipy and repeated sampling."""

import pytest
import torch
from scipy.stats import t, ttest_ind, ttest_rel

from refine.intervals import compare, mean_interval, share_interval, student_quantile, summarise_repeats
from renderers.checks import UserError


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


def test_students_quantile_is_scipys():
    """At whole and broken degrees of freedom, as Welch's formula gives them."""
    for freedom in (1, 1.3, 2, 2.7, 3, 4, 19, 100, 1e5):
        assert student_quantile(freedom) == pytest.approx(t.ppf(0.975, freedom), rel=1e-7)


def test_summary_of_repeats_by_hand():
    found = summarise_repeats([1.0, 2.0, 3.0])
    assert (found["n"], found["mean"], found["sd"]) == (3, 2.0, 1.0)
    assert found["ci95"] == pytest.approx([2 - 4.302653 / 3**0.5, 2 + 4.302653 / 3**0.5])
    assert found["sem196"] == pytest.approx(1.96 / 3**0.5)
    assert found["actor_pm"] == pytest.approx(1.30667, abs=1e-5)


def test_a_single_repeat_has_no_spread():
    expected = {"n": 1, "mean": 4.0, "sd": None, "ci95": None, "sem196": None, "actor_pm": None}
    assert summarise_repeats([4.0]) == expected
    with pytest.raises(UserError, match="there are no values"):
        summarise_repeats([])
    with pytest.raises(UserError, match="value 1 of 2 is nan"):
        summarise_repeats([1.0, float("nan")])


@pytest.mark.parametrize("paired", [False, True])
def test_differences_are_scipys(paired):
    a, b = [83.4, 85.1, 80.2, 84.0], [90.3, 96.8, 91.1, 93.4]
    test = ttest_rel(a, b) if paired else ttest_ind(a, b, equal_var=False)
    found = compare(a, b, paired)
    assert found["n"] == [4, 4]
    assert found["difference"] == pytest.approx(sum(a) / 4 - sum(b) / 4)
    assert found["difference_ci95"] == pytest.approx(list(test.confidence_interval(0.95)), rel=1e-6)


def test_ratio_does_not_depend_on_units_and_turns_over():
    a, b = [83.4, 85.1, 80.2], [90.3, 96.8, 91.1, 93.4]
    found, scaled = compare(a, b), compare([value / 7 for value in a], [value / 7 for value in b])
    assert found["ratio"] == pytest.approx(sum(a) / 3 / (sum(b) / 4))
    assert scaled["ratio_ci95"] == pytest.approx(found["ratio_ci95"])
    low, high = found["ratio_ci95"]
    assert compare(b, a)["ratio_ci95"] == pytest.approx([1 / high, 1 / low])
    assert low < found["ratio"] < high


def test_what_pairs_share_cancels():
    common = [10.0, 20.0, 40.0]
    a, b = [0.5 * value for value in common], common
    assert compare(a, b, paired=True)["ratio_ci95"] == pytest.approx([0.5, 0.5])
    low, high = compare(a, b)["ratio_ci95"]
    assert low < 0.25 and high > 1


def test_what_cannot_be_said_is_none():
    found = compare([1.0], [2.0, 3.0])
    assert (found["difference"], found["ratio"]) == (-1.5, 0.4)
    assert found["difference_ci95"] is found["ratio_ci95"] is None
    found = compare([-0.1, 0.2, -0.3], [1.0, 2.0, 3.0])
    assert found["ratio"] is found["ratio_ci95"] is None
    assert found["difference_ci95"] is not None
    assert compare([1.0, 1.0], [2.0, 2.0])["difference_ci95"] == [-1.0, -1.0]
    with pytest.raises(UserError, match="3 and 2 values are not pairs"):
        compare([1.0, 2.0, 3.0], [1.0, 2.0], paired=True)


@pytest.mark.parametrize("paired", [False, True])
def test_comparisons_cover_the_truth(paired, generator):
    """Three seeds a side, spreads 3 and 6 % of means 80 and 100: 95 in 100, or more where Welch is careful."""
    noise = torch.randn(1000, 2, 3, generator=generator, dtype=torch.float64)
    a, b = (80 * (1 + 0.03 * noise[:, 0])).tolist(), (100 * (1 + 0.06 * noise[:, 1])).tolist()
    found = [compare(x, y, paired) for x, y in zip(a, b, strict=True)]
    for what, truth in (("difference", -20), ("ratio", 0.8)):
        covered = sum(low <= truth <= high for low, high in (each[f"{what}_ci95"] for each in found)) / 1000
        assert 0.93 < covered < 0.985
