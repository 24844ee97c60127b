"""The door that every file of unknown origin comes through: what it is, by its content, and its bytes, within limits.

Nothing here follows a link, waits for a device or takes memory before the size is known.
"""

import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from renderers.checks import UserError

# Limits in bytes. A file above its limit is refused unread.
MAX_ARRAYS = 1 << 30  # .npz, .npy: the file and what it unpacks to
MAX_PICKLE = 1 << 29
MAX_MOTION_TEXT = 1 << 28  # BVH, AMC: two hours at 30 frames a second
MAX_MESH = 1 << 28  # GLB
MAX_TABLE = 1 << 24  # CSV and lists in text
MAX_JSON = 1 << 22  # JSON takes up to thirty times its size as Python values

START = 4096  # bytes by which files are told apart
GLTF_WORDS = (b'"asset"', b'"accessors"', b'"bufferViews"')  # which of them comes first is up to the program
BOM = b"\xef\xbb\xbf"
ZIP_MAGIC = (b"PK\x03\x04", b"PK\x05\x06")
PICKLE_STARTS = (b"(dp", b"(lp", b"}q", b"]q", b"ccopy_reg\n", b"cnumpy.core")  # protocols 0 and 1, of Python 2
ACCLAIM = {
    b":fully-specified": "amc",
    b":degrees": "amc",
    b":radians": "amc",
    b":version": "asf",
    b":name": "asf",
    b":units": "asf",
    b":root": "asf",
}
WEB_PAGE = ("is a web page that was saved instead of the file", "sign in where it comes from and get it again")
LFS = ("is a Git LFS pointer, not the file it stands for", "get the file with `git lfs pull`")
UTF_16 = ("is text in UTF-16", "save it as UTF-8")
# What is often taken for a data file, by how it begins, in small letters.
MISTAKEN = {
    b"<!doctype html": WEB_PAGE,
    b"<html": WEB_PAGE,
    b"version https://git-lfs": LFS,
    b"\xff\xfe": UTF_16,
    b"\xfe\xff": UTF_16,
    b"\x1f\x8b": ("is compressed by gzip", "unpack it first"),
    b"bzh9": ("is compressed by bzip2", "unpack it first"),
    b"\xfd7zxz": ("is compressed by xz", "unpack it first"),
    b"\x28\xb5\x2f\xfd": ("is compressed by zstd", "unpack it first"),
    b"7z\xbc\xaf": ("is a 7z archive", "unpack it first"),
    b"rar!": ("is a RAR archive", "unpack it first"),
    b"kaydara fbx": ("is an FBX file, which is not read", "convert it to BVH or GLB, with Blender for example"),
}


@contextmanager
def opened(path: str | Path, max_bytes: int) -> Iterator[BinaryIO]:
    """A regular file with something in it, open for reading, not larger than ``max_bytes``.

    Raises:
        UserError: it is missing, a link, a folder, a device, a pipe or a socket, empty, too large, cannot be read, or
            something that is often mistaken for data, such as a web page.
    """
    path = Path(path)
    try:
        _check_regular(path, os.lstat(path).st_mode)  # before opening: to open a device may already do something
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        stream = os.fdopen(os.open(path, flags), "rb")
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise UserError(path, _reason(error), "check the path") from error
    with stream:
        _check_content(path, stream, max_bytes)
        yield stream


def read_bytes(path: str | Path, max_bytes: int) -> bytes:
    """All bytes of a regular file.

    Raises:
        UserError: see :func:`opened`; or the file grew while it was read.
    """
    with opened(path, max_bytes) as stream:
        size = os.fstat(stream.fileno()).st_size
        try:
            content = stream.read(size + 1)
        except OSError as error:
            raise UserError(path, _reason(error), "check the disk") from error
    if len(content) > size:
        raise UserError(path, "grew while it was read", "wait until it is written")
    return content


def read_json(path: str | Path, max_bytes: int = MAX_JSON, finite: bool = True, unique: bool = False) -> Any:
    """The values of a JSON file in UTF-8.

    Args:
        finite: refuse NaN and infinity, which are no JSON, but which Python writes.
        unique: refuse objects that have a key twice, of which the last would count.

    Raises:
        UserError: see :func:`opened`; or it is no JSON, or nested too deeply.
    """
    return parse_json(path, read_bytes(path, max_bytes), finite, unique)


