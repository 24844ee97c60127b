"""A clip with words: the value that text-to-motion learns from."""

from dataclasses import dataclass
from typing import Literal

from refine.motion import Motion
from renderers.checks import UserError

Split = Literal["train", "val", "test"]


@dataclass(frozen=True, eq=False)
class Described:
    """One clip and what people say that it shows.

    Attributes:
        motion: the clip.
        phrasings: ways to say it. Each names the actions that happen at once: ("walk forwards",) for a single action,
            ("walk forwards", "wave") for a pair. All of a clip's phrasings name equally many.
        key: its name in the set, which no other clip has.
        split: what it is used for.

    Raises:
        UserError: there is no phrasing, one is empty, or they name different numbers of actions.
    """

    motion: Motion
    phrasings: tuple[tuple[str, ...], ...]
    key: str
    split: Split = "train"

    def __post_init__(self):
        counts = {len(phrasing) for phrasing in self.phrasings}
        if len(counts) != 1 or counts == {0}:
            raise UserError(self.key, "phrasings must name actions, all equally many", f"got {self.phrasings!r}")
        if not all(text.strip() for phrasing in self.phrasings for text in phrasing):
            raise UserError(self.key, "has an empty description", "say what the clip shows")

    @property
    def actions(self) -> int:
        """How many happen at once."""
        return len(self.phrasings[0])
