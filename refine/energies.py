"""Motion energy: which body parts an action lives in (Eq. 2)."""

from typing import Literal

import torch
from torch import Tensor

from renderers.checks import UserError, check_shapes
from renderers.rotations import matrix_to_6d
from renderers.skeleton import LEGS, PART_NAMES, PARTS, forward_kinematics, part_of_joint

EnergySpace = Literal["joints_rel", "joints_abs", "rot6d"]


def energy_signal(rotations: Tensor, root: Tensor, rest_joints: Tensor, space: EnergySpace = "joints_rel") -> Tensor:
    """The quantity whose changes are energy (protocol B.4 nos. 5 and 6).

    Args:
        rotations: [... T 24 3 3]; root: [... T 3] metres; rest_joints: [24 3] metres.
        space: ``joints_rel`` joints relative to the pelvis (default: a walk's travel is not an arm's energy);
            ``joints_abs`` world joints; ``rot6d`` local rotations.

    Returns:
        [... T 24 D], metres for the two joint spaces.
    """
    if space == "rot6d":
        return matrix_to_6d(rotations)
    if space == "joints_rel":
        root = torch.zeros_like(root)
    return forward_kinematics(rotations, root, rest_joints)[0]


def part_energies(signal: Tensor) -> Tensor:
    """Eq. 2: mean squared change between frames over a part's joints.

    Args:
        signal: [... T 24 D], T >= 2.

    Returns:
        [... 5], one energy for each of ``skeleton.PARTS``, in the signal's unit squared per frame squared.

    Raises:
        UserError: a single frame has no motion.
    """
    check_shapes("part_energies", signal=(signal, "... T 24 D"))
    if signal.shape[-3] < 2:
        raise UserError("part_energies", "a motion of one frame has no energy", "give a clip of at least two frames")
    change = signal.diff(dim=-3).square().sum(-1).mean(-2)
    return torch.stack([change[..., list(joints)].mean(-1) for joints in PARTS.values()], dim=-1)


def spread_to_joints(parts: Tensor) -> Tensor:
    """[... 5] -> [... 24]: every joint has its part's value, the pelvis the mean of the legs' (protocol B.4 no. 8)."""
    check_shapes("spread_to_joints", parts=(parts, "... 5"))
    legs = parts[..., [PART_NAMES.index(name) for name in LEGS]].mean(-1, keepdim=True)
    with_pelvis = torch.cat([parts, legs], dim=-1)
    return with_pelvis[..., list(part_of_joint(PARTS))]


def joint_energies(signal: Tensor) -> Tensor:
    """[... T 24 D] -> [... 24]: Eq. 2's energy of each joint's part."""
    return spread_to_joints(part_energies(signal))
