"""Mappings, labels and weights of networks."""

import dataclasses
import io
import json
import pickle
import struct
import zipfile
from pathlib import Path

import torch
from hostile_cases import hostile
from hostile_pickles import PROTO, number, text
from safetensors.torch import save

from refine.mae import MAEConfig

# --- JSON -------------------------------------------------------------------------------------------------------------


@hostile("nests JSON 100,000 deep", ".json", "mapping")
def deep_mapping() -> str:
    return "[" * 100_000


@hostile("has a number of 100,000 digits", ".json", "mapping")
def long_json_number() -> str:
    return '{"joints": ' + "9" * 100_000 + "}"


@hostile("is no text", ".json", "mapping")
def binary_mapping() -> bytes:
    return b'{"joints": "\xff\xfe"}'


@hostile("is a list", ".json", "mapping")
def listed_mapping() -> str:
    return "[1, 2, 3]"


@hostile("maps joints to numbers, lists and itself", ".json", "mapping")
def wrong_mapping() -> str:
    return json.dumps({"joints": {"pelvis": 3, "left_hip": ["a"], "harmed": {"a": 1}}, "unit": "parsec"})


def motion_json(**changed) -> str:
    """A motion of one frame as `refine export` writes it."""
    from renderers.skeleton import JOINT_NAMES

    whole = {"format": "refine-motion", "version": 1, "fps": 30, "label": "", "gender": "neutral"}
    whole |= {"joints": list(JOINT_NAMES), "root": [[0, 1, 0]], "rotations": [[[1, 0, 0, 0]] * 24]}
    return json.dumps(whole | changed)


@hostile("has a frame rate of 400 digits", ".json")
def json_rate() -> str:
    return motion_json(fps=10**400)


@hostile("has a place of 400 digits", ".json")
def json_place() -> str:
    return motion_json(root=[[0, 10**400, 0]])


@hostile("has rotations of no length", ".json")
def json_rotations() -> str:
    return motion_json(rotations=[[[0, 0, 0, 0]] * 24])


@hostile("has a label of a million letters", ".json")
def json_label() -> str:
    return motion_json(label="x" * 1_000_000)


@hostile("has a million empty lists", ".json")
def json_lists() -> str:
    return '{"format": "refine-motion", "root": [' + "[]," * 1_000_000 + "[]]}"


@hostile("nests lists 100,000 deep for its places", ".json")
def json_depth() -> str:
    return '{"format": "refine-motion", "root": ' + "[" * 100_000


# --- labels -----------------------------------------------------------------------------------------------------------


@hostile("has a cell of a megabyte", ".csv", "labels")
def long_cell() -> str:
    return 'file,label\na.bvh,"' + "x" * 1_000_000 + '"\n'


@hostile("opens a quote that never ends", ".csv", "labels")
def open_quote() -> str:
    return 'file,label\na.bvh,"walk\n' + "b.bvh,wave\n" * 10_000


@hostile("has 100,000 columns", ".csv", "labels")
def columns() -> str:
    return "file,label" + ",x" * 100_000 + "\n"


@hostile("has zero bytes", ".csv", "labels")
def zero_bytes() -> bytes:
    return b"file,label\na.bvh,walk\0\n"


@hostile("has a label that clears the terminal", ".csv", "labels")
def terminal_label() -> str:
    return "file,label\na.bvh,\x1b[2Jwalk\n"


@hostile("cuts from NaN to infinity", ".csv", "labels")
def nan_pieces() -> str:
    return "file,label,start,end\na.bvh,walk,nan,inf\n"


@hostile("has a label without letters", ".csv", "labels")
def no_label() -> str:
    return 'file,label\na.bvh,"  "\n'


# --- weights ----------------------------------------------------------------------------------------------------------

SMALL = MAEConfig(32, 8, 3, 16, 1, 1, 16, 1, 1)


def described(folder: Path, name: str, weights: bytes, **changed) -> Path:
    config = dataclasses.asdict(SMALL) | changed
    (folder / f"{name}.json").write_text(json.dumps({"config": config}))
    (folder / f"{name}.safetensors").write_bytes(weights)
    return folder / f"{name}.safetensors"


def safetensors(header: dict, content: bytes = b"") -> bytes:
    encoded = json.dumps(header).encode()
    return struct.pack("<Q", len(encoded)) + encoded + content


@hostile("claims a header of an exabyte", reader="weights")
def header_length(folder: Path) -> Path:
    return described(folder, "header_length", struct.pack("<Q", 1 << 60) + b"{}")


@hostile("has a header of 6 MB", reader="weights")
def large_header(folder: Path) -> Path:
    entries = ",".join(f'"{index}":{{"dtype":"F32","shape":[0],"data_offsets":[0,0]}}' for index in range(100_000))
    encoded = f"{{{entries}}}".encode()
    return described(folder, "large_header", struct.pack("<Q", len(encoded)) + encoded)


