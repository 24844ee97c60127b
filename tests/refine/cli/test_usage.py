"""Words that are no command: one line, what is near, exit code 2. And help, the version, and what grammar says."""

import os
import pty
import re
import subprocess
import sys
from importlib.metadata import version

import pytest

from refine.cli.grammar import Command, Flag, grammar
from refine.cli.main import main
from refine.cli.verbs import VERBS, name_of
from refine.cli.words import EXIT_CODES, offer

PROGRAM = [sys.executable, "-m", "refine.cli.main"]


@pytest.fixture(scope="module")
def root() -> Command:
    return grammar(VERBS)


def said_by_help(words: list[str], capsys) -> str:
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--help"])
    assert stopped.value.code == 0
    return capsys.readouterr().out


# --- what is wrong, in one line --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("composs", "command line: there is no 'composs'; did you mean compose?"),
        ("Demo", "command line: there is no 'Demo'; did you mean demo?"),
        ("zzz", "command line: there is no 'zzz'; see `refine --help`"),
        ("data imprt clips", "data: there is no 'imprt'; did you mean import?"),
        ("train maee tiny", "train: there is no 'maee'; did you mean mae?"),
        ("train mae tinny", "train mae: there is no 'tinny'; did you mean tiny?"),
        ("compose walk squat -o a.bvh --stepz 3", "compose: has no flag --stepz; did you mean --steps"),
        ("compose walk squat -o a.bvh --seeed=3", "compose: has no flag --seeed; did you mean --seed"),
        ("train mae tiny --lop.steps 3", "train mae tiny: has no flag --lop.steps; did you mean --loop.steps"),
        ("demo --qqqqq", "demo: has no flag --qqqqq; see `refine demo --help`"),
        ("compose walk", "compose: needs B and -o PATH; see `refine compose --help`"),
        ("completion", "completion: needs SHELL; see `refine completion --help`"),
        ("generate", "generate: needs --model PATH and -o PATH; see `refine generate --help`"),
        ("compose walk squat run -o a.bvh", "compose: Unrecognized options: run; see `refine compose --help`"),
        ("compose walk squat -o a.bvh --seed", "compose: Missing value for argument '--seed'"),
        ("compose walk squat -o a.bvh --seed two", "compose: Error parsing --seed: invalid literal"),
        ("render walk -o a.png --style shiny", "render: invalid choice 'shiny'"),
        (
            "train",
            "train: Expected one of {mae, generator, recogniser, text, text-scorer, text-diffusion}; see",
        ),
        ("", "command line: Expected one of {demo, compose"),
    ],
)
def test_one_line_says_what_is_wrong_and_what_is_near(capsys, words, said):
    assert main(words.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"refine: {said}")
    assert printed.err.count("\n") == 1 and not set("╭│─") & set(printed.err)


def test_flags_with_underscores_and_of_presets_are_known(capsys):
    assert main(["train", "mae", "tiny", "--loop.save_every", "0"]) == 2
    assert "LoopConfig(save_every)" in capsys.readouterr().err


def test_only_what_is_near_is_offered():
    assert offer("compose", ["composed", "demo"]) == "did you mean composed?"
    assert offer("x", ["composed", "demo"]) == ""


# --- help, version, colours ------------------------------------------------------------------------------------------


def test_help_ends_in_the_exit_codes(capsys):
    for words in ([], ["compose"], ["data", "import"]):
        assert said_by_help(words, capsys).rstrip().endswith(EXIT_CODES)
    for code in ("0 done", "1 a check", "2 something that you can mend", "130 stopped by"):
        assert code in EXIT_CODES.replace("\n", " ")


