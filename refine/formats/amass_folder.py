"""AMASS as it lies on disk: files found by the names that annotations have for them, at their true frame rates."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np
import torch

from refine.formats.amass import read_amass
from refine.motion import Motion, resample
from renderers.checks import UserError

# Subsets by the names that annotations use, and those of later releases of AMASS.
RENAMED = {
    "BioMotionLab_NTroje": "BMLrub",
    "DFaust_67": "DFaust",
    "Eyes_Japan_Dataset": "EyesJapanDataset",
    "MPI_HDM05": "HDM05",
    "MPI_Limits": "PosePrior",
    "MPI_mosh": "MoSh",
    "SSM_synced": "SSM",
    "TCD_handMocap": "TCDHands",
    "Transitions_mocap": "Transitions",
}
SUFFIX = ".npz"
POSES, STAGE_TWO = "_poses", "_stageii"  # ends of names, of SMPL-H's files and of SMPL-X's
TRUE_RATES = {"BMLhandball": 240.0, "20160930_50032": 59.0, "20161014_50033": 59.0}
"""Frame rates of files that state wrong ones, by a part of their path."""
LONGEST = 1 << 20
"""Frames that a motion may have; nine hours at 30 a second."""
MAX_PARTS, MAX_LETTERS = 20, 200  # of a path, and of each part of it
NAMED = 5
"""How many missing files are named."""


@dataclass
class AmassFolder:
    """Motions by the names that annotations have for them; which are asked for and not there is kept.

    Attributes:
        folder: what has the subsets in it (ACCAD, BMLmovi, CMU, KIT and so on), from any release.
        fps: frame rate that motions are brought to.
        nearest_lower: take every frame from the file's frame before it, and none in between, as SINC's published code
            does; else rotations go by slerp and the path linearly.
        found: how many motions were there.
        missing: names of those that were not.
    """

    folder: Path
    fps: float = 30.0
    nearest_lower: bool = False
    found: int = 0
    missing: dict[str, None] = field(default_factory=dict)

    def motion(self, name: str) -> Motion | None:
        """The motion of that name, without or with ``.npz``; none where there is no such file.

        Raises:
            UserError: the name leads out of the folder, or the file cannot be read.
        """
        path = find_amass(self.folder, name)
        if path is None:
            self.missing[name] = None
            return None
        self.found += 1
        motion = read_amass(path)
        for part, rate in TRUE_RATES.items():
            if part in name:
                motion = replace(motion, fps=rate)
        if motion.seconds * self.fps > LONGEST:
            problem = f"lasts {motion.seconds:,.0f} s at {motion.fps:g} frames a second"
            raise UserError(path, problem, "mend its frame rate")
        lower = self.nearest_lower and motion.fps > self.fps
        return without_between(motion, self.fps) if lower else resample(motion, self.fps)

    def report(self) -> Iterator[str]:
        """One line on what was missing, if anything was.

        Raises:
            UserError: everything was.
        """
        if not self.missing:
            return
        names = ", ".join(list(self.missing)[:NAMED]) + (" ..." if len(self.missing) > NAMED else "")
        line = f"motion files that are not there: {len(self.missing):,} ({names})"
        if not self.found:
            raise UserError(self.folder, line, "name the folder of AMASS that has ACCAD, CMU, KIT and so on in it")
        yield line


def find_amass(folder: Path, name: str) -> Path | None:
    """The file of a motion, whatever release of AMASS the folder is of.

    BABEL's names have the archive's folder before the subset's (``BMLrub/BioMotionLab_NTroje/rub001/...``), others
    have none; later releases call subsets otherwise, and SMPL-X's files end in another word.

    Raises:
        UserError: the name leads out of the folder.
    """
    parts = PurePosixPath(name.removesuffix(SUFFIX)).parts
    if not 0 < len(parts) <= MAX_PARTS or not all(_is_name(part) for part in parts):
        raise UserError(name[:100] or "''", "is no name of a motion file", "mend the annotation")
    for head, tail in _ways(parts):
        for stem in dict.fromkeys((tail[-1], tail[-1].removesuffix(POSES) + STAGE_TWO)):
            path = folder.joinpath(*head, *tail[:-1], stem + SUFFIX)
            if path.is_file():
                return path
    return None


def _is_name(part: str) -> bool:
    return part != ".." and len(part) <= MAX_LETTERS and part.isprintable() and not set(part) & set("/\\")


def without_between(motion: Motion, fps: float) -> Motion:
    """A lower frame rate as SINC's published code makes it: ``int(T * fps / motion.fps)`` frames of the clip, evenly
    spread from the first to the last, each rounded down to one that is there."""
    frames = max(1, int(fps / motion.fps * len(motion)))
    at = torch.from_numpy(np.linspace(0, len(motion) - 1, frames, dtype=int))  # torch's rounds otherwise
    return replace(motion, rotations=motion.rotations[at], root=motion.root[at], fps=fps)


def _ways(parts: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Folders of the subset that a file may lie in, and the rest of its path."""
    yield (), parts
    if len(parts) < 2:
        return
    archived = len(parts) > 2 and (parts[1] in RENAMED or parts[0] == parts[1])
    subset, tail = (parts[1], parts[2:]) if archived else (parts[0], parts[1:])
    later = RENAMED.get(subset, subset)
    for head in ((subset,), (later,), (subset, subset), (later, subset), (later, later)):
        yield head, tail
    yield (), parts[1:]