@hostile("claims a tensor of a terabyte", reader="weights")
def large_tensor(folder: Path) -> Path:
    entry = {"dtype": "F32", "shape": [1 << 38], "data_offsets": [0, 1 << 40]}
    return described(folder, "large_tensor", safetensors({"cls_token": entry}, bytes(64)))


@hostile("has tensors that overlap", reader="weights")
def overlapping_tensors(folder: Path) -> Path:
    entry = {"dtype": "F32", "shape": [16], "data_offsets": [0, 64]}
    return described(folder, "overlapping_tensors", safetensors({"a": entry, "b": entry}, bytes(64)))


@hostile("describes a network of terabytes", reader="weights")
def large_network(folder: Path) -> Path:
    weights = save({"cls_token": torch.zeros(1, 1, 16)})
    return described(folder, "large_network", weights, width=4096, depth=4096, heads=1)


@hostile("describes a network of 30 MB layers", reader="weights")
def wide_network(folder: Path) -> Path:
    weights = save({f"{index}": torch.zeros(1) for index in range(64)})
    return described(folder, "wide_network", weights, width=4096, depth=32, heads=1)


@hostile("describes a network whose parts do not divide", reader="weights")
def odd_network(folder: Path) -> Path:
    return described(folder, "odd_network", save({"cls_token": torch.zeros(1, 1, 16)}), heads=7)


@hostile("describes a network in words", reader="weights")
def worded_network(folder: Path) -> Path:
    return described(folder, "worded_network", save({"cls_token": torch.zeros(1, 1, 16)}), width="__import__('os')")


@hostile("has a description 100,000 deep", reader="weights")
def deep_description(folder: Path) -> Path:
    path = described(folder, "deep_description", save({"cls_token": torch.zeros(1, 1, 16)}))
    path.with_suffix(".json").write_text("[" * 100_000)
    return path


def checkpoint(program: bytes, **records: bytes) -> bytes:
    """A .pth as PyTorch writes it, of a pickle."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("archive/data.pkl", program)
        archive.writestr("archive/version", b"3\n")
        archive.writestr("archive/byteorder", b"little")
        for name, content in records.items():
            archive.writestr(f"archive/data/{name}", content)
    return stream.getvalue()


def storage(count: int) -> bytes:
    return b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text("0") + text("cpu") + number(count) + b"tQ"


def tensor(count: int, shape: bytes, stride: bytes) -> bytes:
    hooks = b"ccollections\nOrderedDict\n)R"
    return (
        b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage(count) + b"K\x00" + shape + stride + b"\x89" + hooks + b"tR"
    )


@hostile("runs a command", ".pth", "weights")
def checkpoint_code() -> bytes:
    return checkpoint(PROTO + b"cos\nsystem\n" + text("touch harmed") + b"\x85R.")


@hostile("runs a command, as PyTorch wrote files before 2020", ".pth", "weights")
def old_checkpoint_code() -> bytes:
    start = (
        pickle.dumps(0x1950A86A20F9469CFC6C, protocol=2) + pickle.dumps(1001, protocol=2) + pickle.dumps({}, protocol=2)
    )
    return start + PROTO + b"cos\nsystem\n" + text("touch harmed") + b"\x85R."


@hostile("asks for ten gigabytes of zeros", ".pth", "weights")
def zeros() -> bytes:
    return checkpoint(PROTO + b"cbuiltins\nbytearray\n" + number(10**10) + b"\x85R.")


@hostile("asks for a tensor of forty gigabytes", ".pth", "weights")
def unwritten() -> bytes:
    return checkpoint(PROTO + b"ctorch\nTensor\n" + number(10**10) + b"\x85R.")


@hostile("has tuples in each other for a key, which breaks the interpreter", ".pth", "weights")
def checkpoint_key() -> bytes:
    return checkpoint(PROTO + b"})" + b"\x85" * 250_000 + b"K\x01s.")


@hostile("has a tensor of 10^12 numbers that are all the same four bytes", ".pth", "weights")
def same_bytes() -> bytes:
    whole = tensor(1, number(10**12) + b"\x85", b"K\x00\x85")
    return checkpoint(PROTO + b"}" + text("cls_token") + whole + b"s.", **{"0": bytes(4)})


@hostile("has a storage of a terabyte", ".pth", "weights")
def large_storage() -> bytes:
    whole = tensor(1 << 38, b"K\x01\x85", b"K\x01\x85")
    return checkpoint(PROTO + b"}" + text("cls_token") + whole + b"s.", **{"0": bytes(64)})


@hostile("has a program that unpacks to 70 MB", ".pth", "weights")
def packed_program() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", PROTO + b"N0" * 35_000_000 + b"N.")
        archive.writestr("archive/version", b"3\n")
    return stream.getvalue()


@hostile("is a checkpoint of something else", ".pth", "weights")
def no_network() -> bytes:
    stream = io.BytesIO()
    torch.save({"model": {"weight": torch.zeros(3)}}, stream)
    return stream.getvalue()
