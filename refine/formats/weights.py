"""Weights of networks of unknown origin: safetensors, and checkpoints of PyTorch.

PyTorch runs no code of a checkpoint when asked for weights only, but it takes memory for what a file claims. So its
program is run without effect first, by the rules for any pickle, and every size in it is held against the file's.
"""

import argparse
import io
import math
import os
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from refine.formats.npz import MAX_AXES, check_end, check_sizes
from refine.formats.unpickle import Inert, Refused, Unpickler
from refine.formats.untrusted import START, kind_of_start, opened
from renderers.checks import UserError

MAX_WEIGHTS = 12 << 30  # bytes: the largest official network with the state of its optimiser has 8 GB
MAX_HEADER = 1 << 22  # of safetensors, and the list of a checkpoint's members
MAX_PROGRAM = 1 << 24
MAX_TENSORS = 20_000
ITEMS = {"Double": 8, "Long": 8, "Float": 4, "Int": 4, "Half": 2, "BFloat16": 2, "Short": 2, "Byte": 1, "Char": 1}
ITEMS |= {"Bool": 1}
OLD_PARTS = 5  # pickles before the numbers of a checkpoint of before 2020; the fourth holds the tensors


def read_safetensors(path: Path, remedy: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """All tensors of a safetensors file, and its header's metadata.

    Raises:
        UserError: it is missing, damaged, too large or something else.
    """
    with opened(path, MAX_WEIGHTS) as stream:
        start = stream.peek(START)[:START]
    if kind_of_start(start) != "safetensors" or int.from_bytes(start[:8], "little") > MAX_HEADER:
        raise UserError(path, "is damaged or no safetensors file", remedy)
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except SafetensorError as error:
        raise UserError(path, f"is damaged or no safetensors file ({first_line(error)})", remedy) from error


def check_network(
    path: Path, build: Callable[[], nn.Module], blocks: int, tensors: Mapping[str, Tensor], remedy: str
) -> None:
    """Refuse a description of another network than that of the tensors, before memory is taken for it.

    Args:
        build: makes the network.
        blocks: how many repeated parts it has, each with a tensor at least.

    Raises:
        UserError: naming what is missing or has another shape.
    """
    if blocks > len(tensors):
        raise UserError(path, f"does not fit its description ({blocks} blocks, {len(tensors)} tensors)", remedy)
    with torch.device("meta"):
        expected = build().state_dict()
    if wrong := sorted(expected.keys() ^ tensors.keys()):
        some = ", ".join(wrong[:3]) + (", ..." if len(wrong) > 3 else "")
        raise UserError(path, f"does not fit its description ({len(wrong)} tensors missing or unknown: {some})", remedy)
    for name, value in expected.items():
        if tensors[name].shape != value.shape:
            found = f"{name} has the shape {list(tensors[name].shape)}, expected {list(value.shape)}"
            raise UserError(path, f"does not fit its description ({found})", remedy)


def read_checkpoint(path: Path, remedy: str) -> Any:
    """What a checkpoint of PyTorch holds: tensors and plain values, and the ``argparse.Namespace`` of a command.

    Tensors stay in the file until they are used, where its format allows it.

    Raises:
        UserError: it is missing, too large, damaged, or holds anything else.
    """
    try:
        with opened(path, MAX_WEIGHTS) as stream:
            size = os.fstat(stream.fileno()).st_size
            packed = kind_of_start(stream.peek(START)[:START]) == "npz"
            if packed:
                program = io.BytesIO(_program(path, stream))
                _Rehearsal(program, size).load()
            else:
                seen = _Rehearsal(stream, size)
                for _ in range(OLD_PARTS):
                    seen.load()
        with torch.serialization.safe_globals([argparse.Namespace]):
            return torch.load(path, map_location="cpu", weights_only=True, mmap=packed)
    except UserError:
        raise
    except Exception as error:  # a damaged pickle can fail in every operation of the machine that reads it
        reason = f" ({error})" if isinstance(error, Refused) else ""
        problem = f"is damaged, no checkpoint of torch, or holds more than tensors and plain values{reason}"
        raise UserError(path, problem, remedy) from error


def first_line(error: Exception) -> str:
    """The first line of an error, or its kind where it says nothing."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def _program(path: Path, stream: BinaryIO) -> bytes:
    """The pickle in an archive whose members are stored as they are."""
    size = check_end(path, stream, MAX_TENSORS, MAX_HEADER)
    with zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        check_sizes(path, members, size, MAX_WEIGHTS)
        programs = [info for info in members if info.filename.lower().endswith(".pkl")]
        names = {info.filename.lower() for info in members}
        packed = any(info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1 for info in members)
        if packed or len(programs) != 1 or len(names) < len(members) or programs[0].file_size > MAX_PROGRAM:
            raise Refused("its archive is none of PyTorch's")
        return archive.read(programs[0])


class _Rehearsal(Unpickler):
    """Runs the program of a checkpoint without effect. Nothing that it makes is used."""

    RECORDS = re.compile(
        rf"torch\._utils\._rebuild_(tensor|tensor_v2|parameter)|torch\.({'|'.join(ITEMS)})Storage"
        r"|torch\.(Size|device)|argparse\.Namespace"
    )

    def __init__(self, stream: BinaryIO, size: int):
        super().__init__(stream, size)
        self.stored: dict[str, int] = {}
        self.numbers_left = size

    def persistent_load(self, pid: Any) -> Inert:
        """A storage: its bytes must be in the file."""
        word, kind, key, _, count = pid[:5]
        name = re.fullmatch(r"torch\.(\w+)Storage", kind.name)
        if word not in ("storage", b"storage") or type(count) is not int or count < 0:
            raise Refused("holds numbers that are not stored in it")
        if key not in self.stored:
            self.numbers_left -= count * ITEMS[name[1]]
            self.stored[str(key)] = count
        if self.numbers_left < 0 or count > self.stored[str(key)]:
            raise Refused("claims more numbers than it holds")
        storage = Inert()
        storage.state = count
        return storage

    def load_reduce(self) -> None:
        super().load_reduce()
        made = self.stack[-1]
        if isinstance(made, Inert) and made.name.startswith("torch._utils._rebuild_tensor"):
            storage, _, shape = made.args[:3]
            if len(shape) > MAX_AXES or math.prod(shape) > storage.state:
                raise Refused("has a tensor of more numbers than are stored for it")

    def load_build(self) -> None:
        if type(self.stack[-2]) is dict:  # what goes with a network's tensors, and is not used
            self.stack.pop()
        else:
            super().load_build()
