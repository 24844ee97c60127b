"""The ladder of inpainters runs, with tiny settings, and says what it measured."""

import importlib
import json
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import spearmanr

from refine.mae import MAEConfig, load_mae

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TINY = MAEConfig(size=32, width=16, depth=1, heads=1, decoder_width=16, decoder_depth=1, decoder_heads=1)


@pytest.fixture
def ladder(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("ladder")


def test_rungs_differ_from_the_base_in_one_thing(ladder):
    base, *others = ladder.RUNGS
    assert len({rung.name for rung in ladder.RUNGS}) == len(ladder.RUNGS)
    assert set(ladder.SLOWEST_FIRST) <= {rung.name for rung in others}
    for rung in others:
        changed = [
            rung.network != base.network or rung.pictures.pinned != base.pictures.pinned,
            replace(rung.pictures, pinned=base.pictures.pinned) != base.pictures,
            rung.share != base.share,
            rung.weights is not None,
        ]
        assert sum(changed) == 1, rung.name


def test_a_rung_is_trained_for_its_share_of_the_steps(ladder, tmp_path):
    settings = replace(ladder.QUICK, steps=4, training_clips=2, batch=2, precision="float32")
    for share, steps in ((1.0, 4), (0.5, 2)):
        weights = ladder.trained(ladder.Rung(f"share {share}", TINY, share=share), settings, tmp_path)
        assert json.loads(weights.with_suffix(".json").read_text())["step"] == steps
    fresh = ladder.trained(ladder.Rung("fresh", TINY, share=0.0), settings, tmp_path)
    assert load_mae(fresh).config == TINY


def test_correlation_is_spearmans_with_ties(ladder):
    pairs = [(0.3, 1.0), (0.1, 1.0), (0.2, 3.0), (0.9, -1.0), (0.4, 1.0)]
    assert ladder.rank_correlation(pairs) == pytest.approx(spearmanr(*zip(*pairs, strict=True)).statistic)


def test_the_table_has_a_row_a_rung(ladder, tmp_path, monkeypatch):
    monkeypatch.setattr(ladder.refinement, "FRAMES", 6)
    monkeypatch.setattr(ladder, "RefinementConfig", lambda: ladder.refinement.RefinementConfig(steps=1, frames=1))
    monkeypatch.setattr(ladder, "load_clips_for", lambda config, rest: [ladder.draw_pair(0, 0, None, rest).legs])
    settings = ladder.Settings(steps=0, clips=1, pictures=1, pairs=4, refined=2)
    rungs = ladder.Rung("parts", TINY, share=0), ladder.Rung("none", TINY, share=0, inpaints=False)
    rows = [ladder.measure((rung, settings, None, tmp_path)) for rung in rungs]
    assert rows[1]["inpainting"] is None and rows[0]["inpainting"]["built-in"].keys() == {"random", "attention"}
    assert rows[0]["ranking"]["built-in"].keys() == rows[0]["refinement"].keys() == {"ours", "as published"}
    for loss in ("ours", "as published"):
        assert 0 < rows[0]["through_mae"][loss]["mean"] < 1
    text = ladder.tables(json.loads(json.dumps({"rungs": rows})))
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| parts", "| none"]
    assert len({line.count("|") for line in lines}) == 1 and "before refinement: " in text


def test_what_was_measured_is_kept_for_the_same_question(ladder, tmp_path, monkeypatch):
    asked = []

    def measured(task):
        asked.append(task[0].name)
        return {"name": task[0].name, "number": len(asked)}

    monkeypatch.setattr(ladder, "measure", measured)
    rung, settings = ladder.Rung("a rung", TINY), ladder.QUICK
    first = ladder.kept((rung, settings, tmp_path, tmp_path))
    assert ladder.kept((rung, settings, tmp_path, tmp_path)) == first and len(asked) == 1
    for other in (
        (rung, replace(settings, pairs=3), tmp_path),
        (rung, settings, None),
        (replace(rung, share=0.5), settings, None),
    ):
        ladder.kept((*other, tmp_path))
    monkeypatch.setattr(ladder, "commit", lambda: "another")
    ladder.kept((replace(rung, share=0.5), settings, None, tmp_path))
    assert len(asked) == 5


def test_a_rung_that_is_trained_is_not_trained_again(ladder, tmp_path):
    settings = replace(ladder.QUICK, steps=4, training_clips=2, batch=2, precision="float32")
    weights = ladder.trained(ladder.Rung("once", TINY), settings, tmp_path)
    before = weights.stat().st_mtime_ns
    assert ladder.trained(ladder.Rung("once", TINY), settings, tmp_path) == weights
    assert weights.stat().st_mtime_ns == before
