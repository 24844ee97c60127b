"""Evaluation on a small benchmark: what is drawn, what is measured, and what is refused."""

import importlib
import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from refine.cli.main import main
from refine.coupling import CouplingConfig, couple_features
from refine.generator import TINY, Generator, GeneratorConfig
from refine.motion import from_features, to_features
from refine.recogniser import BothActions
from renderers.checks import UserError
from renderers.rotations import matrix_to_6d
from train.building import build_benchmark
from train.config import GENERATOR_PRESETS
from train.data import DataConfig
from train.evaluate import (
    UNTOLD,
    EvaluationConfig,
    Judge,
    beside,
    evaluate,
    generated,
    hash_recogniser,
    operated,
    repeat,
)
from train.generator import train_generator
from train.recipes import synth_c
from train.recogniser import RecogniserTraining, train_recognisers
from train.tables import load_evaluation
from train.variants import VARIANTS, as_variant

NETWORK = replace(TINY, latent=16, feedforward=16, layers=1)
ONCE = EvaluationConfig(repeats=1)


@pytest.fixture(scope="module")
def benchmark(rest_joints, tmp_path_factory):
    """synth-c with two test clips of each action, and recognisers that have hardly learned anything."""
    material = synth_c(rest_joints, seed=3, train=2, test=2, extra=0, seconds=2.5)
    built = build_benchmark(tmp_path_factory.mktemp("benchmarks") / "synth-c", material, rest_joints, 3, "refine ...")
    train_recognisers(built.folder, RecogniserTraining(widths=(4, 8), depths=(1, 1), epochs=3, learning_rate=1e-2))
    return built


@pytest.fixture(scope="module")
def judge(benchmark, rest_joints):
    return Judge(benchmark, rest_joints)


def generator_for(benchmark, fps=30.0, classes=None):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        classes = classes or tuple(sorted(benchmark.lower + benchmark.upper))
        return Generator(GeneratorConfig.of(NETWORK, classes, fps)).eval()


@pytest.fixture(scope="module")
def run(benchmark, tmp_path_factory):
    _, preset = GENERATOR_PRESETS["small"]
    out = tmp_path_factory.mktemp("runs") / "run"
    loop = replace(preset.loop, steps=2, save_every=2)
    data = DataConfig(source=str(benchmark.folder))
    train_generator(
        as_variant(replace(preset, out=out, loop=loop, data=data, network=NETWORK, variant="without-dr", measured=4))
    )
    return out


def test_test_compositions_are_perfect_by_every_measure_of_distance(judge):
    masked = judge.measure(judge.compositions["mask"], torch.Generator())
    assert max(masked["fid_c"], masked["fid_half"]) < 1e-3 * masked["fid_true"]
    true = judge.measure(judge.compositions["true"], torch.Generator())
    assert true["fid_true"] < 1e-3 * true["fid_c"]
    assert true["nearest_true"] == true["covered_true"] == 0 < masked["nearest_true"]


def test_shares_of_parts_are_each_under_its_name(judge, monkeypatch):
    """Every leg right, every fourth arm, never both, which no body could do."""
    n = len(judge.labels)
    found = BothActions(torch.ones(n) > 0, torch.arange(n) % 4 == 0, torch.zeros(n) > 0)
    monkeypatch.setattr("train.evaluate.both_actions", lambda *_: found)
    measured = judge.measure(judge.compositions["mask"], torch.Generator())
    assert [measured[name] for name in ("legs", "arms", "both_actions")] == [1.0, 0.25, 0.0]


def test_nearness_is_within_a_pair(judge):
    joints, true = (judge.joints(judge.compositions[kind]) for kind in ("mask", "true"))
    pairs = [(n, m) for n, label in enumerate(judge.labels) for m, other in enumerate(judge.labels) if other == label]
    errors = {
        at: float((joints[at[0]] - joints[at[0], :, :1] - true[at[1]] + true[at[1], :, :1]).norm(dim=-1)[:, 1:].mean())
        for at in pairs
    }
    found = judge.nearness(joints)
    for name, side in (("nearest_true", 0), ("covered_true", 1)):
        best = [min(value for at, value in errors.items() if at[side] == n) for n in range(len(judge.labels))]
        assert found[name] == pytest.approx(sum(best) / len(best), rel=1e-5)


