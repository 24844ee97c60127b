"""One motion from any file, and to any file."""

import re
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from refine.formats.amass import read_amass, write_amass
from refine.formats.bvh import read_bvh, write_bvh
from refine.motion import Motion
from refine.retarget import retarget
from renderers.checks import UserError
from renderers.outputs import refuse_existing

WRITERS = {".bvh": write_bvh, ".npz": lambda path, motion, _rest_joints: write_amass(path, motion)}
SUFFIXES = tuple(WRITERS)
KNOWN = f"known are {' and '.join(SUFFIXES)}"

ZIP_MAGIC = b"PK\x03\x04"
# Bandai-Namco: dataset-2_walk-turn-left_active_001 is action, style, number.
NAMED_LIKE_BANDAI_NAMCO = re.compile(r"dataset-\d+_(?P<label>[^_]+)_[^_]+_\d+")
NUMBERED = re.compile(r"(?P<label>.*?)[\s_.-]*\d*")


def load_motion(path: str | Path, rest_joints: Tensor) -> Motion:
    """Read a .bvh of a known skeleton or an AMASS-style .npz onto a body with T-pose joints [24 3] in metres.

    What the file holds decides, not what it is called. A file that carries no label is labelled after its name.

    Raises:
        UserError: the file is missing, empty, of another kind or broken; the message says where.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(64)
    except OSError as error:
        raise UserError(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not start.strip():
        raise UserError(path, "is empty", "give a motion file")
    if start.startswith(ZIP_MAGIC):
        motion = read_amass(path)
    elif b"HIERARCHY" in start.upper() or path.suffix.lower() == ".bvh":
        motion = retarget(read_bvh(path), rest_joints)
    else:
        raise UserError(path, "is not a motion file", KNOWN)
    return motion if motion.label else replace(motion, label=label_from_name(path))


def save_motion(motion: Motion, path: str | Path, rest_joints: Tensor, force: bool = False) -> None:
    """Write a motion in the format of the suffix, on a skeleton with T-pose joints [24 3] in metres; folders are made.

    Raises:
        UserError: the suffix is not known, the file exists and ``force`` is not set, or it cannot be written.
    """
    path = Path(path)
    check_suffix(path)
    refuse_existing(path, force)
    WRITERS[path.suffix.lower()](path, motion, rest_joints)


def check_suffix(path: str | Path) -> None:
    """Refuse, before any work is done, a name that :func:`save_motion` would refuse after it."""
    if Path(path).suffix.lower() not in WRITERS:
        raise UserError(path, f"no motion format has the suffix '{Path(path).suffix}'", KNOWN)


def label_from_name(path: str | Path, pattern: re.Pattern[str] | None = None) -> str:
    """The action a file name tells: ``pattern``'s group ``label``, else Bandai-Namco's, else all before a last number.

    >>> label_from_name("dataset-2_walk-turn-left_active_001.bvh"), label_from_name("wave both_02.bvh")
    ('walk-turn-left', 'wave both')
    """
    stem = Path(path).stem
    for known in (pattern, NAMED_LIKE_BANDAI_NAMCO, NUMBERED):
        match = known.fullmatch(stem) if known else None
        if match and match["label"]:
            return match["label"]
    return stem
