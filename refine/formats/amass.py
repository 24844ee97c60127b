"""AMASS-style .npz files in and out, which is also this project's own file for one motion.

On disk z is up and a standing figure whose root is turned by 90 degrees about x faces -y; inside y is up and it faces
+z. The two frames differ by one rotation about x and nothing else, so left stays left (protocol A.5). Files that look
like AMASS's but have y up are read as such only where that is said; their bodies lie on their faces otherwise.

``trans`` is SMPL's translation: the pelvis joint, in the frame of the file, less its position in SMPL's own T-pose,
whose origin is near the chest. That position is taken from SMPL's mean body whatever the body here, so that heights are
those of the file and other programs find our pelvis where we had it.

SMPL (72 numbers a frame), SMPL-H (156) and SMPL-X (165) share their first 22 joints. Fingers, jaws and eyes are not
kept: a hand is one joint here, which turns four fingers.
"""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.npz import read_npz
from refine.motion import Motion
from renderers.checks import UserError, check_finite, check_known
from renderers.outputs import replacing
from renderers.rotations import axis_angle_to_matrix, matrix_to_axis_angle, rotation_about
from renderers.skeleton import JOINT_NAMES

BODY = 22  # joints that SMPL, SMPL-H and SMPL-X share; SMPL's two hands come after them
# Where the four fingers' first joints stand in ``poses`` of each width, left hand and right hand. SMPL's hand joint
# turns all fingers, so it is written to the four and read from the second, the middle finger.
FINGERS = {
    72: ((22,), (23,)),
    156: ((22, 25, 28, 31), (37, 40, 43, 46)),
    165: ((25, 28, 31, 34), (40, 43, 46, 49)),
}
MODELS = {"smpl": 72, "smplh": 156, "smplx": 165}
SMPLX_NAME = "_stageii"
MIDDLE_FINGERS = (3, 18)  # among the 30 joints of ``pose_hand``
PELVIS = (-0.0018, -0.2233, 0.0282)  # of SMPL's mean neutral body at rest, metres
RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")
KEYS = ("poses", "root_orient", "pose_body", "pose_hand", "trans", "label", *RATE_KEYS)
SHAPE_KEYS = ("betas", "gender")
GENDERS = ("neutral", "female", "male")
MAX_BETAS = 400  # SMPL-X has the most
BETAS, DYNAMICS = 16, 8  # numbers of shape and of soft tissue that AMASS's programs expect


def read_amass(path: str | Path, up: str = "z", fps: float | None = None) -> Motion:
    """Read poses, path and frame rate, and the shape of the body if it is there.

    Poses are ``poses`` [T 72, 156 or 165], or ``root_orient`` [T 3] with ``pose_body`` [T 63] and maybe ``pose_hand``
    [T 90]; the path is ``trans``; a shape is ``betas``, of any number, with ``gender``.

    Args:
        up: the axis of the file that points up, "z" or "y".
        fps: frame rate, for a file that has none.

    Raises:
        UserError: the file is not safe to read, lacks one of these, or holds values that are not finite.
    """
    check_known("--up", up, ("y", "z"))
    arrays = read_npz(path, KEYS)
    axis_angles = _axis_angles(path, arrays)
    trans = _numbers(path, arrays, "trans")
    if trans.shape != (len(axis_angles), 3):
        raise UserError(
            path, f"trans has shape {list(trans.shape)}, poses have {len(axis_angles)} frames", "mend the file"
        )
    rate = _rate(path, arrays, fps)
    check_finite(path, axis_angles, "frame joint coordinate", {"joint": JOINT_NAMES})
    check_finite(path, trans, "frame coordinate")
    rotations = axis_angle_to_matrix(torch.from_numpy(axis_angles))
    upright = _upright() if up == "z" else torch.eye(3, dtype=torch.float64)
    rotations[:, 0] = upright @ rotations[:, 0]
    root = torch.from_numpy(trans + PELVIS) @ upright.mT
    betas, gender = _shape(path)
    return Motion(rotations.float(), root.float(), rate, _text(arrays.get("label")), str(path), betas, gender)