def test_the_version(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert not stopped.value.code
    assert capsys.readouterr().out == f"refine {version('refine-motion')}\n"


def on_a_terminal(*words: str, **environment: str) -> str:
    """What the program prints on a terminal, a pseudo one."""
    ours, theirs = pty.openpty()
    variables = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    with subprocess.Popen(
        [*PROGRAM, *words], stdout=theirs, stderr=theirs, env=variables | {"TERM": "xterm"} | environment
    ) as process:
        os.close(theirs)
        printed = b""
        while True:
            try:
                block = os.read(ours, 65536)
            except OSError:  # the last one has closed it
                break
            if not block:
                break
            printed += block
        process.wait()
    os.close(ours)
    return printed.decode()


def test_no_color_takes_the_colours_of_help_away():
    assert "\x1b[" in on_a_terminal("demo", "--help")
    plain = on_a_terminal("demo", "--help", NO_COLOR="1")
    assert "\x1b" not in plain and "--out PATH" in plain
    assert "\x1b" not in on_a_terminal("demoo", NO_COLOR="1")


def test_complaints_are_as_plain_on_a_terminal():
    said = "refine: compose: needs B and -o PATH; see `refine compose --help`"
    assert on_a_terminal("compose", "walk").strip() == said
    assert on_a_terminal("compose", "walk", PYTHONIOENCODING="ascii").strip() == said


# --- grammar ---------------------------------------------------------------------------------------------------------


def parsers_flags(said: str) -> set[str]:
    """The flags that start a line of help."""
    heads = re.findall(r"^[│ ] (-[-a-z][^│]*?)(?:  |$| *│)", said, re.MULTILINE)
    words = {word.strip(",") for head in heads for word in head.split()}
    return {word for word in words if word.startswith("-") and word.strip("-")} - {"-h", "--help"}


def leaves(command: Command) -> list[Command]:
    return [each for each in command.every() if each.flags]


def test_grammar_knows_the_flags_that_the_parser_knows(root, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    compared = 0
    for command in leaves(root):
        words = command.name.split()
        chain = root.along(words)
        assert chain[-1] is command
        parents = chain[:-1] if not command.commands else []
        flags = [flag for each in (*parents, command) for flag in each.flags if not flag.positional]
        known = {name for flag in flags for name in flag.names}
        found = parsers_flags(said_by_help(words, capsys))
        if command.commands:  # before a preset is chosen, the parser shows what comes before it alone
            assert found <= known
        else:
            assert found == known, command.name
        compared += len(found)
    assert compared > 400


def test_grammar_says_what_the_dataclasses_say(root):
    compose = root.commands["compose"]
    flags = {flag.names[-1]: flag for flag in compose.flags}
    assert list(root.commands)[:2] == ["demo", "compose"]
    assert flags["A"].positional and flags["A"].default is None and "built-in action" in flags["A"].said
    assert flags["--out"].names == ("-o", "--out") and (flags["--out"].value, flags["--out"].default) == ("PATH", None)
    assert flags["--lam"] == Flag(("--lam",), "NUMBER", "Share of A where both move alike, 0 to 1.", "0.5")
    assert (flags["--steps"].value, flags["--steps"].default) == ("INT", "none")
    assert (flags["--force"].value, flags["--force"].default) == ("", "off")
    assert flags["--json"].said.startswith("Print one JSON object")
    style = next(flag for flag in root.commands["render"].flags if flag.names == ("--style",))
    assert style.choices == ("shaded", "parts", "silhouette") and style.value == "shaded|parts|silhouette"
    tiny, small = (root.along(["train", "mae", name])[-1] for name in ("tiny", "small"))
    batch = [next(flag for flag in preset.flags if flag.names == ("--batch",)).default for preset in (tiny, small)]
    assert batch == ["32", "64"]
    assert any(flag.names == ("--data.actions",) and flag.many for flag in tiny.flags)
    generator = root.along(["train", "generator", "tiny"])[-1]
    assert [flag.default for flag in generator.flags if flag.names == ("--coupling.no-mask",)] == ["on"]


def test_grammar_imports_nothing_heavy_before_a_preset_is_asked_for():
    code = "import sys; from refine.cli.verbs import VERBS; from refine.cli.grammar import grammar; grammar(VERBS)"
    code += ".along(['composs']); assert 'torch' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_every_verb_has_a_name_an_example_and_flags_that_are_explained(root):
    for command in leaves(root):
        if command.name.startswith("train ") and len(command.name.split()) > 2:
            continue  # presets
        assert f"Example: refine {command.name}" in " ".join(command.said.split()), command.name
        assert all(flag.said for flag in command.flags), command.name
    assert name_of(VERBS["data"]["import"], VERBS) == "data import"
