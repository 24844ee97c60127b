"""Reading .npz and .npy files of unknown origin: sizes are checked before memory is taken, and nothing is unpickled.

A header is read as a pattern of words, not as the Python expression that it looks like.
"""

import math
import os
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from refine.formats.untrusted import MAX_ARRAYS, opened
from renderers.checks import UserError

REMEDY = "give an intact .npz file"
MAX_BYTES = MAX_ARRAYS
MAX_MEMBERS = 1024
MAX_DIRECTORY = 1 << 18  # bytes of the list of members
# Motion packs to a half or a tenth, and zeros to a thousandth: what unpacks to much must be much.
MAX_RATIO = 100
SMALL = 1 << 26  # bytes that any archive may unpack to
MAX_HEADER = 10_000
MAX_AXES = 32
CHUNK = 1 << 20
# What an archive ends with, without a comment; the last is there always, the others in large ones.
END_64, LOCATOR, END = struct.Struct("<4sQ2H2L4Q"), struct.Struct("<4sLQL"), struct.Struct("<4s4H2LH")
ITEM = re.compile(r" ?'(\w+)' ?: ?('[^']*'|True|False|\([-\dL, ]*\)|\[[^]]*\]) ?(?:,|$)")
NUMBERS = re.compile(r"[<>|=]?[biufSU]\d{1,9}|[?]")  # the types that are read


def read_npz(
    path: str | Path, keys: tuple[str, ...] | None = None, max_bytes: int = MAX_ARRAYS
) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz file.

    Args:
        keys: read only these, as far as they are there; others are not even opened.
        max_bytes: limit on the unpacked size of what is read.

    Raises:
        UserError: the file is missing, damaged or not .npz, holds Python objects, or claims more than ``max_bytes`` or
            a hundred times its own size.
    """
    with opened(path, max_bytes) as stream:
        try:
            size = check_end(path, stream)
            with zipfile.ZipFile(stream) as packed:
                members = _members(path, packed, keys)
                check_sizes(path, list(members.values()), size, max_bytes)
                arrays = {}
                for name, info in members.items():
                    with packed.open(info) as member:
                        arrays[name] = read_array(f"{path}, array '{name}'", member, info.file_size)
                return arrays
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, zlib.error) as error:
            raise UserError(path, f"is damaged or not an .npz file ({error})", REMEDY) from error
        except (ValueError, struct.error, MemoryError) as error:  # a name that is no text, a field that is cut short
            raise UserError(path, "is damaged or not an .npz file", REMEDY) from error


def read_npy(path: str | Path, max_bytes: int = MAX_ARRAYS) -> np.ndarray:
    """Read the array of an .npy file.

    Raises:
        UserError: the file is missing, damaged or not .npy, holds Python objects, or is larger than ``max_bytes``.
    """
    with opened(path, max_bytes) as stream:
        try:
            return read_array(path, stream, os.fstat(stream.fileno()).st_size)
        except OSError as error:
            raise UserError(path, f"cannot be read ({error.strerror})", "check the disk") from error


def read_array(where: str | Path, stream: BinaryIO, size: int) -> np.ndarray:
    """The array of an .npy stream whose header must account for exactly ``size`` bytes.

    Raises:
        UserError: the header is no header of NumPy's, names another type than numbers and text, or claims another size.
    """
    remedy = "write it with numpy.save or numpy.savez"
    header, start = _header(stream)
    found = dict(ITEM.findall(header[1:-1]))
    whole = header[:1] == "{" and header[-1:] == "}" and not ITEM.sub("", header[1:-1]).strip()
    if not whole or found.keys() != {"descr", "fortran_order", "shape"} or found["shape"][0] != "(":
        raise UserError(where, "is not a NumPy array", remedy)
    code, lengths = found["descr"].strip("'"), re.findall(r"-?\d+", found["shape"])
    if "O" in code:
        raise UserError(where, "holds Python objects, which are never loaded", "save it as numbers or text")
    if not NUMBERS.fullmatch(code):
        raise UserError(where, f"holds {code[:40]}, neither numbers nor text", "save it as numbers or text")
    try:
        kind = np.dtype(code)
    except TypeError as error:
        raise UserError(where, f"is of a type that NumPy does not know ({code})", remedy) from error
    claim = f"claims shape [{', '.join(lengths)[:60]}] of {kind}, which is not what it holds"
    if len(lengths) > MAX_AXES or any(len(length) > 15 or int(length) < 0 for length in lengths):
        raise UserError(where, claim, remedy)
    shape = tuple(map(int, lengths))
    expected = math.prod(shape) * kind.itemsize
    # Empty arrays might have axes of any length, which whoever walks along them would feel.
    vast = math.prod(max(1, length) for length in shape) * max(1, kind.itemsize) > max(size, CHUNK)
    if vast or expected != size - start:
        raise UserError(where, claim, remedy)
    fortran = found["fortran_order"] == "True"
    flat = np.empty(math.prod(shape), kind)
    taken = _fill(stream, flat)
    if taken != expected:
        raise UserError(where, f"holds {taken} of {expected} bytes", remedy)
    if kind.kind == "U" and not is_text(flat):
        raise UserError(where, "holds text that is no Unicode", remedy)
    return flat.reshape(shape, order="F" if fortran else "C")


def is_text(array: np.ndarray) -> bool:
    """Whether an array of type U holds characters alone: other numbers break whatever prints or converts them."""
    if array.nbytes == 0:
        return True
    codes = np.ascontiguousarray(array).reshape(-1).view(array.dtype.byteorder.replace("|", "=") + "u4")
    return bool(codes.max() <= 0x10FFFF and not ((codes >= 0xD800) & (codes <= 0xDFFF)).any())


def _header(stream: BinaryIO) -> tuple[str, int]:
    """The header's text, "" if it is none, and how many bytes stand before the data."""
    width = {b"\x93NUMPY\x01\x00": 2, b"\x93NUMPY\x02\x00": 4, b"\x93NUMPY\x03\x00": 4}.get(stream.read(8), 0)
    length = int.from_bytes(stream.read(width), "little")
    if not width or length > MAX_HEADER:
        return "", 0
    return " ".join(stream.read(length).decode("latin1").split()), 8 + width + length


