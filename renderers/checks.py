"""Checks at public entries, and the one place that words errors.

An error names the place, what was expected, what came, and what to do next, in one line.
"""

from __future__ import annotations  # torch is named below, but not imported: the command line answers --help without it

import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor


LONGEST = 800  # characters of a message: what it names may come from a file that somebody else made


def printable(line: str) -> str:
    r"""A line in which nothing steers a terminal: labels and names come from other people's files.

    Control characters, and those that turn the direction of writing or take no room, are written as in Python.

    >>> printable("walk\x1b[31m\r")
    'walk\\x1b[31m\\r'
    """
    if line.isprintable():
        return line
    return "".join(
        character if character.isprintable() or character in "\t " else character.encode("unicode_escape").decode()
        for character in line.encode("utf-8", "backslashreplace").decode()
    )


class UserError(Exception):
    """Something the user can mend: one line on stderr, exit code 2.

    Not a ValueError: parsers of flags and files catch those, and would reword it.
    """

    def __init__(self, where: str | Path, problem: str, remedy: str = ""):
        self.where, self.problem, self.remedy = str(where), problem, remedy
        text = printable(f"{where}: {problem}" + (f"; {remedy}" if remedy else ""))
        super().__init__(text if len(text) <= LONGEST else f"{text[:LONGEST]}...")

    def __reduce__(self):
        return type(self), (self.where, self.problem, self.remedy)


class ShapeError(UserError):
    """A tensor does not have the shape its name promises."""


def check_shapes(where: str, bound: dict[str, int] | None = None, /, **tensors: tuple[Tensor | np.ndarray, str]):
    """Check that shapes fit their axis names, where one name means one size in the whole call.

    Each keyword is ``name=(tensor, "N V 3")``: words bind to a size, numbers must be met, a leading ``...``
    takes any batch axes. Returns the bound sizes, so that a later call can continue with them.

    >>> check_shapes("f", a=(torch.zeros(2, 5, 3), "N V 3"), b=(torch.zeros(2), "N"))
    {'N': 2, 'V': 5}

    Raises:
        ShapeError: an axis has another size than its name is bound to; the message shows both.
    """
    sizes = dict(bound or {})
    for name, (tensor, spec) in tensors.items():
        axes = spec.split()
        shape = tuple(tensor.shape)
        if axes and axes[0] == "...":
            axes = axes[1:]
            trailing = shape[len(shape) - len(axes) :] if len(shape) >= len(axes) else None
        else:
            trailing = shape if len(shape) == len(axes) else None
        fits = trailing is not None
        for axis, size in zip(axes, trailing or (), strict=fits):
            expected = int(axis) if axis.isdigit() else sizes.setdefault(axis, size)
            fits = fits and size == expected
        if not fits:
            known = ", ".join(f"{axis}={size}" for axis, size in sizes.items() if axis in axes)
            raise ShapeError(
                f"{where}({name})",
                f"expected shape [{spec}]" + (f" with {known}" if known else "") + f", got {list(shape)}",
            )
    return sizes


def check_finite(
    where: str | Path, values: Tensor | np.ndarray, axes: str, names: dict[str, tuple[str, ...]] | None = None
):
    """Refuse NaN and infinity, saying where the first one stands.

    Args:
        values: any shape.
        axes: a word for each axis, such as ``"frame joint coordinate"``.
        names: for an axis, the words for its indices (joint names).

    Raises:
        UserError: naming the index along every axis of the first value that is not finite.
    """
    if hasattr(values, "detach"):
        if values.isfinite().all():  # asked where the values are: a copy from a GPU for every picture would be dear
            return
        values = values.detach().cpu()
    array = np.asarray(values)
    bad = ~np.isfinite(array)
    if not bad.any():
        return
    first = np.argwhere(bad)[0]
    place = ", ".join(
        f"{axis} {(names or {}).get(axis, {})[index] if axis in (names or {}) else index}"
        for axis, index in zip(axes.split(), first, strict=True)
    )
    raise UserError(
        where,
        f"value {array[tuple(first)]} at {place} ({int(bad.sum())} of {bad.size} values are not finite)",
        "repair or crop the file",
    )


def check_range(config: object, low: float, high: float, *names: str):
    """Refuse numbers of a configuration that are not from ``low`` to ``high``; NaN never is.

    Raises:
        UserError: naming the configuration, the first such field, the range and the value.
    """
    for name in names:
        value = getattr(config, name)
        if not low <= value <= high:
            expected = f"{low} or more" if high == math.inf else f"{low} to {high}"
            raise UserError(f"{type(config).__name__}({name})", f"expected {expected}, got {value}")


def check_known(where: str | Path, name: str, known: Iterable[str]):
    """Refuse a name that is not among the known ones.

    Raises:
        UserError: offering the names nearest in spelling, or all of them when none is near.
    """
    known = list(known)
    if name in known:
        return
    near = difflib.get_close_matches(name, known, n=3) or known
    raise UserError(where, f"unknown name {name!r}", f"did you mean {', '.join(near)}?")
