"""The pages of commands: as the code has them, complete, and with examples that can be typed."""

import importlib.util
import re
import shlex
from pathlib import Path

import pytest
from PIL import Image

from refine.cli.grammar import Flag
from refine.cli.words import parsed

ROOT = Path(__file__).resolve().parents[2]
SPEC = importlib.util.spec_from_file_location("write_commands", ROOT / "tools" / "write_commands.py")
write_commands = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(write_commands)
COMMANDS, CONSOLE, PICTURES = write_commands.COMMANDS, write_commands.CONSOLE, write_commands.PICTURES
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCED = re.compile(r"^```(?:console|bash|)\n(.*?)^```", re.DOTALL | re.MULTILINE)
OPERATORS = {"|", "||", "&&", ";", "<", ">", "&", ">>", "do", "then"}


def commands_in(page: Path) -> list[list[str]]:
    """The words of every ``refine`` command in the page's code blocks."""
    found = []
    for block in FENCED.findall(page.read_text()):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.removeprefix("$ ")
            if "refine " not in line or not re.match(r"\$ |refine |for |cat |BPY|printf ", line):
                continue
            lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
            lexer.whitespace_split, lexer.commenters = True, "#"
            words, command = list(lexer), None
            for word in words:
                if word in OPERATORS or set(word) <= set("|&;<>"):
                    command = None
                elif word == "refine" and command is None:
                    found.append(command := [])
                elif command is not None:
                    command.append(word)
    return found


def test_tables_are_as_the_code_has_them():
    for path, text in write_commands.written().items():
        assert path.read_text() == text, f"{path.name}: run python tools/write_commands.py"


def test_every_verb_has_a_page_an_example_and_a_light_picture():
    names = [write_commands.page_name(command) for command in write_commands.verbs()]
    assert sorted(names) == sorted(path.stem for path in COMMANDS.glob("*.md")) == sorted(write_commands.DRAWN)
    for command in write_commands.verbs():
        name = write_commands.page_name(command)
        page = (COMMANDS / f"{name}.md").read_text()
        assert page.startswith(f"# `refine {command.name}`\n\n") and f"](pictures/{name}.png)" in page
        assert f"$ refine {command.name}" in CONSOLE.search(page)["lines"]
        picture = PICTURES / f"{name}.png"
        assert picture.stat().st_size <= write_commands.HEAVIEST
        with Image.open(picture) as opened:
            assert opened.format == "PNG" and opened.width >= 300


def test_links_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "README.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert f"]({page.name})" in index or page.name == "README.md", page.name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_documentation_can_be_typed(page, capsys):
    """Every one is understood by the parser; none is run."""
    for words in commands_in(page):
        if any("..." in word or "$" in word for word in words):
            continue
        try:
            parsed(words)
        except SystemExit as stopped:
            assert not stopped.code, words  # help


def test_the_reader_of_commands_reads():
    found = commands_in(COMMANDS / "compose.md")
    assert ["compose", "-", "wave.bvh", "-o", "-", "--steps", "0", "--quiet"] in found
    assert sum(map(len, map(commands_in, PAGES))) > 50


# --- the tool --------------------------------------------------------------------------------------------------------


def test_examples_are_run_again_with_what_they_print(tmp_path):
    block = "$ echo one; echo two >&2\nold\nolder\n$ pwd\n/elsewhere\n$ false; echo $?\n"
    now = f"$ echo one; echo two >&2\none\ntwo\n$ pwd\n{tmp_path}\n$ false; echo $?\n1\n"
    assert write_commands.rerun(block, tmp_path) == f"```console\n{now}```"
    with pytest.raises(SystemExit, match="ended with 1"):
        write_commands.rerun("$ false\n", tmp_path)


def test_pictures_are_made_light(tmp_path):
    noise = Image.effect_noise((1400, 1000), 80).convert("RGB")
    write_commands.save_small(noise, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size <= write_commands.HEAVIEST
    flat = Image.new("RGB", (400, 100), "red")
    write_commands.save_small(flat, tmp_path / "b.png")
    assert Image.open(tmp_path / "b.png").size == (400, 100)


def test_a_row_of_a_flag():
    flag = Flag(("-o", "--out"), "PATH", "A | b, ``c`` <d>.", None)
    row = write_commands.row(flag, write_commands.given(flag.default))
    assert row == "| `-o PATH`, `--out PATH` | A \\| b, `c` &lt;d>. | has to be given |"
    many = Flag(("--kinds",), "a|b ...", "", "none", ("a", "b"))
    assert write_commands.typed(many) == "`--kinds` *a, b* ..."
    assert write_commands.unless({"x": "1", "y": "1"}) == "`1`"
    assert write_commands.unless({"x": "1", "y": "2"}) == "`1` (x), `2` (y)"
    assert write_commands.unless({"x": "on"}, everywhere=False) == "on (x)"