def _fill(stream: BinaryIO, flat: np.ndarray) -> int:
    """Read the bytes of an array with one axis; returns how many there were."""
    place, taken = memoryview(flat.view(np.uint8)) if flat.nbytes else b"", 0
    while taken < len(place):
        chunk = stream.read(min(CHUNK, len(place) - taken))
        if not chunk:
            break
        place[taken : taken + len(chunk)] = chunk
        taken += len(chunk)
    return taken


def check_end(
    path: str | Path, stream: BinaryIO, max_members: int = MAX_MEMBERS, max_bytes: int = MAX_DIRECTORY
) -> int:
    """Check the records that end a zip archive, before a list of members as long as they claim is read.

    Returns:
        The size of the file.

    Raises:
        UserError: it does not end as an archive without a comment does, or lists more members or bytes than allowed.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - END.size - LOCATOR.size - END_64.size))
    tail = stream.read()
    if len(tail) < END.size:
        raise UserError(path, "is damaged (it is cut short)", "get or write it again")
    magic, disk, _, here, count, length, _, comment = END.unpack(tail[-END.size :])
    locator = tail[-END.size - LOCATOR.size : -END.size]
    if locator.startswith(b"PK\x06\x07") and len(tail) == END.size + LOCATOR.size + END_64.size:
        *_, here, count, length, _ = END_64.unpack(tail[: END_64.size])
        _, _, place, _ = LOCATOR.unpack(locator)
        disk = disk or place != size - len(tail)  # readers differ in where they look for it
    if magic != b"PK\x05\x06" or disk or here != count or comment:
        raise UserError(path, "is damaged (it does not end as an archive does)", "get or write it again")
    if count > max_members or length > max_bytes:
        raise UserError(path, f"holds more than {max_members} arrays, or names too long", "split the file")
    return size


def _members(path: str | Path, packed: zipfile.ZipFile, keys: tuple[str, ...] | None) -> dict[str, zipfile.ZipInfo]:
    """The arrays by name, those of ``keys`` if any are given."""
    members = {}
    for info in packed.infolist():
        name = info.filename.removesuffix(".npy")
        if info.filename.startswith(("/", "\\")) or ".." in re.split(r"[/\\]", info.filename):
            raise UserError(path, f"holds a file named {info.filename[:60]!r}, outside of its own folder", REMEDY)
        if not info.filename.endswith(".npy") or (keys is not None and name not in keys):
            continue
        if name in members:
            raise UserError(path, f"holds two arrays named {name[:60]!r}", REMEDY)
        if info.flag_bits & 1:
            raise UserError(path, "is encrypted", "write it without a password")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise UserError(path, "is packed in another way than by NumPy", "write it with numpy.savez_compressed")
        members[name] = info
    return members


def check_sizes(path: str | Path, members: list[zipfile.ZipInfo], size: int, max_bytes: int = MAX_ARRAYS) -> None:
    """Refuse members that share bytes, reach out of the file or unpack to too much.

    Raises:
        UserError: saying which.
    """
    end = 0
    for info in sorted(members, key=lambda info: info.header_offset):
        if info.header_offset < end or info.header_offset + info.compress_size > size:
            raise UserError(path, "is damaged (what it holds overlaps)", "get or write it again")
        end = info.header_offset + info.compress_size
    unpacked = sum(info.file_size for info in members)
    if unpacked > max_bytes:
        raise UserError(path, f"unpacks to {unpacked} bytes, more than the {max_bytes} allowed", "split the file")
    if unpacked > max(SMALL, MAX_RATIO * size):
        raise UserError(path, f"has {size} bytes and unpacks to {unpacked}, as no numbers do", "get or write it again")
