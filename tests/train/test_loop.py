"""The training loop on a model of two numbers: exact resume, bad losses, what is left on disk."""

import json
import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
from safetensors import safe_open
from torch import nn

from renderers.checks import UserError
from train.checkpoints import save_state
from train.loop import RULE, LoopConfig, check_loop, fit, learning_rate, open_run, seed_of, take_step


@dataclass(frozen=True)
class LineConfig:
    width: int = 2


class Line(nn.Module):
    """A noisy line with dropout, so that both random streams matter."""

    def __init__(self):
        super().__init__()
        self.config = LineConfig()
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.layers = nn.Sequential(nn.Linear(2, 8), nn.Dropout(0.5), nn.Linear(8, 1))

    def losses(self, step, random):
        x = torch.randn(16, 2, generator=random)
        error = (self.layers(x)[:, 0] - x.sum(1)).square().mean()
        yield {"error": error, "total": 2 * error}


def run(folder, steps, resume=False, losses=None, **changes):
    folder.mkdir(exist_ok=True)
    model = Line()
    config = replace(LoopConfig(steps=steps, learning_rate=1e-2, save_every=5, warmup=4), **changes)
    held_out = torch.ones(1, 2)
    path = fit(
        model,
        losses(model) if losses else model.losses,
        config,
        folder,
        "mae",
        {"note": "a line"},
        lambda: {"total": float((model.layers(held_out) - 2).square())},
        resume,
    )
    return model, path


