"""On a graphics card: the very figures of the processor, from a single look to whole programs."""

import json
from dataclasses import replace

import pytest
import torch

from refine.decoupling import Decoupler, DecouplingConfig
from refine.generator import TINY
from refine.mae import MAE, MAEConfig, load_mae
from refine.refinement import RefinementConfig, refine_motion
from refine.seeing import Clips
from refine.synthetic import draw, perform
from renderers.body import Body
from train.building import build_benchmark
from train.config import GeneratorTraining, MAETraining
from train.data import DataConfig
from train.evaluate import EvaluationConfig, evaluate
from train.generator import Training, train_generator
from train.loop import LoopConfig
from train.mae import train_mae
from train.processes import Processes
from train.recipes import synth_c
from train.recogniser import RecogniserTraining, train_recognisers
from train.shares import SharesConfig
from train.steps import GeneratorLoss

CARD = "cuda"
SMALL_MAE = MAEConfig(width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1, decoder_heads=2)

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")


@pytest.fixture(autouse=True)
def exact_products():
    """Without TF32, which rounds products to ten bits."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    torch.backends.cudnn.allow_tf32 = False
    yield
    torch.set_float32_matmul_precision(before)
    torch.backends.cudnn.allow_tf32 = True


def training(folder, device, **changes) -> GeneratorTraining:
    data = DataConfig(
        lower=("walk", "squat"), upper=("wave-both-hands",), frames=20, synthetic_clips=2, synthetic_seconds=1.0
    )
    whole = GeneratorTraining(
        out=folder,
        data=data,
        network=TINY,
        loss=GeneratorLoss(decoupling=1.0, decoupling_clips=3, decoupling_frames=2),
        shares=SharesConfig(looks=0),
        loop=LoopConfig(steps=6, learning_rate=1e-3, save_every=3),
        batch=6,
        measured=4,
        device=device,
    )
    return replace(whole, **changes)


def logged(folder):
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [{name: value for name, value in row.items() if name not in ("seconds", "held_out")} for row in rows]


def assert_same_losses(here, there, rel=1e-3):
    assert len(here) == len(there)
    for one, other in zip(here, there, strict=True):
        assert other == pytest.approx(one, rel=rel)


def performed(rest_joints, *names):
    return [perform(draw(name, torch.Generator().manual_seed(n)), 24, rest_joints) for n, name in enumerate(names)]


def test_a_look_and_its_gradient(rest_joints):
    walk, wave = (Clips(each.rotations[None], each.root[None]) for each in performed(rest_joints, "walk", "drink"))
    found = []
    for device in ("cpu", CARD):
        decoupler = Decoupler(Body.free("light"), load_mae(), DecouplingConfig()).to(device)
        i, j = (Clips(*(value.to(device) for value in clips)) for clips in (walk, wave))
        moved = i.rotations.clone().requires_grad_()
        trace = decoupler(Clips(moved, i.root), i, j, torch.tensor([[2, 11, 20]], device=device))
        trace.loss.backward()
        found.append((trace.composed.pictures.cpu(), trace.loss.cpu(), moved.grad.cpu()))
    (pictures, loss, pull), (pictures_there, loss_there, pull_there) = found
    # A vertex that is rounded otherwise may take a level outline past a scan, in a pixel or two.
    difference = (pictures_there - pictures).abs()
    assert difference.max() < 0.02 and difference.mean() < 1e-6
    torch.testing.assert_close(loss_there, loss, rtol=1e-4, atol=0)
    assert (pull_there - pull).norm() < 1e-2 * pull.norm()


def test_a_step_and_its_gradient(tmp_path):
    found = []
    for device in ("cpu", CARD):
        run = Training(training(tmp_path / device, device), Processes(), device)
        drawn, noise = run.draw(run.learned, 6, torch.Generator().manual_seed(0))
        terms = run.terms(run.learned, drawn, noise, slice(None), run.config.loss)
        terms["total"].backward()
        pulls = [parameter.grad.flatten().cpu() for parameter in run.generator.parameters()]
        found.append(({name: float(value.detach()) for name, value in terms.items()}, torch.cat(pulls)))
    (terms, pull), (terms_there, pull_there) = found
    assert terms["dr"] > 0 and terms_there == pytest.approx(terms, rel=1e-4)
    assert (pull_there - pull).norm() < 1e-3 * pull.norm()


def test_a_run_has_the_same_losses_and_shares(tmp_path):
    for device in ("cpu", CARD):
        train_generator(training(tmp_path / device, device, shares=SharesConfig(looks=4)))
    assert_same_losses(logged(tmp_path / "cpu"), logged(tmp_path / CARD))
    here, there = (json.loads((tmp_path / device / "last.json").read_text()) for device in ("cpu", CARD))
    assert here["leans"] and there["held_out"] == pytest.approx(here["held_out"], rel=1e-2)
    for one, other in zip(here["leans"], there["leans"], strict=True):
        assert other["log_odds"] == pytest.approx(one["log_odds"], abs=1e-3)


def test_a_run_moves_from_one_to_the_other(tmp_path):
    train_generator(training(tmp_path / "whole", "cpu"))
    brief = LoopConfig(steps=3, learning_rate=1e-3, save_every=3)
    train_generator(training(tmp_path / "moved", "cpu", loop=brief))
    train_generator(training(tmp_path / "moved", CARD, resume=True))
    assert_same_losses(logged(tmp_path / "whole"), logged(tmp_path / "moved"))


def test_a_resumed_run_goes_on(tmp_path):
    train_generator(training(tmp_path / "whole", CARD))
    brief = LoopConfig(steps=3, learning_rate=1e-3, save_every=3)
    train_generator(training(tmp_path / "cut", CARD, loop=brief))
    train_generator(training(tmp_path / "cut", CARD, resume=True))
    assert_same_losses(logged(tmp_path / "whole"), logged(tmp_path / "cut"), rel=1e-5)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_the_network_as_published(tmp_path, precision):
    """Dropout, tokens that are masked, the body's vertices, all in either precision."""
    network = replace(TINY, dropout=0.1, standardise=False, prior="normal", memory="concat")
    loss = GeneratorLoss(decoupling=1e-2, decoupling_clips=2, decoupling_frames=1, positions="vertices")
    decoupling = DecouplingConfig(precision=precision)
    train_generator(
        training(tmp_path / "run", CARD, network=network, loss=loss, precision=precision, decoupling=decoupling)
    )
    rows = logged(tmp_path / "run")
    assert rows[-1]["total"] < rows[0]["total"]