def parse_json(where: str | Path, content: bytes, finite: bool = True, unique: bool = False) -> Any:
    """As :func:`read_json`, of bytes.

    Raises:
        UserError: it is no JSON, or nested too deeply.
    """
    try:
        return json.loads(
            content.decode("utf-8-sig"),
            parse_constant=_no_number if finite else None,
            object_pairs_hook=partial(_each_once, where) if unique else None,
        )
    except RecursionError as error:
        raise UserError(where, "is nested too deeply", "check what it is") from error
    except ValueError as error:  # of the text, the syntax, or a number of thousands of digits
        raise UserError(where, f"is not JSON ({_reason(error)})", "mend it or write it again") from error


def kind_of(path: str | Path) -> str:
    """What a file holds, by its content: "bvh", "npz" (any zip archive), "npy", "pickle", "amc", "asf", "glb", "gltf",
    "json" (any other), "safetensors", or "" for anything else.

    Raises:
        UserError: it is missing, empty, no regular file, or often mistaken for data, see :func:`opened`.
    """
    with opened(path, max_bytes=1 << 62) as stream:
        return kind_of_start(stream.read(START))


def kind_of_start(start: bytes) -> str:
    """:func:`kind_of` from a file's first ``START`` bytes."""
    for magics, kind in ((ZIP_MAGIC, "npz"), (b"\x93NUMPY", "npy"), (b"glTF", "glb"), (PICKLE_STARTS, "pickle")):
        if start.startswith(magics):
            return kind
    if start[:2] in (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"):
        return "pickle"
    if start[8:9] == b"{" and start[3:8] == bytes(5):  # the length of its header comes first
        return "safetensors"
    text = start.removeprefix(BOM).lstrip()
    if text[:9].upper() == b"HIERARCHY" and not text[9:10].isalnum() and b"\0" not in text:
        return "bvh"
    if text[:1] in (b"{", b"["):
        return "gltf" if any(word in text for word in GLTF_WORDS) else "json"
    return _acclaim(text)


def _acclaim(text: bytes) -> str:
    """The kind by the first word that is no comment."""
    for line in text.splitlines():
        words = line.split()
        if words and not words[0].startswith(b"#"):
            return ACCLAIM.get(words[0].lower(), "")
    return ""


def _check_content(path: Path, stream: BinaryIO, max_bytes: int) -> None:
    """Refuse an open file by its size and its first bytes."""
    status = os.fstat(stream.fileno())
    _check_regular(path, status.st_mode)
    if status.st_size > max_bytes:
        problem = f"has {status.st_size} bytes, more than the {max_bytes} that are read"
        raise UserError(path, problem, "check what it is, or split it")
    try:
        start = stream.peek(START)[:START]
    except OSError as error:
        raise UserError(path, _reason(error), "check the disk") from error
    text = start.removeprefix(BOM).lstrip()
    if status.st_size == 0 or (not text and status.st_size <= START):
        raise UserError(path, "is empty", "get or export it again")
    if not kind_of_start(start):
        for magic, (problem, remedy) in MISTAKEN.items():
            if text[: len(magic)].lower() == magic:
                raise UserError(path, problem, remedy)


def _check_regular(path: Path, mode: int) -> None:
    if stat.S_ISREG(mode):
        return
    if stat.S_ISLNK(mode):
        raise UserError(path, f"is a link to {os.readlink(path)!r}, and links are not followed", "give the file itself")
    kinds = {stat.S_IFDIR: "folder", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket"}
    raise UserError(path, f"is a {kinds.get(stat.S_IFMT(mode), 'device')}, not a file", "give a regular file")


def _reason(error: Exception) -> str:
    """One short line."""
    if isinstance(error, OSError):
        return f"cannot be read ({error.strerror or type(error).__name__})"
    return " ".join(str(error).split())[:100]


def _each_once(where: str | Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise UserError(where, f"has {key!r} twice", "keep one of them")
        found[key] = value
    return found


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")
