"""The program of the recognisers on a small benchmark: what they learn, what is recorded, what is refused."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from refine.cli.main import main
from refine.recogniser import OTHER, Recogniser, RecogniserConfig, both_actions, features_of
from refine.synthetic import draw, perform, perform_together
from renderers.checks import UserError
from renderers.rotations import (
    axis_angle_to_matrix,
    heading,
    matrix_from_6d,
    matrix_to_6d,
    matrix_to_axis_angle,
)
from train.benchmarks import load_benchmark
from train.building import Material, build_benchmark
from train.lessons import lesson_of, numbers
from train.recogniser import (
    RecogniserTraining,
    alike,
    disturb,
    learn,
    load_recogniser,
    load_recognisers,
    place_of,
    train_recognisers,
    weights_of,
)

LOWER, UPPER = ("marking-time-and-knee-lifting", "walk"), ("elbow-circling", "standing-rotation")
FRAMES = 30
SETTINGS = RecogniserTraining(widths=(8, 16), depths=(1, 1), learning_rate=1e-2, schedule="cosine", batch=4, epochs=40)


def material(rest_joints, true=True) -> Material:
    """Three test clips of each action, so that a pair has nine compositions; one clip is shorter than a window."""
    draws = {
        name: [draw(name, torch.Generator().manual_seed(100 * index + number)) for number in range(6)]
        for index, name in enumerate(LOWER + UPPER)
    }
    by_source = {f"{name} {number}": drawn for name in draws for number, drawn in enumerate(draws[name])}

    def clips(first, last):
        frames = {"walk 5": FRAMES - 3}
        sources = [f"{name} {number}" for name in draws for number in range(first, last)]
        return [
            replace(perform(by_source[source], frames.get(source, 2 * FRAMES), rest_joints), source=source)
            for source in sources
        ]

    def together(i, j):
        return perform_together(by_source[i.source], by_source[j.source], 2 * FRAMES, rest_joints)

    pairs = tuple((i, j) for i in LOWER for j in UPPER)
    splits = (clips(3, 6), clips(0, 3), [])
    return Material("small", 1, 30.0, FRAMES, LOWER, UPPER, pairs, *splits, "by number", together if true else None)


@pytest.fixture(scope="module")
def built(tmp_path_factory, rest_joints):
    folder = tmp_path_factory.mktemp("benchmark")
    build_benchmark(folder / "with", material(rest_joints), rest_joints)
    build_benchmark(folder / "without", material(rest_joints, true=False), rest_joints)
    return folder


@pytest.fixture(scope="module")
def trained(built, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "benchmark"
    shutil.copytree(built / "with", folder)
    return load_benchmark(folder), train_recognisers(folder, SETTINGS)


@pytest.fixture
def benchmark(built, tmp_path):
    shutil.copytree(built / "with", tmp_path / "benchmark")
    return load_benchmark(tmp_path / "benchmark")


def stacked(motions):
    return torch.stack([motion.six for motion in motions])


def test_all_of_what_is_learned_is_named_and_training_stops_there(trained):
    _, records = trained
    assert list(records) == ["mask", "half", "true", "legs", "arms"]
    for kind, record in records.items():
        assert record["accuracy"]["learned"] == 1, kind
        assert record["epochs"] == len(record["history"]) < SETTINGS.epochs
        assert [row["accuracy"] == 1 for row in record["history"][-3:]] == [False, True, True]
        assert record == json.loads(json.dumps(record, default=vars)) | {"training": SETTINGS}
    assert records["mask"]["clips"] == 36 and records["half"]["clips"] == 4 * 5
    assert records["half"]["steps"] == records["half"]["epochs"] * 5  # batches of four
    assert list(records["half"]["accuracy"]) == ["learned", "other half"]
    assert list(records["mask"]["accuracy"]) == ["learned", "true"]
    assert list(records["legs"]["accuracy"]) == ["learned", "held out", "test"]


def test_what_is_written_is_what_was_trained(trained):
    benchmark, records = trained
    recognisers = load_recognisers(benchmark)
    assert list(recognisers) == list(records)
    motions = benchmark.compositions("mask")
    mask = recognisers["mask"]
    named = [mask.config.classes[index] for index in features_of(mask, stacked(motions)).logits.argmax(1)]
    assert named == [motion.label for motion in motions]
    assert not any(value.requires_grad for value in mask.parameters()) and not mask.training
    described = json.loads(place_of(benchmark, "legs").with_suffix(".json").read_text())
    assert described["benchmark"] == {"name": "small", "hash": benchmark.hash}
    assert described["config"]["classes"] == [*LOWER, OTHER] and described["config"]["joints"][0] == 0
    assert described["provenance"]["seed"] == described["training"]["seed"] == 10
    assert {"torch", "python"} <= described["provenance"]["versions"].keys()
    assert not [path for path in place_of(benchmark, "mask").parent.iterdir() if path.name.startswith(".")]


def test_parts_say_how_often_they_find_both_actions(trained):
    benchmark, _ = trained
    written = json.loads((benchmark.folder / "recognisers" / "parts.json").read_text())
    recognisers = load_recognisers(benchmark)
    for kind in ("mask", "true"):
        motions = benchmark.compositions(kind)
        labels = [motion.label for motion in motions]
        found = both_actions(recognisers["legs"], recognisers["arms"], stacked(motions), labels)
        assert written[kind]["both"] == pytest.approx(float(found.both.double().mean()))
        assert written[kind]["both"] == pytest.approx(sum(written[kind]["pairs"].values()) / 4)
        assert written[kind]["both"] <= min(written[kind]["legs"], written[kind]["arms"])
    assert written["true"]["both"] > 0.9
    wrong = ["+".join((LOWER[label.startswith(LOWER[0])], label.split("+")[1])) for label in labels]
    assert not both_actions(recognisers["legs"], recognisers["arms"], stacked(motions), wrong).both.any()


def test_the_seed_decides_everything(trained, benchmark):
    again, other = replace(SETTINGS, kinds=("legs",)), replace(SETTINGS, kinds=("arms",), seed=11)
    state = torch.random.get_rng_state()
    train_recognisers(benchmark.folder, again)
    train_recognisers(benchmark.folder, other)
    assert torch.equal(torch.random.get_rng_state(), state)
    for kind, same in (("legs", True), ("arms", False)):
        before, now = (load_recogniser(place_of(where, kind)).state_dict() for where in (trained[0], benchmark))
        assert all(torch.equal(before[name], now[name]) for name in before) == same


def test_bfloat16_trains_too(benchmark):
    settings = replace(SETTINGS, kinds=("half",), epochs=1)
    exact, rounded = (
        train_recognisers(benchmark.folder, replace(settings, precision=name), force=True)["half"]["history"][0]["loss"]
        for name in ("float32", "bfloat16")
    )
    assert rounded != exact and rounded == pytest.approx(exact, rel=0.05)


def test_training_ends_after_passes_without_a_fault_in_a_row(benchmark, monkeypatch):
    lesson = lesson_of(benchmark, "half", 0.2, 0)
    recogniser = Recogniser(RecogniserConfig(lesson.classes, widths=(4,), depths=(1,)))
    for shares, settings, passes in (
        ([1, 0.9, 1, 0.9, 1, 1, 1], SETTINGS, 6),
        ([1, 1, 1, 1], replace(SETTINGS, patience=1), 1),
        ([0.9, 1, 0.9], replace(SETTINGS, epochs=3), 3),
    ):
        answers = iter(shares)
        monkeypatch.setattr("train.recogniser.accuracy", lambda *_, answers=answers: next(answers))
        assert [row["accuracy"] for row in learn(recogniser, lesson, settings, 0, "half")] == shares[:passes]


def test_disturbed_clips_are_rotations_turned_as_far_as_is_said(generator):
    six = matrix_to_6d(axis_angle_to_matrix(torch.randn(1000, 12, 24, 3, generator=generator)))
    noise = 0.1
    turned = disturb(six, noise, generator)
    assert torch.allclose(matrix_to_6d(matrix_from_6d(turned)), turned, atol=1e-5)
    relative = matrix_from_6d(six).mT @ matrix_from_6d(turned)
    turns = matrix_to_axis_angle(relative)
    of_clip = turns.mean(1, keepdim=True)
    # Deviations of s U(0, 1)^2 make a mean square of s^2 / 5; the mean of 12 frames keeps 1 / 12 of their part.
    assert of_clip.square().mean() == pytest.approx(noise**2 / 5 * (1 + 1 / 12), rel=0.1)
    assert (turns - of_clip).square().mean() == pytest.approx(noise**2 / 5 * (1 - 1 / 12), rel=0.1)
    levels = (turns - of_clip).square().mean((1, 2, 3)).sqrt() * (12 / 11) ** 0.5
    assert levels.max() < 1.1 * noise and levels.min() < 0.1 * noise
    assert disturb(six, 0.0, generator) is six


def test_the_last_layer_names_what_is_left_and_features_stay(benchmark):
    settings = replace(SETTINGS, kinds=("mask", "legs"), epochs=4)
    before = train_recognisers(benchmark.folder, settings)
    features = load_recogniser(place_of(benchmark, "mask"))
    after = train_recognisers(benchmark.folder, replace(settings, finish=300), force=True)
    assert before["mask"]["accuracy"]["learned"] < 1 and not before["mask"]["finished"]
    assert (
        after["mask"]["accuracy"]["learned"] > before["mask"]["accuracy"]["learned"] + 0.1 and after["mask"]["finished"]
    )
    assert after["legs"]["accuracy"] == before["legs"]["accuracy"] and not after["legs"]["finished"]
    six = stacked(benchmark.compositions("true"))
    finished = load_recogniser(place_of(benchmark, "mask"))
    assert torch.equal(features_of(features, six).features, features_of(finished, six).features)


def test_classes_weigh_alike(benchmark):
    lesson = lesson_of(benchmark, "legs", 0.2, 0)
    weights, counts = weights_of(lesson), torch.bincount(lesson.learned.classes)
    assert torch.allclose(weights * counts, torch.full((3,), float(counts.sum()) / 3))


def test_a_half_is_every_other_composition_of_each_pair(benchmark):
    assert numbers(torch.tensor([0, 0, 1, 0, 1])).tolist() == [0, 1, 0, 2, 1]
    lesson = lesson_of(benchmark, "half", 0.2, 0)
    motions = benchmark.compositions("mask")  # by pair, nine each
    assert torch.equal(lesson.learned.six, stacked([m for n, m in enumerate(motions) if n % 9 % 2 == 0]))
    assert torch.equal(lesson.unseen["other half"].six, stacked([m for n, m in enumerate(motions) if n % 9 % 2 == 1]))


def test_parts_learn_single_actions_and_never_those_held_out_or_tested(benchmark):
    lesson = lesson_of(benchmark, "arms", 0.2, 0)
    assert lesson.classes == (*UPPER, OTHER)
    clips = [*benchmark.clips("train"), *benchmark.clips("test")]  # twelve each
    assert lesson.clips == 12 - 4 and len(lesson.unseen["held out"].six) == 3 * 4
    assert torch.bincount(lesson.learned.classes).tolist() == [6, 6, 12]

    def clip_of(six):
        """Which clip a canonical window is from: local rotations stay as they are."""
        return next(n for n, clip in enumerate(clips) if (clip.six[:, 1:] - six[0, 1:]).abs().amax((1, 2)).min() < 1e-6)

    held_out = {clip_of(six) for six in lesson.unseen["held out"].six}
    random = torch.Generator().manual_seed(0)
    first, second = lesson.draw(random), lesson.draw(random)
    assert len(held_out) == 4 and not {clip_of(six) for six in first.six} & held_out
    assert {clip_of(six) for six in lesson.learned.six} == {*range(12)} - held_out
    assert {clip_of(six) for six in lesson.unseen["test"].six} == {*range(12, 24)}
    assert first.six.shape == (8, FRAMES, 24, 6) and not torch.equal(first.six, second.six)
    assert heading(matrix_from_6d(first.six[:, 0, 0])).abs().max() < 1e-5


def test_actions_that_are_mistaken_for_each_other_are_alike():
    classes = ("a", "b", "c", "d", OTHER)
    mistaken = torch.diag(torch.tensor([10, 10, 10, 10, 40]))
    assert alike(mistaken, classes, 0.25) == ()
    guessed = mistaken.clone()
    guessed[0, :2] = guessed[1, :2] = 5
    assert alike(guessed, classes, 0.25) == (("a", "b"),)
    one_way = mistaken.clone()
    one_way[3, [0, 3]] = torch.tensor([10, 0])
    assert alike(one_way, classes, 0.25) == (("a", "d"),) and alike(one_way, classes, 0.6) == ()
    chain = guessed.clone()
    chain[2, [1, 2]] = torch.tensor([8, 2])
    assert alike(chain, classes, 0.25) == (("a", "b", "c"),)
    few = mistaken.clone()
    few[2, 2:4] = torch.tensor([6, 4])
    assert alike(few, classes, 0.25) == ()
    never = mistaken.clone()
    never[0, [0, 4]] = torch.tensor([0, 10])
    assert alike(never, classes, 0.1) == ()


def test_what_is_there_is_refused_unless_forced(trained, benchmark):
    settings = replace(SETTINGS, epochs=1)
    train_recognisers(benchmark.folder, replace(settings, kinds=("legs",)))
    before = place_of(benchmark, "legs").read_bytes()
    with pytest.raises(UserError, match="legs.json: is already there; .*--force, or the others with --kinds arms"):
        train_recognisers(benchmark.folder, replace(settings, kinds=("arms", "legs")))
    assert place_of(benchmark, "legs").read_bytes() == before and not place_of(benchmark, "arms").exists()
    train_recognisers(benchmark.folder, replace(settings, kinds=("legs",), seed=11), force=True)
    assert place_of(benchmark, "legs").read_bytes() != before


def test_weights_without_their_description_are_missing(benchmark, monkeypatch):
    """A kill between the two files: an older description must not go with newer weights."""
    settings = replace(SETTINGS, kinds=("half",), epochs=1)
    train_recognisers(benchmark.folder, settings)

    def killed(path, kind, model, record):
        path.write_bytes(b"newer weights")
        raise KeyboardInterrupt

    monkeypatch.setattr("train.recogniser.save_weights", killed)
    with pytest.raises(KeyboardInterrupt):
        train_recognisers(benchmark.folder, settings, force=True)
    monkeypatch.undo()
    with pytest.raises(UserError, match="half.json: no such file"):
        load_recogniser(place_of(benchmark, "half"))
    train_recognisers(benchmark.folder, settings)


def test_recognisers_that_are_missing_or_of_other_data_are_refused(trained, benchmark):
    remedy = f"refine train recogniser small --benchmark {benchmark.folder}"
    with pytest.raises(UserError, match=f"mask.*no such recogniser; .*{remedy}"):
        load_recognisers(benchmark)
    shutil.copytree(trained[0].folder / "recognisers", benchmark.folder / "recognisers")
    assert len(load_recognisers(benchmark)) == 5
    described = place_of(benchmark, "true").with_suffix(".json")
    described.write_text(described.read_text().replace(benchmark.hash, "0" * 64))
    with pytest.raises(UserError, match=f"true.safetensors: .*other data.*{remedy} --force"):
        load_recognisers(benchmark)
    described.write_text(described.read_text().replace('"classes": [', '"classes": ["more",', 1))
    with pytest.raises(UserError, match="does not fit its description"):
        load_recogniser(place_of(benchmark, "true"))


def test_true_compositions_are_needed_only_where_there_are_some(built, tmp_path):
    folder = shutil.copytree(built / "without", tmp_path / "benchmark")
    settings = replace(SETTINGS, epochs=1)
    with pytest.raises(UserError, match="has no true compositions; leave out the recogniser 'true'"):
        train_recognisers(folder, replace(settings, kinds=("mask", "true")))
    assert not (folder / "recognisers").exists()
    records = train_recognisers(folder, settings)
    assert list(records) == ["mask", "half", "legs", "arms"] and list(records["mask"]["accuracy"]) == ["learned"]
    assert list(load_recognisers(load_benchmark(folder))) == list(records)


@pytest.mark.parametrize("change", [{"epochs": 0}, {"kinds": ("leg",)}, {"learning_rate": 0.0}, {"held_out": 1.0}])
def test_settings_that_cannot_be_are_refused(change):
    with pytest.raises(UserError, match="RecogniserTraining"):
        replace(SETTINGS, **change)


def test_a_loss_that_is_not_finite_is_named_and_nothing_is_written(benchmark):
    with pytest.raises(UserError, match="'mask': the loss of pass . is not finite; lower --learning-rate"):
        train_recognisers(benchmark.folder, replace(SETTINGS, kinds=("mask",), learning_rate=1e30))
    assert not (benchmark.folder / "recognisers").exists()


def test_the_command_trains_and_prints_a_table(benchmark, capsys):
    flags = ["--widths", "4", "--depths", "1", "--epochs", "2", "--kinds", "legs", "arms"]
    command = ["train", "recogniser", "small", "--benchmark", str(benchmark.folder), *flags]
    assert main(command) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines[1:3]] == [["legs", "3", "2"], ["arms", "3", "2"]]
    assert "held out" in lines[1] and lines[3] == str(benchmark.folder / "recognisers")
    assert main(command) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["train", "recogniser", "small", "--benchmark", str(benchmark.folder / "no")]) == 2
