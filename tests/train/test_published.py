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


def test_every_column_is_the_papers():
    """The columns of the paper's two tables, top to bottom."""
    columns = {
        (UESTC, "Table 1", "fid_c"): "0.00±0.00 164.17±47.51 121.27±18.05 2502.81±0.00 90.13±12.58",
        (UESTC, "Table 1", "accuracy"): "100.0±0.00 67.80±3.13 83.20±3.48 4.00±0.00 87.20±1.69",
        (UESTC, "Table 1", "diversity"): "38.52±0.76 28.79±0.42 32.69±0.63 15.00±0.34 33.06±0.81",
        (UESTC, "Table 1", "multimodality"): "5.03±0.00 12.24±0.23 9.50±0.20 0.00±0.00 10.12±0.06",
        (HUMANACT, "Table 1", "fid_c"): "0.00±0.00 162.35±34.72 123.08±28.57 6908.91±0.00 83.43±13.01",
        (HUMANACT, "Table 1", "accuracy"): "100.0±0.00 49.7±2.95 52.2±4.84 11.1±0.00 64.1±5.41",
        (HUMANACT, "Table 1", "diversity"): "30.09±0.73 21.74±0.60 21.0±0.21 14.81±0.63 21.36±0.39",
        (HUMANACT, "Table 1", "multimodality"): "6.79±0.06 14.35±0.52 14.79±0.53 0.00±0.00 14.01±0.38",
        (UESTC, "Table A.1", "fid_c"): "102.48±22.12 188.66±33.41 294.87±71.4 102.48±22.12 90.13±12.58",
        (UESTC, "Table A.1", "accuracy"): "84.80±1.59 59.90±6.29 35.40±4.30 84.80±1.59 87.20±1.69",
        (UESTC, "Table A.1", "diversity"): "33.25±0.61 29.60±0.35 25.77±0.41 33.25±0.61 33.06±0.81",
        (UESTC, "Table A.1", "multimodality"): "10.56±0.12 13.12±0.11 12.86±0.27 10.56±0.12 10.12±0.06",
        (HUMANACT, "Table A.1", "fid_c"): "86.47±9.98 149.42±24.48 251.85±37.47 86.41±19.8 83.43±13.01",
        (HUMANACT, "Table A.1", "accuracy"): "63.6±2.62 51.4±4.54 31.6±2.54 63.6±5.26 64.1±5.41",
        (HUMANACT, "Table A.1", "diversity"): "21.31±0.57 21.38±0.50 18.39±0.56 21.11±0.58 21.36±0.39",
        (HUMANACT, "Table A.1", "multimodality"): "14.04±0.32 14.77±0.31 13.92±0.66 14.29±0.13 14.01±0.38",
    }
    for (benchmark, table, name), printed in columns.items():
        rows = [getattr(each, name) for each in PUBLISHED if (each.benchmark, each.table) == (benchmark, table)]
        assert [(row.mean, row.plus_minus) for row in rows] == [
            tuple(map(float, pair.split("±"))) for pair in printed.split()
        ]