def rows(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def terms(folder):
    return [{name: row[name] for name in ("step", "error", "total", "gradient")} for row in rows(folder)]


def test_a_resumed_run_equals_an_unbroken_one_bit_for_bit(tmp_path):
    whole, _ = run(tmp_path / "whole", 20)
    run(tmp_path / "broken", 10)
    with (tmp_path / "broken" / "log.jsonl").open("a") as log:  # what a run logs after its last checkpoint, then dies
        log.write('{"step": 10, "error": 7.0, "total": 14.0, "gradient": 1.0}\n{"step": 11, "err')
    resumed, _ = run(tmp_path / "broken", 20, resume=True)
    assert terms(tmp_path / "broken") == terms(tmp_path / "whole")
    for ours, theirs in zip(resumed.parameters(), whole.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_another_seed_gives_other_losses(tmp_path):
    run(tmp_path / "a", 3)
    run(tmp_path / "b", 3, seed=11)
    assert terms(tmp_path / "a") != terms(tmp_path / "b")


def test_the_loss_falls_and_the_global_generator_is_left_alone(tmp_path):
    before = torch.random.get_rng_state()
    run(tmp_path / "run", 200, save_every=100)
    assert torch.equal(torch.random.get_rng_state(), before)
    total = [row["total"] for row in rows(tmp_path / "run")]
    assert sum(total[-20:]) < 0.5 * sum(total[:20])


def test_best_is_the_lowest_held_out_total(tmp_path):
    _, path = run(tmp_path / "run", 60)
    measured = {row["step"] + 1: row["held_out"]["total"] for row in rows(tmp_path / "run") if "held_out" in row}
    described = json.loads(path.with_suffix(".json").read_text())
    assert len(measured) == 12
    assert described["step"] == min(measured, key=measured.get)
    assert described["held_out"]["total"] == min(measured.values())
    assert json.loads((tmp_path / "run" / "last.json").read_text())["step"] == 60


def test_a_loss_that_is_not_finite_stops_and_keeps_the_checkpoint(tmp_path):
    def broken(model):
        def losses(step, random):
            for found in model.losses(step, random):
                yield found | {"error": found["error"] * (math.nan if step == 7 else 1)}

        return losses

    with pytest.raises(UserError, match=r"step 7: the term 'error' became nan; the last good checkpoint is .*state"):
        run(tmp_path / "run", 20, losses=broken)
    kept = {name: (tmp_path / "run" / name).read_bytes() for name in ("state.safetensors", "last.safetensors")}
    run(tmp_path / "five", 5)
    assert kept == {name: (tmp_path / "five" / name).read_bytes() for name in kept}
    assert len(rows(tmp_path / "run")) == 7


def test_the_batch_of_a_bad_step_is_named(tmp_path):
    model = Line()

    def losses(step, random):
        for terms in model.losses(step, random):
            yield terms | {"total": terms["total"] * (math.inf if step == 2 else 1)}

    message = r"step 2: the term 'total' became inf on batch 2; there is no checkpoint yet; start again"
    with pytest.raises(UserError, match=message):
        fit(model, losses, LoopConfig(steps=5), tmp_path, "mae", {}, dict, describe=lambda step: f"batch {step}")


def test_parts_of_a_step_are_summed(tmp_path):
    """Terms, gradient and update of a step in three parts are those of their sum."""
    weight = nn.Linear(1, 1, bias=False)
    weight.weight.data.fill_(2.0)
    optimiser = torch.optim.SGD(weight.parameters(), 0.0)

    def losses(step, random):
        for part in (1.0, 2.0, 4.0):
            yield {"linear": part * weight.weight.sum(), "total": part * weight.weight.square().sum()}

    row = take_step(weight, optimiser, losses, 0, torch.Generator(), LoopConfig())
    assert row == {"linear": 14.0, "total": 28.0, "gradient": 28.0}
    assert weight.weight.grad.item() == 28.0


def test_the_state_says_what_the_sampler_goes_on_from(tmp_path):
    run(tmp_path / "run", 10)
    with safe_open(tmp_path / "run" / "state.safetensors", framework="pt") as file:
        progress = json.loads(file.metadata()["progress"])
    assert progress["sampler"] == {"seed": 10, "step": 10, "rule": RULE}
    assert seed_of(10, 10, 0) == int(np.random.SeedSequence((10, 10, 0)).generate_state(1)[0])


def test_tensorboard_is_refused_where_it_is_not_installed(monkeypatch):
    monkeypatch.setattr("train.loop.find_spec", lambda name: None)
    check_loop(LoopConfig())
    with pytest.raises(
        UserError, match=r"--loop.tensorboard: TensorBoard is not installed; pip install 'refine-motion"
    ):
        check_loop(LoopConfig(tensorboard=True))


class Board:
    """Stands for TensorBoard's writer."""

    def __init__(self):
        self.scalars, self.closed = [], False

    def add_scalar(self, name, value, step):
        self.scalars.append((name, step))

    def close(self):
        self.closed = True


def test_tensorboard_is_told_every_logged_term(tmp_path, monkeypatch):
    opened = []

    def open_board(folder, first):
        opened.append((folder, first, Board()))
        return opened[-1][-1]

    monkeypatch.setattr("train.loop.open_board", open_board)
    run(tmp_path / "run", 4, tensorboard=True, save_every=2)
    run(tmp_path / "run", 6, tensorboard=True, save_every=2, resume=True)
    assert [(folder, first) for folder, first, _ in opened] == [(tmp_path / "run", 0), (tmp_path / "run", 4)]
    assert all(board.closed for *_, board in opened)
    names = [name for name, step in opened[0][2].scalars if step == 1]
    assert names == ["error", "total", "gradient", "held_out/total"]
    assert {step for _, step in opened[1][2].scalars} == {4, 5}


def test_tensorboard_writes_what_it_is_told(tmp_path):
    pytest.importorskip("tensorboard")
    run(tmp_path / "run", 4, tensorboard=True)
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    told = {event.step: event.value for event in events.Scalars("error")}
    assert told == pytest.approx({row["step"]: row["error"] for row in rows(tmp_path / "run")}, rel=1e-6)


def test_gradients_are_clipped(tmp_path):
    def large(model):
        return lambda step, random: ({"total": 1e6 * found["total"]} for found in model.losses(step, random))

    moved = {}
    for clip in (None, 1e-12):
        model, _ = run(tmp_path / str(clip), 1, losses=large, clip_gradients=clip, weight_decay=0.0, warmup=0)
        moved[clip] = (model.layers[0].weight - Line().layers[0].weight).abs().max().item()
        assert rows(tmp_path / str(clip))[0]["gradient"] > 1e3  # the norm before clipping
    assert moved[None] == pytest.approx(1e-2, rel=1e-3)  # AdamW's first step
    assert moved[1e-12] < 1e-4  # a gradient far below its epsilon of 1e-8 moves nothing


def test_learning_rate_rises_then_falls_along_a_cosine():
    config = LoopConfig(steps=110, learning_rate=2.0, warmup=10, schedule="cosine")
    assert [learning_rate(step, config) for step in (0, 4, 9)] == pytest.approx([0.2, 1.0, 2.0])
    assert learning_rate(60, config) == pytest.approx(1.0)
    assert learning_rate(110, config) == pytest.approx(0.0, abs=1e-12)
    assert learning_rate(500, replace(config, schedule="constant")) == 2.0


def test_log_every_thins_the_log_but_keeps_checkpoints(tmp_path):
    run(tmp_path / "run", 12, log_every=4, save_every=6)
    assert [row["step"] for row in rows(tmp_path / "run")] == [0, 4, 5, 8, 11]


def test_curves_are_drawn(tmp_path):
    from PIL import Image

    run(tmp_path / "run", 10)
    picture = Image.open(tmp_path / "run" / "curves.png").convert("L")
    darkest, lightest = picture.getextrema()
    assert picture.size == (760, 420)
    assert darkest < 80 < 250 < lightest


def test_no_file_is_left_beside(tmp_path):
    run(tmp_path / "run", 5)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    weights = {f"{name}.{suffix}" for name in ("best", "last") for suffix in ("json", "safetensors")}
    assert names == weights | {"state.safetensors", "log.jsonl", "curves.png"}


def test_open_run_refuses_what_would_be_lost(tmp_path):
    folder = tmp_path / "deep" / "run"
    with pytest.raises(UserError, match="holds no run to resume; start it without --resume"):
        open_run(folder, LoopConfig(), resume=True)
    assert not folder.exists()
    open_run(folder, LoopConfig(steps=3), resume=False)
    assert json.loads((folder / "config.json").read_text())["steps"] == 3
    with pytest.raises(UserError, match="already holds a run; go on with --resume"):
        open_run(folder, LoopConfig(), resume=False)
    open_run(folder, LoopConfig(steps=9), resume=True)
    assert json.loads((folder / "config.json").read_text())["steps"] == 9
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file"):
        open_run(tmp_path / "file", LoopConfig(), resume=False)


@dataclass(frozen=True)
class Whole:
    """A run's configuration in small."""

    out: str = "run"
    loop: LoopConfig = field(default_factory=LoopConfig)
    actions: tuple[str, ...] = ("walk",)
    batch: int = 4
    device: str = "cpu"
    resume: bool = False


def test_a_run_is_not_resumed_under_another_configuration(tmp_path):
    begun = Whole()
    open_run(tmp_path, begun, resume=False)
    stored = (tmp_path / "config.json").read_bytes()
    changed = replace(begun, batch=8, actions=("walk", "run"), loop=LoopConfig(steps=7, learning_rate=1e-3))
    with pytest.raises(UserError) as caught:
        open_run(tmp_path, changed, resume=True)
    assert str(caught.value) == (
        f"{tmp_path / 'config.json'}: is of another run: actions was ['walk'] and is ['walk', 'run'], batch was 4 and "
        "is 8, loop.learning_rate was 0.0001 and is 0.001; give the same, or choose another folder with --out"
    )
    assert (tmp_path / "config.json").read_bytes() == stored


def test_a_resumed_run_may_be_longer_elsewhere_and_write_otherwise(tmp_path):
    open_run(tmp_path, Whole(), resume=False)
    longer = LoopConfig(steps=9000, log_every=7, save_every=70)
    open_run(tmp_path, Whole(out="moved", loop=longer, device="cuda", resume=True), resume=True)
    assert json.loads((tmp_path / "config.json").read_text())["loop"]["steps"] == 9000


def test_a_run_of_a_version_with_other_values_is_not_resumed(tmp_path):
    open_run(tmp_path, Whole(), resume=False)
    stored = json.loads((tmp_path / "config.json").read_text())
    del stored["batch"]
    (tmp_path / "config.json").write_text(json.dumps(stored))
    with pytest.raises(UserError, match="batch was None and is 4"):
        open_run(tmp_path, Whole(), resume=True)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe"])
def test_a_damaged_configuration_is_refused(tmp_path, content):
    (tmp_path / "config.json").write_bytes(content)
    with pytest.raises(UserError, match="is no configuration .*start again in another folder") as caught:
        open_run(tmp_path, Whole(), resume=True)
    assert "\n" not in str(caught.value)


def test_a_run_killed_before_its_first_checkpoint_is_resumed_from_the_start(tmp_path):
    run(tmp_path / "whole", 10)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "log.jsonl").write_text('{"step": 0, "error": 7.0}\n{"step": 1, "err')
    run(tmp_path / "broken", 10, resume=True)
    assert terms(tmp_path / "broken") == terms(tmp_path / "whole")


def test_a_run_killed_within_its_first_checkpoint_is_resumed_from_the_start(tmp_path, monkeypatch):
    """The weights are written and their state is not: the second state of the run is where it dies."""
    run(tmp_path / "whole", 10)
    states = []

    def dying(path, model, optimiser, progress):
        states.append(progress["step"])
        if len(states) == 2:
            raise KeyboardInterrupt
        save_state(path, model, optimiser, progress)

    monkeypatch.setattr("train.loop.save_state", dying)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "broken", 10)
    assert states == [0, 5] and (tmp_path / "broken" / "last.safetensors").exists()
    run(tmp_path / "broken", 10, resume=True)
    assert terms(tmp_path / "broken") == terms(tmp_path / "whole")
    for name in ("best.safetensors", "state.safetensors"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_run_that_lost_its_state_is_not_trained_over(tmp_path):
    run(tmp_path / "run", 5)
    (tmp_path / "run" / "state.safetensors").unlink()
    weights = (tmp_path / "run" / "best.safetensors").read_bytes()
    with pytest.raises(UserError, match="state.safetensors: no such file; start again in another folder with --out"):
        run(tmp_path / "run", 10, resume=True)
    assert (tmp_path / "run" / "best.safetensors").read_bytes() == weights


def test_seeds_differ_by_every_key():
    assert len({seed_of(a, b, c) for a in range(4) for b in range(4) for c in range(2)}) == 32


def test_impossible_configurations_are_refused():
    with pytest.raises(UserError, match=r"LoopConfig\(steps\): expected 1 or more, got 0"):
        LoopConfig(steps=0)
    with pytest.raises(UserError, match="learning_rate"):
        LoopConfig(learning_rate=0.0)


def test_every_step_draws_afresh_from_both_streams(tmp_path):
    """Dropout draws from torch's own generator, all else from the one that is handed over."""
    drawn = []

    def recording(model):
        def losses(step, random):
            drawn.append((float(torch.rand(())), float(torch.rand((), generator=random))))
            yield from model.losses(step, random)

        return losses

    run(tmp_path / "run", 10, losses=recording)
    assert len({value for pair in drawn for value in pair}) == 20


def test_weights_that_a_step_broke_are_not_written(tmp_path):
    """A huge step from a finite gradient: the loss of the step is fine, that of the weights after it is not."""
    run(tmp_path / "run", 5)
    kept = {name: (tmp_path / "run" / name).read_bytes() for name in ("state.safetensors", "last.safetensors")}
    with pytest.raises(UserError, match=r"the term 'total' became (nan|inf).*start again in another folder"):
        run(tmp_path / "run", 6, resume=True, learning_rate=1e38, save_every=1, warmup=0)
    assert kept == {name: (tmp_path / "run" / name).read_bytes() for name in kept}
