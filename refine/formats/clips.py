"""Many labelled clips packed: what training reads. One .npz, or, for many, a folder of them with a manifest."""

import hashlib
import json
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.lib import format as npy
from torch import Tensor

from refine.formats.npz import read_npz
from refine.formats.untrusted import opened, read_json
from refine.motion import Motion
from renderers.checks import ShapeError, UserError, check_shapes
from renderers.outputs import replacing
from renderers.rotations import matrix_from_6d

KEYS = ("six", "root", "lengths", "fps", "labels", "sources")
SHAPE_KEYS = ("betas", "genders")  # there only where a clip says whose motion it is
FRAME_BYTES = 4 * (24 * 6 + 3)
MAX_BYTES = 1 << 30  # of the frames of a file
ABOUT_BYTES = 1 << 27  # of its names and labels

MANIFEST = "manifest.json"
MANIFEST_BYTES = 1 << 25
SCHEMA = 1
KIND = "clips"
SHARD = re.compile(r"clips-\d{5}\.npz")
SHARD_FRAMES = 50_000  # 29 MB
REMEDY = "import the clips again"


class Packed(NamedTuple):
    """A clip as it lies in a file."""

    six: np.ndarray  # [T 24 6] float32
    root: np.ndarray  # [T 3] float32, metres
    fps: float
    label: str
    source: str
    betas: np.ndarray | None = None  # [B] float32
    gender: str = "neutral"

    @property
    def frames(self) -> int:
        return len(self.root)


def pack(motion: Motion) -> Packed:
    six, root = (tensor.detach().float().cpu().numpy() for tensor in (motion.six, motion.root))
    betas = None if motion.betas is None else motion.betas.detach().float().cpu().numpy()
    return Packed(six, root, motion.fps, motion.label, motion.source, betas, motion.gender)


def save_clips(path: str | Path, motions: Sequence[Motion]) -> None:
    """Write clips [T_c 24 6] and [T_c 3] end to end as float32, with their lengths, frame rates, labels and sources,
    and with shapes and genders where there are any."""
    save_packed(path, [pack(motion) for motion in motions])


def save_packed(path: str | Path, clips: Sequence[Packed]) -> None:
    """As `save_clips`. The clips are not copied on the way to the disk."""
    if not clips:
        raise UserError(path, "there are no clips to write", "import some first")
    frames = sum(clip.frames for clip in clips)
    if FRAME_BYTES * frames > MAX_BYTES:
        problem = f"would take {FRAME_BYTES * frames:,} bytes, more than the {MAX_BYTES:,} that are read"
        raise UserError(path, problem, "choose fewer, or name a folder for many files")
    about = {
        "lengths": np.array([clip.frames for clip in clips]),
        "fps": np.array([clip.fps for clip in clips], dtype=np.float64),
        "labels": np.array([clip.label for clip in clips]),
        "sources": np.array([clip.source for clip in clips]),
    }
    if any(clip.betas is not None or clip.gender != "neutral" for clip in clips):
        about |= {"betas": _padded([clip.betas for clip in clips]), "genders": np.array([c.gender for c in clips])}
    with replacing(path) as partial, zipfile.ZipFile(partial, "w") as stored:
        for name, shape in (("six", (frames, 24, 6)), ("root", (frames, 3))):
            with stored.open(f"{name}.npy", "w", force_zip64=True) as stream:
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                npy.write_array_header_1_0(stream, header)
                for clip in clips:
                    stream.write(np.ascontiguousarray(getattr(clip, name), dtype="<f4").data)
        for name, array in about.items():
            with stored.open(f"{name}.npy", "w", force_zip64=True) as stream:
                npy.write_array(stream, array, allow_pickle=False)


def load_clips(path: str | Path) -> list[Motion]:
    """Read what :func:`save_clips` wrote, or a folder of :class:`Shards`.

    Raises:
        UserError: the file or folder is missing, damaged, changed since, or something else.
    """
    path = Path(path)
    if not path.exists():
        raise UserError(path, "does not exist", "check the path")
    if not path.is_dir():
        return _load_file(path)
    return list(chain.from_iterable(map(_load_file, shard_paths(path))))


def is_packed(path: str | Path) -> bool:
    """Whether an .npz file is one of packed clips."""
    return len(read_npz(path, ("lengths", "labels", "sources"))) == 3


# --- many files ------------------------------------------------------------------------------------------------------


