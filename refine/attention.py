"""Attention: energies at projected joints spread over the picture (Eq. 6)."""

import torch
from torch import Tensor

from renderers.checks import check_shapes


def attention_map(energies: Tensor, joints_px: Tensor, size: tuple[int, int], epsilon: float = 1.0) -> Tensor:
    """Eq. 6: every joint gives its energy over its squared distance.

    Args:
        energies: [N J].
        joints_px: [N J 2] pixels (x, y).
        size: (height, width).
        epsilon: pixels squared, added to the squared distance (protocol B.4 no. 27): at a joint the map is its energy
            over ``epsilon``.

    Returns:
        [N H W] at the pixel centres, in the energies' unit per pixel squared.
    """
    check_shapes("attention_map", energies=(energies, "N J"), joints_px=(joints_px, "N J 2"))
    height, width = size
    x = torch.arange(width, dtype=joints_px.dtype, device=joints_px.device) + 0.5
    y = torch.arange(height, dtype=joints_px.dtype, device=joints_px.device) + 0.5
    across = (joints_px[:, :, 0, None] - x).square()
    down = (joints_px[:, :, 1, None] - y).square()
    return (energies[:, :, None, None] / (down[:, :, :, None] + across[:, :, None, :] + epsilon)).sum(1)