def test_the_operator_draws_new_windows_from_every_seed(judge):
    first, again, other = (operated(judge)(torch.Generator().manual_seed(seed)).rotations for seed in (1, 1, 2))
    assert first.shape == (len(judge.labels), 60, 24, 3, 3)
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_the_operator_follows_the_order_of_the_test_set(judge):
    """Legs that move much in the test set move much in the operator's sample."""
    sample = operated(judge)(torch.Generator().manual_seed(0))
    legs = sample.rotations[:, :, [1, 2, 4, 5]].diff(dim=1).square().sum((1, 2, 3, 4))
    test = judge.compositions["mask"].rotations[:, :, [1, 2, 4, 5]].diff(dim=1).square().sum((1, 2, 3, 4))
    assert torch.corrcoef(torch.stack([legs, test]))[0, 1] > 0.5


def test_a_generator_makes_one_motion_a_test_composition(judge, benchmark):
    sample = generated(generator_for(benchmark), judge, None, ONCE)(torch.Generator().manual_seed(1))
    assert sample.rotations.shape[:2] == (len(judge.labels), 60)
    small = generated(generator_for(benchmark), judge, None, EvaluationConfig(batch=7))(
        torch.Generator().manual_seed(1)
    )
    assert not torch.equal(sample.rotations[0], sample.rotations[1])
    assert torch.allclose(sample.rotations[:7], small.rotations[:7], atol=1e-5)


def test_a_generator_of_single_actions_is_coupled(judge, benchmark, rest_joints):
    generator = generator_for(benchmark)
    coupled = generated(generator, judge, CouplingConfig(), ONCE)(torch.Generator().manual_seed(1))
    # The same draws, coupled by hand: all of i first, then all of j.
    random = torch.Generator().manual_seed(1)
    features = []
    for side in (0, 1):
        labels = torch.zeros(len(judge.pairs), len(generator.config.classes))
        for row, pair in enumerate(judge.pairs):
            labels[row, generator.config.classes.index(pair[side])] = 1
        latent = torch.randn(len(labels), NETWORK.latent, generator=random)
        with torch.no_grad():
            features.append(generator.decode(latent, labels, torch.ones(len(labels), 60, dtype=torch.bool)))
    expected = couple_features(*features, torch.full((len(labels),), 0.5), rest_joints)
    found = to_features(matrix_to_6d(coupled.rotations), coupled.root)
    rotations, _ = from_features(expected)
    assert torch.allclose(found[:, :, :24], matrix_to_6d(rotations), atol=1e-4)


def test_every_repeat_has_a_seed_of_its_own(judge, benchmark):
    sampler = generated(generator_for(benchmark), judge, None, ONCE)
    values = repeat(sampler, judge, EvaluationConfig(repeats=2), "test")
    assert values["fid_c"][0] != values["fid_c"][1]
    assert repeat(sampler, judge, ONCE, "test")["fid_c"] == values["fid_c"][:1]


def test_a_run_is_measured_and_told_apart_from_the_operator(run, benchmark):
    found = evaluate(run, benchmark, ONCE)
    assert (found.row, found.seed, found.n, found.benchmark) == ("without-dr", 10, 100, "synth-c")
    assert found.truth["fid_c"] > [0.0]
    assert found.metrics.keys() == found.real.keys() >= {"fid_c", "fid_true", "both_actions", "nearest_true", "jitter"}
    assert found.real["nearest_true"][0] < found.metrics["nearest_true"][0]
    assert set(found.hashes) == {"model", "benchmark", "mask", "half", "true", "legs", "arms"}


@pytest.fixture
def kept(judge, monkeypatch):
    """Where what stands beside generators is kept, empty, and how often the operator was measured."""
    path, times = judge.benchmark.folder / "recognisers" / "beside.json", []
    path.unlink(missing_ok=True)

    def counted(*arguments):
        times.append(arguments)
        return repeat(*arguments)

    monkeypatch.setattr("train.evaluate.repeat", counted)
    return path, times


