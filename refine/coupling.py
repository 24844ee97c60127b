"""Coupling: two sub-actions blended into a pseudo-composition by their energies (Eqs. 1 and 3)."""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.energies import EnergySpace, energy_signal, joint_energies, spread_to_joints
from refine.motion import Motion, from_features, to_features
from renderers.checks import UserError, check_shapes
from renderers.rotations import matrix_from_6d, matrix_to_6d
from renderers.skeleton import JOINTS, PARENTS, forward_kinematics

LambdaLaw = Literal["gaussian", "uniform", "half"]

EPSILON = 1e-8
FARTHEST = 30.0  # log odds: a share is 0 or 1 to the last digit long before, and its exponential soon overflows
HIPS = [JOINTS["left_hip"], JOINTS["right_hip"]]  # each has the weight of its leg


@dataclass(frozen=True)
class CouplingConfig:
    """How two sub-actions become one (defaults: protocol B.4)."""

    energy_space: EnergySpace = "joints_rel"
    """Where motion energy is measured."""
    blend_space: Literal["rot6d", "joints"] = "rot6d"
    """Blend local rotations, or world joints that the bones then follow."""
    mask: bool = True
    """Weigh by energy; without, every part is weighed by lambda alone (the paper's ablation "w/o Mask")."""
    normalise_energies: bool = False
    """Compare each action's shares instead of its energies, so that a wild action does not silence a calm one."""
    root: Literal["legs_owner", "blend"] = "legs_owner"
    """Travel and global orientation from whoever owns the legs, or blended as the legs are."""


class Coupling(NamedTuple):
    """A pseudo-composition and why it looks as it does."""

    motion: Motion
    weights: Tensor  # [24] share of sub-action i in each joint; j has the rest
    energies_i: Tensor  # [24]
    energies_j: Tensor  # [24]


def sample_lam(count: int, generator: torch.Generator, law: LambdaLaw = "gaussian") -> Tensor:
    """[count] mixing weights: N(0.5, 0.1) clipped to 0..1, U(0, 1), or always a half.

    LFCA calls 0.1 a variance and a standard deviation; as a variance one draw in nine would leave 0..1.
    """
    if law == "half":
        return torch.full((count,), 0.5)
    if law == "uniform":
        return torch.rand(count, generator=generator)
    return (0.5 + 0.1 * torch.randn(count, generator=generator)).clamp(0, 1)


def coupling_weights(
    energies_i: Tensor,
    energies_j: Tensor,
    lam: Tensor | float,
    config: CouplingConfig,
    lean: Tensor | None = None,
) -> Tensor:
    """Eq. 3's share of sub-action i in every joint.

    Args:
        energies_i, energies_j: [... 24].
        lam: scalar or [...].
        lean: [... 5] log odds by which i's share of each of ``skeleton.PARTS`` is raised; the root does not lean. None
            is Eq. 3 as published.

    Returns:
        [... 24] in 0..1. Where neither moves it is ``lam``. Joint 0 stands for the root: the mean weight of the two
        legs, or who has more of it (protocol B.4 no. 8).
    """
    check_shapes("coupling_weights", energies_i=(energies_i, "... 24"), energies_j=(energies_j, "... 24"))
    lam = torch.as_tensor(lam, dtype=energies_i.dtype, device=energies_i.device)[..., None]
    if not config.mask:
        energies_i, energies_j = torch.ones_like(energies_i), torch.ones_like(energies_j)
    if config.normalise_energies:
        energies_i = energies_i / (energies_i.sum(-1, keepdim=True) + EPSILON)
        energies_j = energies_j / (energies_j.sum(-1, keepdim=True) + EPSILON)
    of_i, of_j = lam * (energies_i + EPSILON), (1 - lam) * (energies_j + EPSILON)
    weights = of_i / (of_i + of_j)
    root = weights[..., HIPS].mean(-1, keepdim=True)
    if config.root == "legs_owner" and config.mask:
        root = (torch.sign(root - 0.5) + 1) / 2
    if lean is not None:
        of_i = of_i * spread_to_joints(lean).clamp(-FARTHEST, FARTHEST).exp()
        weights = of_i / (of_i + of_j)
    return torch.cat([root, weights[..., 1:]], dim=-1)


def blend(
    rotations_i: Tensor,
    root_i: Tensor,
    rotations_j: Tensor,
    root_j: Tensor,
    weights: Tensor,
    rest_joints: Tensor,
    space: str = "rot6d",
) -> tuple[Tensor, Tensor]:
    """``weights`` of i and the rest of j, for rotations [... T 24 3 3], roots [... T 3] and weights [... 24]."""
    share = weights[..., None, :, None]
    six = share * matrix_to_6d(rotations_i) + (1 - share) * matrix_to_6d(rotations_j)
    rotations = matrix_from_6d(six)
    root = share[..., 0, :] * root_i + (1 - share[..., 0, :]) * root_j
    if space == "joints":
        joints_i = forward_kinematics(rotations_i, root_i, rest_joints)[0]
        joints_j = forward_kinematics(rotations_j, root_j, rest_joints)[0]
        rotations = point_bones(rotations, share * joints_i + (1 - share) * joints_j, rest_joints)
    return rotations, root