class Shards:
    """Clips into ``clips-00000.npz``, ``clips-00001.npz`` and so on in a folder, as they come, and a manifest.

    Each file holds whole clips: as many as fit into ``frames`` frames (`SHARD_FRAMES`), at least one.
    """

    def __init__(self, folder: Path, frames: int | None = None):
        self.folder, self.frames = folder, frames or SHARD_FRAMES
        self.held: list[Packed] = []
        self.held_frames = 0
        self.files: dict[str, dict[str, Any]] = {}
        self.labels: Counter[str] = Counter()

    def add(self, clip: Packed):
        if self.held and self.held_frames + clip.frames > self.frames:
            self._write()
        self.held.append(clip)
        self.held_frames += clip.frames
        self.labels[clip.label] += 1

    def close(self, left_out: Sequence[tuple[str, str]] = ()) -> dict[str, Any]:
        """Write what is held and the manifest.

        Args:
            left_out: names of clips that are not there, and why.
        """
        if self.held:
            self._write()
        if not self.files:
            raise UserError(self.folder, "there are no clips to write", "import some first")
        manifest = {
            "schema": SCHEMA,
            "kind": KIND,
            "clips": sum(file["clips"] for file in self.files.values()),
            "frames": sum(file["frames"] for file in self.files.values()),
            "labels": dict(sorted(self.labels.items())),
            "left_out": [{"source": source, "problem": problem} for source, problem in left_out],
            "files": self.files,
            "hash": _hash(self.files),
        }
        (self.folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
        return manifest

    def _write(self):
        path = self.folder / f"clips-{len(self.files):05d}.npz"
        save_packed(path, self.held)
        self.files[path.name] = {"sha256": _sha256(path), "clips": len(self.held), "frames": self.held_frames}
        self.held, self.held_frames = [], 0


def is_shards(folder: str | Path) -> bool:
    """Whether a folder is one that :class:`Shards` wrote: its manifest says so."""
    try:
        return _manifest(Path(folder)).get("kind") == KIND
    except UserError:
        return False


def shard_paths(folder: str | Path) -> list[Path]:
    """The files of a folder of packed clips, in order.

    Raises:
        UserError: there is no such folder, a file is missing, or one is not as the manifest has it.
    """
    folder = Path(folder)
    manifest = _manifest(folder)
    files = manifest.get("files")
    if manifest.get("kind") != KIND or manifest.get("schema") != SCHEMA or not isinstance(files, dict) or not files:
        raise UserError(folder, "is not a folder of packed clips", "make one with 'refine data import'")
    for name, file in files.items():
        if not SHARD.fullmatch(name) or not isinstance(file, dict):
            raise UserError(folder / MANIFEST, f"names a file that is none of clips ({name[:40]!r})", REMEDY)
        if not (folder / name).is_file() or (folder / name).is_symlink():
            raise UserError(folder / name, "is missing", REMEDY)
        if _sha256(folder / name) != file.get("sha256"):
            raise UserError(folder / name, "was changed since it was written", REMEDY)
    return [folder / name for name in sorted(files)]


def _manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    if not path.exists():
        raise UserError(folder, "is not a folder of packed clips", "make one with 'refine data import'")
    manifest = read_json(path, MANIFEST_BYTES)
    if not isinstance(manifest, dict):
        raise UserError(path, "is not a manifest", REMEDY)
    return manifest


def _sha256(path: Path) -> str:
    with opened(path, MAX_BYTES + ABOUT_BYTES) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _hash(files: dict[str, dict[str, Any]]) -> str:
    """SHA-256 of the hashes of all files."""
    return hashlib.sha256("".join(f"{files[name]['sha256']} {name}\n" for name in sorted(files)).encode()).hexdigest()


# --- one file --------------------------------------------------------------------------------------------------------


def _load_file(path: Path) -> list[Motion]:
    arrays = read_npz(path, KEYS + SHAPE_KEYS, MAX_BYTES + ABOUT_BYTES)
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise UserError(path, f"is not a file of clips (no '{missing[0]}')", "make one with 'refine data import'")
    lengths = arrays["lengths"]
    arrays.setdefault("betas", np.zeros((len(lengths), 0), np.float32) if lengths.ndim else lengths)
    arrays.setdefault("genders", np.full(lengths.shape, "neutral"))
    try:
        sizes = check_shapes(
            "clips",
            six=(arrays["six"], "N 24 6"),
            root=(arrays["root"], "N 3"),
            lengths=(lengths, "C"),
            betas=(arrays["betas"], "C B"),
            **{key: (arrays[key], "C") for key in ("fps", "labels", "sources", "genders")},
        )
    except ShapeError as error:
        raise UserError(path, f"is damaged ({error})", REMEDY) from error
    kinds = "".join(arrays[key].dtype.kind for key in KEYS + SHAPE_KEYS)
    fits = kinds == "ffifUUfU" and not np.isinf(arrays["betas"]).any()
    # Each length is held against the sum before they are summed, so that none overflows.
    if not fits or not (1 <= lengths.min(initial=1) <= lengths.max(initial=1) <= sizes["N"] == lengths.sum()):
        raise UserError(path, "is damaged (lengths or types do not fit)", REMEDY)
    rotations = _rotations(torch.from_numpy(arrays["six"])).split(lengths.tolist())
    roots = torch.from_numpy(arrays["root"]).split(lengths.tolist())
    rest = zip(
        *(arrays[key].tolist() for key in ("fps", "labels", "sources")),
        map(_betas, arrays["betas"]),
        arrays["genders"].tolist(),
        strict=True,
    )
    return [Motion(*clip, *about) for *clip, about in zip(rotations, roots, rest, strict=True)]


def _padded(betas: Iterable[np.ndarray | None]) -> np.ndarray:
    """[C B] float32, rows filled up with NaN."""
    rows = [np.zeros(0, np.float32) if row is None else row for row in betas]
    padded = np.full((len(rows), max(map(len, rows))), np.nan, np.float32)
    for row, values in zip(padded, rows, strict=True):
        row[: len(values)] = values
    return padded


def _betas(row: np.ndarray) -> Tensor | None:
    known = row[~np.isnan(row)]
    return torch.from_numpy(known) if len(known) else None


def _rotations(six: Tensor) -> Tensor:
    """[N 24 6] -> [N 24 3 3]. Rows that are orthonormal but for rounding stay as they are stored, so that what is read
    has the very features that were written."""
    rotations = matrix_from_6d(six)
    rows = six.reshape(*six.shape[:-1], 2, 3)
    sound = ((rotations[..., :2, :] - rows).abs() < 1e-5).all(-1).all(-1)[..., None, None]
    rotations[..., :2, :] = torch.where(sound, rows, rotations[..., :2, :])
    return rotations
