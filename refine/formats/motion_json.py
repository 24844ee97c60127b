"""A motion as JSON, for programs that read nothing else.

One object: ``format`` ("refine-motion"), ``version`` (1), ``fps``, ``label``, ``gender``, ``joints`` (names),
``parents`` (-1 for the root), ``rest_joints`` [24][3] in metres, ``root`` [T][3] world positions of the pelvis in
metres with y up, ``rotations`` [T][24][4] unit quaternions (w, x, y, z) relative to the T-pose, each joint's in its
parent's frame, and ``betas`` where a shape is known. Quaternions keep their sign along the time.
"""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from refine.formats.untrusted import parse_json, read_bytes
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.outputs import replacing
from renderers.rotations import continuous, matrix_to_quaternion, quaternion_to_matrix
from renderers.skeleton import JOINT_NAMES, PARENTS

FORMAT, VERSION = "refine-motion", 1
MAX_BYTES = 1 << 24  # some 15,000 frames
DENSEST = 8  # bytes a bracket: a motion's lists are longer, and empty ones would take many times their size
DIGITS = 7
GENDERS = ("neutral", "female", "male")
REMEDY = "write it again with `refine export`"


def write_motion_json(path: str | Path, motion: Motion, body: Body) -> None:
    """Write a motion; lengths and quaternions have seven decimals.

    Raises:
        UserError: it is longer than what is read again.
    """
    quaternions = continuous(matrix_to_quaternion(motion.rotations.detach().cpu().double()))
    found = {
        "format": FORMAT,
        "version": VERSION,
        "fps": motion.fps,
        "label": motion.label,
        "gender": motion.gender,
        "joints": list(JOINT_NAMES),
        "parents": list(PARENTS),
        "rest_joints": _rounded(body.rest_joints),
        "root": _rounded(motion.root),
        "rotations": _rounded(quaternions),
    }
    if motion.betas is not None:
        found["betas"] = _rounded(motion.betas)
    text = json.dumps(found, separators=(",", ":"), allow_nan=False) + "\n"
    if len(text) > MAX_BYTES:
        raise UserError(path, f"would have {len(text):,} bytes, more than the {MAX_BYTES:,} that are read", "cut it")
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def read_motion_json(path: str | Path) -> Motion:
    """Read what :func:`write_motion_json` wrote.

    Raises:
        UserError: it is not that, of another version, or holds shapes or values that cannot be.
    """
    content = read_bytes(path, MAX_BYTES)
    if content.count(b"[") + content.count(b"{") > 64 + len(content) / DENSEST:
        raise UserError(path, "is JSON, but no motion", REMEDY)
    found = parse_json(path, content)
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise UserError(path, "is JSON, but no motion", f'one has "format": "{FORMAT}"; {REMEDY}')
    if found.get("version") != VERSION:
        raise UserError(path, f"is of version {str(found.get('version'))[:20]}, and {VERSION} is read", REMEDY)
    if found.get("joints") != list(JOINT_NAMES):
        raise UserError(path, "names other joints than SMPL's 24", REMEDY)
    fps, label, gender = (found.get(key) for key in ("fps", "label", "gender"))
    if type(fps) not in (int, float) or not abs(fps) < 1e9 or not isinstance(label, str) or gender not in GENDERS:
        raise UserError(path, "has no fps, label or gender that could be one", REMEDY)
    root = _numbers(path, found, "root", (3,))
    quaternions = _numbers(path, found, "rotations", (len(JOINT_NAMES), 4))
    if len(root) != len(quaternions):
        raise UserError(path, f"has {len(root)} places and {len(quaternions)} poses", REMEDY)
    lengths = quaternions.norm(dim=-1)
    if not ((lengths - 1).abs() < 1e-3).all():  # NaN is refused too
        raise UserError(path, "has rotations that are no unit quaternions", REMEDY)
    rotations = quaternion_to_matrix(quaternions / lengths[..., None])
    betas = _numbers(path, found, "betas", ()).float() if "betas" in found else None
    return Motion(rotations.float(), root.float(), float(fps), label, str(path), betas, gender)


def _rounded(values: Tensor) -> Any:
    scale = 10.0**DIGITS
    return ((values.detach().cpu().double() * scale).round() / scale).tolist()


def _numbers(path: str | Path, found: dict, key: str, shape: tuple[int, ...]) -> Tensor:
    """[N *shape] float64."""
    rows = found.get(key)
    if not isinstance(rows, list) or not rows or not all(_fits(row, shape) for row in rows):
        size = " by ".join(map(str, ("frames", *shape)))
        raise UserError(path, f"'{key}' is no list of finite numbers, {size}", REMEDY)
    return torch.tensor(rows, dtype=torch.float64)


def _fits(value: Any, shape: tuple[int, ...]) -> bool:
    if not shape:
        return type(value) in (int, float) and abs(value) < 1e9  # NaN and infinity are not
    return isinstance(value, list) and len(value) == shape[0] and all(_fits(one, shape[1:]) for one in value)