def write_amass(path: str | Path, motion: Motion, model: str | None = None) -> None:
    """Write a motion, with both spellings of the frame rate and a shape of at least 16 numbers.

    SMPL-H's layout (156 wide) is what programs for AMASS read. The SMPL-X add-on for Blender asks for all 55 joints of
    SMPL-X (165 wide), which are written as AMASS's own SMPL-X files are, body and hands apart as well.

    Args:
        model: "smpl", "smplh" or "smplx"; none goes by the name, as AMASS's files are named: SMPL-X for what ends in
            ``_stageii.npz``, else SMPL-H.

    Raises:
        UserError: another model, or the file cannot be written.
    """
    model = model or ("smplx" if Path(path).stem.endswith(SMPLX_NAME) else "smplh")
    check_known("write_amass(model)", model, MODELS)
    width = MODELS[model]
    upright = _upright()
    rotations = motion.rotations.detach().to("cpu", torch.float64, copy=True)
    rotations[:, 0] = upright.mT @ rotations[:, 0]
    axis_angles = matrix_to_axis_angle(rotations)
    poses = torch.zeros(len(motion), width // 3, 3, dtype=torch.float64)
    poses[:, :BODY] = axis_angles[:, :BODY]
    for hand, fingers in enumerate(FINGERS[width], start=BODY):
        poses[:, list(fingers)] = axis_angles[:, hand, None]
    poses = poses.reshape(len(motion), -1).numpy()
    betas = np.zeros(BETAS) if motion.betas is None else motion.betas.detach().cpu().double().numpy()
    arrays = {
        "poses": poses,
        "trans": (motion.root.detach().cpu().double() @ upright).numpy() - PELVIS,
        "betas": np.pad(betas, (0, max(0, BETAS - len(betas)))),
        "gender": np.array(motion.gender),
        "surface_model_type": np.array(model),
        "label": np.array(motion.label),
        **dict.fromkeys(RATE_KEYS[:2], np.float64(motion.fps)),
    }
    if model == "smplh":
        arrays["dmpls"] = np.zeros((len(motion), DYNAMICS))
    if model == "smplx":
        parts = {"root_orient": 3, "pose_body": 63, "pose_jaw": 3, "pose_eye": 6, "pose_hand": 90}
        ends = np.cumsum(list(parts.values()))[:-1]
        arrays |= dict(zip(parts, np.split(poses, ends, axis=1), strict=True))
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _rate(path: str | Path, arrays: dict[str, np.ndarray], fps: float | None) -> float:
    for key in RATE_KEYS:
        rate = arrays.get(key)
        if rate is not None and rate.dtype.kind in "fiu" and rate.size == 1 and 0 < rate.item() < math.inf:
            return float(rate.item())
    if fps is not None:
        return fps
    raise UserError(path, f"has no frame rate ({' or '.join(RATE_KEYS[:2])})", "add one, or say it with --fps")


def _shape(path: str | Path) -> tuple[Tensor | None, str]:
    """``betas`` [B], none if there are no usable ones, and the gender. Neither is needed: what cannot be read is left
    out, such as text that was stored as Python objects."""
    found = {}
    for key in SHAPE_KEYS:
        try:
            found |= read_npz(path, (key,))
        except UserError:
            continue
    gender = _text(found.get("gender")).lower()
    gender = gender if gender in GENDERS else "neutral"
    betas = found.get("betas", np.zeros(0))
    if betas.ndim == 2 and len(betas):  # one shape a frame, which is the same in all
        betas = betas[0]
    if betas.dtype.kind not in "fiu" or betas.ndim != 1 or not 0 < len(betas) <= MAX_BETAS:
        return None, gender
    shape = torch.from_numpy(betas.astype(np.float64)).float()
    return shape if shape.isfinite().all() else None, gender


def _text(stored: np.ndarray | None) -> str:
    """The text of an array that holds one, else none."""
    if stored is None or stored.size != 1:
        return ""
    text = stored.item()
    text = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    return text.strip() if isinstance(text, str) else ""


def _upright() -> Tensor:
    """The rotation [3 3] from the file's frame (z up) to ours (y up)."""
    return rotation_about("x", torch.tensor(-math.pi / 2, dtype=torch.float64))


def _axis_angles(path: str | Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """[T 24 3] radians."""
    if "poses" not in arrays:
        return _apart(path, arrays)
    poses = _numbers(path, arrays, "poses")
    if poses.ndim != 2 or poses.shape[1] not in FINGERS:
        known = ", ".join(map(str, FINGERS))
        raise UserError(path, f"poses have shape {list(poses.shape)}", f"give frames by one of {known}")
    joints = poses.reshape(len(poses), poses.shape[1] // 3, 3)
    left, right = (fingers[min(1, len(fingers) - 1)] for fingers in FINGERS[poses.shape[1]])
    return joints[:, [*range(BODY), left, right]]


def _apart(path: str | Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """[T 24 3] radians from root, body and hands stored apart."""
    root, body = (_numbers(path, arrays, key) for key in ("root_orient", "pose_body"))
    if body.ndim != 2 or body.shape[1] < 3 * (BODY - 1) or root.shape != (len(body), 3):
        problem = f"root_orient {list(root.shape)} and pose_body {list(body.shape)} do not fit"
        raise UserError(path, problem, "give frames by 3 and frames by 63")
    hands = np.zeros((len(body), 2, 3))
    if "pose_hand" in arrays:
        fingers = _numbers(path, arrays, "pose_hand")
        if fingers.shape != (len(body), 90):
            raise UserError(path, f"pose_hand has shape {list(fingers.shape)}", "give frames by 90, or leave it out")
        hands = fingers.reshape(len(body), 30, 3)[:, list(MIDDLE_FINGERS)]
    joints = np.concatenate([root, body[:, : 3 * (BODY - 1)]], axis=1).reshape(len(body), BODY, 3)
    return np.concatenate([joints, hands], axis=1)


def _numbers(path: str | Path, arrays: dict[str, np.ndarray], key: str) -> np.ndarray:
    if key not in arrays or arrays[key].dtype.kind not in "fiu":
        raise UserError(path, f"has no array of numbers '{key}'", "give an AMASS-style .npz with poses and trans")
    return arrays[key].astype(np.float64)
