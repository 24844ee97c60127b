"""What an examination finds, as values."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

DISTRIBUTION = "refine-motion"
REINSTALL = f"install it anew: pip install --force-reinstall {DISTRIBUTION}"


@dataclass(frozen=True)
class Finding:
    """One thing that was tried."""

    about: str
    """Under which heading it stands."""
    name: str
    state: Literal["ok", "missing", "broken"]
    found: str
    """What there is, in a few words."""
    remedy: str = ""
    """What to do if it is not ok."""
    needed: bool = True
    """Whether Refine does its main job only with it."""
    values: dict[str, Any] = field(default_factory=dict)
    """For programs."""


def healthy(findings: Sequence[Finding]) -> bool:
    """Whether all that is needed works."""
    return all(each.state == "ok" for each in findings if each.needed)


def size(count: int) -> str:
    """A number of bytes in words: 1536 is 1.5 KiB."""
    value = float(count)
    for unit in ("bytes", "KiB", "MiB"):
        if value < 1024:
            return f"{value:.0f} {unit}" if unit == "bytes" else f"{value:.1f} {unit}"
        value /= 1024
    return f"{value:.1f} GiB"
