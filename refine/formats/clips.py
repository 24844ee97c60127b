"""Many labelled clips in one .npz: what training reads, and how a folder of motion files becomes one."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.files import READ_SUFFIXES, label_from_name, load_motion
from refine.formats.npz import MAX_BYTES, read_npz
from refine.motion import Motion
from renderers.checks import ShapeError, UserError, check_shapes
from renderers.outputs import replacing
from renderers.rotations import matrix_from_6d

KEYS = ("six", "root", "lengths", "fps", "labels", "sources")
FRAME_BYTES = 4 * (24 * 6 + 3)


@dataclass(frozen=True)
class Imported:
    """The clips of a folder, and one error for each file that could not be read."""

    motions: list[Motion]
    refused: list[UserError]


def import_folder(
    folder: str | Path,
    rest_joints: Tensor,
    label_pattern: str | None = None,
    progress: Callable[[Sequence[Path]], Iterable[Path]] = iter,
) -> Imported:
    """Read every motion file under a folder, in the order of their names.

    Args:
        rest_joints: [24 3] T-pose joints in metres.
        label_pattern: a regular expression for the whole file name without suffix, with a group ``label``.
        progress: wraps the list of files, as ``tqdm`` does.

    Raises:
        UserError: the folder has no motion files, none can be read, or the pattern is not one.
    """
    pattern = _pattern(label_pattern)
    folder = Path(folder)
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in READ_SUFFIXES)
    if not paths:
        known = " or ".join(READ_SUFFIXES)
        raise UserError(folder, f"has no files that end in {known}", "give a folder of motion files")
    motions, refused = [], []
    for path in progress(paths):
        try:
            motion = load_motion(path, rest_joints)
        except UserError as error:
            refused.append(error)
            continue
        label = label_from_name(path, pattern) if pattern else motion.label
        motions.append(replace(motion, label=label, source=str(path.relative_to(folder))))
    if not motions:
        raise UserError(folder, f"none of its {len(paths)} motion files can be read", f"the first: {refused[0]}")
    return Imported(motions, refused)


def save_clips(path: str | Path, motions: Sequence[Motion]) -> None:
    """Write clips [T_c 24 6] and [T_c 3] end to end as float32, with their lengths, frame rates, labels and sources."""
    if not motions:
        raise UserError(path, "there are no clips to write", "import some first")
    size = FRAME_BYTES * sum(map(len, motions))
    if size > MAX_BYTES:
        raise UserError(path, f"would take {size:,} bytes, more than the {MAX_BYTES:,} that are read", "choose fewer")
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez(
            stream,
            six=torch.cat([motion.six for motion in motions]).detach().float().cpu().numpy(),
            root=torch.cat([motion.root for motion in motions]).detach().float().cpu().numpy(),
            lengths=np.array([len(motion) for motion in motions]),
            fps=np.array([motion.fps for motion in motions], dtype=np.float64),
            labels=np.array([motion.label for motion in motions]),
            sources=np.array([motion.source for motion in motions]),
        )


def load_clips(path: str | Path) -> list[Motion]:
    """Read what :func:`save_clips` wrote.

    Raises:
        UserError: the file is missing, damaged, or something else.
    """
    arrays = read_npz(path, KEYS)
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise UserError(path, f"is not a file of clips (no '{missing[0]}')", "make one with 'refine data import'")
    lengths = arrays["lengths"]
    try:
        sizes = check_shapes(
            "clips",
            six=(arrays["six"], "N 24 6"),
            root=(arrays["root"], "N 3"),
            lengths=(lengths, "C"),
            **{key: (arrays[key], "C") for key in ("fps", "labels", "sources")},
        )
    except ShapeError as error:
        raise UserError(path, f"is damaged ({error})", "import the clips again") from error
    kinds = "".join(arrays[key].dtype.kind for key in KEYS)
    if kinds != "ffifUU" or lengths.min(initial=1) < 1 or lengths.sum() != sizes["N"]:
        raise UserError(path, "is damaged (lengths or types do not fit)", "import the clips again")
    rotations = _rotations(torch.from_numpy(arrays["six"])).split(lengths.tolist())
    roots = torch.from_numpy(arrays["root"]).split(lengths.tolist())
    rest = zip(arrays["fps"].tolist(), arrays["labels"].tolist(), arrays["sources"].tolist(), strict=True)
    return [Motion(*clip, *about) for *clip, about in zip(rotations, roots, rest, strict=True)]


def _rotations(six: Tensor) -> Tensor:
    """[N 24 6] -> [N 24 3 3]. Rows that are orthonormal but for rounding stay as they are stored, so that what is read
    has the very features that were written."""
    rotations = matrix_from_6d(six)
    rows = six.reshape(*six.shape[:-1], 2, 3)
    sound = ((rotations[..., :2, :] - rows).abs() < 1e-5).all(-1).all(-1)[..., None, None]
    rotations[..., :2, :] = torch.where(sound, rows, rotations[..., :2, :])
    return rotations


def _pattern(text: str | None) -> re.Pattern[str] | None:
    if text is None:
        return None
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise UserError("label pattern", f"'{text}' is not a regular expression ({error})", "mend it") from error
    if "label" not in pattern.groupindex:
        raise UserError("label pattern", f"'{text}' has no group called label", "write (?P<label>...) around the label")
    return pattern
