"""What the training benchmark measures with: turns, ratios, stages of a real step, the report."""

import importlib
import itertools
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from refine.generator import TINY
from train.config import GENERATOR_PRESETS

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def training(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("training")


def test_steps_take_turns_and_the_first_ones_do_not_count(training):
    called = []

    def step(name):
        def run():
            called.append(name)
            return float(len(called))

        return run

    found = training.alternate({"a": step("a"), "b": step("b")}, 2)
    assert called == ["a", "b"] * (training.WARM_UP + 2)
    assert found == {"a": [7.0, 9.0], "b": [8.0, 10.0]}


def test_the_overhead_is_the_ratio_of_medians_and_is_paid_at_every_nth_step(training):
    times = {0.0: iter([9, 9, 9, 1.0, 2.0, 30.0]), 0.5: iter([9, 9, 9, 5.0, 7.0, 6.0])}
    loss = SimpleNamespace(decoupling=0.5, decoupling_every=4)
    stepper = SimpleNamespace(config=SimpleNamespace(loss=loss), seconds=lambda weight: next(times[weight]))
    assert training.overhead(stepper, 3) == {"plain": 2000.0, "with": 6000.0, "ratio": 3.0, "average": 1.5}


def test_the_paper_s_batch_is_cut_where_there_is_no_gpu(training):
    paper = GENERATOR_PRESETS["paper"][1]
    on_cpu, on_gpu = (training.prepared(paper, device) for device in ("cpu", "cuda"))
    assert (on_gpu.batch, on_gpu.loss.decoupling_clips) == (800, 128)
    assert (on_cpu.batch, on_cpu.loss.decoupling_clips) == (25, 4)
    assert on_cpu.network == on_gpu.network == paper.network


def test_the_stages_of_a_step_are_all_there_and_add_up_to_it(training, monkeypatch):
    monkeypatch.setattr("time.perf_counter", itertools.count().__next__)  # time passes by looking at the clock alone
    preset = training.prepared(GENERATOR_PRESETS["tiny"][1], "cpu")
    stepper = training.Stepper(replace(preset, network=replace(TINY, latent=32, layers=1), batch=4))
    start = time.perf_counter()
    found = stepper.stages()
    whole = time.perf_counter() - start
    names = "data coupling generator losses body renderer projection MAE blur optimiser rest"
    assert found.keys() == {*names.split(), "attention, patches"}
    trained = {"generator", "losses", "body", "renderer", "projection", "MAE", "blur"}
    assert {name for name, (_, backward) in found.items() if backward > 0} >= trained
    assert all(forward > 0 for forward, _ in found.values())
    assert 0.9 * whole < sum(map(sum, found.values())) <= whole  # what is left is the measurement's own


def test_a_step_without_the_decoupling_loss_does_not_look(training, monkeypatch):
    preset = training.prepared(GENERATOR_PRESETS["tiny"][1], "cpu")
    stepper = training.Stepper(replace(preset, network=replace(TINY, latent=32, layers=1), batch=4))
    looks = []
    forward = stepper.training.decoupler.forward
    monkeypatch.setattr(stepper.training.decoupler, "forward", lambda *given: looks.append(1) or forward(*given))
    before = stepper.training.generator.write.weight.clone()
    assert stepper.seconds(0.0) > 0 and not looks
    assert stepper.seconds(1e-2) > 0 and looks
    assert not before.equal(stepper.training.generator.write.weight)


def test_the_report_says_every_figure(training):
    stage = {"forward": 1.5, "backward": 2.5, "share": 0.25}
    preset = {
        "preset": "small", "batch": 16, "frames": 60, "precision": "float32", "parameters": 1_230_000,
        "decoupling_clips": 4, "decoupling_frames": 1, "decoupling_every": 2, "views": 2, "aim": 2.0,
        "overhead": {"plain": 101.0, "with": 222.0, "ratio": 2.2, "average": 1.6}, "stages": {"MAE": stage},
    }  # fmt: skip
    report = {
        "command": "python x", "commit": "abc", "hardware": "h", "versions": {"torch": "2"}, "threads": 1,
        "minutes": 3.0, "plan": {"repeats": 5}, "presets": [preset],
        "by_batch": [{"batch": 8, "float32": 12.0, "bfloat16": 11.0}],
        "by_pictures": [{"clips": 2, "frames": 1, "added": 33.0}, {"clips": 2, "frames": 4, "added": 44.0}],
    }  # fmt: skip
    said = training.markdown(report)
    assert "| small | 16 x 60 | 1.23 | float32 | 4 x 1 x 2 | 2 | 101 | 222 | 2.20 | 1.60 (aim 2.0) |" in said
    assert "| MAE | 1.5 + 2.5 (25 %) |" in said
    assert "| 8 | 12 | 11 |" in said
    assert "| clips | 1 frame | 4 frames |" in said and "| 2 | 33 | 44 |" in said
