"""Pictures as a grid of square patches: taking apart, putting together, choosing. P patches run row by row."""

import torch
from torch import Tensor

from renderers.checks import ShapeError, check_shapes


def grid_of(size: tuple[int, int], patch: int) -> tuple[int, int]:
    """(height, width) in pixels -> (rows, columns) of patches."""
    if size[0] % patch or size[1] % patch:
        raise ShapeError("patches", f"a picture of {size[0]} x {size[1]} px has no whole patches of {patch} px")
    return size[0] // patch, size[1] // patch


def patchify(images: Tensor, patch: int) -> Tensor:
    """[N C H W] -> [N P D], D = patch * patch * C in the order (row, column, channel) (protocol E.1)."""
    n, channels = check_shapes("patchify", images=(images, "N C H W"))["N"], images.shape[1]
    rows, columns = grid_of(tuple(images.shape[-2:]), patch)
    tiles = images.reshape(n, channels, rows, patch, columns, patch)
    return tiles.permute(0, 2, 4, 3, 5, 1).reshape(n, rows * columns, patch * patch * channels)


def unpatchify(patches: Tensor, patch: int, size: tuple[int, int]) -> Tensor:
    """[N P D] -> [N C H W], the inverse of ``patchify``."""
    n, _, depth = patches.shape
    rows, columns = grid_of(size, patch)
    check_shapes("unpatchify", patches=(patches, f"N {rows * columns} D"))
    tiles = patches.reshape(n, rows, columns, patch, patch, depth // (patch * patch))
    return tiles.permute(0, 5, 1, 3, 2, 4).reshape(n, -1, *size)


def patch_means(maps: Tensor, patch: int) -> Tensor:
    """[N H W] -> [N P] mean over each patch."""
    check_shapes("patch_means", maps=(maps, "N H W"))
    grid_of(tuple(maps.shape[-2:]), patch)
    return torch.nn.functional.avg_pool2d(maps[:, None], patch).flatten(1)


def keep_top(scores: Tensor, fraction: float) -> Tensor:
    """[N P] -> [N P] bool: the floor(P * fraction) highest of each row, at least one (protocol B.4 no. 28)."""
    check_shapes("keep_top", scores=(scores, "N P"))
    count = max(1, int(scores.shape[1] * fraction + 1e-9))
    kept = torch.zeros_like(scores, dtype=torch.bool)
    return kept.scatter_(1, scores.topk(count, dim=1).indices, True)


def keep_random(n: int, count: int, fraction: float, generator: torch.Generator) -> Tensor:
    """[n count] bool: floor(count * fraction) patches of each row, uniformly drawn."""
    return keep_top(torch.rand(n, count, generator=generator), fraction)


def paste(visible: Tensor, predicted: Tensor, kept: Tensor) -> Tensor:
    """Patches [N P D] of ``visible`` where ``kept`` [N P], of ``predicted`` elsewhere (protocol B.4 no. 31)."""
    check_shapes("paste", visible=(visible, "N P D"), predicted=(predicted, "N P D"), kept=(kept, "N P"))
    return torch.where(kept[..., None], visible, predicted)
