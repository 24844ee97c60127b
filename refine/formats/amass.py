"""AMASS-style .npz files in and out, which is also this project's own file for one motion.

On disk z is up and a standing figure whose root is turned by 90 degrees about x faces -y; inside y is up and it faces
+z. The two frames differ by one rotation about x and nothing else, so left stays left (protocol A.5). ``trans`` is
SMPL's translation: the pelvis joint, in the frame of the file, less its position in SMPL's own T-pose, whose origin is
near the chest. That position is taken from SMPL's mean body whatever the body here, so that heights are those of the
file and other programs find our pelvis where we had it.
"""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.npz import read_npz
from refine.motion import Motion
from renderers.checks import UserError, check_finite
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
PELVIS = (-0.0018, -0.2233, 0.0282)  # of SMPL's mean neutral body at rest, metres
RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")
KEYS = ("poses", "root_orient", "pose_body", "trans", "label", *RATE_KEYS)


def read_amass(path: str | Path) -> Motion:
    """Read poses, path and frame rate.

    Poses are ``poses`` [T 72, 156 or 165], or ``root_orient`` [T 3] with ``pose_body`` [T 63]; the path is ``trans``.

    Raises:
        UserError: the file is not safe to read, lacks one of these, or holds values that are not finite.
    """
    arrays = read_npz(path, KEYS)
    axis_angles = _axis_angles(path, arrays)
    trans = _numbers(path, arrays, "trans")
    if trans.shape != (len(axis_angles), 3):
        raise UserError(
            path, f"trans has shape {list(trans.shape)}, poses have {len(axis_angles)} frames", "mend the file"
        )
    rate = _rate(path, arrays)
    check_finite(path, axis_angles, "frame joint coordinate", {"joint": JOINT_NAMES})
    check_finite(path, trans, "frame coordinate")
    rotations = axis_angle_to_matrix(torch.from_numpy(axis_angles))
    upright = _upright()
    rotations[:, 0] = upright @ rotations[:, 0]
    root = torch.from_numpy(trans + PELVIS) @ upright.mT
    return Motion(rotations.float(), root.float(), rate, str(arrays.get("label", "")), str(path))


def write_amass(path: str | Path, motion: Motion) -> None:
    """Write SMPL-H's layout, 156 wide, with both spellings of the frame rate and a mean, neutral shape."""
    upright = _upright()
    rotations = motion.rotations.detach().to("cpu", torch.float64, copy=True)
    rotations[:, 0] = upright.mT @ rotations[:, 0]
    axis_angles = matrix_to_axis_angle(rotations)
    poses = torch.zeros(len(motion), 52, 3, dtype=torch.float64)
    poses[:, :BODY] = axis_angles[:, :BODY]
    for hand, fingers in enumerate(FINGERS[156], start=BODY):
        poses[:, list(fingers)] = axis_angles[:, hand, None]
    trans = (motion.root.detach().cpu().double() @ upright).numpy() - PELVIS
    with replacing(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(
            stream,
            poses=poses.reshape(len(motion), -1).numpy(),
            trans=trans,
            betas=np.zeros(16),
            gender=np.array("neutral"),
            label=np.array(motion.label),
            **dict.fromkeys(RATE_KEYS, np.float64(motion.fps)),
        )


def _rate(path: str | Path, arrays: dict[str, np.ndarray]) -> float:
    for key in RATE_KEYS:
        rate = arrays.get(key)
        if rate is not None and rate.dtype.kind in "fiu" and rate.size == 1 and 0 < rate.item() < math.inf:
            return float(rate.item())
    raise UserError(path, f"has no frame rate ({' or '.join(RATE_KEYS)})", "add one")


def _upright() -> Tensor:
    """The rotation [3 3] from the file's frame (z up) to ours (y up)."""
    return rotation_about("x", torch.tensor(-math.pi / 2, dtype=torch.float64))


def _axis_angles(path: str | Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """[T 24 3] radians."""
    if "poses" in arrays:
        poses = _numbers(path, arrays, "poses")
    else:
        root, body = (_numbers(path, arrays, key) for key in ("root_orient", "pose_body"))
        if body.ndim != 2 or body.shape[1] < 3 * (BODY - 1) or root.shape != (len(body), 3):
            problem = f"root_orient {list(root.shape)} and pose_body {list(body.shape)} do not fit"
            raise UserError(path, problem, "give frames by 3 and frames by 63")
        hands = np.zeros((len(body), 6))
        poses = np.concatenate([root, body[:, : 3 * (BODY - 1)], hands], axis=1)
    if poses.ndim != 2 or poses.shape[1] not in FINGERS:
        known = ", ".join(map(str, FINGERS))
        raise UserError(path, f"poses have shape {list(poses.shape)}", f"give frames by one of {known}")
    joints = poses.reshape(len(poses), poses.shape[1] // 3, 3)
    left, right = (fingers[min(1, len(fingers) - 1)] for fingers in FINGERS[poses.shape[1]])
    return joints[:, [*range(BODY), left, right]]


def _numbers(path: str | Path, arrays: dict[str, np.ndarray], key: str) -> np.ndarray:
    if key not in arrays or arrays[key].dtype.kind not in "fiu":
        raise UserError(path, f"has no array of numbers '{key}'", "give an AMASS-style .npz with poses and trans")
    return arrays[key].astype(np.float64)
