"""What can be typed, as values: verbs and their flags, read off the dataclasses that the parser is made of.

Completion, the offers after a misspelt word, and the tables in the documentation come from here.
"""

import ast
import inspect
import textwrap
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from tyro.conf import Positional

POSITIONAL = get_args(Positional[int])[1]
PLURAL = "..."


@dataclass(frozen=True)
class Flag:
    """One flag, or one word that is told by its place."""

    names: tuple[str, ...]
    """As typed, the short one first, such as ("-o", "--out"); of a word, its name alone, such as ("A",)."""
    value: str
    """What follows it: "PATH", "NUMBER", "INT", "TEXT", "a|b", each with "..." where several may; "" for a switch."""
    said: str
    """Its description, in one line."""
    default: str | None = None
    """What it is unless given, as typed; None where it has to be given. What a switch is about is "on" or "off"."""
    choices: tuple[str, ...] = ()
    """All that it may be, if they are few."""
    positional: bool = False

    @property
    def many(self) -> bool:
        return self.value.endswith(PLURAL)


@dataclass(frozen=True)
class Command:
    """A verb, a word that verbs come under, or a preset of a verb."""

    name: str
    """As typed after ``refine``, such as "data import"; "" for ``refine`` itself."""
    said: str
    """Its description, as in ``--help``."""
    read: Callable[[], Iterable[Flag]] = tuple
    """Makes ``flags``."""
    below: Callable[[], dict[str, "Command"]] = dict
    """Makes ``commands``, and imports for it what presets are made of."""

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        return tuple(self.read())

    @cached_property
    def commands(self) -> dict[str, "Command"]:
        """Words that may follow, in the order of ``--help``."""
        return self.below()

    def every(self) -> Iterator["Command"]:
        """This one and all below it, in the order of ``--help``."""
        yield self
        for command in self.commands.values():
            yield from command.every()

    def along(self, words: Sequence[str]) -> list["Command"]:
        """This one, and those below it that the words name, one after the other from their first."""
        chain = [self]
        for word in words:
            if word not in chain[-1].commands:
                break
            chain.append(chain[-1].commands[word])
        return chain


def grammar(verbs: Mapping[str, Any], name: str = "") -> Command:
    """The commands of a table of verbs, see ``refine.cli.verbs.VERBS``."""
    made = {}
    for word, verb in verbs.items():
        path = f"{name} {word}".strip()
        if isinstance(verb, Mapping):
            made[word] = grammar(verb, path)
        elif word:
            presets = partial(_presets, path, verb.presets) if hasattr(verb, "presets") else dict
            made[word] = Command(path, inspect.getdoc(verb) or "", partial(_flags, verb), presets)
    return Command(name, verbs.get("", ""), below=lambda: made)


def _presets(name: str, presets: Callable[[], dict[str, tuple[str, Any]]]) -> dict[str, Command]:
    return {
        word: Command(f"{name} {word}", said, partial(_flags, type(config), config))
        for word, (said, config) in presets().items()
    }


def _flags(owner: type, values: Any = None, prefix: str = "") -> Iterator[Flag]:
    """The flags of a dataclass; ``values`` is an instance whose values are the defaults.

    A field that is a dataclass stands for its fields, with its name and a dot before theirs, or nothing if it is named
    "". A field of any type (presets) has no flag of its own.
    """
    hints = get_type_hints(owner, include_extras=True)
    for each in fields(owner):
        kind, notes = _bare(hints[each.name])
        default = _default(each) if values is None else getattr(values, each.name)
        names, aliases = [], []
        for note in notes:
            names += [name] if (name := getattr(note, "name", None)) is not None else []
            aliases += getattr(note, "aliases", None) or ()
        name = (names or [each.name.replace("_", "-")])[0]
        if is_dataclass(kind):
            yield from _flags(kind, default, f"{prefix}{name}." if name else prefix)
        elif kind is not Any:
            positional, off = POSITIONAL in notes, "no-" if kind is bool and default is True else ""
            typed = (name.upper(),) if positional else (*aliases, f"--{prefix}{off}{name}")
            value, choices = _value(kind)
            said = " ".join(_said(owner).get(each.name, "").split())
            yield Flag(typed, value, said, _typed(default), choices, positional)


def _bare(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without its notes and without ``| None``, and the notes."""
    notes: tuple[Any, ...] = ()
    while hasattr(hint, "__metadata__"):
        notes, hint = notes + hint.__metadata__, hint.__origin__
    if get_origin(hint) in (Union, types.UnionType):
        others = [each for each in get_args(hint) if each is not type(None)]
        if len(others) == 1:
            inner, more = _bare(others[0])
            return inner, notes + more
    return hint, notes


def _value(kind: Any) -> tuple[str, tuple[str, ...]]:
    """What is typed for a type, and the choices there are."""
    if get_origin(kind) is tuple:
        value, choices = _value(_bare(get_args(kind)[0])[0])
        if get_args(kind)[-1] is Ellipsis:
            return f"{value} {PLURAL}", choices
        return " ".join([value] * len(get_args(kind))), choices
    if get_origin(kind) is Literal:
        choices = tuple(map(str, get_args(kind)))
        return "|".join(choices), choices
    return {bool: "", int: "INT", float: "NUMBER", Path: "PATH"}.get(kind, "TEXT"), ()


def _default(each: Field) -> Any:
    return each.default_factory() if each.default_factory is not MISSING else each.default


def _typed(value: Any) -> str | None:
    """A default as one would type it."""
    if value is MISSING:
        return None
    if value is None or value == () or value == "":
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(str(_typed(each)) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


@cache
def _said(owner: type) -> dict[str, str]:
    """The docstrings below the fields of a dataclass."""
    found: dict[str, str] = {}
    for each in reversed(owner.__mro__[:-1]):
        [definition] = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(definition, ast.ClassDef)
        for before, after in zip(definition.body, definition.body[1:], strict=False):
            match before, after:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[name] = inspect.cleandoc(text)
    return found
