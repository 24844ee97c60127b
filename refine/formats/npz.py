"""Reading .npz files of unknown origin: sizes are checked before memory is taken, and nothing is ever unpickled."""

import math
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from renderers.checks import UserError

MAX_BYTES = 1 << 30
REMEDY = "give an intact .npz file"


def read_npz(
    path: str | Path, keys: tuple[str, ...] | None = None, max_bytes: int = MAX_BYTES
) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz file.

    Args:
        keys: read only these, as far as they are there; others are not even opened.
        max_bytes: limit on the unpacked size of what is read.

    Raises:
        UserError: the file is missing, damaged or not .npz, holds Python objects, or claims more than ``max_bytes``.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            members = {
                info.filename.removesuffix(".npy"): info
                for info in packed.infolist()
                if info.filename.endswith(".npy") and (keys is None or info.filename.removesuffix(".npy") in keys)
            }
            size = sum(info.file_size for info in members.values())
            if size > max_bytes:
                raise UserError(path, f"unpacks to {size} bytes, more than the {max_bytes} allowed", "split the file")
            arrays = {}
            for name, info in members.items():
                with packed.open(info) as stream:
                    arrays[name] = _read_array(f"{path}, array '{name}'", stream, info.file_size)
            return arrays
    except FileNotFoundError as error:
        raise UserError(path, "does not exist", "check the path") from error
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, zlib.error) as error:
        raise UserError(path, f"is damaged or not an .npz file ({error})", REMEDY) from error


def _read_array(where: str, stream: IO[bytes], size: int) -> np.ndarray:
    """One .npy member whose header must account for exactly ``size`` bytes."""
    try:
        version = npy.read_magic(stream)
        read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, fortran_order, dtype = read_header(stream)
    except (ValueError, KeyError) as error:
        raise UserError(where, "is not a NumPy array", REMEDY) from error
    if dtype.hasobject:
        raise UserError(where, "holds Python objects, which are never loaded", "save it as numbers or text")
    expected = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or expected != size - stream.tell():
        raise UserError(where, f"claims shape {list(shape)} of {dtype}, which is not what it holds", REMEDY)
    data = stream.read(expected)
    if len(data) != expected:
        raise UserError(where, f"holds {len(data)} of {expected} bytes", REMEDY)
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran_order else "C").copy()
