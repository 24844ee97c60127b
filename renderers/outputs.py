"""Files and folders that are there whole or not at all: written beside their place, then renamed."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from renderers.checks import UserError


def refuse_existing(path: str | Path, force: bool = False, folder: bool = False) -> None:
    """Refuse, before any work is done, an output that is already there or could not be written after it.

    Args:
        force: a file may replace a file, and a folder a folder.
        folder: the output is a folder; one that is empty counts as not there.

    Raises:
        UserError: the output is there and ``force`` is not set, a file stands where a folder is needed or the other way
            round, nothing may be written there, or the path ends in no name (".").
    """
    path = Path(path)
    if not path.name or path.name == "..":
        raise UserError(path, "is no name for an output", f"name a new {'folder' if folder else 'file'}")
    if path.exists():
        if path.is_dir() != folder:
            raise UserError(path, "is a file" if folder else "is a folder", "choose another name")
        if not force and not (folder and not any(path.iterdir())):
            raise UserError(path, "is already there", "choose another name or pass --force to replace it")
    check_place(path)


def check_place(path: str | Path) -> None:
    """Refuse a path beside which nothing can be written; missing folders on the way are no obstacle.

    Raises:
        UserError: naming what is in the way.
    """
    nearest = next(parent for parent in Path(path).absolute().parents if parent.exists())
    if not nearest.is_dir():
        raise UserError(path, f"cannot be written ({nearest} is a file)", "choose another place")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise UserError(path, f"cannot be written (no permission to write in {nearest})", "choose another place")


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write a file to; it takes the name when the block ends well and is removed if not."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise UserError(path, f"cannot be written ({error.strerror or error})", "choose another place") from error
    finally:
        if partial.exists():
            partial.unlink()


@contextmanager
def replacing_folder(path: str | Path) -> Iterator[Path]:
    """As :func:`replacing` for a folder: an older folder of that name gives way only to a complete new one."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    older = path.with_name(f".{path.name}.{os.getpid()}.old")
    try:
        partial.mkdir(parents=True)
        yield partial
        if path.exists():
            os.replace(path, older)
        os.replace(partial, path)
    except OSError as error:
        raise UserError(path, f"cannot be written ({error.strerror or error})", "choose another place") from error
    finally:
        if older.exists() and not path.exists():
            os.replace(older, path)
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(older, ignore_errors=True)
