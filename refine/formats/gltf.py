"""glTF 2.0 files of unknown origin: their table of contents and the arrays it promises, every claim checked first.

A ``.glb`` holds both in one file. A ``.gltf`` is the table alone; its buffers are in it as base64, or are files beside
it, and nothing else is followed: no folder, no link, no address.
"""

import base64
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from refine.formats.untrusted import MAX_MESH, parse_json, read_bytes
from renderers.checks import UserError, check_finite

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, b"JSON", b"BIN\0"
# glTF's numbers for the types of components, and how many make an element.
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
ELEMENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

MAX_TEXT = 1 << 25  # bytes of JSON, most of which may be base64
MAX_VALUES = 500_000  # in the JSON; each takes some hundred bytes in Python
BASE64 = re.compile(r"data:[\w.+/-]{0,99};base64,")
PACKED = ("EXT_meshopt_compression", "KHR_meshopt_compression", "MESHOPT_compression")
REMEDY = "export the file again"


@dataclass(frozen=True, eq=False)
class Gltf:
    """A file that is open: what it lists, and the bytes behind it.

    Attributes:
        path: the file, for messages and for what lies beside it.
        document: its JSON.
        binary: the chunk that comes with a ``.glb``.
    """

    path: Path
    document: dict[str, Any]
    binary: memoryview | None
    _entries: dict[str, list] = field(default_factory=dict, repr=False)
    _buffers: dict[int, memoryview] = field(default_factory=dict, repr=False)

    def entries(self, kind: str) -> list[dict[str, Any]]:
        """All of a kind, such as "nodes"; none where the file lists none.

        Raises:
            UserError: it is no list of objects.
        """
        if kind not in self._entries:
            found = self.document.get(kind, [])
            if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
                raise UserError(self.path, f"its '{kind}' are no list of objects", REMEDY)
            self._entries[kind] = found
        return self._entries[kind]

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """One of a kind by its number.

        Raises:
            UserError: there is no such one.
        """
        entries = self.entries(kind)
        if not is_count(index) or index >= len(entries):
            raise UserError(self.path, f"refers to number {shown(index)} of its {len(entries)} {kind}", REMEDY)
        return entries[index]

    def numbers(self, index: object, element: str, limit: int) -> np.ndarray:
        """The array [count size] float64 of an accessor, whose elements are called ``element``.

        Args:
            element: a key of ``ELEMENTS``.
            limit: refuse more elements than this.

        Raises:
            UserError: it is missing, of another type, longer than ``limit`` or than its bytes, or not finite.
        """
        accessor, where = self.entry("accessors", index), f"{self.path}, accessor {index}"
        if accessor.get("type") != element:
            raise UserError(where, f"expected a {element}, got {shown(accessor.get('type'))}", REMEDY)
        count, width = accessor.get("count"), ELEMENTS[element]
        if not is_count(count) or not 0 < count <= limit:
            raise UserError(where, f"holds {shown(count)} elements, 1 to {limit} are read", REMEDY)
        dtype = self._component(where, accessor)
        values = np.zeros((count, width), dtype)
        if "bufferView" in accessor:
            values = self._elements(where, accessor, count, width, dtype)
        if "sparse" in accessor:
            values = self._overwritten(where, accessor["sparse"], values)
        result = values.astype(np.float64)
        if accessor.get("normalized") is True and dtype.kind != "f":
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        check_finite(where, result, "element component")
        return result

    def _component(self, where: str, owner: Mapping[str, Any]) -> np.dtype:
        kind = owner.get("componentType")
        if not is_count(kind) or kind not in COMPONENTS:
            raise UserError(where, f"has components of the unknown type {shown(kind)}", REMEDY)
        return np.dtype(COMPONENTS[kind])

    def _elements(self, where: str, owner: Mapping[str, Any], count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """[count width], a look at the bytes themselves."""
        view = self.entry("bufferViews", owner.get("bufferView"))
        if any(name in PACKED for name in _object(view.get("extensions"))):
            raise UserError(where, "is compressed by meshopt, which is not read", "export the file uncompressed")
        buffer = self._buffer(view.get("buffer"))
        size = width * dtype.itemsize
        offset, inner, length = view.get("byteOffset", 0), owner.get("byteOffset", 0), view.get("byteLength")
        stride = view.get("byteStride", size)
        if not all(map(is_count, (offset, inner, length, stride))) or stride < size:
            raise UserError(where, "its place in the file is not given in whole bytes", REMEDY)
        end = inner + stride * (count - 1) + size
        if end > length or offset + length > len(buffer):
            problem = f"claims {end} bytes of a view of {length} at {offset} in a buffer of {len(buffer)}"
            raise UserError(where, problem, REMEDY)
        return np.ndarray((count, width), dtype, buffer, offset + inner, (stride, dtype.itemsize))

    def _overwritten(self, where: str, sparse: object, values: np.ndarray) -> np.ndarray:
        """The values with those that a sparse accessor replaces."""
        sparse = _object(sparse)
        indices, replaced = _object(sparse.get("indices")), _object(sparse.get("values"))
        count = sparse.get("count")
        if not is_count(count) or not 0 < count <= len(values):
            raise UserError(where, f"replaces {shown(count)} of {len(values)} elements", REMEDY)
        places = self._elements(where, indices, count, 1, self._component(where, indices))[:, 0]
        if places.dtype.kind != "u" or places[-1] >= len(values) or (np.diff(places.astype(np.int64)) <= 0).any():
            raise UserError(where, "the numbers of its sparse elements do not rise, or are too high", REMEDY)
        values = values.copy()
        values[places] = self._elements(where, replaced, count, values.shape[1], values.dtype)
        return values

    def _buffer(self, index: object) -> memoryview:
        buffer = self.entry("buffers", index)
        if index not in self._buffers:
            content = self.binary if "uri" not in buffer and index == 0 else self._uri(index, buffer.get("uri"))
            if content is None:
                raise UserError(self.path, "has no binary chunk", REMEDY)
            self._buffers[index] = memoryview(content)
        return self._buffers[index]

    def _uri(self, index: int, uri: object) -> bytes:
        where = f"{self.path}, buffer {index}"
        if not isinstance(uri, str):
            raise UserError(where, "has neither bytes nor a place where they are", REMEDY)
        start = BASE64.match(uri)
        if start:
            try:
                return base64.b64decode(uri[start.end() :], validate=True)
            except ValueError as error:
                raise UserError(where, "is not the base64 it says it is", REMEDY) from error
        name = unquote(uri)
        if name in ("", ".", "..") or set(name) & set("/\\:\0"):
            problem = f"is at {shown(uri)}, and only files in the same folder are read"
            raise UserError(where, problem, "export it as one file, .glb")
        left = MAX_MESH - sum(map(len, self._buffers.values()))
        return read_bytes(self.path.parent / name, left)


def read_gltf(path: str | Path) -> Gltf:
    """Open a ``.glb`` or ``.gltf`` file, whichever its content says.

    Raises:
        UserError: it is missing, damaged, of glTF 1, or claims more than the limits of this module.
    """
    path = Path(path)
    content = read_bytes(path, MAX_MESH)
    text, binary = _chunks(path, content) if content.startswith(MAGIC) else (content, None)
    if len(text) > MAX_TEXT or sum(map(text.count, (b",", b"[", b"{"))) > MAX_VALUES:
        raise UserError(path, f"lists more than {MAX_VALUES} values or {MAX_TEXT} bytes of JSON", "export less at once")
    document = parse_json(path, text.rstrip(b"\0"))
    asset = document.get("asset") if isinstance(document, dict) else None
    if not isinstance(asset, dict):
        raise UserError(path, "is JSON, but no glTF", "give a .glb or .gltf file")
    version = asset.get("version")
    if not isinstance(version, str) or not version.startswith("2."):
        raise UserError(path, f"is glTF {shown(version)}, only 2.0 is read", "export it as glTF 2.0")
    return Gltf(path, document, binary)


def _chunks(path: Path, content: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON of a ``.glb`` and what follows it."""
    if len(content) < 20:
        raise UserError(path, f"ends after {len(content)} bytes", REMEDY)
    _, version, length, size, kind = struct.unpack_from("<4sIII4s", content)
    if version != VERSION:
        raise UserError(path, f"is binary glTF {version}, only {VERSION} is read", "export it as glTF 2.0")
    if length > len(content) or kind != JSON_CHUNK or 20 + size > length:
        raise UserError(path, f"is cut short or damaged: its parts are not those of its {length} bytes", REMEDY)
    rest = 20 + size
    if rest + 8 > length:
        return content[20:rest], None
    size, kind = struct.unpack_from("<I4s", content, rest)
    if rest + 8 + size > length:
        raise UserError(path, f"its second chunk claims {size} bytes and has {length - rest - 8}", REMEDY)
    return content[20:rest], memoryview(content)[rest + 8 : rest + 8 + size] if kind == BINARY_CHUNK else None


def is_count(value: object) -> bool:
    """Whether a value of JSON is a whole number, 0 or more, that fits 53 bits; True and False are none."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


def shown(value: object) -> str:
    """A value of JSON for a message: on one line, short, and nothing in it that a terminal would obey."""
    text = ascii(value) if isinstance(value, str | int | float | None) else f"a {type(value).__name__}"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _object(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
