"""The door that every file of unknown origin comes through: what it is, by its content, before anything is read."""

from pathlib import Path

from renderers.checks import UserError

ZIP_MAGIC = b"PK\x03\x04"


def kind_of(path: str | Path) -> str:
    """What a file holds: "bvh" or "npz"; "" for anything else.

    Raises:
        UserError: it is missing, empty, or cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(64)
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not start.strip():
        raise UserError(path, "is empty", "give a motion file")
    if start.startswith(ZIP_MAGIC):
        return "npz"
    if b"HIERARCHY" in start.upper() or path.suffix.lower() == ".bvh":
        return "bvh"
    return ""
