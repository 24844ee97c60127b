"""Pickles as other tools write them, and pickles that were written to do harm."""

import pickle
import struct

import numpy as np
import pytest

from refine.formats.unpickle import Inert, read_pickle
from renderers.checks import UserError

ARRAYS = {
    "float": np.arange(6, dtype=np.float64).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
    "big_endian": np.arange(3, dtype=">i4"),
    "text": np.array(["walk", "wave"]),
    "empty": np.zeros((0, 3)),
    "scalar": np.float32(1.5),
    "flag": np.bool_(True),
}


@pytest.fixture
def written(tmp_path):
    """Write bytes to a file and give its path."""

    def write(content: bytes):
        path = tmp_path / "file.pkl"
        path.write_bytes(content)
        return path

    return write


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_data_of_every_protocol_comes_back(written, protocol):
    data = {"y": [1, 2.5, "a", None, True], "set": {1, 2}, **ARRAYS}
    read = read_pickle(written(pickle.dumps(data, protocol=protocol)))
    assert read["y"] == data["y"] and read["set"] == data["set"]
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(np.asarray(read[name]), array)
        assert np.asarray(read[name]).dtype.newbyteorder("=") == array.dtype.newbyteorder("=")


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_large_arrays_of_every_protocol_come_back(written, protocol, monkeypatch):
    monkeypatch.setattr("refine.formats.unpickle.SPARE", 10_000)
    for array in (np.zeros((50_000, 3)), np.random.default_rng(0).random((50_000, 3))):
        np.testing.assert_array_equal(read_pickle(written(pickle.dumps([array, array[:9]], protocol)))[0], array)


def test_arrays_as_python_2_wrote_them_come_back(written):
    """Protocol 2 of Python 2 with NumPy 1: bytes are text, and modules have their old names."""
    values = np.array([1.0, -2.5])
    raw = values.tobytes()
    array = (
        b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R"
        b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U" + bytes([len(raw)]) + raw + b"tb"
    )
    read = read_pickle(written(b"\x80\x02}(U\x05poses" + array + b"u."))
    np.testing.assert_array_equal(read["poses"], values)


def test_old_style_objects_of_chumpy_are_kept_as_records(written):
    """Protocol 0 builds objects through copy_reg."""
    text = b"ccopy_reg\n_reconstructor\n(cchumpy.ch\nCh\nc__builtin__\nobject\nNtR(dS'x'\nI5\nsb."
    read = read_pickle(written(text))
    assert isinstance(read, Inert) and read.name == "chumpy.ch.Ch" and read.state == {"x": 5}


HARMFUL = {
    "os.system": b"cos\nsystem\n(S'touch PLACE'\ntR.",
    "posix.system": b"cposix\nsystem\n(S'touch PLACE'\ntR.",
    "builtins.eval": b"c__builtin__\neval\n(S\"open('PLACE', 'w')\"\ntR.",
    "builtins.getattr": b"c__builtin__\ngetattr\n(S'a'\nS'b'\ntR.",
    "numpy.load": b"cnumpy\nload\n(S'PLACE'\ntR.",
    "numpy.testing.run_string": b"cnumpy.testing\nrun_string\n(S'PLACE'\ntR.",
    "chumpyx.system": b"cchumpyx\nsystem\n(S'touch PLACE'\ntR.",
    "os.system, by INST": b"(S'touch PLACE'\nios\nsystem\n.",
    "os.system, by STACK_GLOBAL": b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x0btouch PLACE\x85R.",
}


@pytest.mark.parametrize("payload", HARMFUL.values(), ids=HARMFUL)
def test_code_in_a_pickle_does_not_run(written, tmp_path, payload):
    place = tmp_path / "harmed"
    payload = payload.replace(b"\x0btouch PLACE", bytes([6 + len(str(place))]) + b"touch PLACE")
    payload = payload.replace(b"PLACE", str(place).encode())
    with pytest.raises(UserError, match="which is not on the list of harmless names; only numbers, text"):
        read_pickle(written(payload))
    assert not place.exists()


def test_the_harmful_payload_would_work_in_an_ordinary_reader(tmp_path):
    place = tmp_path / "harmed"
    pickle.loads(HARMFUL["os.system"].replace(b"PLACE", str(place).encode()))
    assert place.exists()


def test_the_readers_own_functions_cannot_be_changed(written):
    """BUILD on a function would set its attributes, such as its defaults, for all later files."""
    with pytest.raises(UserError, match="changes an object that is not data"):
        read_pickle(written(b"c_codecs\nencode\n(N}S'__defaults__'\nI1\nstb."))


def test_arrays_of_objects_are_refused(written):
    with pytest.raises(UserError, match="holds an array of type 'O8', which is never loaded"):
        read_pickle(written(pickle.dumps(np.array([{}, []], dtype=object))))


@pytest.mark.parametrize("code", ["i4,O", "f8,V3", "M8"])
def test_a_type_that_only_begins_like_a_number_is_refused(written, code):
    with pytest.raises(UserError, match=f"holds an array of type '{code}'"):
        read_pickle(written(f"cnumpy\ndtype\n(S'{code}'\ntR.".encode()))


def test_an_array_larger_than_its_bytes_is_refused(written):
    content = pickle.dumps(np.zeros(3), protocol=2).replace(b"K\x03\x85", b"J\xff\xff\xff\x7f\x85")
    with pytest.raises(UserError, match=r"claims shape \[2147483647\], but has 24 bytes"):
        read_pickle(written(content))


def test_a_claimed_size_takes_no_memory(written):
    huge = struct.pack("<Q", 1 << 60)
    for content in (b"\x80\x04\x8e" + huge + b"ab.", b"\x80\x05\x96" + huge + b"ab."):
        with pytest.raises(UserError, match="is damaged or not a pickle file"):
            read_pickle(written(content))
    assert read_pickle(written(b"\x80\x02Nr\xff\xff\xff\xff.")) is None  # memo number 4294967295


def test_a_file_above_the_limit_is_not_read(written):
    with pytest.raises(UserError, match="has 200 bytes, more than the 100 that are read"):
        read_pickle(written(b"x" * 200), max_bytes=100)


CONTENTS = {
    "empty": b"",
    "html": b"<!DOCTYPE html><html><body>Please log in</body></html>",
    "text": b"HIERARCHY\nROOT Hips\n",
    "zip": b"PK\x03\x04" + bytes(40),
    "random": bytes(range(256)),
    "deep": b"\x80\x02" + b"(" * 5000 + b"t" * 5000 + b".",
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_other_files_are_refused_in_one_line(written, content):
    path = written(content)
    try:
        read_pickle(path)
    except UserError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
    else:
        assert content is CONTENTS["deep"]  # nested tuples are data


def test_a_file_cut_anywhere_is_refused(written):
    content = pickle.dumps({"poses": np.arange(20.0)}, protocol=2)
    for length in range(len(content) - 1):
        with pytest.raises(UserError, match=r"file\.pkl"):
            read_pickle(written(content[:length]))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none.pkl: cannot be read \(No such file"):
        read_pickle(tmp_path / "none.pkl")
