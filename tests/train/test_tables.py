"""Evaluations there and back, and what tables show, mark and refuse."""

import json
from dataclasses import replace

import pytest

from renderers.checks import UserError
from train.tables import (
    CAUTION,
    OF_TRUTH,
    REAL,
    TRUE,
    Evaluation,
    comparison_table,
    contrast_table,
    evaluation_table,
    load_evaluation,
    published_table,
    save_evaluation,
)


def evaluation(row: str, seed: int, **metrics: list[float]) -> Evaluation:
    return Evaluation(row, seed, "synth-c", 625, metrics, hashes={"benchmark": "ab" * 32, "model": f"{row}{seed}"})


def trained(row: str, **metrics: list[float]) -> list[Evaluation]:
    """One evaluation a seed, each of one repeat."""
    count = len(next(iter(metrics.values())))
    return [
        evaluation(row, seed, **{name: [values[seed]] for name, values in metrics.items()}) for seed in range(count)
    ]


def cells(markdown: str, first: str) -> list[str]:
    """The cells of the one line of a table that starts with ``first``."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in markdown.splitlines() if line[:1] == "|"]
    (found,) = (line for line in lines if line[0] == first)
    return found


class TestFiles:
    def test_there_and_back(self, tmp_path):
        one = replace(
            evaluation("with DR", 2, fid_c=[83.1, 0.1 + 0.2], accuracy=[0.64, 0.66]),
            real={"fid_c": [1.5]}, truth={"fid_c": [9.0]}, versions={"torch": "2.14"}, provenance={"seconds": 3.5},
        )  # fmt: skip
        save_evaluation(tmp_path / "one.json", one)
        assert load_evaluation(tmp_path / "one.json") == one

    def test_evaluations_of_before_the_truth_was_measured(self, tmp_path):
        older = evaluation("with DR", 2, fid_c=[83.1]).to_json()
        del older["truth"]
        (tmp_path / "one.json").write_text(json.dumps(older))
        found = load_evaluation(tmp_path / "one.json")
        assert found == evaluation("with DR", 2, fid_c=[83.1])
        assert cells(evaluation_table(found), "measure")[-1] == "real against real"
        assert TRUE not in comparison_table([found])

    def test_summary_is_in_the_units_of_the_tables(self):
        """ACTOR's plus-minus is of squared percent."""
        summary = evaluation("with DR", 0, accuracy=[0.01, 0.02, 0.03]).to_json()["summary"]["accuracy"]
        assert (summary["unit"], summary["mean"]) == ("%", 2.0)
        assert summary["actor_pm"] == pytest.approx(1.30667, abs=1e-5)

    def test_what_is_none_is_refused(self, tmp_path):
        path = tmp_path / "one.json"
        with pytest.raises(UserError, match="one.json: no such file"):
            load_evaluation(path)
        good = evaluation("with DR", 0, fid_c=[1.0]).to_json()
        for content, problem in (
            ("{", "is not JSON"),
            ("[1]", "is no evaluation"),
            (json.dumps({**good, "kind": "mae"}), "is no evaluation"),
            (json.dumps({**good, "schema": 7}), "is of schema 7, this version reads 1"),
            (json.dumps({name: value for name, value in good.items() if name != "n"}), "is damaged .KeyError: 'n'"),
            (json.dumps({**good, "metrics": {"fid_c": ["much"]}}), "is damaged .ValueError"),
            (json.dumps({**good, "metrics": 3}), "is damaged .AttributeError"),
        ):
            path.write_text(content)
            with pytest.raises(UserError, match=f"one.json: {problem}"):
                load_evaluation(path)

    def test_values_are_there_and_finite(self):
        with pytest.raises(UserError, match="evaluation of with DR, seed 3: fid_c: 1 of 2 values are not finite"):
            evaluation("with DR", 3, fid_c=[1.0, float("nan")])
        with pytest.raises(UserError, match="kid_c: there are no values"):
            evaluation("with DR", 3, kid_c=[])


