"""Text to motion end to end: train, go on after a kill, make motions, diffuse, measure."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from refine.synthetic import draw, perform, perform_together
from refine.text.corpus import save_corpus
from refine.text.described import Described
from refine.text.diffusion import DiffusionConfig
from refine.text.encoder import has_default
from refine.text.generation import generate_by_parts, generate_described
from refine.text.model import TextNetworkConfig
from refine.text.parts import Parts
from renderers.body import Body
from renderers.checks import UserError
from train.loop import LoopConfig
from train.tables import comparison_table, evaluation_table
from train.text import TextTraining, train_text
from train.text_data import TextDataConfig
from train.text_diffusion import DiffusionTraining, train_diffusion
from train.text_evaluate import TextEvaluationConfig, evaluate_text
from train.text_models import encoder_of, load_diffusion, load_text_model, load_text_to_motion
from train.text_steps import TextLoss

pytestmark = pytest.mark.skipif(not has_default(), reason="the extra [text] is not installed")

FPS = 15.0
NETWORK = TextNetworkConfig(latent=32, feedforward=64, heads=2, layers=1, dropout=0.1, norm_first=True)
SAID = {"walk": "walk forwards", "squat": "squat", "wave-right-hand": "wave with the right hand", "run": "run"}


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    rest_joints, random, items = Body.free("light").rest_joints, torch.Generator().manual_seed(0), []
    for name, text in SAID.items():
        for number, split in enumerate(("train", "train", "val")):
            items.append(
                Described(perform(draw(name, random, FPS), 30, rest_joints), ((text,),), f"{name}{number}", split)
            )
    for number, (name, split) in enumerate((("walk", "train"), ("squat", "test"), ("run", "test"))):
        both = perform_together(draw(name, random, FPS), draw("wave-right-hand", random, FPS), 30, rest_joints)
        items.append(Described(both, ((SAID[name], SAID["wave-right-hand"]),), f"pair{number}", split))
    folder = tmp_path_factory.mktemp("corpus") / "texts"
    save_corpus(folder, items, {})
    return folder


def config(out: Path, corpus: Path, **changes) -> TextTraining:
    given = TextTraining(
        out=out,
        data=TextDataConfig(source=str(corpus), fps=FPS, frames=24),
        network=NETWORK,
        loop=LoopConfig(steps=6, learning_rate=1e-3, save_every=3, log_every=1),
        batch=4,
        measured=4,
    )
    return replace(given, **changes)


@pytest.fixture(scope="module")
def run(tmp_path_factory, corpus) -> Path:
    out = tmp_path_factory.mktemp("run") / "text"
    train_text(config(out, corpus))
    return out


@pytest.fixture(scope="module")
def scorer(tmp_path_factory, corpus) -> Path:
    out = tmp_path_factory.mktemp("scorer") / "scorer"
    alone = TextDataConfig(source=str(corpus), fps=FPS, frames=24, synthetic="none", pairs=False)
    train_text(config(out, corpus, data=alone, loss=TextLoss(contrastive=0.1)), "text-scorer")
    return out


def rows(run: Path) -> list[dict]:
    kept = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    return [{name: value for name, value in row.items() if name != "seconds"} for row in kept]


def test_a_killed_run_goes_on_as_if_nothing_had_been(run, corpus, tmp_path):
    short = config(tmp_path / "text", corpus)
    train_text(replace(short, loop=replace(short.loop, steps=3)))
    train_text(replace(short, resume=True))
    assert rows(tmp_path / "text") == rows(run)
    whole, parts = (load_file(folder / "last.safetensors") for folder in (run, tmp_path / "text"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def test_every_term_is_logged_and_falls_in_words(run):
    first, *_, last = rows(run)
    assert set(first) == {"step", "text", "motion", "kl", "latent", "total", "gradient"}
    assert set(last["held_out"]) == {"text", "motion", "kl", "latent", "total"}
    record = json.loads((run / "last.json").read_text())
    assert record["data"] == {"source": record["data"]["source"], "singles": 8, "pairs": 1, "unseen": 4}
    assert record["config"]["encoder"] == "all-MiniLM-L6-v2"


def test_motions_of_any_sentence_any_length_and_any_number_of_actions(run):
    model = load_text_to_motion(run)
    encoder, random = encoder_of(model), torch.Generator().manual_seed(0)
    texts = [("jump over a puddle",), ("walk", "wave"), ("walk", "wave", "look up")]
    made = generate_described(model, encoder, texts, [10, 20, 15], random)
    assert [len(motion) for motion in made] == [10, 20, 15] and made[1].label == "walk while waving"
    alone = generate_described(model, encoder, texts[:1], [10], torch.Generator().manual_seed(0))
    torch.testing.assert_close(alone[0].rotations, made[0].rotations, atol=1e-4, rtol=1e-4)
    again = generate_described(model, encoder, texts, [10, 20, 15], torch.Generator().manual_seed(0))
    assert torch.equal(again[2].rotations, made[2].rotations)


def test_actions_made_alone_are_put_together_by_their_parts(run):
    model, legs, arm = load_text_to_motion(run), Parts.of(("global", "left leg", "right leg")), Parts.of(("right arm",))
    encoder, texts = encoder_of(model), [("walk", "wave"), ("wave", "walk")]
    made = generate_by_parts(
        model, encoder, texts, [[legs, arm], [arm, legs]], [12, 12], torch.Generator().manual_seed(0)
    )
    alone = generate_described(
        model, encoder, [("walk",), ("wave",), ("wave",), ("walk",)], [12] * 4, torch.Generator().manual_seed(0)
    )
    for motion, walk, wave in ((made[0], alone[0], alone[1]), (made[1], alone[3], alone[2])):
        assert torch.equal(motion.rotations[:, 21], wave.rotations[:, 21])
        assert torch.equal(motion.rotations[:, 4], walk.rotations[:, 4]) and torch.equal(motion.root, walk.root)


def test_texts_apart_are_learned_and_used(corpus, tmp_path):
    train_text(config(tmp_path / "ste", corpus, network=replace(NETWORK, separate=True)))
    model = load_text_to_motion(tmp_path / "ste")
    made = [
        generate_described(model, encoder_of(model), [texts], [12], torch.Generator().manual_seed(0))[0].rotations
        for texts in (("walk", "wave"), ("walk", "squat"), ("walk",))
    ]
    assert not torch.equal(made[0], made[1]) and not torch.equal(made[0], made[2])


def test_diffusion_on_the_latents_of_a_run(run, corpus, scorer, tmp_path):
    training = DiffusionTraining(
        start=run,
        out=tmp_path / "diffusion",
        data=TextDataConfig(source=str(corpus), fps=FPS, frames=24),
        network=DiffusionConfig(feedforward=32, heads=2, layers=3, dropout=0.0, times=100, steps=5),
        loop=LoopConfig(steps=4, learning_rate=1e-3, save_every=2),
        batch=4,
        measured=4,
    )
    train_diffusion(training)
    model = load_diffusion(tmp_path / "diffusion" / "last.safetensors")
    frozen, whole = load_file(run / "best.safetensors"), model.state_dict()
    assert all(torch.equal(whole[f"motion.{name}"], value) for name, value in frozen.items())
    assert type(load_text_model(tmp_path / "diffusion")) is type(model)
    found = evaluate_text(tmp_path / "diffusion", scorer, None, TextEvaluationConfig(repeats=2))
    assert found.n == 2 and 0 <= found.metrics["temos"][0] <= 1
    train_diffusion(replace(training, out=tmp_path / "part", loop=replace(training.loop, steps=2)))
    train_diffusion(replace(training, out=tmp_path / "part", resume=True))
    parts = load_file(tmp_path / "part" / "last.safetensors")
    assert all(
        torch.equal(value, parts[name])
        for name, value in load_file(tmp_path / "diffusion" / "last.safetensors").items()
    )
    with pytest.raises(UserError, match="frames a second"):
        train_diffusion(replace(training, out=tmp_path / "other", data=replace(training.data, fps=20.0)))


def test_measuring_and_its_table(run, scorer, tmp_path):
    evaluations = [
        evaluate_text(run, scorer, None, TextEvaluationConfig(repeats=2, by=by), row)
        for by, row in (("sentence", "whole"), ("parts", "put together"))
    ]
    first, second = evaluations
    assert first.metrics["temos"] != second.metrics["temos"] and first.benchmark == "texts"
    assert set(first.truth) >= {"text_top1", "text_rank", "foot_skate"} and "temos" not in first.truth
    same = evaluate_text(run, scorer, None, TextEvaluationConfig(repeats=2), "whole")
    assert same.metrics == first.metrics
    text = comparison_table(evaluations)
    assert "TEMOS score" in text and "SINC's own figures" in text and "FID-C" not in text
    assert "APE trajectory" in evaluation_table(first)
    legacy = evaluate_text(run, scorer, None, TextEvaluationConfig(repeats=2, heading="sinc_legacy"))
    assert legacy.metrics["ape_local"] != first.metrics["ape_local"]
    assert legacy.metrics["temos"] == first.metrics["temos"]


def test_a_clip_measured_against_itself_is_perfect(run, scorer, corpus):
    from refine.text.corpus import load_corpus
    from train.text_evaluate import TextJudge

    judging = load_text_to_motion(scorer, "text-scorer")
    tested = load_corpus(corpus, "test")
    config = TextEvaluationConfig()
    judge = TextJudge(tested, judging, encoder_of(judging), 24, config, Body.free("light").rest_joints)
    found = judge.measure(judge.motions, judge.true, torch.Generator().manual_seed(0))
    assert found["temos"] == pytest.approx(1)
    assert max(value for name, value in found.items() if name.startswith(("ape", "ave"))) < 1e-6


@pytest.mark.parametrize("by", ["sentence", "parts"])
def test_refined_before_it_is_measured(run, scorer, by):
    plain, refined = (
        evaluate_text(run, scorer, None, TextEvaluationConfig(repeats=1, by=by, refined=wanted, most=1))
        for wanted in (False, True)
    )
    assert refined.metrics["ape_local"] != plain.metrics["ape_local"]
    assert refined.metrics["ape_root"] == pytest.approx(plain.metrics["ape_root"], abs=1e-3)  # travel is left alone
    assert refined.n == 1 and refined.provenance["measured"]["refined"] and "text_multimodality" not in refined.metrics


def test_what_does_not_fit_is_refused(run, scorer, corpus, tmp_path):
    with pytest.raises(UserError, match="weights of a text-scorer"):
        load_text_to_motion(scorer)
    with pytest.raises(UserError, match="already holds a run"):
        train_text(config(run, corpus))
    with pytest.raises(UserError, match="holds no run"):
        evaluate_text(tmp_path, scorer, None, TextEvaluationConfig())
    with pytest.raises(UserError, match="no test clips of singles"):
        only = tmp_path / "only"
        rest_joints = Body.free("light").rest_joints
        both = perform_together(
            *(draw(name, torch.Generator(), FPS) for name in ("walk", "wave-right-hand")), 30, rest_joints
        )
        save_corpus(only, [Described(both, (("walk", "wave"),), "pair", "test")], {})
        evaluate_text(run, scorer, only, TextEvaluationConfig(actions="singles"))
    stored = json.loads((run / "last.json").read_text())
    stored["config"]["encoder"] = "distilbert"
    for suffix in (".safetensors", ".json"):
        (tmp_path / f"other{suffix}").write_bytes((run / f"last{suffix}").read_bytes())
    (tmp_path / "other.json").write_text(json.dumps(stored))
    with pytest.raises(UserError, match="trained with 'distilbert'"):
        encoder_of(load_text_to_motion(tmp_path / "other.safetensors"))