@pytest.fixture(scope="module")
def measures(judge):
    return judge.measure(judge.compositions["mask"], torch.Generator()).keys()


def test_what_is_the_same_for_every_run_is_measured_once(judge, measures, kept):
    path, times = kept
    first = beside(judge, ONCE, measures)
    assert first == beside(judge, ONCE, measures) and len(times) == 1
    assert first.real == repeat(operated(judge), judge, ONCE, "again")
    found = json.loads(path.read_text())
    assert found["real"] == first.real and found["key"]["benchmark"] == judge.benchmark.hash
    found["real"]["fid_c"] = [7.0]
    path.write_text(json.dumps(found))
    assert beside(judge, ONCE, measures).real["fid_c"] == [7.0]


def test_what_was_kept_for_another_evaluation_is_measured_again(judge, measures, kept, monkeypatch):
    """By repeats, seed, benchmark, recogniser and measures; and a file that is damaged."""
    path, times = kept

    def quick(sampler, judge, config, name):
        times.append(name)
        return {name: [config.seed + 0.5] * config.repeats for name in measures}

    monkeypatch.setattr("train.evaluate.repeat", quick)
    monkeypatch.setattr("train.evaluate.truth_of", lambda *_: {name: [2.0] for name in measures - {*UNTOLD}})
    first = beside(judge, ONCE, measures)
    good = json.loads(path.read_text())
    named = {"fid_c": [1.0]} | good["real"]
    for content in (
        "{", "[1]", "[" * 100_000, json.dumps({}),
        *(json.dumps(good | {"key": good["key"] | {name: "ab"}}) for name in good["key"]),
        *(json.dumps(good | {"real": named | {"fid_c": values}}) for values in ([], [1.0, 2.0], ["much"], 3, [1e999])),
        json.dumps(good | {"real": {"fid_c": [1.0]}}),
        json.dumps(good | {"truth": {}}),
    ):  # fmt: skip
        path.write_text(content)
        before = len(times)
        assert beside(judge, ONCE, measures) == first, content[:80]
        assert len(times) == before + 1 and json.loads(path.read_text()) == good, content[:80]
    beside(judge, EvaluationConfig(repeats=1, seed=1), measures)
    assert json.loads(path.read_text())["real"] != first.real


def test_a_folder_that_cannot_be_written_keeps_nothing_and_stops_nothing(judge, measures, kept):
    path, times = kept
    path.mkdir()
    try:
        assert beside(judge, ONCE, measures).real and len(times) == 1
    finally:
        path.rmdir()


def test_the_truth_is_what_perfect_composing_would_measure(judge, measures, kept):
    """As the true compositions measure; nothing of themselves against themselves, and nothing where there are none."""
    found = beside(judge, ONCE, measures).truth
    assert found.keys() == measures - {*UNTOLD} >= {"fid_c", "both_actions", "jitter"}
    measured = judge.measure(judge.compositions["true"], torch.Generator())
    for name in ("fid_c", "accuracy", "both_actions", "jitter"):
        assert found[name] == [measured[name]]


