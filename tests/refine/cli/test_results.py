"""How results are printed: lines, one JSON object, or nothing; never what steers a terminal."""

import io
import json
import sys
from pathlib import Path

import pytest

from refine.cli.main import fail, main
from refine.cli.results import Output, Result, hushed, is_stdout, show
from renderers.checks import printable

RESULT = Result("ok fine\nbroken\x1b[2J label", (Path("a.bvh"), Path("b")), {"loss": float("nan"), "of": Path("c")})


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_lines_for_people(capsys):
    show(RESULT, Output(), "demo")
    assert capsys.readouterr().out == "ok fine\nbroken\\x1b[2J label\n"


def test_one_object_for_programs(capsys):
    show(RESULT, Output(json=True, quiet=True), "data import")
    printed = capsys.readouterr()
    assert printed.err == ""
    assert json.loads(printed.out) == {"verb": "data import", "files": ["a.bvh", "b"], "loss": None, "of": "c"}
    assert "NaN" not in printed.out


def test_nothing_when_quiet(capsys):
    show(RESULT, Output(quiet=True), "demo")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("flags", [Output(), Output(json=True)])
def test_what_went_to_standard_output_has_its_results_on_stderr(capsys, flags):
    show(Result("- 3 frames", (Path("-"),)), flags, "compose")
    printed = capsys.readouterr()
    assert printed.out == "" and "-" in printed.err


def test_colours_are_for_terminals_that_want_them(monkeypatch):
    result = Result("  ok  a ok\n  oks\nbroken", colours={"ok": "green", "broken": "red"})

    def printed(stream: io.StringIO) -> str:
        monkeypatch.setattr(sys, "stdout", stream)
        show(result, Output(), "doctor")
        return stream.getvalue()

    monkeypatch.delenv("NO_COLOR", raising=False)
    assert printed(Terminal()) == "  \x1b[32mok\x1b[0m  a ok\n  oks\n\x1b[31mbroken\x1b[0m\n"
    assert "\x1b" not in printed(io.StringIO())
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in printed(Terminal())


def test_quiet_hushes_what_is_said_on_stderr(capsys):
    with hushed(True):
        print("a note", file=sys.stderr)
    with hushed(False):
        print("another", file=sys.stderr)
    assert capsys.readouterr().err == "another\n"


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("walk", "walk"),
        ("läuft ü走 🚶", "läuft ü走 🚶"),
        ("a\tb", "a\tb"),
        ("\x1b]0;title\x07", "\\x1b]0;title\\x07"),
        ("a\rb\x00\x7f", "a\\rb\\x00\\x7f"),
        ("\x9b31m", "\\x9b31m"),
        ("\u202egnp.exe", "\\u202egnp.exe"),
        ("zero\u200bwidth", "zero\\u200bwidth"),
        ("line\u2028break", "line\\u2028break"),
        ("lone \ud800", "lone \\ud800"),
    ],
)
def test_nothing_steers_the_terminal(line, shown):
    assert printable(line) == shown
    assert printable(shown) == shown


@pytest.mark.parametrize(
    ("name", "expected"),
    [("-", True), ("-.npz", True), ("-.tar.gz", False), ("a-", False), ("--", False), ("./a", False)],
)
def test_which_names_stand_for_standard_output(name, expected):
    assert is_stdout(name) is expected and is_stdout(Path(name)) is expected


# --- the verbs -------------------------------------------------------------------------------------------------------

COUPLE = ["compose", "walk", "squat", "--steps", "0"]


def test_verbs_print_json_of_what_they_wrote(tmp_path, capsys):
    out = tmp_path / "both.npz"
    assert main([*COUPLE, "-o", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    made = {"made": "coupled", "by": "energies", "frames": 120, "fps": 30.0}
    assert printed == {"verb": "compose", "files": [str(out)], **made}
    picture = tmp_path / "a.png"
    assert main(["render", str(out), "-o", str(picture), "--size", "32", "--poses", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(picture)]


def test_a_quiet_verb_says_nothing_but_errors(tmp_path, capsys):
    assert main([*COUPLE, "-o", str(tmp_path / "a.bvh"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main([*COUPLE, "-o", str(tmp_path / "a.bvh"), "--quiet"]) == 2
    assert "is already there" in capsys.readouterr().err


def test_a_quiet_verb_leaves_its_notes_out(tmp_path, capsys):
    for name, fps in (("walk", "30"), ("squat", "20")):
        assert main(["export", name, "-o", str(tmp_path / f"{name}.npz"), "--seconds", "1", "--fps", fps]) == 0
    capsys.readouterr()
    couple = ["compose", str(tmp_path / "walk.npz"), str(tmp_path / "squat.npz"), "--steps", "0", "--force"]
    assert main([*couple, "-o", str(tmp_path / "a.bvh")]) == 0
    assert "resampled" in capsys.readouterr().err
    assert main([*couple, "-o", str(tmp_path / "a.bvh"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_what_the_system_says_of_a_file_cannot_steer_the_terminal(capsys):
    assert fail("a\x1b[2J\nb", 2) == 2
    assert capsys.readouterr().err == "refine: a\\x1b[2J b\n"


def test_a_name_from_a_file_cannot_steer_the_terminal(tmp_path, capsys):
    evil = tmp_path / "\x1b[2J\x1b]0;owned\x07.bvh"
    assert main([*COUPLE, "-o", str(evil), "--force"]) == 0
    assert "\x1b" not in capsys.readouterr().out
    (tmp_path / "x\x1b[31m.bvh").write_text("HIERARCHY\nROOT")
    assert main(["render", str(tmp_path / "x\x1b[31m.bvh"), "-o", str(tmp_path / "a.png")]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said and "\\x1b[31m" in said
