"""What Tab offers, asked of the shells themselves."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from refine.cli.completion import INSTALL, offers, script
from refine.cli.grammar import Command, Flag, grammar
from refine.cli.main import main
from refine.cli.verbs import VERBS

ACTIONS = ("walk", "wave-left-hand")
ASK = """
source "$1"; shift
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
_refine
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def root() -> Command:
    return grammar(VERBS)


@pytest.fixture(scope="module")
def scripts(tmp_path_factory, root) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("scripts")
    for shell in INSTALL:
        (folder / shell).write_text(script(shell, root, ACTIONS))
    return {shell: folder / shell for shell in INSTALL}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with two files to complete."""
    folder = tmp_path_factory.mktemp("place")
    for name in ("wild.bvh", "my walk.npz"):
        (folder / name).touch()
    return folder


def program(shell: str) -> str:
    found = shutil.which(shell)
    if found is None:
        pytest.skip(f"there is no {shell} here")
    return found


CASES = [
    ("refine comp", {"compose", "completion"}),
    ("refine data ", {"import", "benchmark", "inspect", "texts"}),
    ("refine train ", {"mae", "generator", "recogniser", "text", "text-scorer", "text-diffusion"}),
    ("refine train mae ", {"tiny", "small", "plain", "paper"}),
    ("refine completion ", {"bash", "zsh", "fish"}),
    ("refine compose w", {"walk", "wave-left-hand", "wild.bvh"}),
    ("refine compose walk squat -o w", {"wild.bvh"}),
    ("refine compose walk squat --bod", {"--body"}),
    ("refine compose walk squat --lam ", set()),
    ("refine render walk --style ", {"shaded", "parts", "silhouette"}),
    ("refine train mae tiny --loop.save", {"--loop.save-every"}),
    ("refine demo --actions wa", {"walk", "wave-left-hand"}),
    ("refine demo --js", {"--json"}),
]


@pytest.mark.parametrize(("line", "expected"), CASES)
def test_bash(scripts, place, line, expected):
    words = line.split(" ")
    done = subprocess.run(
        [program("bash"), "-c", ASK, "ask", scripts["bash"], *words], capture_output=True, text=True, cwd=place
    )
    assert done.stderr == ""
    assert set(done.stdout.split("\n")) - {""} == expected


@pytest.mark.parametrize(("line", "expected"), CASES)
def test_fish(scripts, place, line, expected):
    asked = f"source {scripts['fish']}; complete -C '{line}'"
    environment = os.environ | {"HOME": str(place), "XDG_CONFIG_HOME": str(place / "none")}
    done = subprocess.run(
        [program("fish"), "--no-config", "-c", asked], capture_output=True, text=True, cwd=place, env=environment
    )
    assert done.stderr == ""
    assert {offer.partition("\t")[0] for offer in done.stdout.splitlines()} - {"none/"} == expected


def test_zsh_takes_the_script_of_bash(scripts):
    head, _, body = scripts["zsh"].read_text().partition("_refine() {")
    assert body == scripts["bash"].read_text().partition("_refine() {")[2]
    assert "bashcompinit" in head
    assert subprocess.run([program("zsh"), "-n", scripts["zsh"]]).returncode == 0


def test_every_verb_and_flag_is_in_every_script(scripts, root):
    commands = [command for command in root.every() if command.name]
    for shell, path in scripts.items():
        text = path.read_text()
        assert INSTALL[shell] in text
        for command in commands:
            assert f"/{command.name.replace(' ', '/')}" in text
            for flag in command.flags:
                long = flag.names[-1]
                assert flag.positional or (long if shell != "fish" else f"-l {long[2:]} ") in text


def test_what_is_offered():
    assert offers(Flag(("--style",), "a|b", "", choices=("a", "b")), ACTIONS) == ["a", "b"]
    assert offers(Flag(("--lam",), "NUMBER", "Share."), ACTIONS) == []
    assert offers(Flag(("A",), "TEXT", "A file or the name of a built-in action.", positional=True), ACTIONS)[:2] == [
        *ACTIONS
    ]


def test_the_verb_prints_the_script(scripts, capsys):
    assert main(["completion", "bash"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("# Tab completion for refine.") and "raise-up-left-hand" in printed
    assert main(["completion", "powershell"]) == 2
    assert "invalid choice 'powershell'" in capsys.readouterr().err
