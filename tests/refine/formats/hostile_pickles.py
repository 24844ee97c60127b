"""Pickles that run code, or that make much of little. HumanAct12's file is one, and so are bodies and checkpoints."""

import pickle
import struct

import numpy as np
from hostile_cases import hostile

PROTO = b"\x80\x02"
TOUCH = b"open('harmed', 'w')"


def text(value: str) -> bytes:
    return b"X" + struct.pack("<L", len(value.encode())) + value.encode()


def number(value: int) -> bytes:
    return b"\x8a\x09" + value.to_bytes(9, "little", signed=True)


def dtype(code: str = "u1") -> bytes:
    return b"cnumpy\ndtype\n" + text(code) + b"K\x00K\x01\x87R"


def actions(poses: bytes = b"]", joints: bytes = b"]", y: bytes = b"]") -> bytes:
    """HumanAct12's dictionary of three lists."""
    return PROTO + b"}(" + text("poses") + poses + text("joints3D") + joints + text("y") + y + b"u."


def body(**arrays: bytes) -> bytes:
    return PROTO + b"}(" + b"".join(text(name) + value for name, value in arrays.items()) + b"u."


def record(module: str, name: str, **state: bytes) -> bytes:
    """An object with a state, as protocol 2 makes it."""
    items = b"".join(text(key) + value for key, value in state.items())
    return f"c{module}\n{name}\n".encode() + b")\x81}(" + items + b"ub"


def as_array(values) -> bytes:
    return pickle.dumps(np.asarray(values), protocol=3)[2:-1]


# --- code -------------------------------------------------------------------------------------------------------------


@hostile("runs a command", ".pkl")
def os_system() -> bytes:
    return PROTO + b"cos\nsystem\n" + text("touch harmed") + b"\x85R."


@hostile("runs Python", ".pkl")
def builtins_eval() -> bytes:
    return b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93\x8c" + bytes([len(TOUCH)]) + TOUCH + b"\x85R."


@hostile("runs a command by the oldest instruction", ".pkl", "body")
def inst() -> bytes:
    return b"(S'touch harmed'\nios\nsystem\n."


@hostile("runs a command by an instruction for objects", ".pkl")
def obj() -> bytes:
    return PROTO + b"(cposix\nsystem\n" + text("touch harmed") + b"o."


@hostile("runs a command after its data, which are intact", ".pkl")
def late_code() -> bytes:
    return actions(y=b"cos\nsystem\n" + text("touch harmed") + b"\x85R")


@hostile("has NumPy unpickle another file", ".pkl")
def numpy_load() -> bytes:
    return PROTO + b"cnumpy\nload\n" + text("other.npy") + b"N\x88\x87R."


@hostile("has NumPy run text", ".pkl")
def run_string() -> bytes:
    return PROTO + b"cnumpy.testing._private.utils\nrunstring\n" + text(TOUCH.decode()) + b"}\x86R."


@hostile("reaches for a function through an allowed module, and calls it", ".pkl", "body")
def dotted_name() -> bytes:
    return b"\x80\x04\x8c\x06chumpy\x8c\x0cch.os.system\x93" + text("touch harmed") + b"\x85R."


@hostile("reaches into the attributes of an allowed name", ".pkl")
def attributes() -> bytes:
    name = "dtype.__class__.__base__.__subclasses__"
    return b"\x80\x04\x8c\x05numpy\x8c" + bytes([len(name)]) + name.encode() + b"\x93)R."


@hostile("changes the defaults of a function of the reader", ".pkl")
def defaults() -> bytes:
    return PROTO + b"c_codecs\nencode\n}(" + text("__defaults__") + b"K\x01\x85ub."


@hostile("asks the reader to load something by a name of its own", ".pkl", "body")
def persistent() -> bytes:
    return b"Pharmed\n."


@hostile("asks for a registered extension", ".pkl")
def extension() -> bytes:
    return PROTO + b"\x82\x01."


@hostile("has a line break and control characters in the name it asks for", ".pkl")
def name_with_a_line_break() -> bytes:
    return b"\x80\x04\x8c\x02os\x8c\x0esys\n\x1b[2J\r\ntem\x07\x93."


# --- size -------------------------------------------------------------------------------------------------------------


@hostile("asks for an array of eight gigabytes that are not there", ".pkl")
def ndarray() -> bytes:
    return PROTO + b"cnumpy\nndarray\n" + number(10**9) + b"\x85\x85R."


