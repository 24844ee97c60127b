"""The six parts of the body that a description can be about (SINC), and what says so."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from renderers.checks import UserError

BODY_PARTS = ("global", "torso", "left arm", "right arm", "left leg", "right leg")  # in the paper's order


class Parts(NamedTuple):
    """For each of ``BODY_PARTS``, whether it is one of those that an action is about."""

    whole: bool  # "global": travel and global orientation
    torso: bool
    left_arm: bool
    right_arm: bool
    left_leg: bool
    right_leg: bool

    @classmethod
    def of(cls, names: Iterable[str]) -> "Parts":
        """The parts of those names.

        Raises:
            UserError: one is no part's name.
        """
        chosen = set(names)
        for name in sorted(chosen - set(BODY_PARTS)):
            raise UserError("Parts", f"{name!r} is no part of the body", f"choose among {', '.join(BODY_PARTS)}")
        return cls(*(name in chosen for name in BODY_PARTS))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, about in zip(BODY_PARTS, self, strict=True) if about)

    def mirrored(self) -> "Parts":
        """Left and right exchanged."""
        whole, torso, left_arm, right_arm, left_leg, right_leg = self
        return Parts(whole, torso, right_arm, left_arm, right_leg, left_leg)


@dataclass(frozen=True)
class Labelled:
    """What a labeller says of a phrase."""

    phrase: str
    parts: Parts
    by: str
    """Which labeller."""
    why: str = ""
    """One line for people."""
    unknown: tuple[str, ...] = ()
    """Words that it does not know."""


class Labeller(Protocol):
    """Says which parts phrases are about."""

    def __call__(self, phrases: Sequence[str]) -> list[Labelled]: ...
