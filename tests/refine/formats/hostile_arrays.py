"""Zip archives that unpack to too much or lie about it, and arrays that are none."""

import io
import pickle
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from hostile_cases import HARMED, hostile


def npy(shape: str, code: str = "'<f8'", content: bytes = b"", order: str = "False") -> bytes:
    """A .npy file that claims what it likes."""
    text = f"{{'descr': {code}, 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


def array(values) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.asarray(values), allow_pickle=False)
    return stream.getvalue()


def npz(compression: int = zipfile.ZIP_STORED, **members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def amass(frames: int = 3, **changed: bytes) -> bytes:
    poses, trans = np.zeros((frames, 72), np.float32), np.zeros((frames, 3), np.float32)
    members = {"poses": array(poses), "trans": array(trans), "mocap_framerate": array(30.0)}
    return npz(**{**members, **changed})


def clips(**changed) -> bytes:
    six = np.tile(np.eye(3, dtype=np.float32)[:2].reshape(6), (4, 24, 1))
    members = {
        "six": six,
        "root": np.zeros((4, 3), np.float32),
        "lengths": np.array([2, 2]),
        "fps": np.array([30.0, 30.0]),
    }
    members |= {"labels": np.array(["a", "b"]), "sources": np.array(["a", "b"])} | changed
    return npz(**{name: value if isinstance(value, bytes) else array(value) for name, value in members.items()})


def central(archive: bytes) -> int:
    """Where the list of members begins."""
    return struct.unpack_from("<L", archive, len(archive) - 6)[0]


def patched(archive: bytes, offset: int, content: bytes) -> bytes:
    """Other bytes at a place in the list's first entry."""
    place = central(archive) + offset
    return archive[:place] + content + archive[place + len(content) :]


# --- archives ---------------------------------------------------------------------------------------------------------


@hostile("unpacks 100 KB to 100 MB of zeros", ".npz")
def zip_bomb() -> bytes:
    count = 100 * 1024**2 // 8 // 72
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    header = npy(f"({count}, 72)")
    size, crc, packed = len(header) + count * 72 * 8, zlib.crc32(header), packer.compress(header)
    left, zeros = count * 72 * 8, bytes(1 << 20)
    while left:
        chunk = zeros[: min(left, len(zeros))]
        crc, packed, left = zlib.crc32(chunk, crc), packed + packer.compress(chunk), left - len(chunk)
    packed += packer.flush()
    sizes = struct.pack("<LLL", crc, len(packed), size)
    local = b"PK\3\4" + struct.pack("<5H", 20, 0, 8, 0, 33) + sizes + struct.pack("<2H", 9, 0) + b"poses.npy" + packed
    entry = b"PK\1\2" + struct.pack("<6H", 20, 20, 0, 8, 0, 33) + sizes + struct.pack("<5H2L", 9, 0, 0, 0, 0, 0, 0)
    entry += b"poses.npy"
    return local + entry + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, len(entry), len(local), 0)


@hostile("claims to unpack to four gigabytes", ".npz")
def claimed_size() -> bytes:
    return patched(amass(), 24, struct.pack("<L", 0xFFFFFFF0))


@hostile("claims to unpack to less than it does", ".npz")
def hidden_size() -> bytes:
    return patched(npz(zipfile.ZIP_DEFLATED, poses=array(np.zeros((100_000, 72)))), 24, struct.pack("<L", 1000))


@hostile("names the same packed bytes in a hundred entries", ".npz")
def overlap() -> bytes:
    archive = npz(zipfile.ZIP_DEFLATED, poses=array(np.zeros((40_000, 72))))
    start, end = central(archive), len(archive) - 22
    names = ("poses", "trans", "label", "betas")
    entries = b"".join(archive[start:end].replace(b"poses", name.encode()) for name in names)
    tail = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, len(names), len(names), len(entries), start, 0)
    return archive[:start] + entries + tail


@hostile("has 60,000 members", ".npz")
def members() -> bytes:
    entry = b"PK\1\2" + bytes(24) + struct.pack("<5H2L", 5, 0, 0, 0, 0, 0, 0) + b"a.npy"
    return (
        b"PK\3\4"
        + bytes(26)
        + entry * 60_000
        + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 60_000, 60_000, 51 * 60_000, 30, 0)
    )


@hostile("says it has one member, and lists 60,000", ".npz")
def uncounted_members() -> bytes:
    archive = members()
    return archive[:-14] + struct.pack("<2H", 1, 1) + archive[-10:]


