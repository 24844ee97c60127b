"""``refine data``: what it writes and says, and what it refuses."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.cli.main import main
from refine.formats.clips import load_clips, save_clips
from refine.synthetic import draw, perform
from train.benchmarks import load_benchmark

LABELS = ("walk", "squat", "punching", "wave-left-hand")


@pytest.fixture(scope="module")
def packed(tmp_path_factory, rest_joints) -> Path:
    """Three clips of each of four actions: 70 frames, but 40 of the squats."""
    path = tmp_path_factory.mktemp("packed") / "clips.npz"
    motions = []
    for label in LABELS:
        random = torch.Generator().manual_seed(5)
        for number in range(3):
            frames = 40 if label == "squat" else 70
            motion = perform(draw(label, random, 30.0), frames, rest_joints)
            motions.append(replace(motion, source=f"{label}_{number}"))
    save_clips(path, motions)
    return path


def custom(packed: Path, out: Path, *more: str) -> list[str]:
    labels = ["--lower", "walk", "squat", "--upper", "punching", "wave-left-hand", "--per-action", "2"]
    return ["data", "benchmark", "custom", "--source", str(packed), *labels, "--out", str(out), *more]


def refused(capsys, *arguments) -> str:
    assert main([str(word) for word in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    return said


def test_a_benchmark_of_labels_of_ones_own(packed, tmp_path, capsys):
    out = tmp_path / "mine"
    assert main(custom(packed, out)) == 0
    said = capsys.readouterr()
    benchmark = load_benchmark(out)
    assert said.err == "" and said.out.splitlines() == [
        f"{out / 'train.npz'}  4 clips, 250 frames",
        f"{out / 'test.npz'}  8 clips, 500 frames",
        f"{out / 'mask.npz'}  16 clips, 960 frames",
        "shorter than 60 frames, and still in their last pose from there: 1 train, 2 test clips",
        "with such a clip: 8 compositions",
        f"{out}  16 compositions of 4 pairs, hash {benchmark.hash[:12]}",
    ]
    assert benchmark.pairs[1] == ("walk", "wave-left-hand") and benchmark.lower == ("walk", "squat")
    assert benchmark.manifest["command"] == (
        f"refine data benchmark custom --source {packed} --lower walk squat --upper punching wave-left-hand "
        "--per-action 2 --seed 0 --out custom"
    )


def test_the_command_of_the_manifest_builds_the_same_bytes(packed, tmp_path, monkeypatch):
    assert main(custom(packed, tmp_path / "mine", "--seed", "3")) == 0
    command = json.loads((tmp_path / "mine" / "manifest.json").read_text())["command"].split()
    monkeypatch.chdir(tmp_path)
    assert command[0] == "refine" and main(command[1:]) == 0
    for path in (tmp_path / "mine").iterdir():
        assert (tmp_path / "custom" / path.name).read_bytes() == path.read_bytes(), path.name


def test_a_benchmark_that_is_there_is_refused_without_force(packed, tmp_path, capsys):
    out = tmp_path / "mine"
    assert main(custom(packed, out)) == 0
    (out / "note").write_text("mine")
    capsys.readouterr()
    assert "mine: is already there; choose another name or pass --force" in refused(capsys, *custom(packed, out))
    assert (out / "note").read_text() == "mine"
    assert main(custom(packed, out, "--force", "--seed", "1")) == 0
    assert not (out / "note").exists() and load_benchmark(out).manifest["seed"] == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bn-c"], "bn-c: is made of clips that do not ship with Refine; say where they are with --source"),
        (["bn-c", "--source", "nowhere"], "nowhere: does not exist"),
        (["synth-c", "--source", "PACKED"], "synth-c: is made of built-in actions; leave out --source"),
        (["bn-c", "--source", "PACKED", "--lower", "walk"], "bn-c: has labels of its own"),
        (["custom", "--source", "PACKED", "--lower", "walk"], "custom: needs labels to pair"),
        (
            ["custom", "--source", "PACKED", "--lower", "walk", "--upper", "wave-left"],
            "unknown name 'wave-left'; did you mean wave-left-hand",
        ),
        (
            ["custom", "--source", "PACKED", "--lower", "walk", "--upper", "punching", "--per-action", "3"],
            "clips.npz: has 3 clips of punching, 4 are needed; give more clips of it",
        ),
    ],
)
def test_a_mistake_costs_one_line_and_leaves_nothing(packed, tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    words = [str(packed) if word == "PACKED" else word for word in arguments]
    assert said in refused(capsys, "data", "benchmark", *words, "--out", "out")
    assert not list(tmp_path.iterdir())


def test_import_reads_actors_package_and_keeps_labels(tmp_path, capsys):
    random = np.random.default_rng(0)
    poses, joints = ([random.normal(0, 0.2, (4, *shape)) for _ in range(3)] for shape in ((72,), (24, 3)))
    package = tmp_path / "humanact12poses.pkl"
    package.write_bytes(pickle.dumps({"poses": poses, "joints3D": joints, "y": [1, 4, 1]}, protocol=2))
    out = tmp_path / "clips.npz"
    assert main(["data", "import", str(package), "--out", str(out)]) == 0
    assert [motion.label for motion in load_clips(out)] == ["walk", "drink", "walk"]
    assert main(["data", "import", str(package), "--out", str(out), "--labels", "drink", "--force"]) == 0
    assert [motion.source for motion in load_clips(out)] == ["humanact12poses.pkl/0001"]
    assert capsys.readouterr().out.endswith(f"    1  drink\n{out}  1 clips, 4 frames\n")
    said = refused(capsys, "data", "import", package, "--out", tmp_path / "b.npz", "--labels", "wlk")
    assert "humanact12poses.pkl: unknown name 'wlk'; did you mean walk?" in said


def test_help_shows_an_example_and_a_seed(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["data", "benchmark", "--help"])
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    assert "Example: refine data benchmark synth-c" in said and "--seed" in said
