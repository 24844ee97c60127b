"""Comparing images: a failure leaves the picture, what was expected, and the difference in tests/failures/."""

from pathlib import Path

import torch
from torch import Tensor

from renderers.images import save_png

FAILURES = Path(__file__).resolve().parents[1] / "failures"


def assert_images_close(name: str, actual: Tensor, expected: Tensor, largest: float, mean: float | None = None):
    """Compare images [N C H W]: the largest difference of a pixel, and the mean over all pixels."""
    assert actual.shape == expected.shape
    difference = (actual - expected).abs()
    if difference.max() <= largest and (mean is None or difference.mean() <= mean):
        return
    frame, channel = (difference.amax((-2, -1)) == difference.max()).nonzero()[0].tolist()
    pictures = (
        torch.cat([image[frame, channel] for image in (actual, expected, difference)], dim=-1).detach().clamp(0, 1)
    )
    FAILURES.mkdir(exist_ok=True)
    save_png(FAILURES / f"{name}.png", pictures.float().expand(3, -1, -1))
    raise AssertionError(
        f"{name}: largest difference {difference.max():.3g} (allowed {largest:.3g}), mean {difference.mean():.3g}"
        f" (allowed {mean}); actual, expected and difference are in {FAILURES / name}.png"
    )
