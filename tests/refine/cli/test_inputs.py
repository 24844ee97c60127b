"""Standard input and output in place of files, patterns in place of names, and what waits for a terminal."""

import io
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from refine.cli import inputs
from refine.cli.inputs import (
    check_motion_output,
    clip_of,
    expand,
    input_path,
    output_path,
    output_suffix,
    refuse_output,
)
from refine.formats.files import load_motion, save_motion
from refine.synthetic import draw, perform
from renderers.checks import UserError

PROGRAM = [sys.executable, "-m", "refine.cli.main"]


@pytest.fixture(scope="module")
def walk(tmp_path_factory, rest_joints, free_body) -> Path:
    import torch

    path = tmp_path_factory.mktemp("inputs") / "walk.bvh"
    save_motion(perform(draw("walk", torch.Generator().manual_seed(3), 30.0), 9, rest_joints), path, free_body)
    return path


@pytest.fixture
def piped(monkeypatch):
    """Puts bytes on standard input."""

    def pipe(content: bytes) -> None:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))

    return pipe


# --- input_path ------------------------------------------------------------------------------------------------------


def test_a_name_is_a_path():
    with input_path("a.bvh") as path:
        assert path == Path("a.bvh")


def test_standard_input_is_a_private_file_that_goes_away(piped):
    piped(b"HIERARCHY" * 1000)
    with input_path("-") as path:
        assert path.read_bytes() == b"HIERARCHY" * 1000
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert path == path.resolve()
        folder = path.parent
    assert not folder.exists()


def test_it_is_read_once_and_not_without_end(piped, monkeypatch):
    piped(b"12345678")
    with input_path("-"):
        pass
    with pytest.raises(UserError, match=r"standard input: is empty.*can be read once"), input_path("-"):
        pass
    monkeypatch.setattr(inputs, "MAX_STDIN", 7)
    piped(b"12345678")
    with pytest.raises(UserError, match="has more than 7 bytes"), input_path("-"):
        pass


def test_a_terminal_is_no_file(monkeypatch):
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with pytest.raises(UserError, match="is a terminal"), input_path("-"):
            pass
    os.close(ours)


def test_a_clip_comes_from_standard_input_by_what_it_holds(piped, walk, rest_joints, free_body, tmp_path):
    for suffix in (".bvh", ".npz"):
        save_motion(load_motion(walk, rest_joints), tmp_path / f"walk{suffix}", free_body)
        piped((tmp_path / f"walk{suffix}").read_bytes())
        clip = clip_of("-", rest_joints)
        assert (len(clip), clip.source) == (9, "standard input")
    piped(b"no motion")
    with pytest.raises(UserError, match="stdin"):
        clip_of("-", rest_joints)


# --- output_path -----------------------------------------------------------------------------------------------------


def test_an_output_is_its_path_or_goes_to_standard_output(capsysbinary, tmp_path):
    with output_path(tmp_path / "a.npz") as path:
        assert path == tmp_path / "a.npz"
    for name, suffix in (("-", ".bvh"), ("-.NPZ", ".npz")):
        with output_path(Path(name)) as path:
            assert path.suffix == suffix
            path.write_bytes(b"\x00made\xff")
        assert capsysbinary.readouterr().out == b"\x00made\xff"
        assert not path.parent.exists()
    assert (output_suffix(Path("a.PNG")), output_suffix(Path("-"), ".png")) == (".png", ".png")


def test_nothing_comes_out_of_a_block_that_fails(capsysbinary):
    with pytest.raises(ZeroDivisionError), output_path(Path("-")) as path:
        path.write_bytes(b"half")
        raise ZeroDivisionError
    assert capsysbinary.readouterr().out == b""
    assert not path.parent.exists()