def point_bones(rotations: Tensor, joints: Tensor, rest_joints: Tensor) -> Tensor:
    """Turn every bone of ``rotations`` [... 24 3 3] by the shortest arc towards ``joints`` [... 24 3].

    Blended positions break bone lengths; their directions can still be followed. Twist about a bone stays. A joint
    with several children follows the mean of their directions.
    """
    world: list[Tensor] = []
    local: list[Tensor] = []
    for joint, parent in enumerate(PARENTS):
        before = world[parent] if parent >= 0 else torch.eye(3).to(rotations).expand_as(rotations[..., 0, :, :])
        turned = before @ rotations[..., joint, :, :]
        children = [child for child, its_parent in enumerate(PARENTS) if its_parent == joint]
        if children:
            rest = (rest_joints[children].mean(0) - rest_joints[joint]).expand_as(joints[..., joint, :])
            towards = joints[..., children, :].mean(-2) - joints[..., joint, :]
            turned = shortest_arc((turned @ rest[..., None])[..., 0], towards) @ turned
        world.append(turned)
        local.append(before.mT @ turned)
    return torch.stack(local, dim=-3)


def shortest_arc(start: Tensor, end: Tensor) -> Tensor:
    """[... 3], [... 3] -> [... 3 3] the smallest rotation that turns the direction ``start`` into ``end``.

    Half a turn about ``start``, then half a turn about the middle of both: a rotation however near to opposite they
    are. Exactly opposite directions, or one without length, give the identity.
    """
    start = torch.nn.functional.normalize(start, dim=-1)
    between = start + torch.nn.functional.normalize(end, dim=-1)
    length = between.norm(dim=-1, keepdim=True)
    middle = torch.where(length > 1e-6, between / length.clamp(min=1e-6), start)
    return half_turn(middle) @ half_turn(start)


def half_turn(axis: Tensor) -> Tensor:
    """The rotation by pi [... 3 3] about a unit axis [... 3]."""
    return 2 * axis[..., :, None] * axis[..., None, :] - torch.eye(3).to(axis)


def couple(
    i: Motion, j: Motion, rest_joints: Tensor, lam: float = 0.5, config: CouplingConfig | None = None
) -> Coupling:
    """Blend two clips from their first frames, over the length of the shorter.

    Raises:
        UserError: their frame rates differ (resample first), or one has a single frame.
    """
    config = config or CouplingConfig()
    if i.fps != j.fps:
        raise UserError("couple", f"{i.source} has {i.fps:g} fps, {j.source} {j.fps:g}", "resample one of them first")
    if not 0 <= lam <= 1:
        raise UserError("couple(lam)", f"expected a weight between 0 and 1, got {lam}")
    frames = min(len(i), len(j))
    poses = [(clip.rotations[:frames], clip.root[:frames]) for clip in (i, j)]
    energies = [joint_energies(energy_signal(*pose, rest_joints, config.energy_space)) for pose in poses]
    weights = coupling_weights(*energies, lam, config)
    rotations, root = blend(*poses[0], *poses[1], weights, rest_joints, config.blend_space)
    label = "+".join(label for label in (i.label, j.label) if label)
    motion = replace(i, rotations=rotations, root=root, label=label, source=f"{i.source} + {j.source}")
    return Coupling(motion, weights, *energies)


def couple_features(
    x_i: Tensor,
    x_j: Tensor,
    lam: Tensor,
    rest_joints: Tensor,
    config: CouplingConfig | None = None,
    lean: Tensor | None = None,
) -> Tensor:
    """Eq. 3 on a batch in ACTOR's layout: x_i, x_j [B T 25 6], lam [B] -> [B T 25 6]; lean [B 5] as in
    ``coupling_weights``."""
    config = config or CouplingConfig()
    check_shapes("couple_features", x_i=(x_i, "B T 25 6"), x_j=(x_j, "B T 25 6"), lam=(lam, "B"))
    if lean is not None:
        check_shapes("couple_features", {"B": len(lam)}, lean=(lean, "B 5"))
    poses = [from_features(x) for x in (x_i, x_j)]
    energies = [joint_energies(energy_signal(*pose, rest_joints, config.energy_space)) for pose in poses]
    weights = coupling_weights(*energies, lam, config, lean)
    rotations, root = blend(*poses[0], *poses[1], weights, rest_joints, config.blend_space)
    return to_features(matrix_to_6d(rotations), root)
