"""Reading pickles of unknown origin without running anything in them.

A pickle is a program: it names functions and calls them. Here every name leads to a record that only stores what it is
given (arrays of numbers become arrays), and a name that is not on the list stops the reading. Neither chumpy nor scipy
needs to be installed, and a file written by Python 2 or NumPy 1 reads as well.

What a program may cost is bounded by the size of its file: its steps, and the bytes that its arrays take.
"""

import math
import os
import pickle
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from refine.formats.npz import MAX_AXES, NUMBERS, is_text
from refine.formats.untrusted import MAX_PICKLE, opened
from renderers.checks import UserError

REMEDY = "only numbers, text, lists, dictionaries and NumPy arrays are read; convert the file to .npz"
MAX_LENGTH = 1 << 40  # of an axis
MAX_NAMES = 64  # of classes
STEPS = 300_000  # of any file, and one more for every hundred bytes: HumanAct12 takes 110,000 for 200 MB
SPARE = 1 << 24  # bytes of sets, dictionaries and arrays beyond those of the file
KEYS = (str, bytes, int, float, bool, type(None))


class Inert:
    """An object of a class that is never run: its name, what it was called with, and its state."""

    name = ""
    state: Any = None

    def __init__(self, *args: Any):
        self.args = args


def read_pickle(path: str | Path, max_bytes: int = MAX_PICKLE) -> Any:
    """Read a pickle file; objects of chumpy and scipy.sparse come as `Inert`.

    Raises:
        UserError: the file is missing, larger than ``max_bytes``, damaged, no pickle, holds anything but data, or takes
            more steps or memory than data of its size do.
    """
    with opened(path, max_bytes) as stream:
        try:
            return Unpickler(stream, os.fstat(stream.fileno()).st_size).load()
        except Refused as error:
            raise UserError(path, str(error), REMEDY) from error
        except Exception as error:  # a damaged pickle can fail in every operation of the machine that reads it
            raise UserError(path, "is damaged or not a pickle file", "get it again") from error


class Refused(pickle.UnpicklingError):
    """The file asks for what is never done; the message says it."""


class _Bounded:
    """A file of which nobody can ask more than there is: memory for what is asked is taken before it is read."""

    def __init__(self, stream: BinaryIO, size: int):
        self.stream, self.size, self.readline = stream, size, stream.readline

    def read(self, count: int) -> bytes:
        return self.stream.read(min(count, self.size))


class _Steps(dict):
    """A table of operations that counts how often it is asked."""

    def __init__(self, table: dict[int, Callable], limit: int):
        super().__init__(table)
        self.left = limit

    def __getitem__(self, code: int) -> Callable:
        self.left -= 1
        if self.left < 0:
            raise Refused("takes more steps than data of its size do")
        return super().__getitem__(code)


class _Dtype:
    """``numpy.dtype``, for numbers and text only."""

    def __init__(self, code: str, align: bool = False, copy: bool = False):
        if not isinstance(code, str) or not NUMBERS.fullmatch(code):
            what = repr(code[:40]) if isinstance(code, str) else f"a {type(code).__name__}"
            raise Refused(f"holds an array of type {what}, which is never loaded")
        self.dtype = np.dtype(code)


class _Array(np.ndarray):
    """An array that waits for its shape, type and bytes."""


def _checked(data: Any, kind: Any, shape: Any) -> bytes:
    """The bytes of an array, if there are as many as its shape needs; Python 2 wrote them as text."""
    if not isinstance(kind, _Dtype):
        raise Refused("holds an array without a type")
    if not isinstance(data, str | bytes | bytearray):
        raise Refused("holds an array without bytes")
    axes = type(shape) is tuple and len(shape) <= MAX_AXES
    if not axes or any(type(length) is not int or not 0 <= length <= MAX_LENGTH for length in shape):
        raise Refused("holds an array without a shape")
    data = data.encode("latin1") if isinstance(data, str) else bytes(data)
    if math.prod(shape) * kind.dtype.itemsize != len(data) or (not data and math.prod(filter(None, shape)) > SPARE):
        raise Refused(f"holds an array that claims shape {list(shape)}, but has {len(data)} bytes")
    if kind.dtype.kind == "U" and not is_text(np.frombuffer(data, kind.dtype)):
        raise Refused("holds text that is no Unicode")
    return data


def _check_keys(keys: Iterable[Any]) -> None:
    """Only what is hashed at once: a nested tuple can break the interpreter, and large numbers are made to collide."""
    for key in keys:
        if not isinstance(key, KEYS) or (isinstance(key, int) and key.bit_length() > 63):
            raise Refused("holds keys that are neither words nor plain numbers")