class TestOneModel:
    def test_every_figure(self):
        one = replace(
            evaluation("with DR", 2, accuracy=[0.62, 0.64, 0.66], fid_c=[80.0, 83.0, 86.0], swing=[1.0, 1.0, 1.0]),
            real={"fid_c": [3.0, 4.0]}, versions={"torch": "2.14"},
        )  # fmt: skip
        text = evaluation_table(one)
        assert CAUTION in text
        assert cells(text, "FID-C ↓") == ["FID-C ↓", "625", "3", "83.00", "3.00", "[75.55, 90.45]", "11.8", "3.50"]
        assert cells(text, "accuracy, % ↑")[3:] == ["64.0", "2.0", "[59.0, 69.0]", "5.23", "–"]
        assert cells(text, "swing")[3:5] == ["1.000", "0.000"]
        assert text.index("FID-C ↓") < text.index("accuracy, % ↑") < text.index("swing")
        assert "torch 2.14, benchmark `abababababab`" in text

    def test_the_truth_has_a_column(self):
        one = replace(evaluation("a", 0, fid_c=[80.0], fid_true=[7.0]), truth={"fid_c": [43.21]})
        text = evaluation_table(one)
        assert cells(text, "measure")[-1] == "true compositions" and OF_TRUTH in text
        assert cells(text, "FID-C ↓")[-2:] == ["–", "43.21"] and cells(text, "FID to true ↓")[-2:] == ["–", "–"]

    def test_one_repeat_has_no_interval(self):
        text = evaluation_table(evaluation("with DR", 2, fid_c=[80.0]))
        assert cells(text, "FID-C ↓") == ["FID-C ↓", "625", "1", "80.00", "–", "–", "–", "–"]


class TestComparison:
    def test_means_and_intervals_are_over_seeds(self):
        """Means of repeats 1, 2 and 3 whatever the number of repeats; t of two degrees of freedom."""
        group = [evaluation("with DR", seed, fid_c=[seed, seed + 2.0]) for seed in range(3)]
        text = comparison_table([*group, evaluation("without DR", 0, fid_c=[9.0])])
        assert cells(text, "with DR") == ["with DR", "3", "**2.00** [-0.48, 4.48]"]
        assert cells(text, "without DR") == ["without DR", "1", "9.00"]
        assert "625 motions a repeat, 1 or 2 repeats a model" in text
        assert CAUTION in text and published_table() in text

    def test_bold_only_beyond_the_intervals(self):
        """The best, and no other, when its interval ends before all others begin; of one seed nothing is known."""
        near, far = {"fid_c": [80.0, 81.0, 82.0]}, {"fid_c": [100.0, 101.0, 102.0]}
        assert "**81.00**" in comparison_table(trained("a", **near) + trained("b", **far))
        overlapping = {"fid_c": [82.0, 83.0, 84.0]}
        assert "**" not in comparison_table(trained("a", **near) + trained("b", **far) + trained("c", **overlapping))
        assert "**" not in comparison_table([evaluation("a", 0, fid_c=[80.0]), *trained("b", **far)])
        assert "**" not in comparison_table(trained("a", **near))

    def test_bold_goes_the_measures_way(self):
        low, high = {"accuracy": [0.50, 0.51, 0.52]}, {"accuracy": [0.70, 0.71, 0.72]}
        text = comparison_table(trained("low", **low) + trained("high", **high))
        assert cells(text, "high")[2].startswith("**71.0**") and "**" not in cells(text, "low")[2]

    def test_real_motions_do_not_compete_but_say_what_is_near(self):
        close, tame = {"diversity": [28.0, 28.1, 28.2]}, {"diversity": [20.0, 20.1, 20.2]}
        rows = trained("close", **close) + trained("tame", **tame)
        assert "**" not in comparison_table(rows)
        text = comparison_table([evaluation(REAL, 0, diversity=[30.0]), *rows])
        assert cells(text, "close")[2].startswith("**28.10**")
        assert text.count("**") == 2

    def test_real_motions_come_from_beside_a_model(self):
        close, tame = trained("close", diversity=[28.0, 28.1, 28.2]), trained("tame", diversity=[20.0, 20.1, 20.2])
        text = comparison_table([close[0], replace(close[1], real={"diversity": [29.0, 31.0]}), close[2], *tame])
        text = text.partition("as published")[0]
        assert cells(text, REAL) == [REAL, "–", "30.00"]
        assert cells(text, "close")[:2] == ["close", "3"] and cells(text, "close")[2].startswith("**28.10**")
        assert text.index(f"| {REAL} |") < text.index("| close |")

    def test_the_truth_stands_under_the_real_ones_and_does_not_compete(self):
        rows = trained("a", fid_c=[80.0, 81.0, 82.0], fid_true=[5.0, 5.1, 5.2])
        rows += trained("b", fid_c=[100.0, 101.0, 102.0], fid_true=[9.0, 9.1, 9.2])
        rows[1] = replace(rows[1], real={"fid_c": [3.0]}, truth={"fid_c": [43.21]})
        text = comparison_table(rows).partition("as published")[0]
        lines = [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("|")]
        assert lines[2:6] == [REAL, TRUE, "a", "b"]
        assert cells(text, TRUE) == [TRUE, "–", "43.21", "–"]
        assert cells(text, "a")[2].startswith("**81.00**") and cells(text, "a")[3].startswith("**5.10**")
        assert OF_TRUTH in text and text.index(OF_TRUTH) < text.index("| seeds |")
        assert OF_TRUTH not in comparison_table(rows[:1])

    def test_a_measure_that_a_row_lacks(self):
        text = comparison_table([evaluation("a", 0, fid_c=[1.0]), evaluation("b", 0, kid_c=[0.5])])
        assert cells(text, "a")[2:] == ["1.00", "–"] and cells(text, "b")[2:] == ["–", "0.500"]
        assert cells(comparison_table(trained("a", fid_c=[1.0], kid_c=[2.0]), ["kid_c"]), "a")[2:] == ["2.000"]

    def test_what_was_measured_otherwise_is_refused(self):
        one = evaluation("a", 0, fid_c=[1.0])
        for other, problem in (
            (replace(one, row="b", benchmark="bn-c"), "b, seed 0: benchmark is bn-c, that of a synth-c"),
            (replace(one, row="b", n=600), "n is 600, that of a 625"),
            (replace(one, row="b", hashes={"benchmark": "cd"}), "was measured with another benchmark than a"),
            (replace(one, row="b", hashes={**one.hashes, "recogniser": "ef"}), "with another recogniser than a"),
            (one, "a, seed 0: is there twice"),
        ):
            with pytest.raises(UserError, match=problem):
                comparison_table([one, other])
        with pytest.raises(UserError, match="there are no evaluations"):
            comparison_table([])

    def test_a_bar_in_a_name_does_not_break_the_table(self):
        line = next(line for line in comparison_table(trained("a|b", fid_c=[1.0])).splitlines() if "a\\|b" in line)
        assert line == "| a\\|b | 1 | 1.00 |"


