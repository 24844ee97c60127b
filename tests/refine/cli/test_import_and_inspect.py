"""``refine data import`` and ``refine data inspect`` as they are typed."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.cli.main import main
from refine.formats.amass import write_amass
from refine.formats.bvh import write_bvh
from refine.formats.clips import load_clips
from refine.motion import Motion
from refine.synthetic import draw, perform

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return perform(draw("walk", torch.Generator().manual_seed(1), 30.0), 40, rest_joints)


@pytest.fixture
def folder(tmp_path, walk, rest_joints) -> Path:
    folder = tmp_path / "in"
    write_bvh(folder / "walk_01.bvh", walk, rest_joints)
    write_amass(folder / "step_01.npz", walk)
    (folder / "broken.npz").write_bytes(b"PK\x03\x04")
    return folder


def refused(capsys, *arguments) -> str:
    assert main([str(word) for word in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    return said


def test_import_into_a_folder(folder, tmp_path, capsys):
    out = tmp_path / "out"
    (tmp_path / "labels.csv").write_text("file,label,start,end\nwalk_01.bvh,first,0,0.5\nwalk_01,second,0.5,\n")
    words = ["data", "import", str(folder), "-o", str(out), "--labels-file", str(tmp_path / "labels.csv")]
    assert main(words) == 0
    said = capsys.readouterr()
    assert said.out.splitlines() == ["    1  first", "    1  second", f"{out}  2 clips, 40 frames"]
    assert said.err == f"refine: left out 2 files that {tmp_path / 'labels.csv'} does not name\n"
    assert [len(clip) for clip in load_clips(out)] == [15, 25]
    assert "is already there" in refused(capsys, *words)
    assert main([*words, "--force", "--json", "--workers", "1"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verb"] == "data import" and found["files"] == [str(out)]
    assert (found["clips"], found["frames"], found["labels"]) == (2, 40, {"first": 1, "second": 1})


def test_bodies_that_lie_are_said(tmp_path, walk, rest_joints, capsys):
    """As a file is read with z up that has y up, or the other way round."""
    folder, out = tmp_path / "in", tmp_path / "out.npz"
    write_amass(folder / "walk_01.npz", walk)
    write_amass(folder / "walk_02.npz", replace(walk, fps=60.0))
    write_bvh(folder / "step_01.bvh", walk, rest_joints)
    np.save(folder / "hop_01.npy", walk.joints(rest_joints))
    words = ["data", "import", str(folder), "-o", str(out), "--force"]
    assert main(words) == 0 and capsys.readouterr().err == ""
    assert main([*words, "--up", "y"]) == 0
    said = "lie from beginning to end; if it is another axis that is up, give --up y or --up z\n"
    assert capsys.readouterr().err == f"refine: 2 clips {said}"
    assert main([*words, "--up", "z", "--labels", "hop"]) == 0
    assert capsys.readouterr().err == f"refine: 1 clip {said.replace('lie', 'lies', 1)}"
    assert main([*words, "--up", "z", "--labels", "walk"]) == 0 and capsys.readouterr().err == ""
    words = ["export", str(folder / "walk_01.npz"), "-o", str(tmp_path / "out.bvh"), "--force"]
    assert main(words) == 0 and capsys.readouterr().err == ""
    assert main([*words, "--up", "y"]) == 0 and "walk_01.npz lies from beginning" in capsys.readouterr().err


def test_a_broken_file_is_said_and_skipped(folder, tmp_path, capsys):
    assert main(["data", "import", str(folder), "-o", str(tmp_path / "a.npz")]) == 0
    said = capsys.readouterr()
    assert said.err.startswith(f"refine: left out {folder / 'broken.npz'}: ") and said.err.count("\n") == 1
    assert said.out.endswith("a.npz  2 clips, 80 frames\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--labels-file", "LABELS"], "labels.csv, line 2: names no label"),
        (["--labels-file", "nowhere.csv"], "nowhere.csv"),
        (["--label-pattern", "("], "is not a regular expression"),
        (["--workers", "0"], "--workers: expected 1 to 256, got 0"),
        (["--labels", "wlk"], "unknown name 'wlk'; did you mean walk?"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(folder, tmp_path, capsys, words, said):
    (tmp_path / "labels.csv").write_text("file,label\nwalk_01.bvh,\n")
    words = [str(tmp_path / "labels.csv") if word == "LABELS" else word for word in words]
    error = refused(capsys, "data", "import", folder, "-o", tmp_path / "out", *words)
    assert said in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "labels.csv"]


def test_ctrl_c_leaves_nothing_behind(tmp_path, walk):
    """Sent to all processes of the terminal at once, as a terminal does, in the middle of an import by two workers."""
    folder, out = tmp_path / "in", tmp_path / "out"
    write_amass(folder / "walk.npz", walk)
    for number in range(4000):
        os.link(folder / "walk.npz", folder / f"walk_{number:04d}.npz")
    command = [sys.executable, "-m", "refine.cli.main", "data", "import", folder, "-o", out, "--workers", "2"]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".out.*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert said == "refine: stopped; nothing half-written is left\n"
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
    assert gone(process.pid)


def gone(group: int) -> bool:
    """Whether all processes of a group end within some seconds."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_inspect_a_file(folder, tmp_path, capsys):
    mapping = tmp_path / "mapping.json"
    assert main(["data", "inspect", str(folder / "walk_01.bvh"), "--mapping", str(mapping)]) == 0
    said = capsys.readouterr().out
    assert "skeleton    SMPL" in said and "pelvis <- pelvis" in said and said.endswith(f"{mapping}\n")
    joints = json.loads(mapping.read_text())["joints"]
    assert joints["left_knee"] == "left_knee"
    words = ["data", "import", str(folder / "walk_01.bvh"), "-o", str(tmp_path / "a.npz"), "--mapping", str(mapping)]
    assert main(words) == 0
    words = ["data", "inspect", str(folder / "walk_01.bvh"), "--use-mapping", str(mapping), "--json"]
    capsys.readouterr()
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["files"] == []


