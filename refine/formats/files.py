"""Motions from any file, and to any file."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from torch import Tensor

from refine.formats.actor import read_humanact
from refine.formats.amass import read_amass, write_amass
from refine.formats.asf_amc import read_amc
from refine.formats.bvh import Bvh, read_bvh, write_bvh
from refine.formats.clips import is_packed, load_clips
from refine.formats.fbx import blender_python, write_fbx
from refine.formats.glb import write_glb
from refine.formats.glb_read import read_glb
from refine.formats.joints import read_joints, write_joints
from refine.formats.motion_json import read_motion_json, write_motion_json
from refine.formats.untrusted import kind_of
from refine.motion import Motion
from refine.skeletons.mapping import mapping_of, read_mapping
from refine.skeletons.retarget import retarget
from renderers.body import Body
from renderers.checks import UserError
from renderers.outputs import refuse_existing

# Bandai-Namco: dataset-2_walk-turn-left_active_001 is action, style, number.
NAMED_LIKE_BANDAI_NAMCO = re.compile(r"dataset-\d+_(?P<label>[^_]+)_[^_]+_\d+")
NUMBERED = re.compile(r"(?P<label>.*?)[\s_.-]*\d*")


@dataclass(frozen=True)
class Reading:
    """What a person may say about a file that the file does not say."""

    unit: str | None = None
    """Unit of length, "m", "cm", "mm" or "in"; none guesses it from the height of the body."""
    fps: float | None = None
    """Frame rate, for files that have none."""
    mapping: Path | None = None
    """JSON file that says which joint of the file is which of ours, as `refine data inspect` writes it."""
    up: str | None = None
    """Axis that points up, "y" or "z"; none looks for it in skeletons, and takes z for AMASS-style files and y for
    joints."""


def read_one_bvh(path: Path, rest_joints: Tensor, reading: Reading) -> list[Motion]:
    return [mapped(read_bvh(path, reading.unit), rest_joints, reading)]


def mapped(bvh: Bvh, rest_joints: Tensor, reading: Reading) -> Motion:
    """A skeleton's motion on a body, by the mapping and the axis that a person gave, or by those that are found."""
    mapping = read_mapping(reading.mapping) if reading.mapping else mapping_of(bvh)
    return retarget(bvh, rest_joints, replace(mapping, up=reading.up) if reading.up else mapping)


def read_one_amc(path: Path, rest_joints: Tensor, reading: Reading) -> list[Motion]:
    return [mapped(read_amc(path, reading.fps, reading.unit), rest_joints, reading)]


def read_one_asf(path: Path, _rest_joints: Tensor, _reading: Reading) -> list[Motion]:
    raise UserError(path, "is a skeleton without a motion", "give the .amc file that lies beside it")


def read_one_npz(path: Path, _rest_joints: Tensor, reading: Reading) -> list[Motion]:
    return load_clips(path) if is_packed(path) else [read_amass(path, reading.up or "z", reading.fps)]


def read_one_glb(path: Path, rest_joints: Tensor, reading: Reading) -> list[Motion]:
    # By the standard y is up; who says otherwise knows better.
    onto = replace(reading, up=reading.up or "y")
    return read_glb(path, rest_joints, reading.fps, lambda bvh: mapped(bvh, rest_joints, onto))


def read_one_npy(path: Path, rest_joints: Tensor, reading: Reading) -> list[Motion]:
    return [read_joints(path, rest_joints, reading.fps, reading.up or "y").motion]


def read_one_pickle(path: Path, rest_joints: Tensor, _reading: Reading) -> list[Motion]:
    return read_humanact(path, rest_joints)


# By what a file holds, see `kind_of`.
READERS: dict[str, Callable[[Path, Tensor, Reading], list[Motion]]] = {
    "bvh": read_one_bvh,
    "amc": read_one_amc,
    "asf": read_one_asf,
    "npz": read_one_npz,
    "glb": read_one_glb,
    "gltf": read_one_glb,
    "npy": read_one_npy,
    "pickle": read_one_pickle,
    "json": lambda path, _rest_joints, _reading: [read_motion_json(path)],
}
READ_SUFFIXES = (".bvh", ".npz", ".amc", ".glb", ".gltf", ".npy", ".json")
# By suffix.
WRITERS: dict[str, Callable[[Path, Motion, Body], None]] = {
    ".bvh": lambda path, motion, body: write_bvh(path, motion, body.rest_joints),
    ".npz": lambda path, motion, _body: write_amass(path, motion),
    ".glb": write_glb,
    ".fbx": write_fbx,
    ".npy": write_joints,
    ".json": write_motion_json,
}
SUFFIXES = tuple(WRITERS)
KNOWN = f"known are {' and '.join(SUFFIXES)}"


def load_motions(path: str | Path, rest_joints: Tensor, reading: Reading | None = None) -> list[Motion]:
    """Read every motion of a file onto a body with T-pose joints [24 3] in metres.

    What the file holds decides, not what it is called. A motion that carries no label is labelled after the file's
    name.

    Raises:
        UserError: the file is missing, empty, of another kind or broken; the message says where.
    """
    path = Path(path)
    kind = kind_of(path)
    if kind not in READERS:
        raise UserError(path, "is not a motion file", f"known are {' and '.join(READ_SUFFIXES)}")
    with np.errstate(all="ignore"):  # what is not finite is refused by name, without a warning before
        motions = READERS[kind](path, rest_joints, reading or Reading())
    return [motion if motion.label else replace(motion, label=label_from_name(path)) for motion in motions]


def load_motion(path: str | Path, rest_joints: Tensor, reading: Reading | None = None) -> Motion:
    """The one motion of a file, see :func:`load_motions`.

    Raises:
        UserError: the same, or the file holds several.
    """
    motions = load_motions(path, rest_joints, reading)
    if len(motions) > 1:
        names = ", ".join(motion.label for motion in motions[:4])
        raise UserError(path, f"holds {len(motions)} motions ({names}...)", "pack them with `refine data import`")
    return motions[0]


def save_motion(motion: Motion, path: str | Path, body: Body, force: bool = False) -> None:
    """Write a motion of a body in the format of the suffix; folders are made.

    Raises:
        UserError: the suffix is not known, the file exists and ``force`` is not set, or it cannot be written.
    """
    path = Path(path)
    check_suffix(path)
    refuse_existing(path, force)
    WRITERS[path.suffix.lower()](path, motion, body)


def check_suffix(path: str | Path) -> None:
    """Refuse, before any work is done, a name that :func:`save_motion` would refuse after it."""
    if Path(path).suffix.lower() not in WRITERS:
        raise UserError(path, f"no motion format has the suffix '{Path(path).suffix}'", KNOWN)
    if Path(path).suffix.lower() == ".fbx":
        blender_python()


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