def test_the_inpainter(tmp_path):
    for device in ("cpu", CARD):
        train_mae(
            MAETraining(
                out=tmp_path / device,
                data=DataConfig(actions=("walk", "wave-both-hands"), synthetic_clips=2, synthetic_seconds=1.0),
                network=SMALL_MAE,
                loop=LoopConfig(steps=6, learning_rate=3e-3, save_every=3),
                batch=8,
                measured=40,
                device=device,
            )
        )
    assert_same_losses(logged(tmp_path / "cpu"), logged(tmp_path / CARD))


def test_recognisers_and_an_evaluation(rest_joints, tmp_path):
    material = synth_c(rest_joints, seed=3, train=2, test=2, extra=0, seconds=2.5)
    built = build_benchmark(tmp_path / "synth-c", material, rest_joints, 3, "refine ...")
    settings = RecogniserTraining(widths=(4, 8), depths=(1, 1), epochs=2, learning_rate=1e-2)
    records = {}
    for device in ("cpu", CARD):
        records[device] = train_recognisers(built.folder, replace(settings, device=device), force=True)
    for kind, record in records["cpu"].items():
        assert_same_losses(
            [{"loss": row["loss"]} for row in record["history"]],
            [{"loss": row["loss"]} for row in records[CARD][kind]["history"]],
            rel=1e-2,
        )
    run = tmp_path / "run"
    train_generator(training(run, CARD, data=DataConfig(source=str(built.folder)), loss=GeneratorLoss(decoupling=0.0)))
    here, there = (evaluate(run, built, EvaluationConfig(repeats=1, device=device), "") for device in ("cpu", CARD))
    assert here.metrics.keys() == there.metrics.keys()
    for name, values in here.metrics.items():
        assert there.metrics[name] == pytest.approx(values, rel=1e-2, abs=1e-3), name


def test_a_motion_is_refined(rest_joints):
    i, j = performed(rest_joints, "walk", "drink")
    composed = replace(i, rotations=i.rotations.clone())
    settings, body = RefinementConfig(steps=4, frames=4), Body.free("light")
    torch.manual_seed(0)
    found = []
    for device in ("cpu", CARD):
        decoupler = Decoupler(body, load_mae(), DecouplingConfig()).to(device)
        three = [replace(m, rotations=m.rotations.to(device), root=m.root.to(device)) for m in (composed, i, j)]
        found.append(refine_motion(*three, decoupler, settings))
    assert found[1].history["total"] == pytest.approx(found[0].history["total"], rel=1e-2)
    torch.testing.assert_close(found[1].motion.rotations.cpu(), found[0].motion.rotations, atol=1e-2, rtol=0)


def test_an_untrained_inpainter_is_the_same_one_on_both():
    torch.manual_seed(0)
    mae = MAE(SMALL_MAE)
    pictures, kept = torch.rand(2, 6, 64, 64), torch.rand(2, 64) < 0.4
    kept[:, 0], kept[1] = True, kept[0]
    here, there = mae(pictures, kept), mae.to(CARD)(pictures.to(CARD), kept.to(CARD)).cpu()
    torch.testing.assert_close(there, here, atol=1e-5, rtol=1e-4)