@hostile("has a larger list of members behind a second end", ".npz")
def zip64() -> bytes:
    archive = members()
    record = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 60_000, 60_000, 51 * 60_000, 30)
    locator = struct.pack("<4sLQL", b"PK\6\7", 0, len(archive) - 22, 1)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return archive[:-22] + record + locator + end


@hostile("is encrypted", ".npz")
def encrypted() -> bytes:
    archive = bytearray(patched(amass(), 8, b"\1\0"))
    archive[6] |= 1
    return bytes(archive)


@hostile("names a member ../../poses.npy", ".npz")
def path_up() -> bytes:
    return npz(**{"../../harmed": array(np.zeros(3))})


@hostile("names a member /tmp/harmed.npy", ".npz")
def absolute_path() -> bytes:
    return npz(**{"/tmp/harmed": array(np.zeros(3))})


@hostile(r"names a member ..\harmed.npy", ".npz")
def backslashes() -> bytes:
    return npz(**{"..\\harmed": array(np.zeros(3))})


@hostile("holds two arrays of one name, for readers to disagree about", ".npz")
def twice() -> bytes:
    return amass().replace(b"trans.npy", b"poses.npy")


@hostile("is packed by a method that asks for a dictionary of gigabytes", ".npz")
def lzma() -> bytes:
    return npz(zipfile.ZIP_LZMA, poses=array(np.zeros((3, 72))))


@hostile("is cut", ".npz")
def cut_archive() -> bytes:
    return amass()[:-30]


@hostile("has a byte flipped", ".npz")
def flipped() -> bytes:
    content = bytearray(npz(zipfile.ZIP_DEFLATED, poses=array(np.arange(216.0).reshape(3, 72))))
    content[100] ^= 0xFF
    return bytes(content)


@hostile("has its members before its beginning", ".npz")
def negative_offset() -> bytes:
    archive = amass()
    return archive[:-6] + struct.pack("<LH", 0xFFFFFF00, 0)


@hostile("has a member name that is no text", ".npz")
def wrong_name() -> bytes:
    return patched(patched(amass(), 8, b"\0\x08"), 46, b"\xff\xfe\xff")


@hostile("is an archive without arrays", ".npz")
def no_arrays() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("run.py", "open('harmed', 'w')")
    return stream.getvalue()


@hostile("is an archive of nothing", ".npz")
def empty_archive() -> bytes:
    return npz()


@hostile("holds an archive in an archive", ".npz")
def nested_archive() -> bytes:
    return npz(poses=amass(), trans=amass())


# --- arrays -----------------------------------------------------------------------------------------------------------


class Touch:
    def __reduce__(self):
        return Path.touch, (Path(HARMED),)


@hostile("holds an object that runs code when it is loaded", ".npz")
def object_array() -> bytes:
    return amass(poses=npy("(1,)", "'|O'", pickle.dumps(np.array([Touch()], dtype=object))))


@hostile("has an expression for a shape", ".npz")
def expression() -> bytes:
    return amass(poses=npy("(__import__('os').system('touch harmed'),)"))


@hostile("has a header of 50 KB of parentheses", ".npz")
def nested_header() -> bytes:
    return amass(poses=npy("(" * 9000 + ")" * 9000))


@hostile("has a header of 9,000 minus signs", ".npz")
def signs() -> bytes:
    return amass(poses=npy("(" + "-" * 9000 + "1,)"))


@hostile("has a header of four gigabytes", ".npz")
def long_header() -> bytes:
    return amass(poses=b"\x93NUMPY\x02\x00\xff\xff\xff\xff{'descr': '<f8', " + b" " * 1000)


@hostile("has a header full of spaces", ".npz")
def spaces() -> bytes:
    return amass(poses=npy(" " * 9000 + "(3, 72)" + " " * 500))


@hostile("claims a shape whose size overflows 64 bits to 0", ".npz")
def wrapping_shape() -> bytes:
    return amass(poses=npy("(4294967296, 4294967296, 2)"))


@hostile("claims a terabyte", ".npz")
def large_shape() -> bytes:
    return amass(poses=npy("(1000000000, 156)", content=bytes(64)))


@hostile("claims a negative number of frames", ".npz")
def negative_shape() -> bytes:
    return amass(poses=npy("(-1, -8)", content=bytes(64)))


@hostile("has no values in 10^12 frames", ".npz")
def empty_frames() -> bytes:
    return amass(poses=npy("(1000000000000, 0)"), trans=npy("(1000000000000, 0)"))