class Unpickler(pickle._Unpickler):
    """The interpreter in Python: the one in C takes memory for whatever size or memo number a file claims.

    Args:
        stream: at the beginning of a pickle.
        size: of the file; bounds what the pickle may cost.
    """

    RECORDS = re.compile(r"(chumpy|scipy\.sparse)\..+")  # the classes whose objects come as `Inert`

    def __init__(self, stream: BinaryIO, size: int):
        super().__init__(_Bounded(stream, size), encoding="latin1")
        table = {code: getattr(type(self), step.__name__) for code, step in pickle._Unpickler.dispatch.items()}
        self.dispatch = _Steps(table, STEPS + size // 100)
        self.bytes_left = 2 * size + SPARE  # protocol 2 makes bytes of text, and arrays of these
        self.records: dict[str, type[Inert]] = {}
        self.functions: dict[str, Callable] = {
            "numpy.dtype": _Dtype,
            "numpy.core.multiarray._reconstruct": lambda _class, _shape, _code: _Array((0,)),
            "numpy.core.multiarray.scalar": self.scalar,
            "numpy.core.numeric._frombuffer": self.array,
            "_codecs.encode": self.latin1,
            "copyreg._reconstructor": self.new_inert,
            "builtins.set": self.set_of,
            "builtins.frozenset": lambda items=(): frozenset(self.set_of(items)),
            "builtins.bytes": lambda: b"",  # protocols before 3 write only the empty ones this way
            "collections.OrderedDict": self.dictionary,
        }

    def find_class(self, module: str, name: str) -> Any:
        module = {"copy_reg": "copyreg", "__builtin__": "builtins"}.get(module, module)
        full = f"{module}.{name}".replace("numpy._core.", "numpy.core.", 1)
        if full in self.functions:
            return self.functions[full]
        if full in ("numpy.ndarray", "builtins.object"):
            return full  # only ever handed to functions that ignore it
        if full not in self.records and self.RECORDS.fullmatch(full):
            if len(self.records) == MAX_NAMES or len(full) > 200:
                raise Refused("names too many classes")
            self.records[full] = type("Record", (Inert,), {"name": full})
        if full in self.records:
            return self.records[full]
        raise Refused(f"asks for {full[:100]}, which is not on the list of harmless names")

    def charge(self, count: int) -> None:
        """Count bytes that are made from others: one text in the file may be used a thousand times."""
        self.bytes_left -= count
        if self.bytes_left < 0:
            raise Refused("takes more memory than data of its size do")

    def bytes_of(self, data: Any, kind: Any, shape: Any) -> bytes:
        data = _checked(data, kind, shape)
        self.charge(len(data))
        return data

    def array(self, data: Any, kind: Any, shape: Any, order: str) -> np.ndarray:
        return np.frombuffer(self.bytes_of(data, kind, shape), kind.dtype).reshape(shape, order=order)

    def scalar(self, kind: Any, data: Any) -> np.generic:
        return np.frombuffer(self.bytes_of(data, kind, ()), kind.dtype)[0]

    def latin1(self, text: str, _codec: str) -> bytes:
        self.charge(len(text))
        return text.encode("latin1")

    def new_inert(self, cls: Any, _base: Any, _state: Any) -> Inert:
        """What ``copyreg._reconstructor`` does, for inert objects alone."""
        return self.record(cls, ())

    def record(self, cls: Any, args: Iterable[Any]) -> Inert:
        if not (isinstance(cls, type) and issubclass(cls, Inert)):
            raise Refused("holds an object that is not data")
        return cls(*args)

    def set_of(self, items: Any = ()) -> set:
        self.charge(64 * len(items))
        _check_keys(items)
        return set(items)

    def dictionary(self, pairs: Any = ()) -> dict:
        self.charge(128 * len(pairs))
        _check_keys(key for key, _ in pairs)
        return dict(pairs)

    def _instantiate(self, cls: Any, args: list) -> None:  # what INST and OBJ do
        self.append(self.record(cls, args))

    def load_newobj(self) -> None:
        args = self.stack.pop()
        self.append(self.record(self.stack.pop(), args))

    def load_reduce(self) -> None:
        if not callable(self.stack[-2]):
            raise Refused("calls what is no function")
        super().load_reduce()

    def load_build(self) -> None:
        state = self.stack.pop()
        match self.stack[-1]:
            case Inert() as record:
                record.state = state
            case _Dtype() as kind:
                kind.dtype = kind.dtype.newbyteorder(state[1])
            case _Array() as array:
                *_, shape, kind, fortran_order, data = state
                data = self.bytes_of(data, kind, shape)
                array.__setstate__((1, shape, kind.dtype, bool(fortran_order), data))
            case _:  # such as a function, whose attributes it would change
                raise Refused("changes an object that is not data")

    def load_dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self.set_items(items)

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self.set_items([key, value])

    def load_setitems(self) -> None:
        self.set_items(self.pop_mark())

    def set_items(self, items: list) -> None:
        if type(self.stack[-1]) is not dict:
            raise Refused("changes an object that is not data")
        _check_keys(items[::2])
        self.stack[-1].update(zip(items[::2], items[1::2], strict=True))

    def load_frozenset(self) -> None:
        items = self.pop_mark()
        self.append(frozenset(self.set_of(items)))

    def load_additems(self) -> None:
        items = self.pop_mark()
        if type(self.stack[-1]) is not set:
            raise Refused("changes an object that is not data")
        self.stack[-1].update(self.set_of(items))

    def load_long4(self) -> None:
        raise Refused("holds a number of more than 255 bytes")

    def load_bytearray8(self) -> None:
        self.append(bytearray(self.read(int.from_bytes(self.read(8), "little"))))