def test_names_of_files_with_characters_that_are_not_printed(tmp_path, walk, rest_joints, capsys):
    """Such as the space of Japanese; and where the folder lies is not told."""
    folder = tmp_path / "in"
    for name in ("walk\u3000on_01", "step\n_02"):
        write_bvh(folder / f"{name}.bvh", walk, rest_joints)
    assert main(["data", "import", str(folder), "-o", str(tmp_path / "out.npz")]) == 0
    clips = load_clips(tmp_path / "out.npz")
    assert [(clip.label, clip.source) for clip in clips] == [
        ("step", "step\\n_02.bvh"),
        ("walk\\u3000on", "walk\\u3000on_01.bvh"),
    ]


def test_inspect_standard_input(folder, monkeypatch, capsys):
    with (folder / "walk_01.bvh").open() as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        assert main(["data", "inspect", "-"]) == 0
    assert capsys.readouterr().out.startswith("what        standard input: BVH\n")


def test_inspect_a_folder_draws_and_says_as_json(folder, tmp_path, capsys):
    out = tmp_path / "look"
    assert main(["data", "inspect", str(folder), "-o", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["files"] == [str(out / "report.html")] and found["clips"] == 2
    assert found["labels"] == {"walk": 2} and len(found["unread"]) == 1
    assert sorted(path.name for path in out.iterdir()) == ["clips.png", "report.html", "report.json"]
    assert "is already there" in refused(capsys, "data", "inspect", folder, "-o", out)


def test_what_cannot_be_inspected_is_one_line(folder, tmp_path, capsys):
    assert "broken.npz" in refused(capsys, "data", "inspect", folder / "broken.npz", "-o", tmp_path / "x")
    assert "brings no skeleton" in refused(
        capsys, "data", "inspect", folder / "step_01.npz", "--mapping", tmp_path / "m"
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]