def test_the_verb_writes_json_and_a_table_and_compares(run, benchmark, tmp_path, capsys):
    out = tmp_path / "found.json"
    call = ["evaluate", str(run), "--benchmark", str(benchmark.folder), "--repeats", "2", "-o", str(out)]
    assert main(call) == 0
    assert "FID-C" in capsys.readouterr().out
    assert load_evaluation(out).metrics["fid_c"] and out.with_suffix(".md").read_text().startswith("## without-dr")
    assert main(call) == 2 and "already there" in capsys.readouterr().err
    other = tmp_path / "other.json"
    other.write_text(json.dumps(json.loads(out.read_text()) | {"row": "with-dr"}))
    assert main(["evaluate", "--table", str(out), str(other), "--against", "without-dr"]) == 0
    assert "| with-dr |" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["evaluate"], "takes one run and its --benchmark"),
        (["evaluate", "--table"], "no evaluation was given"),
        (["evaluate", "--table", "a.json", "-o", "b.json"], "end its name in .md"),
        (["evaluate", "run", "--benchmark", "set", "--against", "real"], "give it with --table"),
        (["evaluate", "nowhere", "--benchmark", "nowhere"], "holds no benchmark"),
    ],
)
def test_what_is_missing_is_one_line(arguments, words, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_what_does_not_fit_is_refused(run, benchmark, judge, tmp_path):
    with pytest.raises(UserError, match="makes 25 frames a second"):
        generated(generator_for(benchmark, fps=25.0), judge, None, ONCE)
    with pytest.raises(UserError, match="unknown name"):
        generated(generator_for(benchmark, classes=("walk", "wave")), judge, None, ONCE)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(UserError, match="no such file"):
        evaluate(empty, benchmark, ONCE)


def test_runs_that_do_not_belong_are_refused(run, benchmark, tmp_path):
    for changes, words in (
        ({"step": 1}, "is at step 1 of 2; finish it with --resume"),
        ({"data": {"benchmark": "another"}}, "was not trained on"),
    ):
        folder = tmp_path / words[:5]
        folder.mkdir()
        for path in run.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        described = folder / "last.json"
        described.write_text(json.dumps(json.loads(described.read_text()) | changes))
        with pytest.raises(UserError, match=words):
            evaluate(folder, benchmark, ONCE)
    (folder / "config.json").write_text((run / "config.json").read_text().replace('"mask"', '"veil"'))
    with pytest.raises(UserError, match="is no configuration of a generator"):
        evaluate(folder, benchmark, ONCE)


def test_what_counts_as_right_is_part_of_a_recognisers_hash(benchmark, tmp_path):
    for path in (benchmark.folder / "recognisers").glob("legs.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    before, described = hash_recogniser(tmp_path / "legs.safetensors"), tmp_path / "legs.json"
    described.write_text(described.read_text().replace('"seconds":', '"took":'))
    assert hash_recogniser(tmp_path / "legs.safetensors") == before
    found = json.loads(described.read_text())
    found["config"]["alike"] = [["a", "b"]]
    described.write_text(json.dumps(found))
    assert hash_recogniser(tmp_path / "legs.safetensors") != before


def test_a_sheet_shows_the_first_set_that_is_measured(run, benchmark, judge, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    sheet = importlib.import_module("generation_sheet")
    measured = []
    monkeypatch.setattr(Judge, "measure", lambda self, sample, random: measured.append(sample) or {"fid_c": 0.0})
    evaluate(run, benchmark, EvaluationConfig(repeats=1))
    shown = sheet.first_set(run, sheet.Asked(benchmark, judge.pairs, judge.rest_joints))
    assert torch.equal(shown.rotations, measured[0].rotations)
    assert torch.equal(shown.root, measured[0].root)


def test_every_row_changes_what_it_is_named_after_and_nothing_else():
    _, preset = GENERATOR_PRESETS["small"]
    plain = {name: Path("plain.safetensors") for name, variant in VARIANTS.items() if variant.plain}
    rows = {name: as_variant(replace(preset, variant=name, mae=plain.get(name))) for name in VARIANTS}
    assert {name for name, row in rows.items() if not row.loss.decoupling} == {
        "pretrain-mask", "disentanglement", "without-mask", "without-gaussian", "all-classes", "without-dr", "dr-shares"
    }  # fmt: skip
    assert {name for name, row in rows.items() if row.shares.looks} == {
        "with-dr", "dr-shares", "dr-one-camera", "dr-plain"
    }  # fmt: skip
    assert len({repr(replace(row, variant="", mae=None)) for row in rows.values()}) == len(rows)
    for row in rows.values():
        assert (row.loop, row.network, row.batch) == (preset.loop, preset.network, preset.batch)
    assert as_variant(preset) is preset
    with pytest.raises(UserError, match="did you mean without-dr"):
        as_variant(replace(preset, variant="witout-dr"))
    with pytest.raises(UserError, match="refine train mae plain"):
        as_variant(replace(preset, variant="dr-paper"))
