"""What a verb found and wrote, and how that is printed: lines for people, or one JSON object."""

import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from renderers.checks import printable

ANSI = {"green": 32, "yellow": 33, "red": 31}
STDOUT = "-"  # in place of an output's name; "-.npz" is standard output in that format


@dataclass(frozen=True)
class Output:
    """Flags of every verb that prints results."""

    quiet: bool = False
    """Print nothing but errors: no results, no notes, no bar."""
    json: bool = False
    """Print one JSON object instead of lines for people: the verb, the files written, and the values found."""


# A verb's last field is ``output: Printed = AS_LINES``, and its ``run`` returns a `Result`.
Printed = Annotated[Output, arg(name="")]
AS_LINES = Output()


@dataclass(frozen=True)
class Result:
    """What a verb's ``run`` returns.

    ``main`` prints it as the flags of `Output` ask; a verb prints nothing to stdout itself.
    """

    text: str = ""
    """Lines for people."""
    files: tuple[Path, ...] = ()
    """Files and folders that were written, those that a person would open first."""
    values: dict[str, Any] = field(default_factory=dict)
    """The same and more for programs: what JSON knows, and paths. NaN and infinity become null."""
    code: int = 0
    """Exit code: 1 when what was checked was found wanting."""
    colours: dict[str, str] = field(default_factory=dict)
    """Colours, on a terminal, of words that begin a line."""


def show(result: Result, output: Output, verb: str) -> None:
    """Print a result; to stderr when standard output has taken what the verb made."""
    if output.quiet and not output.json:
        return
    stream = sys.stderr if any(is_stdout(path) for path in result.files) else sys.stdout
    if output.json:
        found = {"verb": verb, "files": [str(path) for path in result.files], **result.values}
        print(json.dumps(_plain(found), indent=2, ensure_ascii=False, allow_nan=False), file=stream)
    elif result.text:
        colours = result.colours if stream.isatty() and not os.environ.get("NO_COLOR") else {}
        print("\n".join(_coloured(printable(line), colours) for line in result.text.split("\n")), file=stream)


@contextmanager
def hushed(quiet: bool) -> Iterator[None]:
    """Where ``quiet``, nothing that is said on stderr in the block is seen: notes, warnings, bars."""
    if not quiet:
        yield
        return
    with redirect_stderr(StringIO()):
        yield


def _coloured(line: str, colours: dict[str, str]) -> str:
    """The line with its first word in the colour it has."""
    word = line.split(maxsplit=1)[0] if line.strip() else ""
    if word not in colours:
        return line
    return line.replace(word, f"\x1b[{ANSI[colours[word]]}m{word}\x1b[0m", 1)


def is_stdout(path: str | Path) -> bool:
    """Whether an output's name stands for standard output: "-", or "-" with a suffix."""
    name = str(path)
    return name == STDOUT or (name.startswith("-.") and name[2:].isalnum())


def _plain(value: Any) -> Any:
    """The value as JSON knows it."""
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, str | int | float | bool):
        return value
    return str(value)
