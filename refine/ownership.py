"""Ownership: which sub-action answers for which body part.

Coupling compares the two actions' energies, so a wild action keeps a say in limbs that it only swings along. Here a
part has a standing in each action: its energy over that of the action's most energetic part, measured where the part
itself turns, so that an arm does not count for being carried along. A part belongs to the action in which it stands
higher.

Where somebody has said what each action is about, no energy is asked: see ``as_divided``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from renderers.checks import check_shapes
from renderers.skeleton import DRAWN_PARTS, PART_NAMES, PARTS, part_of_joint

PART_OF_CHANNEL = [part_of_joint(PARTS)[joints[-1]] for joints in DRAWN_PARTS.values()]
TORSO = PART_NAMES.index("torso")
ARMS = [PART_NAMES.index(name) for name in ("left_arm", "right_arm")]
JOINT_OF_CHANNEL = [joints[-1] for joints in DRAWN_PARTS.values()]


class Owned(NamedTuple):
    """One sub-action's part in each channel of a picture."""

    answers: Tensor  # [B C] in 0..1: how much its picture is the one to match
    shown: Tensor  # [B C] bool: False where the channel shows what the other owns


class Divided(NamedTuple):
    """How a composition by parts is divided between two actions: each joint is from one of them."""

    from_i: Tensor  # [24] bool; the others are from j
    unclaimed: Tensor  # [24] bool: no action is about them, they are from one because they must be from somewhere


def as_divided(divided: Divided) -> tuple[Owned, Owned]:
    """What each action of one pair owns, B = 1: the parts that are from it, and those that nobody claims.

    For these both answer, since each action does something there by the way.
    """
    sides = [(divided.unclaimed | mine)[None, JOINT_OF_CHANNEL] for mine in (divided.from_i, ~divided.from_i)]
    return tuple(Owned(side.float(), side) for side in sides)


def everything(batch: int, channels: int) -> tuple[Owned, Owned]:
    """Both sub-actions answer for every channel, as published."""
    owned = Owned(torch.ones(batch, channels), torch.ones(batch, channels, dtype=torch.bool))
    return owned, owned


def by_standing(energies_i: Tensor, energies_j: Tensor, contested: float, quiet: float) -> tuple[Owned, Owned]:
    """Divide the drawn parts between two sub-actions.

    A part that both live in, or neither, is nobody's: it stays as coupling made it. An arm that neither moves goes with
    whoever moves the torso that carries it.

    Args:
        energies_i, energies_j: [B 5] part energies (Eq. 2) of local rotations.
        contested: where the smaller standing is this fraction of the larger, both live in the part; half is clear.
        quiet: standing that an action must have in a part to own it for certain; with half of it it owns nothing.

    Returns:
        what i and what j own, C = 6 drawn parts (the head goes with the torso).
    """
    check_shapes("by_standing", energies_i=(energies_i, "B 5"), energies_j=(energies_j, "B 5"))
    of_i, of_j = (e / e.amax(-1, keepdim=True).clamp(min=1e-12) for e in (energies_i, energies_j))
    larger, smaller = torch.maximum(of_i, of_j), torch.minimum(of_i, of_j)
    loudness = (2 * larger / quiet - 1).clamp(0, 1)
    clear = ((contested - smaller / larger.clamp(min=1e-12)) / (contested / 2)).clamp(0, 1)
    is_i, sure = of_i >= of_j, loudness * clear
    carried = sure[:, TORSO, None] * (1 - loudness[:, ARMS])
    follows = carried > sure[:, ARMS]
    is_i[:, ARMS] = torch.where(follows, is_i[:, TORSO, None], is_i[:, ARMS])
    sure[:, ARMS] = torch.where(follows, carried, sure[:, ARMS])
    sides = []
    for mine in (is_i, ~is_i):
        shown = mine | (sure < 0.5)
        sides.append(Owned((sure * mine)[:, PART_OF_CHANNEL], shown[:, PART_OF_CHANNEL]))
    return tuple(sides)
