"""Benchmarks: frozen sets of single actions and of their compositions, which a manifest holds to their hashes.

A folder holds ``manifest.json`` and packed clips: ``train.npz`` and ``test.npz``, whole single actions that share no
clip; ``extra.npz``, where there is one, more single actions for recognisers to learn; ``mask.npz``, compositions of the
test clips by their energies (LFCA, Eq. 3); and ``true.npz``, where both actions can be performed at once, the same
pairs so composed. Other files in the folder are nobody's business here.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from refine.formats.clips import load_clips
from refine.formats.untrusted import MAX_ARRAYS, read_bytes, read_json
from refine.motion import Motion
from renderers.checks import UserError, check_known

SCHEMA = 1
MANIFEST = "manifest.json"
SPLITS = ("train", "test", "extra")
COMPOSITIONS = ("mask", "true")
REMEDY = "build it again with `refine data benchmark`"


@dataclass(frozen=True, eq=False)
class Benchmark:
    """A benchmark on disk, whose files are those of its manifest."""

    name: str
    folder: Path
    fps: float
    frames: int
    lower: tuple[str, ...]
    upper: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    manifest: dict[str, Any]

    def clips(self, split: str) -> list[Motion]:
        """Whole single actions of "train", "test" or "extra"; there may be no extra ones."""
        check_known("clips(split)", split, SPLITS)
        return load_clips(self.folder / f"{split}.npz") if f"{split}.npz" in self.manifest["files"] else []

    def compositions(self, kind: str) -> list[Motion]:
        """Compositions of the test clips, ``frames`` long each, labelled "i+j", by pair and then by number.

        Args:
            kind: "mask" for those by energies, "true" for both actions performed at once, the same pairs and moments.

        Raises:
            UserError: an unknown kind, or true compositions of real clips.
        """
        check_known("compositions(kind)", kind, COMPOSITIONS)
        if kind == "true" and not self.has_true:
            raise UserError(self.folder, "has no true compositions", "only synth-c has; take those by energies")
        return load_clips(self.folder / f"{kind}.npz")

    @property
    def has_true(self) -> bool:
        return "true.npz" in self.manifest["files"]

    @property
    def hash(self) -> str:
        """SHA-256 of the hashes of all files."""
        files = self.manifest["files"]
        return sha256("".join(f"{files[name]['sha256']} {name}\n" for name in sorted(files)).encode())


def load_benchmark(folder: str | Path) -> Benchmark:
    """Read a benchmark's manifest and compare every file with it.

    Raises:
        UserError: there is no benchmark, or it was changed; the file is named.
    """
    folder = Path(folder)
    path = folder / MANIFEST
    if not path.exists():
        raise UserError(folder, "holds no benchmark (no manifest.json)", REMEDY)
    try:
        manifest = read_json(path)
        if manifest["schema"] != SCHEMA:
            raise UserError(path, f"has schema {manifest['schema']}, not {SCHEMA}", REMEDY)
        sealed = manifest.pop("sha256")
        if sealed != seal(manifest):
            raise UserError(path, "was changed since it was built", REMEDY)
        hashes = {name: file["sha256"] for name, file in manifest["files"].items()}
        benchmark = Benchmark(
            name=manifest["name"],
            folder=folder,
            fps=manifest["fps"],
            frames=manifest["frames"],
            lower=tuple(manifest["lower"]),
            upper=tuple(manifest["upper"]),
            pairs=tuple((i, j) for i, j in manifest["pairs"]),
            manifest=manifest,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise UserError(path, "is not a benchmark's manifest", REMEDY) from error
    for name, sealed in hashes.items():
        if Path(name).name != name:
            raise UserError(path, f"names a file outside of its folder ({name[:60]!r})", REMEDY)
        if not (folder / name).is_file():
            raise UserError(folder / name, "is missing", REMEDY)
        if sha256(read_bytes(folder / name, MAX_ARRAYS)) != sealed:
            raise UserError(folder / name, "was changed since the benchmark was built", REMEDY)
    return benchmark


def seal(manifest: dict[str, Any]) -> str:
    """SHA-256 of what a manifest says, however it is laid out."""
    return sha256(json.dumps(manifest, sort_keys=True).encode())


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
