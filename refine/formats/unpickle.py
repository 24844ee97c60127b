"""Reading pickles of unknown origin without running anything in them.

A pickle is a program: it names functions and calls them. Here every name leads to a record that only stores what it is
given (arrays of numbers become arrays), and a name that is not on the list stops the reading. Neither chumpy nor scipy
needs to be installed, and a file written by Python 2 or NumPy 1 reads as well.
"""

import io
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from renderers.checks import UserError

MAX_BYTES = 1 << 29
REMEDY = "only numbers, text, lists, dictionaries and NumPy arrays are read; convert the file to .npz"
NUMBERS = "biufSU"


class Inert:
    """An object of a class that is never run: its name, what it was called with, and its state."""

    name = ""
    state: Any = None

    def __init__(self, *args: Any):
        self.args = args

    def __setstate__(self, state: Any):
        self.state = state


def read_pickle(path: str | Path, max_bytes: int = MAX_BYTES) -> Any:
    """Read a pickle file; objects of chumpy and scipy.sparse come as `Inert`.

    Raises:
        UserError: the file is missing, larger than ``max_bytes``, damaged, no pickle, or holds anything but data.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise UserError(path, f"has {size} bytes, more than the {max_bytes} allowed", "check the file")
        return _Unpickler(io.BytesIO(path.read_bytes()), encoding="latin1").load()
    except UserError:
        raise
    except FileNotFoundError as error:
        raise UserError(path, "does not exist", "check the path") from error
    except _Refused as error:
        raise UserError(path, str(error), REMEDY) from error
    except Exception as error:  # a damaged pickle can fail in every operation of the machine that reads it
        raise UserError(path, "is damaged or not a pickle file", "download it again") from error


class _Refused(pickle.UnpicklingError):
    pass


class _Dtype:
    """``numpy.dtype``, for numbers and text only."""

    def __init__(self, code: str, align: bool = False, copy: bool = False):
        self.dtype = np.dtype(code)
        if self.dtype.kind not in NUMBERS:
            raise _Refused(f"holds an array of type {code!r}, which is never loaded")

    def __setstate__(self, state: tuple):
        self.dtype = self.dtype.newbyteorder(state[1])


class _Array(np.ndarray):
    """An array whose shape, type and bytes are checked against each other before NumPy sees them."""

    def __setstate__(self, state: tuple):
        *_, shape, kind, fortran_order, data = state
        data = _checked(data, kind, shape)
        super().__setstate__((1, tuple(shape), kind.dtype, bool(fortran_order), data))


def _checked(data: Any, kind: _Dtype, shape: tuple) -> bytes:
    """The bytes of an array, if there are as many as its shape needs; Python 2 wrote them as text."""
    if not isinstance(kind, _Dtype):
        raise _Refused("holds an array without a type")
    data = data.encode("latin1") if isinstance(data, str) else bytes(data)
    if min(shape, default=0) < 0 or math.prod(shape) * kind.dtype.itemsize != len(data):
        raise _Refused(f"holds an array that claims shape {list(shape)}, but has {len(data)} bytes")
    return data


def _empty_array(_cls: type, _shape: tuple, _code: bytes) -> np.ndarray:
    return _Array((0,))


def _array_from_buffer(data: Any, kind: _Dtype, shape: tuple, order: str) -> np.ndarray:
    return np.frombuffer(_checked(data, kind, shape), kind.dtype).reshape(shape, order=order)


def _scalar(kind: _Dtype, data: Any) -> np.generic:
    return np.frombuffer(_checked(data, kind, ()), kind.dtype)[0]


def _latin1(text: str, _codec: str) -> bytes:
    return text.encode("latin1")


def _empty_bytes() -> bytes:
    return b""


def _new_inert(cls: type, _base: type, _state: Any) -> Inert:
    """What ``copyreg._reconstructor`` does, for inert objects alone."""
    if not issubclass(cls, Inert):
        raise _Refused("holds an object that is not data")
    return cls()


_ALLOWED = {
    "numpy.dtype": _Dtype,
    "numpy.ndarray": _Array,
    "numpy.core.multiarray._reconstruct": _empty_array,
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _array_from_buffer,
    "_codecs.encode": _latin1,
    "copyreg._reconstructor": _new_inert,
    "builtins.object": object,
    "builtins.set": set,
    "builtins.frozenset": frozenset,
    "builtins.bytes": _empty_bytes,  # protocols before 3 write only the empty ones this way
    "collections.OrderedDict": dict,
}
_RENAMED = {"copy_reg": "copyreg", "__builtin__": "builtins"}


class _Unpickler(pickle._Unpickler):
    """The interpreter in Python: the one in C takes memory for whatever size or memo number a file claims."""

    def find_class(self, module: str, name: str) -> Any:
        module = _RENAMED.get(module, module).replace("numpy._core", "numpy.core")
        full = f"{module}.{name}"
        if full in _ALLOWED:
            return _ALLOWED[full]
        if module.startswith(("chumpy.", "scipy.sparse.")):
            return type(name, (Inert,), {"name": full})
        raise _Refused(f"asks for {full}, which is not on the list of harmless names")

    def load_build(self):
        # On anything else than an instance, BUILD would change attributes of the functions above.
        if not isinstance(self.stack[-2], Inert | _Array | _Dtype):
            raise _Refused("changes an object that is not data")
        super().load_build()

    dispatch = {**pickle._Unpickler.dispatch, pickle.BUILD[0]: load_build}  # noqa: RUF012 - as in the base class
