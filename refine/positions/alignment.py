"""Rotations that bring directions to directions, for many frames at once; finite wherever a direction is missing."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

NOTHING = 1e-9  # a vector shorter than this has no direction


def direction(bone: Tensor, otherwise: Tensor) -> Tensor:
    """Unit vectors [... 3]; those of ``otherwise`` for bones without length."""
    return normalize(torch.where(bone.norm(dim=-1, keepdim=True) > NOTHING, bone, otherwise), dim=-1)


def across(vector: Tensor, along: Tensor) -> Tensor:
    """The part of a vector [... 3] at right angles to a unit vector."""
    return vector - (vector * along).sum(dim=-1, keepdim=True) * along


def frame(first: Tensor, second: Tensor) -> Tensor:
    """[... 3 3] right-handed columns: ``first``, the part of ``second`` across it, their cross product."""
    first = normalize(first, dim=-1)
    second = normalize(across(second, first), dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def swing(start: Tensor, end: Tensor) -> Tensor:
    """The smallest rotation [... 3 3] that turns one direction [... 3] to another; none where one has no length.

    Half a turn is about any axis across.
    """
    start = direction(start, torch.ones_like(start))
    end = direction(end, start)
    cosine = (start * end).sum(dim=-1)[..., None, None]
    sine = torch.linalg.cross(*torch.broadcast_tensors(start, end))
    zero = torch.zeros_like(sine[..., 0])
    x, y, z = sine.unbind(dim=-1)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    whole = torch.eye(3, dtype=start.dtype)
    smallest = whole + skew + skew @ skew / (1 + cosine).clamp(min=NOTHING)
    least = torch.eye(3, dtype=start.dtype)[start.abs().argmin(dim=-1)]
    axis = normalize(across(least, start), dim=-1)
    half = 2 * axis[..., :, None] * axis[..., None, :] - whole
    return torch.where(cosine > -1 + 1e-7, smallest, half)


def kabsch(still: Tensor, moved: Tensor, weights: Tensor | None = None) -> Tensor:
    """The rotations [T 3 3] that take vectors [P 3] nearest to vectors [T P 3], each with its weight [P]."""
    weighted = still if weights is None else weights[:, None] * still
    # A little of no rotation at all: vectors that are too few or too short leave some open.
    spread = moved.mT @ weighted + NOTHING * still.square().sum() * torch.eye(3, dtype=still.dtype)
    left, _, right = torch.linalg.svd(spread)
    sign = torch.linalg.det(left @ right)
    last = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
    return left * last[:, None] @ right