def test_outputs_that_cannot_be_are_refused_first(tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    with pytest.raises(UserError, match="no motion format has the suffix '.xyz'"):
        check_motion_output(Path("-.xyz"), force=False)
    (tmp_path / "a.bvh").touch()
    with pytest.raises(UserError, match="is already there"):
        check_motion_output(tmp_path / "a.bvh", force=False)
    monkeypatch.setattr(sys, "stdout", Terminal())
    refuse_output(Path("-"), force=False)
    with pytest.raises(UserError, match="standard output: is a terminal"):
        refuse_output(Path("-.npz"), force=False)


# --- patterns --------------------------------------------------------------------------------------------------------


def test_patterns_are_put_in_for_what_they_match(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("b.bvh", "a.bvh", "c.npz", "[x].bvh", "in/deep/d.bvh"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert [path.name for path in expand(["c.npz", "*.bvh"])] == ["c.npz", "[x].bvh", "a.bvh", "b.bvh"]
    assert expand(["[x].bvh"]) == [Path("[x].bvh")]  # it is there as it stands
    assert [path.name for path in expand(["**/*.bvh"])] == ["[x].bvh", "a.bvh", "b.bvh", "d.bvh"]
    assert expand(["missing.bvh", "?.npz"]) == [Path("missing.bvh"), Path("c.npz")]
    with pytest.raises(UserError, match=r"\*\.glb: matches no file"):
        expand(["*.glb"])


def test_a_pattern_for_one_clip_matches_one(walk, rest_joints, tmp_path):
    assert len(clip_of(str(walk.parent / "w*.bvh"), rest_joints)) == 9
    for name in ("a.bvh", "b.bvh"):
        (tmp_path / name).touch()
    with pytest.raises(UserError, match="matches 2 files, and one is wanted"):
        clip_of(str(tmp_path / "*.bvh"), rest_joints)


# --- the program -----------------------------------------------------------------------------------------------------


def test_a_pipe_of_two(walk, tmp_path, rest_joints):
    """Composing from a pipe into a pipe gives the same bytes as from a file into a file."""
    couple = ["compose", "-", "squat", "--steps", "0", "-o"]
    done = subprocess.run([*PROGRAM, *couple, "-"], input=walk.read_bytes(), capture_output=True, cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith(b"HIERARCHY") and done.stderr == b"-  9 frames at 30 fps\n"
    assert not list(tmp_path.iterdir())
    assert (
        subprocess.run([*PROGRAM, "compose", walk, "squat", "--steps", "0", "-o", "a.bvh"], cwd=tmp_path).returncode
        == 0
    )
    assert (tmp_path / "a.bvh").read_bytes() == done.stdout


# --- actions, streams that are closed, and no room -------------------------------------------------------------------


def test_actions_that_hold_the_word_are_offered(rest_joints):
    with pytest.raises(UserError) as refused:
        clip_of("wave", rest_joints)
    assert refused.value.remedy == "did you mean wave-left-hand, wave-right-hand, wave-both-hands?"


def in_shell(redirected: str, *words: str, folder: Path | None = None) -> subprocess.CompletedProcess:
    command = ["bash", "-c", redirected, "bash", *PROGRAM, *words]
    root = {"PYTHONPATH": str(Path(inputs.__file__).parents[2])}
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=os.environ | root)


def test_streams_that_are_closed_are_empty_or_lost(tmp_path):
    assert in_shell('"$@" >&- 2>&-', "completion", "bash").returncode == 0
    done = in_shell('"$@" <&-', "compose", "-", "walk", "-o", str(tmp_path / "both.bvh"), "--steps", "0")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("refine: standard input: is empty")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_no_room_is_one_line_and_leaves_nothing(tmp_path):
    said = "refine: the output cannot be written (No space left on device); make room, or write elsewhere\n"
    done = in_shell('"$@" > /dev/full', "completion", "bash")
    assert (done.returncode, done.stderr) == (2, said)
    words = ("compose", "walk", "squat", "--steps", "0", "-o", "both.bvh")
    done = in_shell('ulimit -f 8; "$@"', *words, folder=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "both.bvh: cannot be written (File too large)" in done.stderr
    assert list(tmp_path.iterdir()) == []
