"""How far, how shaky, how skating, how deep in the floor: measures of a motion's joints, in metres and seconds."""

import torch
from torch import Tensor

from renderers.checks import UserError, check_shapes
from renderers.skeleton import DRAWN_PARTS, JOINTS

FEET = [JOINTS[name] for name in ("left_ankle", "right_ankle", "left_foot", "right_foot")]


def joint_errors(joints: Tensor, reference: Tensor) -> Tensor:
    """Distance of every joint after the pelvises are laid on each other.

    Args:
        joints, reference: [... T 24 3] metres.

    Returns:
        [... T 24] metres; the pelvis is 0.
    """
    check_shapes("joint_errors", joints=(joints, "... T 24 3"), reference=(reference, "... T 24 3"))
    return ((joints - joints[..., :1, :]) - (reference - reference[..., :1, :])).norm(dim=-1)


def mean_joint_error(joints: Tensor, reference: Tensor) -> float:
    """Mean of ``joint_errors`` over frames and the 23 joints below the pelvis, metres."""
    return float(joint_errors(joints, reference)[..., 1:].mean())


def part_errors(joints: Tensor, reference: Tensor) -> dict[str, float]:
    """Mean of ``joint_errors`` over each drawn part's joints (without the pelvis), metres."""
    errors = joint_errors(joints, reference)
    return {name: float(errors[..., [n for n in part if n]].mean()) for name, part in DRAWN_PARTS.items()}


def planted_feet(joints: Tensor, fps: float, height: float = 0.05, speed: float = 0.15) -> Tensor:
    """Which feet stand.

    Args:
        joints: [T 24 3] metres.
        height: metres above the lowest point that this foot joint reaches in the clip.
        speed: metres a second.

    Returns:
        [T 4] bool for ``FEET``: low, and slower than ``speed``.
    """
    feet = joints[:, FEET]
    if len(feet) < 2:
        raise UserError("planted_feet", "one frame does not tell a standing foot from a moving one")
    speeds = feet.diff(dim=0).norm(dim=-1) * fps
    low = feet[..., 1] < feet[..., 1].amin(0) + height
    return low & (torch.cat([speeds[:1], speeds]) < speed)


def foot_skate(joints: Tensor, fps: float, height: float = 0.05) -> float:
    """Mean horizontal speed, metres a second, of the foot joints within ``height`` metres of their lowest point.

    joints [T 24 3] metres. 0 when no foot is ever low for two frames.
    """
    return float(foot_skates(joints[None], fps, height))


def foot_skates(joints: Tensor, fps: float, height: float = 0.05) -> Tensor:
    """``foot_skate`` of each of many clips [N T 24 3], [N] float64."""
    check_shapes("foot_skates", joints=(joints, "N T 24 3"))
    feet = joints[:, :, FEET]
    low = feet[..., 1] < feet[..., 1].amin(1, keepdim=True) + height
    both = low[:, 1:] & low[:, :-1]
    sliding = feet[..., [0, 2]].diff(dim=1).norm(dim=-1).double() * fps
    return (sliding * both).sum((1, 2)) / both.sum((1, 2)).clamp(min=1)


def jitter(joints: Tensor, fps: float) -> float:
    """Mean size of the joints' third time derivative, metres per second cubed; joints [T 24 3] with T >= 4."""
    return float(jitters(joints[None], fps))


def jitters(joints: Tensor, fps: float) -> Tensor:
    """``jitter`` of each of many clips [N T 24 3], [N] float64."""
    frames = check_shapes("jitters", joints=(joints, "N T 24 3"))["T"]
    if frames < 4:
        raise UserError("jitter", f"needs at least 4 frames, got {frames}")
    return joints.diff(n=3, dim=1).norm(dim=-1).double().mean((1, 2)) * fps**3


def floor_penetration(joints: Tensor, floor: float | None = None) -> float:
    """How far the lowest foot joint is below the floor, metres, on average over frames (0 where it is above).

    Args:
        joints: [T 24 3] metres.
        floor: its height; without one, the median over frames of the lowest foot joint's height. A foot stands in most
            frames of most actions, and the median is not drawn down by the very frames that are to be found, as the
            minimum would be. Where both feet are in the air for half of the time it lies too high.
    """
    check_shapes("floor_penetration", joints=(joints, "T 24 3"))
    return float(floor_penetrations(joints[None], floor))


def floor_penetrations(joints: Tensor, floor: float | None = None) -> Tensor:
    """``floor_penetration`` of each of many clips [N T 24 3], [N] float64; each has its own floor, unless given."""
    check_shapes("floor_penetrations", joints=(joints, "N T 24 3"))
    lowest = joints[:, :, FEET, 1].double().amin(2)
    level = lowest.quantile(0.5, dim=1, keepdim=True) if floor is None else floor
    return (level - lowest).clamp(min=0).mean(1)


def nearest_true(joints: Tensor, references: Tensor, values: int = 2**24) -> Tensor:
    """Mean of ``joint_errors`` to the nearest of many references: how near a motion is to any true one.

    Args:
        joints: [N T 24 3] metres.
        references: [M T 24 3] metres, M at least 1.
        values: coordinates that are held at once; only memory depends on it.

    Returns:
        [N] float64 metres, over frames and the 23 joints below the pelvis.
    """
    if not len(references):
        raise UserError("nearest_true", "there are no references")
    return motion_errors(joints, references, values).amin(1)


def motion_errors(joints: Tensor, references: Tensor, values: int = 2**24) -> Tensor:
    """``mean_joint_error`` of every motion [N T 24 3] to every reference [M T 24 3], [N M] float64 metres.

    Distances of joints are in the precision of what is given, their means are float64.

    Args:
        values: coordinates that are held at once; only memory depends on it.
    """
    check_shapes("motion_errors", joints=(joints, "N T 24 3"), references=(references, "M T 24 3"))
    joints, references = ((each - each[..., :1, :])[..., 1:, :] for each in (joints, references))
    parts = references.split(max(1, values // max(1, references[:1].numel())))
    found = [
        torch.cat([(part - clip).norm(dim=-1).mean((-2, -1), dtype=torch.float64) for part in parts]) for clip in joints
    ]
    return torch.stack(found) if found else torch.empty(0, len(references), dtype=torch.float64)