class TestContrast:
    def test_ten_percent_lower(self):
        ours, theirs = trained("with", fid_c=[80.0, 81.0, 82.0]), trained("without", fid_c=[100.0, 101.0, 102.0])
        found = cells(contrast_table(ours + theirs, "with", "without"), "FID-C ↓")
        assert found == ["FID-C ↓", "3, 3", "-20.00", "[-22.27, -17.73]", "0.802", "[0.782, 0.823]"]

    def test_seeds_one_by_one(self):
        """What a seed adds to both is gone when seeds are compared one by one."""
        ours, theirs = trained("with", fid_c=[80.0, 90.0, 70.0]), trained("without", fid_c=[101.0, 110.0, 91.0])
        apart = cells(contrast_table(ours + theirs, "with", "without"), "FID-C ↓")[3]
        paired = cells(contrast_table(ours + theirs, "with", "without", paired=True), "FID-C ↓")[3]
        assert paired == "[-22.10, -19.23]"
        assert apart == "[-42.80, 1.47]"
        with pytest.raises(UserError, match="with and without do not have fid_c for the same seeds"):
            contrast_table(ours[:2] + theirs, "with", "without", paired=True)

    def test_measures_of_one_side_are_left_out(self):
        rows = trained("with", fid_c=[1.0], kid_c=[1.0], accuracy=[0.5]) + trained(
            "without", fid_c=[2.0], accuracy=[0.4]
        )
        text = contrast_table(rows, "with", "without")
        assert "KID" not in text
        assert cells(text, "accuracy, % ↑")[2:] == ["+10.0", "–", "1.250", "–"]
        assert "FID" not in contrast_table(rows, "with", "without", metrics=["accuracy"])

    def test_an_unknown_row_is_refused(self):
        with pytest.raises(UserError, match="no evaluation of 'witout'; there are with"):
            contrast_table(trained("with", fid_c=[1.0]), "with", "witout")


def test_published_figures_stand_as_printed():
    text = published_table()
    found = cells(text, "Pre-train+Mask")
    assert found[1:4] == ["Table 1", "164.17 ± 47.51", "67.8 ± 3.13"]
    assert found[6:8] == ["162.35 ± 34.72", "49.7 ± 2.95"]
    assert "using full class on uestc-c (Table A.1)" in text
