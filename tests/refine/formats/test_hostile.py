"""Files that were made to do harm: refused in one line, soon, without memory, and without a trace."""

import json
import pickle
import re
import subprocess
import sys
import time
from pathlib import Path

import hostile
import numpy as np
import pytest
from hostile_cases import CASES, HARMED, Case

from refine.cli.main import main
from refine.formats.clips import load_clips

SCRIPT = Path(hostile.__file__)
DOCS = Path(__file__).resolve().parents[3] / "docs" / "hostile.md"
SECONDS, MEGABYTES = 1, 200
pytestmark = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="memory is measured as Linux does")


@pytest.fixture(scope="module")
def outcomes() -> dict[str, dict]:
    """What became of each file, measured in a process that has little else in its memory."""
    done = subprocess.run([sys.executable, str(SCRIPT), "--json"], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", CASES)
def test_a_hostile_file_is_refused(outcomes, name):
    found = outcomes[name]
    assert found["error"] in ("UserError", "ShapeError"), found
    assert found["answer"].isprintable() and len(found["answer"]) < 1000
    assert found["written"] == [] and found["warnings"] == []
    assert found["seconds"] < 2 * SECONDS and found["megabytes"] < MEGABYTES, found


def test_there_are_many_and_nearly_all_are_refused_at_once(outcomes):
    assert len(outcomes) > 200
    assert sum(found["seconds"] < SECONDS / 2 for found in outcomes.values()) > 0.95 * len(outcomes)


def test_the_page_says_what_is_answered(outcomes):
    """But for what stands in brackets, which comes from the libraries."""

    def without_brackets(page: str) -> list[str]:
        return [re.sub(r"\(.*?\)", "", line) for line in page.splitlines()]

    assert without_brackets(DOCS.read_text()) == without_brackets(hostile.page(outcomes))


# --- would it be seen? ------------------------------------------------------------------------------------------------


def of_pickle(_case: Case, path: Path) -> object:
    return pickle.loads(path.read_bytes())


def test_code_that_runs_leaves_its_mark():
    cases = [CASES[name] for name in ("os_system", "builtins_eval", "obj")]
    assert [found["written"] for found in hostile.outcomes(cases, of_pickle).values()] == [[f"empty/{HARMED}"]] * 3


def test_time_memory_and_a_broken_interpreter_are_seen():
    cases = [CASES[name] for name in ("empty", "nested_key", "picture", "program")]

    def wait(case, path):
        if case.name == "nested_key":
            of_pickle(case, path)
        if case.name == "picture":
            np.ones(40_000_000).sum()
        end = time.process_time() + 0.5 * (case.name == "empty")
        while time.process_time() < end:
            pass

    found = hostile.outcomes(cases, wait)
    assert found["nested_key"]["error"] == "died" and found["program"]["error"] == ""
    assert found["empty"]["seconds"] > 0.4 > found["program"]["seconds"]
    assert found["picture"]["megabytes"] > 250 > 50 > found["program"]["megabytes"]


# --- at the command line ----------------------------------------------------------------------------------------------

COMMANDS = {
    "link": ["render", "FILE", "-o", "out.png"],
    "pipe": ["compose", "FILE", "walk", "-o", "out.bvh"],
    "terminal": ["inspect", "FILE", "walk", "-o", "out"],
    "zip_bomb": ["render", "FILE", "-o", "out.png"],
    "object_array": ["export", "FILE", "-o", "out.glb"],
    "os_system": ["data", "inspect", "FILE"],
    "laughs": ["data", "import", "FILE", "--out", "out.npz"],
    "nested_json": ["view", "FILE", "-o", "out.html"],
    "sparse_counts": ["render", "walk", "--body", "FILE", "-o", "out.png"],
    "checkpoint_key": ["compose", "walk", "squat", "--mae", "FILE", "-o", "out.bvh"],
    "deep_mapping": ["export", "walk.bvh", "--mapping", "FILE", "-o", "out.glb"],
    "open_quote": ["data", "import", ".", "--labels-file", "FILE", "--out", "out.npz"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_command_line_answers_in_one_line(tmp_path, monkeypatch, capfd, name):
    (tmp_path / "files").mkdir()
    file = CASES[name].make(tmp_path / "files")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "here" / "walk.bvh").write_text((Path(__file__).parent / "seeds" / "smpl.bvh").read_text())
    code = main([str(file) if word == "FILE" else word for word in COMMANDS[name]])
    shown = capfd.readouterr()
    assert code == 2
    assert shown.err.startswith("refine: ") and shown.err.count("\n") == 1 and shown.err[:-1].isprintable()
    assert file.name in shown.err
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["walk.bvh"]


def test_a_folder_of_them_imports_what_is_sound(tmp_path, monkeypatch, capfd):
    folder, alone = tmp_path / "in", ("device", "terabyte")  # one has no folder, the other no room to be copied
    for name, case in CASES.items():
        if case.reader == "motion" and name not in alone:
            (folder / name).mkdir(parents=True)
            case.make(folder / name)
    (folder / "squat_01.bvh").write_text((Path(__file__).parent / "seeds" / "smpl.bvh").read_text())
    monkeypatch.chdir(tmp_path)
    assert main(["data", "import", "in", "--out", "out.npz", "--workers", "1"]) == 0
    assert "1  squat" in capfd.readouterr().out
    assert [clip.label for clip in load_clips(tmp_path / "out.npz")] == ["squat"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out.npz"]


# --- labels -----------------------------------------------------------------------------------------------------------

LABEL = "<script>alert(1)</script>\x1b[2J\x1b]0;harmed\x07\u202e=1+1"


@pytest.fixture
def labelled(tmp_path) -> Path:
    """A motion with a label that is a script, a command to the terminal and a formula."""
    path = tmp_path / "labelled.npz"
    poses, trans = np.zeros((12, 72), np.float32), np.zeros((12, 3), np.float32)
    poses[:, 0] = np.pi / 2
    poses[:, 50] = np.linspace(0, 1, 12)
    np.savez(path, poses=poses, trans=trans, mocap_framerate=30.0, label=np.array(LABEL), gender="neutral")
    return path


@pytest.mark.parametrize(
    "words",
    [
        ["view", "FILE", "-o", "out.html"],
        ["data", "inspect", "FILE", "-o", "out"],
        ["data", "inspect", "FILE", "--json"],
        ["data", "import", "FILE", "--out", "out.npz"],
        ["export", "FILE", "-o", "out.glb"],
        ["export", "FILE", "-o", "out.bvh"],
    ],
    ids=" ".join,
)
def test_a_label_runs_nowhere(labelled, tmp_path, monkeypatch, capfd, words):
    monkeypatch.chdir(tmp_path)
    assert main([str(labelled) if word == "FILE" else word for word in words]) == 0
    shown = capfd.readouterr()
    for text in (shown.out, shown.err):
        assert not set(text) & set("\x1b\x07\u202e")
    for page in tmp_path.rglob("*.html"):
        assert "<script>alert" not in page.read_text()
        assert not set(page.read_text()) & set("\x1b\x07")
