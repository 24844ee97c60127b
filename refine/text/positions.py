"""How far motions are from those that were meant, in positions: APE and AVE as TEMOS and SINC report them.

Clips are compared as if they began at one place, on one floor and facing one way: each is moved there by itself first.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.text.features import JOINTS
from renderers.checks import UserError, check_finite, check_shapes
from renderers.rotations import rotation_about
from renderers.skeleton import JOINTS as INDEX

FEET = [INDEX[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")]
SOFTNESS = 0.5  # of the floor

Heading = Literal["correct", "sinc_legacy"]
"""Where a body faces: across its hips and shoulders; or mirrored, as SINC's code takes it, so that a body that has
turned is turned as far again instead of back."""


class Placed(NamedTuple):
    """A clip from one place on, float64 metres: y up, at first facing +z at x = z = 0, the floor at 0."""

    root: Tensor  # [T 3]
    trajectory: Tensor  # [T 2] x and z of the root
    local: Tensor  # [T 21 3] the others seen from under the root, facing +z in each frame
    whole: Tensor  # [T 22 3]


class ClipErrors(NamedTuple):
    """One clip's. Each tensor [4], float64, is of root, trajectory, mean local and mean global."""

    frames: int
    ape: Tensor  # metres, average positional error
    ave: Tensor  # metres squared, error of the variance over time


def place(joints: Tensor, heading: Heading = "correct") -> Placed:
    """Move a clip to where clips are compared: joints [T J 3] in metres, y up, J at least 22."""
    check_shapes("place", joints=(joints, "T J 3"))
    joints = joints[:, :JOINTS].detach().double().cpu()
    floor = joints.new_tensor([0.0, 1.0, 0.0]) * floor_height(joints)
    joints = joints - floor
    under = joints[:, :1] * joints.new_tensor([1.0, 0.0, 1.0])
    turns = rotation_about("y", facing(joints) * (1 if heading == "sinc_legacy" else -1))
    local = (joints - under)[:, 1:] @ turns.mT
    whole = (joints - under[0]) @ turns[0].mT
    return Placed(whole[:, 0], whole[:, 0, [0, 2]], local, whole)


def facing(joints: Tensor) -> Tensor:
    """[T] radians about y, 0 for +z: square to the line across hips and shoulders of joints [T J 3]."""
    right, left = ([INDEX[f"{side}_hip"], INDEX[f"{side}_shoulder"]] for side in ("right", "left"))
    across = (joints[:, right] - joints[:, left]).sum(1)
    return torch.atan2(across[:, 2], -across[:, 0])


def floor_height(joints: Tensor) -> Tensor:
    """Metres: a soft minimum over time of the lowest foot joint's height, as TEMOS takes it."""
    lowest = joints[:, FEET, 1].amin(1)
    least, most = lowest.aminmax()
    return least - torch.log(SOFTNESS + (least - most).exp())


def clip_errors(joints: Tensor, reference: Tensor, heading: Heading = "correct") -> ClipErrors:
    """Of one clip, over the length of the shorter; joints and reference [T J 3] metres, J at least 22.

    APE is the distance, a mean over frames (and joints); AVE is that of the variances along the three axes.

    Raises:
        UserError: fewer than two frames, or a value that is not finite.
    """
    frames = min(len(joints), len(reference))
    if frames < 2:
        raise UserError("clip_errors", "one frame has no variance over time", "compare clips of two frames or more")
    for clip in (joints, reference):
        check_finite("clip_errors", clip, "frame joint coordinate")
    made, meant = (place(clip[:frames], heading) for clip in (joints, reference))
    ape = [(one - other).norm(dim=-1).mean() for one, other in zip(made, meant, strict=True)]
    ave = [(one.var(0) - other.var(0)).norm(dim=-1).mean() for one, other in zip(made, meant, strict=True)]
    return ClipErrors(frames, torch.stack(ape), torch.stack(ave))


def positional_errors(pairs: Sequence[tuple[Tensor, Tensor]], heading: Heading = "correct") -> dict[str, float]:
    """APE over all frames of all clips and AVE over clips, as SINC averages them.

    Args:
        pairs: joints of each clip and of what it should be, see ``clip_errors``.

    Returns:
        ``ape_root``, ``ape_trajectory``, ``ape_local``, ``ape_global`` in metres and ``ave_...`` in metres squared.

    Raises:
        UserError: there are no clips, or as ``clip_errors``.
    """
    if not pairs:
        raise UserError("positional_errors", "there are no clips")
    return mean_errors([clip_errors(*pair, heading) for pair in pairs])


def mean_errors(errors: Sequence[ClipErrors]) -> dict[str, float]:
    """``positional_errors`` of clips that are already compared."""
    frames = torch.tensor([each.frames for each in errors], dtype=torch.float64)
    ape = (torch.stack([each.ape for each in errors]) * frames[:, None]).sum(0) / frames.sum()
    ave = torch.stack([each.ave for each in errors]).mean(0)
    names = ("root", "trajectory", "local", "global")
    return {
        f"{kind}_{name}": float(value)
        for kind, values in (("ape", ape), ("ave", ave))
        for name, value in zip(names, values, strict=True)
    }