@hostile("gives a number for an array's bytes, which makes that many zeros", ".pkl")
def counted_bytes() -> bytes:
    shape = number(4_000_000_000) + b"\x85"
    return PROTO + b"cnumpy.core.numeric\n_frombuffer\n(" + number(4_000_000_000) + dtype() + shape + text("C") + b"tR."


@hostile("claims four gigabytes for bytes that may be changed", ".pkl")
def bytearray8() -> bytes:
    return b"\x80\x05\x96" + struct.pack("<Q", 4_000_000_000) + b"ab."


@hostile("claims an exabyte for a text", ".pkl")
def long_text() -> bytes:
    return b"\x80\x04\x8d" + struct.pack("<Q", 1 << 60) + b"ab."


@hostile("claims an exabyte for a frame", ".pkl")
def frame() -> bytes:
    return b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N."


@hostile("makes a thousand arrays of one text of a megabyte", ".pkl")
def reused_bytes() -> bytes:
    one = b"cnumpy.core.numeric\n_frombuffer\n(h\x00h\x01" + number(1 << 20) + b"\x85" + text("C") + b"tR"
    start = b"C\x00" + b"0" + b"B" + struct.pack("<L", 1 << 20) + bytes(1 << 20) + b"q\x000" + dtype() + b"q\x010"
    return b"\x80\x03" + start + b"](" + one * 1000 + b"e."


@hostile("encodes one text of a megabyte a thousand times", ".pkl")
def reused_text() -> bytes:
    start = text("x" * (1 << 20)) + b"q\x000c_codecs\nencode\nq\x010" + text("latin1") + b"q\x020"
    return PROTO + start + b"](" + b"h\x01h\x00h\x02\x86R" * 1000 + b"e."


@hostile("makes three thousand sets of one list of ten thousand numbers", ".pkl")
def reused_set() -> bytes:
    numbers = b"".join(b"J" + struct.pack("<l", value) for value in range(10_000))
    return PROTO + b"](" + numbers + b"eq\x000cbuiltins\nset\nq\x010](" + b"h\x01h\x00\x85R" * 3000 + b"e."


@hostile("takes two million steps and makes nothing", ".pkl")
def steps() -> bytes:
    return PROTO + b"N0" * 1_000_000 + b"N."


@hostile("makes a million empty dictionaries", ".pkl")
def dictionaries() -> bytes:
    return PROTO + b"](" + b"}" * 1_000_000 + b"e."


@hostile("names 20,000 classes", ".pkl")
def classes() -> bytes:
    return PROTO + b"](" + b"".join(b"cchumpy.ch\nC%d\n" % number for number in range(20_000)) + b"e."


@hostile("has 250,000 tuples in each other for a key, which breaks the interpreter", ".pkl")
def nested_key() -> bytes:
    return PROTO + b"})" + b"\x85" * 250_000 + b"K\x01s."


@hostile("has 60,000 keys that all hash alike", ".pkl")
def colliding_keys() -> bytes:
    prime = (1 << 61) - 1
    keys = b"".join(b"\x8a\x0b" + (prime * value).to_bytes(11, "little") + b"N" for value in range(1, 60_000))
    return PROTO + b"}(" + keys + b"u."


@hostile("has a number of a megabyte for a key", ".pkl")
def long_number() -> bytes:
    return PROTO + b"}(\x8b" + struct.pack("<l", 1 << 20) + b"\x7f" * (1 << 20) + b"Nu."


@hostile("has a number of 100,000 decimal digits", ".pkl", "body")
def decimal_number() -> bytes:
    return b"(lp0\nL" + b"9" * 100_000 + b"L\na."


@hostile("has a shape of 30,000 long numbers to multiply", ".pkl")
def long_shape() -> bytes:
    numbers = (b"\x8a\xff" + b"\x7f" * 255) * 30_000
    return (
        PROTO + b"cnumpy.core.numeric\n_frombuffer\n(" + text("") + dtype() + b"(" + numbers + b"t" + text("C") + b"tR."
    )


@hostile("has an array of objects", ".pkl")
def object_type() -> bytes:
    return pickle.dumps({"poses": np.array([{}, []], dtype=object)}, protocol=2)


@hostile("has an array of records with objects in them", ".pkl")
def record_type() -> bytes:
    return actions(dtype("f8,O"))


@hostile("has a list for a type, which NumPy would read as a table", ".pkl")
def listed_type() -> bytes:
    return actions(b"cnumpy\ndtype\n](" + text("a") + b"e\x85R")


@hostile("has text of code points that are none", ".pkl")
def wrong_text() -> bytes:
    return actions(as_array(np.array(["ab"])).replace(b"a\0\0\0b\0\0\0", b"\xff" * 8))


