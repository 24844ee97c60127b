"""The published figures against the prose of the paper and against what can be computed of them."""

import pytest

from train.published import HUMANACT, PLUS_MINUS, PUBLISHED, UESTC


def figure(benchmark: str, method: str, table: str = "Table A.1"):
    (found,) = (each for each in PUBLISHED if (each.benchmark, each.method, each.table) == (benchmark, method, table))
    return found


def test_both_tables_are_whole():
    for benchmark in (UESTC, HUMANACT):
        rows = [(each.table, each.method) for each in PUBLISHED if each.benchmark == benchmark]
        assert len(rows) == len(set(rows)) == 10
        ours = [figure(benchmark, "Ours (w/ DR)", table) for table in ("Table 1", "Table A.1")]
        assert ours[0].fid_c == ours[1].fid_c and ours[0].multimodality == ours[1].multimodality


def test_gains_are_those_that_the_text_claims():
    """Section A.3.4: over Latent Disentanglement 39.65 and 11.9, 31.14 and 4.0; of DR 3.0 and 0.5, 12.4 and 2.4."""
    for benchmark, other, table, fid, points in (
        (HUMANACT, "Latent Disentanglement", "Table 1", 39.65, 11.9),
        (UESTC, "Latent Disentanglement", "Table 1", 31.14, 4.0),
        (HUMANACT, "Ours (w/o DR)", "Table A.1", 3.0, 0.5),
        (UESTC, "Ours (w/o DR)", "Table A.1", 12.4, 2.4),
    ):
        ours, theirs = figure(benchmark, "Ours (w/ DR)", table), figure(benchmark, other, table)
        assert theirs.fid_c.mean - ours.fid_c.mean == pytest.approx(fid, abs=0.06)
        assert ours.accuracy.mean - theirs.accuracy.mean == pytest.approx(points, abs=0.06)


def test_one_row_is_a_copy_and_says_so():
    full, without = figure(UESTC, "using full class"), figure(UESTC, "Ours (w/o DR)")
    same = [getattr(full, name) == getattr(without, name) for name in ("fid_c", "accuracy", "diversity")]
    assert all(same) and "copy" in full.doubt
    full, without = figure(HUMANACT, "using full class"), figure(HUMANACT, "Ours (w/o DR)")
    assert full.fid_c != without.fid_c and not full.doubt


def test_what_plus_minus_can_mean():
    """Standard deviations of one model's accuracy under both readings, beside that of binomial chance."""
    spreads = []
    for each in PUBLISHED:
        if each.accuracy.plus_minus:
            share, count = each.accuracy.mean / 100, 625 if each.benchmark == UESTC else 900
            deviation = each.accuracy.plus_minus / 1.96 * 20**0.5, (each.accuracy.plus_minus / 1.96) ** 0.5
            spreads.append((*deviation, 100 * (share * (1 - share) / count) ** 0.5))
    assert len(spreads) == 16
    for values, low, high in zip(
        zip(*spreads, strict=True), ("3.6", "0.9", "1.3"), ("14.4", "1.8", "2.0"), strict=True
    ):
        assert (f"{min(values):.1f}", f"{max(values):.1f}") == (low, high)
        assert low in PLUS_MINUS and high in PLUS_MINUS
