"""``refine``: reads the command line, runs the verb, and words what went wrong in one line."""

import difflib
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.metadata import version
from io import BytesIO, TextIOWrapper
from itertools import dropwhile, takewhile
from typing import Any

from tyro.conf import CascadeSubcommandArgs, FlagCreatePairsOff, Positional, PositionalMetavarFromFieldName
from tyro.extras import SubcommandApp

from refine.cli.check_renderer import CheckRenderer
from refine.cli.completion import Shell, script
from refine.cli.compose import Compose
from refine.cli.data import BuildBenchmark, ImportData
from refine.cli.demo import Demo
from refine.cli.doctor import Doctor
from refine.cli.evaluate import Evaluate
from refine.cli.export import Export
from refine.cli.generate import Generate
from refine.cli.grammar import grammar
from refine.cli.inspect import Inspect
from refine.cli.inspect_data import InspectData
from refine.cli.render import Render
from refine.cli.results import Output, Result, hushed, show
from refine.cli.train import TrainGenerator, TrainMAE
from refine.cli.train_recogniser import TrainRecogniser
from refine.cli.view import View
from renderers.checks import UserError, printable

DESCRIPTION = "Compose two human actions into one motion and refine it with a differentiable renderer in the loop."
EXIT_CODES = """\
Exit codes: 0 done; 1 a check found something wanting; 2 something that you can mend, named in one line; 130 stopped by
Ctrl-C. Results go to stdout; notes, bars and errors to stderr. NO_COLOR=1 takes the colours away."""
STYLE = (FlagCreatePairsOff, CascadeSubcommandArgs, PositionalMetavarFromFieldName)
# What is typed: a class whose fields are the verb's flags, or verbs under a common word, with its description in "".
VERBS: dict[str, Any] = {
    "demo": Demo,
    "compose": Compose,
    "inspect": Inspect,
    "render": Render,
    "view": View,
    "export": Export,
    "data": {
        "": "Prepare motion data.\n\nExample: refine data import clips --out clips.npz",
        "inspect": InspectData,
        "import": ImportData,
        "benchmark": BuildBenchmark,
    },
    "train": {
        "": "Train the networks.\n\nExample: refine train mae tiny --out runs/mae",
        "mae": TrainMAE,
        "generator": TrainGenerator,
        "recogniser": TrainRecogniser,
    },
    "generate": Generate,
    "evaluate": Evaluate,
    "check-renderer": CheckRenderer,
    "doctor": Doctor,
}


@dataclass(frozen=True)
class Completion:
    """Print a script that completes verbs, flags, choices, built-in actions and files when Tab is pressed.

    Its first lines say where to keep it. After an update of Refine, write it anew.

    Example: refine completion bash > ~/.local/share/bash-completion/completions/refine
    """

    shell: Positional[Shell]
    """Which shell."""
    seed: int = 0
    """Taken by every verb; nothing is drawn here."""

    def run(self) -> None:
        from refine.synthetic import ACTIONS

        print(script(self.shell, grammar(VERBS), ACTIONS), end="")


VERBS["completion"] = Completion


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it is done, 1 when it found what it checks wanting, 2 for what the user can mend, 130
    after Ctrl-C."""
    try:
        verb = parsed(sys.argv[1:] if argv is None else list(argv))
        check_seed(getattr(verb, "seed", None))
        output = getattr(verb, "output", Output())
        with hushed(output.quiet):
            result = verb.run()
        if isinstance(result, Result):
            show(result, output, name_of(type(verb), VERBS))
        sys.stdout.flush()
    except KeyboardInterrupt:
        return fail("stopped; nothing half-written is left", 130)
    except UserError as error:
        return fail(str(error), 2)
    except BrokenPipeError:  # whoever read our lines has enough of them, as in `refine demo | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        return fail(f"{error.filename}: {error.strerror}", 2)
    return result.code if isinstance(result, Result) else result or 0


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


def app(verbs: dict[str, Any]) -> SubcommandApp:
    """Every verb's flags. Their modules are light: what a verb works with it imports when it runs."""
    made = SubcommandApp()
    for name, verb in verbs.items():
        if isinstance(verb, dict):
            made.command(app(verb), name=name, help=verb[""])
        elif name:
            made.command(verb, name=name)
    return made


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
    lines = (line.strip("╭╮╰╯│─| ") for line in complaint.splitlines()[1:])
    lines = dropwhile(lambda line: not line, (line.strip("+-") and line for line in lines))  # without rules
    return " ".join(takewhile(bool, lines)).rstrip(".") or "cannot be understood"


def offer(word: str, known: Iterable[str]) -> str:
    """The names nearest in spelling, as a question."""
    near = difflib.get_close_matches(word, list(known), n=3)
    return f"did you mean {' or '.join(near)}?" if near else ""


def name_of(verb: type, verbs: dict[str, Any]) -> str:
    """What is typed for a verb, such as "data import"."""
    for name, each in verbs.items():
        if each is verb:
            return name
        if isinstance(each, dict) and (below := name_of(verb, each)):
            return f"{name} {below}"
    return ""


def check_seed(seed: int | None) -> None:
    """Refuse what some of the random generators would."""
    if seed is not None and not 0 <= seed < 2**32:
        raise UserError("--seed", f"expected 0 to {2**32 - 1}, got {seed}")


def fail(message: str, code: int) -> int:
    print("refine:", printable(" ".join(message.split())), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