@hostile("refers to a place in its memory that is empty", ".pkl")
def empty_memory() -> bytes:
    return PROTO + b"j\xff\xff\xff\xff."


@hostile("takes from a stack that is empty", ".pkl")
def empty_stack() -> bytes:
    return PROTO + b"0000tR."


@hostile("is cut", ".pkl")
def cut_pickle() -> bytes:
    return actions(as_array(np.arange(100.0)))[:-50]


# --- data that mislead ------------------------------------------------------------------------------------------------


@hostile("has a class that is two lists, each twice the one before, forty deep", ".pkl")
def laughs() -> bytes:
    doubled = b"]" + b"q\x000](h\x00h\x00e" * 40
    poses, joints = as_array(np.zeros((1, 72))), as_array(np.zeros((1, 24, 3)))
    return actions(b"](" + poses + b"e", b"](" + joints + b"e", b"](" + doubled + b"e")


@hostile("has poses that contain themselves", ".pkl")
def endless() -> bytes:
    return PROTO + b"](]q\x00h\x00ae0" + actions(b"]q\x00h\x00a", b"]q\x01h\x01a", b"]q\x02h\x02a")[2:]


@hostile("has angles of NaN", ".pkl")
def nan_pickle() -> bytes:
    poses, joints = as_array(np.full((1, 72), np.nan)), as_array(np.zeros((1, 24, 3)))
    return actions(b"](" + poses + b"e", b"](" + joints + b"e", b"](K\x01e")


@hostile("has a class that is not among the twelve", ".pkl")
def unknown_class() -> bytes:
    poses, joints = as_array(np.zeros((1, 72))), as_array(np.zeros((1, 24, 3)))
    return actions(b"](" + poses + b"e", b"](" + joints + b"e", b"](J\xff\xff\xff\x7fe")


@hostile("has arrays in arrays of chumpy, 20,000 deep", ".pkl", "body")
def nested_arrays() -> bytes:
    deep = b"cchumpy.ch\nCh\nq\x000" + text("x") + b"q\x010N" + b"q\x020h\x00)\x81}h\x01h\x02sb" * 20_000
    return body(v_template=deep)


@hostile("has an array of chumpy that contains itself", ".pkl", "body")
def endless_array() -> bytes:
    return body(v_template=b"cchumpy.ch\nCh\n)\x81q\x00}" + text("x") + b"h\x00sb")


@hostile("picks elements by lists that double forty times", ".pkl", "body")
def doubled_choice() -> bytes:
    doubled = b"]" + b"q\x000](h\x00h\x00e" * 40
    return body(
        shapedirs=record("chumpy.reordering", "Select", a=as_array(np.zeros(3)), idxs=doubled, preferred_shape=b")")
    )


@hostile("has a sparse matrix whose counts ask for terabytes", ".pkl", "body")
def sparse_counts() -> bytes:
    starts = as_array(np.array([0, *[10**12] * 24]))
    arrays = {"data": as_array(np.ones(3)), "indices": as_array(np.zeros(3, np.int64)), "indptr": starts}
    return body(J_regressor=record("scipy.sparse.csr", "csr_matrix", _shape=b"K\x18K\x3c\x86", **arrays))


@hostile("has a sparse matrix of a terabyte", ".pkl", "body")
def sparse_shape() -> bytes:
    arrays = {name: as_array(np.zeros(1, np.int64)) for name in ("data", "indices", "indptr")}
    return body(J_regressor=record("scipy.sparse.csc", "csc_matrix", _shape=number(10**6) * 2 + b"\x86", **arrays))


@hostile("has parents of NaN in a body", ".pkl", "body")
def nan_parents() -> bytes:
    arrays = {"v_template": (60, 3), "shapedirs": (60, 3, 10), "posedirs": (60, 3, 207), "J_regressor": (24, 60)}
    arrays = {name: np.zeros(shape) for name, shape in (arrays | {"weights": (60, 24), "f": (100, 3)}).items()}
    return pickle.dumps(arrays | {"kintree_table": np.full((2, 24), np.nan)}, protocol=2)


@hostile("has a body of numbers that overflow", ".pkl", "body")
def large_body() -> bytes:
    arrays = {"v_template": (60, 3), "shapedirs": (60, 3, 10), "posedirs": (60, 3, 207), "J_regressor": (24, 60)}
    arrays = {name: np.full(shape, 1e308) for name, shape in (arrays | {"weights": (60, 24)}).items()}
    return pickle.dumps(arrays | {"f": np.zeros((9, 3)), "kintree_table": np.zeros((2, 24))}, protocol=2)
