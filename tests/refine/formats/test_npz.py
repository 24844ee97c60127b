"""Reading .npz safely: claims are checked before memory is taken, and nothing is unpickled."""

import io
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy

from refine.formats.npz import read_npy, read_npz
from renderers.checks import UserError


def header(shape: str, dtype: str = "<f8") -> bytes:
    """A .npy header that claims what it likes."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def packed(path, **members: bytes):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def test_reads_what_numpy_wrote(tmp_path):
    arrays = {
        "c": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "text": np.array(["walk", "wave"]),
        "scalar": np.array(30.0),
        "none": np.zeros((0, 3), dtype=np.float32),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    back = read_npz(tmp_path / "a.npz")
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)
    back["c"][0, 0] = 7  # writable


def test_only_the_keys_asked_for_are_opened(tmp_path):
    np.savez(tmp_path / "a.npz", good=np.ones(2), bad=np.array([object()]))
    assert list(read_npz(tmp_path / "a.npz", ("good", "absent"))) == ["good"]


def test_objects_are_refused_and_never_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return open, (str(tmp_path / "run"), "w")

    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.array([Evil()]), allow_pickle=True)
    path = packed(tmp_path / "evil.npz", poses=stream.getvalue())
    with pytest.raises(UserError, match=r"evil.npz, array 'poses': holds Python objects, which are never loaded"):
        read_npz(path)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (header("(1000000000000,)") + b"\0" * 64, r"claims shape \[1000000000000\] of float64"),
        (header("(3,)") + b"\0" * 16, r"claims shape \[3\]"),
        (header("(-1, -8)") + b"\0" * 64, "claims shape"),
        (header("(3,)", "|O") + b"\0" * 24, "holds Python objects"),
        (b"not numpy at all", "is not a NumPy array"),
        (b"\x93NUMPY\x09\x00", "is not a NumPy array"),
        (header("(__import__('os').getpid(),)"), "is not a NumPy array"),
    ],
)
def test_false_headers_are_refused(tmp_path, content, message):
    with pytest.raises(UserError, match=message):
        read_npz(packed(tmp_path / "a.npz", x=content))


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", x=np.zeros(1_000_000))
    assert (tmp_path / "bomb.npz").stat().st_size < 20_000
    with pytest.raises(UserError, match=r"unpacks to 8000128 bytes, more than the 1000000 allowed"):
        read_npz(tmp_path / "bomb.npz", max_bytes=1_000_000)


def test_damage_is_one_line(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(1000.0))
    whole = (tmp_path / "a.npz").read_bytes()
    flipped = whole[:500] + bytes([whole[500] ^ 255]) + whole[501:]
    for content in (b"PK\x03\x04", whole[:900], flipped):
        (tmp_path / "b.npz").write_bytes(content)
        with pytest.raises(UserError, match=r"b.npz: is damaged") as caught:
            read_npz(tmp_path / "b.npz")
        assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match=r"none.npz: cannot be read \(No such file"):
        read_npz(tmp_path / "none.npz")


DTYPES = st.sampled_from(["|b1", "|i1", "|u1", "<i4", ">i8", "<u2", "<f2", "<f4", ">f8", "|S3", "<U4", ">U4"])


def arrays(code: str) -> st.SearchStrategy[np.ndarray]:
    """Arrays of a type, of text those that are text: NumPy also stores halves of surrogate pairs, which are refused."""
    shapes = numpy.array_shapes(min_dims=0, max_dims=4, min_side=0)
    text = {"elements": {"alphabet": st.characters(codec="utf-8")}} if "U" in code else {}
    return numpy.arrays(np.dtype(code), shapes, **text)


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(
        st.from_regex(r"[a-z_][a-z0-9_]{0,9}", fullmatch=True).filter(lambda name: name != "file"),
        DTYPES.flatmap(arrays),
        min_size=1,
        max_size=4,
    ),
    st.booleans(),
    st.booleans(),
)
def test_any_arrays_come_back(tmp_path_factory, arrays, packed, transposed):
    path = tmp_path_factory.getbasetemp() / "any.npz"
    arrays = {name: np.asfortranarray(array) if transposed else array for name, array in arrays.items()}
    (np.savez_compressed if packed else np.savez)(path, **arrays)
    back = read_npz(path)
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        assert (back[name].dtype, back[name].shape) == (array.dtype, array.shape)
        assert back[name].tobytes() == array.tobytes()
        np.save(path.with_suffix(".npy"), array)
        assert read_npy(path.with_suffix(".npy")).tobytes() == array.tobytes()


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("half", ["\ud800", "\udbff", "\udc00", "\udfff"])
def test_halves_of_surrogate_pairs_are_refused(tmp_path, half, order):
    np.savez(tmp_path / "a.npz", label=np.array(["walk", f"a{half}"], f"{order}U4"))
    with pytest.raises(UserError, match="array 'label': holds text that is no Unicode"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("order", "<>")
def test_text_beyond_the_first_plane_comes_back(tmp_path, order):
    text = np.array(["\ud7ff\ue000", "\U0001f6b6\U0010ffff", ""], f"{order}U4")
    np.savez(tmp_path / "a.npz", label=text)
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz")["label"], text)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
def test_damage_anywhere_is_one_line_or_the_same_array(tmp_path_factory, place, change):
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    array = np.arange(30.0).reshape(5, 6)
    np.savez_compressed(path, poses=array)
    whole = bytearray(path.read_bytes())
    whole[place % len(whole) : place % len(whole) + len(change)] = change
    path.write_bytes(whole)
    try:
        back = read_npz(path)
    except UserError as error:
        assert "\n" not in str(error)
    else:  # names, dates and attributes may be anything
        assert all(np.array_equal(value, array) for value in back.values())


@pytest.mark.parametrize(
    "text",
    ["shape': (2, 3), 'descr': '<f8', 'fortran_order': True", "shape':(2L,3L),'fortran_order':True,'descr':'<f8'"],
)
def test_headers_that_others_write_are_read(tmp_path, text):
    array = np.arange(6.0).reshape(2, 3, order="F")
    for version in (b"\x01\x00", b"\x02\x00", b"\x03\x00"):
        encoded = f"{{'{text}}}\n".encode()
        length = len(encoded).to_bytes(2 if version == b"\x01\x00" else 4, "little")
        (tmp_path / "a.npy").write_bytes(b"\x93NUMPY" + version + length + encoded + array.tobytes("F"))
        np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), array)
