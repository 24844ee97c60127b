"""What a hostile file is: a name, what reads it, what it tries, how it is made. The modules beside make the list."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

HARMED = "harmed"  # what code in a file would leave beside it


@dataclass(frozen=True)
class Case:
    """A hostile file.

    Attributes:
        reader: "motion", "body", "weights", "labels", "mapping" or "json": what is asked to read it.
        tries: what it would do to a careless reader.
        make: writes it into an empty folder; returns its path.
    """

    name: str
    reader: str
    tries: str
    make: Callable[[Path], Path]


CASES: dict[str, Case] = {}


def hostile(tries: str, suffix: str = "", reader: str = "motion") -> Callable:
    """Put a file on the list. What is decorated returns the bytes of a file with the suffix, or, without a suffix, is
    given a folder and returns the path of what it made there."""

    def register(make: Callable) -> Callable:
        def in_folder(folder: Path) -> Path:
            if not suffix:
                return make(folder)
            path = folder / f"{make.__name__}{suffix}"
            content = make()
            path.write_bytes(content.encode() if isinstance(content, str) else content)
            return path

        assert make.__name__ not in CASES
        CASES[make.__name__] = Case(make.__name__, reader, tries, in_folder)
        return make

    return register
