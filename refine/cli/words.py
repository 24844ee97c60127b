"""The words of a command line: read into a verb, or answered in one line with what is wrong and what is near."""

import difflib
import os
import re
import sys
from collections.abc import Iterable, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from importlib.metadata import version
from io import BytesIO, TextIOWrapper
from itertools import dropwhile, takewhile
from typing import Any

from tyro.conf import CascadeSubcommandArgs, FlagCreatePairsOff, PositionalMetavarFromFieldName

from refine.cli.grammar import grammar
from refine.cli.verbs import VERBS, app
from renderers.checks import UserError

DESCRIPTION = "Compose two human actions into one motion and refine it with a differentiable renderer in the loop."
EXIT_CODES = """\
Exit codes: 0 done; 1 a check found something wanting; 2 something that you can mend, named in one line; 130 stopped by
Ctrl-C. Results go to stdout; notes, bars and errors to stderr. NO_COLOR=1 takes the colours away."""
COLOUR = re.compile(r"\x1b\[[\d;]*m")
STYLE = (FlagCreatePairsOff, CascadeSubcommandArgs, PositionalMetavarFromFieldName)


def parsed(argv: Sequence[str]) -> Any:
    """The verb that the words ask for.

    Raises:
        UserError: there is no such verb or flag, one is missing, or has a value that it cannot take.
        SystemExit: help, or the version, was asked for and printed.
    """
    if argv == ["--version"]:
        print(f"refine {version('refine-motion')}")
        raise SystemExit(0)
    if not {"-h", "--help"} & set(argv):
        check_words(argv)
    complaint, plain = _page(), _page() if os.environ.get("NO_COLOR") else None
    try:
        with redirect_stderr(complaint), redirect_stdout(plain) if plain else nullcontext():
            return app(VERBS).cli(prog="refine", description=DESCRIPTION, args=argv, config=STYLE)
    except SystemExit as stopped:
        if stopped.code:
            raise wrong(argv, first_of(_written(complaint))) from None
        print(_written(plain) if plain else "", EXIT_CODES, sep="")
        raise


def _page() -> TextIOWrapper:
    """What takes the parser's output, and is no terminal."""
    return TextIOWrapper(BytesIO(), encoding=sys.stdout.encoding, errors="replace", write_through=True)


def _written(page: TextIOWrapper) -> str:
    return page.buffer.getvalue().decode(page.encoding, errors="replace")


def check_words(argv: Sequence[str]) -> None:
    """Refuse verbs and flags that there are not, before the parser does, which would import all there is for it.

    Raises:
        UserError: offering what is nearest in spelling.
    """
    chain = grammar(VERBS).along(argv)
    last, rest = chain[-1], argv[len(chain) - 1 :]
    if last.commands and rest and not rest[0].startswith("-"):
        raise wrong(argv, f"there is no {rest[0]!r}", offer(rest[0], last.commands))
    known = [name for command in chain for flag in command.flags if not flag.positional for name in flag.names]
    for word in rest:
        flag = word.partition("=")[0].replace("_", "-")
        if flag.startswith("--") and flag.strip("-") and flag not in known:
            raise wrong(argv, f"has no flag {flag}", offer(flag, known))


def wrong(argv: Sequence[str], problem: str, remedy: str = "") -> UserError:
    """What is wrong with the words, at the last command that they name."""
    name = grammar(VERBS).along(argv)[-1].name
    return UserError(name or "command line", problem, remedy or f"see `{f'refine {name}'.strip()} --help`")


def first_of(complaint: str) -> str:
    """In one line what the parser says first, in a box of many lines that a title stands on."""
    plain = COLOUR.sub("", complaint)  # it looks at stdout alone, which may be a terminal
    lines = (line.strip("╭╮╰╯│─| ") for line in plain.splitlines()[1:])
    lines = dropwhile(lambda line: not line, (line.strip("+-") and line for line in lines))  # without rules
    said = " ".join(takewhile(bool, lines)).rstrip(".") or "cannot be understood"
    return f"needs {' and '.join(needed(plain))}" if said.startswith("Missing from") else said


def needed(complaint: str) -> list[str]:
    """Words and flags that the parser misses: the lines of its box that are set in, less than their descriptions."""
    lines = [line.strip("│|").rstrip() for line in complaint.splitlines()]
    insets = [len(line) - len(line.lstrip()) for line in lines]
    first = next(k for k, line in enumerate(lines) if line.lstrip().startswith("Missing from"))
    below = takewhile(lambda each: each[1] > insets[first], zip(lines[first + 1 :], insets[first + 1 :], strict=True))
    return [line.strip().partition(", ")[0] for line, inset in below if inset == insets[first + 1]]


def offer(word: str, known: Iterable[str]) -> str:
    """The names nearest in spelling, as a question."""
    near = difflib.get_close_matches(word, list(known), n=3)
    return f"did you mean {' or '.join(near)}?" if near else ""


def check_seed(seed: int | None) -> None:
    """Refuse what some of the random generators would."""
    if seed is not None and not 0 <= seed < 2**32:
        raise UserError("--seed", f"expected 0 to {2**32 - 1}, got {seed}")