@hostile("has 10^12 labels of no letters", ".npz")
def empty_labels() -> bytes:
    return clips(labels=npy("(1000000000000,)", "'<U0'"))


@hostile("has 10,000 axes", ".npz")
def axes() -> bytes:
    return amass(poses=npy("(" + "1, " * 3000 + ")", content=bytes(8)))


@hostile("is a table with named columns that hold objects", ".npz")
def record_array() -> bytes:
    return amass(poses=npy("(3,)", "[('a', '|O'), ('b', '<f8')]", bytes(48)))


@hostile("is of complex numbers", ".npz")
def complex_numbers() -> bytes:
    return amass(poses=array(np.zeros((3, 72), np.complex64)))


@hostile("is of a type of a gigabyte", ".npz")
def wide_type() -> bytes:
    return amass(label=npy("()", "'<U250000000'"))


@hostile("has a label of code points that are none", ".npz")
def no_unicode() -> bytes:
    return amass(label=npy("()", "'<U2'", b"\xff\xff\xff\x7f" * 2))


@hostile("has a label of half a pair of surrogates", ".npz")
def surrogate() -> bytes:
    return amass(label=npy("()", "'<U1'", struct.pack("<L", 0xD800)))


@hostile("has a label of a million letters", ".npz")
def long_label() -> bytes:
    return amass(label=array("x" * 1_000_000))


@hostile("has angles of NaN", ".npz")
def nan_poses() -> bytes:
    return amass(poses=array(np.full((3, 72), np.nan)))


@hostile("has angles of NaN of a kind that processors stop at", ".npz")
def signalling_nan() -> bytes:
    return amass(poses=npy("(3, 72)", "'<f4'", b"\x01\0\x80\x7f" * 216))


@hostile("has angles that overflow when they are squared", ".npz")
def large_angles() -> bytes:
    return amass(poses=array(np.full((3, 72), 1e308)))


@hostile("has a path that overflows in single precision", ".npz")
def large_path() -> bytes:
    return amass(trans=array(np.full((3, 3), 1e300)))


@hostile("has no frames", ".npz")
def no_frames() -> bytes:
    return amass(0)


@hostile("has more frames in its poses than in its path", ".npz")
def uneven() -> bytes:
    return amass(trans=array(np.zeros((2, 3))))


@hostile("has a frame rate of infinity", ".npz")
def infinite_rate() -> bytes:
    return amass(mocap_framerate=array(np.inf))


@hostile("has a frame rate of 10^300", ".npz")
def slow_rate() -> bytes:
    return amass(mocap_framerate=array(1e300))


@hostile("has lengths of clips that overflow to the right sum", ".npz")
def wrapping_lengths() -> bytes:
    return clips(
        lengths=np.array([2**62, 2**62, 2**62, 2**62 + 4]),
        fps=np.ones(4),
        labels=np.array([*"abcd"]),
        sources=np.array([*"abcd"]),
    )


@hostile("has a clip of negative length", ".npz")
def negative_lengths() -> bytes:
    return clips(lengths=np.array([6, -2]))


@hostile("has lengths of clips in words", ".npz")
def worded_lengths() -> bytes:
    return clips(lengths=np.array([b"2", b"2"]))


@hostile("has clips with labels that are numbers", ".npz")
def numbered_labels() -> bytes:
    return clips(labels=np.array([1, 2]))


@hostile("has rotations of zero", ".npz")
def no_rotations() -> bytes:
    return clips(six=np.full((4, 24, 6), np.nan, np.float32))


@hostile("holds joints as objects that run code", ".npy")
def object_joints() -> bytes:
    return npy("(1,)", "'|O'", pickle.dumps(np.array([Touch()], dtype=object)))


@hostile("claims joints of a terabyte", ".npy")
def large_joints() -> bytes:
    return npy("(1000000000, 22, 3)", content=bytes(64))


@hostile("has joints of NaN", ".npy")
def nan_joints() -> bytes:
    return array(np.full((5, 22, 3), np.nan))


@hostile("has joints 10^300 metres away", ".npy")
def far_joints() -> bytes:
    return array(np.random.default_rng(0).normal(size=(5, 22, 3)) * 1e300)


@hostile("has joints that are all in one place", ".npy")
def one_place() -> bytes:
    return array(np.zeros((5, 22, 3)))


@hostile("has features that overflow", ".npy")
def large_features() -> bytes:
    return array(np.full((5, 263), 1e300))


@hostile("has no frames of joints", ".npy")
def no_joints() -> bytes:
    return array(np.zeros((0, 22, 3)))
