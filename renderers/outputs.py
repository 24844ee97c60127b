"""Files and folders that are there whole or not at all: written beside their place, then renamed."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from renderers.checks import UserError


def refuse_existing(path: str | Path, force: bool = False) -> None:
    """Refuse an output that is already there: a file, or a folder with something in it.

    Raises:
        UserError: it is there and ``force`` is not set, or it is a folder where a file is asked for with ``force``.
    """
    path = Path(path)
    if path.is_dir() and not any(path.iterdir()):
        return
    if path.exists() and not force:
        raise UserError(path, "is already there", "choose another name or pass --force to replace it")


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
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(older, ignore_errors=True)
