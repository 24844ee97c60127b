"""Joint positions in .npy files, in and out, and the feature vectors of HumanML3D and KIT.

Positions are [T J 3], y up, the left of a body that faces +z at +x; SMPL's 24 joints in metres is what is written.
Rotations and the frame rate are not in such a file: the first are fitted, the second is the data set's, or said by the
reader.

Features are those of HumanML3D (Guo et al. 2022), 12 J - 1 numbers a frame: half the turn about y to the next frame,
the step to the next frame in x and z as the body of that frame sees it, the height of the root, the other joints
relative to the point under the root as the body sees them (3 each), rotations (6 each), velocities (3 each), contacts
(4). Positions follow from the first four and the joints alone; the rotations there are of another skeleton.
"""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from refine.formats.npz import read_npy
from refine.motion import Motion
from refine.positions.inverse_kinematics import Fit, fit_joints
from refine.positions.joint_layouts import LAYOUTS
from renderers.body import Body
from renderers.checks import UserError, check_finite, check_known, check_shapes
from renderers.outputs import replacing
from renderers.rotations import rotation_about

MAX_FRAMES = 200_000  # almost three hours at HumanML3D's rate; they take a gigabyte while they are fitted
MAX_BYTES = MAX_FRAMES * 55 * 3 * 8 + 10_000
FEATURES = {12 * joints - 1: joints for joints in (22, 21)}
FARTHEST = 1e9  # in any unit
STRETCHED = 0.3  # bones that change their lengths by more are those of no body
REMEDY = "give positions [frames joints 3] of 24 (SMPL), 22 (HumanML3D) or 21 (KIT) joints, or features of 263 or 251"


def read_joints(path: str | Path, rest_joints: Tensor, fps: float | None = None, up: str = "y", label: str = "") -> Fit:
    """Read positions [T J 3], or features [T 263] or [T 251], and fit a body with the T-pose joints [24 3] to them.

    J of more than 24 are taken for SMPL-H's or SMPL-X's, whose first 22 are HumanML3D's.

    Args:
        fps: frame rate; none takes HumanML3D's 20, KIT's 12.5, or 30 for 24 joints.
        up: the axis of the file that points up, "y" or "z" (then a body that faces -y is turned to face +z).

    Raises:
        UserError: the file is missing, unsafe, of another shape, or holds values that are not finite, or no body.
    """
    check_known("--up", up, ("y", "z"))
    stored = read_npy(path, MAX_BYTES)
    if stored.dtype.kind not in "fiu":
        raise UserError(path, f"holds {stored.dtype}, not numbers", REMEDY)
    stored = stored[0] if stored.ndim == 4 and len(stored) == 1 else stored
    if stored.ndim and len(stored) > MAX_FRAMES:
        raise UserError(path, f"has {len(stored):,} frames, more than the {MAX_FRAMES:,} that are read", "cut it")
    if stored.ndim == 2 and stored.shape[1] in FEATURES:
        check_finite(path, stored, "frame feature")
        positions = positions_from_features(torch.from_numpy(stored.astype(np.float64)))
    elif stored.ndim == 3 and stored.shape[2] == 3 and (stored.shape[1] in LAYOUTS or stored.shape[1] in (52, 55)):
        joints = stored if stored.shape[1] in LAYOUTS else stored[:, :22]
        check_finite(path, joints, "frame joint coordinate")
        positions = torch.from_numpy(joints.astype(np.float64))
    else:
        raise UserError(path, f"has shape {list(stored.shape)}", REMEDY)
    if positions.numel() and not positions.abs().max() <= FARTHEST:
        raise UserError(path, "has joints farther away than any body", REMEDY)
    if up == "z":
        positions = positions[..., [0, 2, 1]] * positions.new_tensor([1, 1, -1])
    fit = fit_joints(positions, rest_joints, fps, label=label, source=str(path))
    if fit.stretch > STRETCHED:
        problem = f"holds no body: its bones change their lengths by {fit.stretch:.0%}"
        raise UserError(path, problem, "if its values are standardised, give them times the deviation plus the mean")
    return fit


def write_joints(path: str | Path, motion: Motion, body: Body) -> None:
    """Write the joints [T 24 3] of a motion on a body, metres, as float32."""
    joints = motion.joints(body.rest_joints.to(motion.root)).detach().cpu().float().numpy()
    with replacing(path) as partial, partial.open("wb") as stream:
        np.save(stream, joints, allow_pickle=False)


def positions_from_features(features: Tensor) -> Tensor:
    """Features [T 263] of HumanML3D or [T 251] of KIT, not standardised, to positions [T 22 3] or [T 21 3] in their
    unit; the body faces +z in the first frame and stands at x = z = 0."""
    check_shapes("positions_from_features", features=(features, "T D"))
    count = FEATURES.get(features.shape[1])
    if count is None:
        raise UserError("positions_from_features", f"expected 263 or 251 features, got {features.shape[1]}")
    turns, steps, height = features[:, 0], features[:, 1:3], features[:, 3]
    # Each turn and step leads to the next frame: the last one leads nowhere.
    yaw = torch.cat([turns.new_zeros(1), 2 * turns[:-1].cumsum(dim=0)])
    facing = rotation_about("y", -yaw)
    step = torch.zeros(len(features), 3, dtype=features.dtype)
    step[1:, [0, 2]] = steps[:-1]
    root = (facing @ step[..., None])[..., 0].cumsum(dim=0)
    local = features[:, 4 : 4 + 3 * (count - 1)].unflatten(1, (count - 1, 3))
    others = local @ facing.mT + root[:, None]
    root[:, 1] = height
    return torch.cat([root[:, None], others], dim=1)
