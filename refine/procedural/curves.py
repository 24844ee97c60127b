"""Time curves: periodic keyed curves, slow drift, and what changes from one repetition to the next."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor


def keyed(phase: Tensor, times: Sequence[float], values: Sequence[float]) -> Tensor:
    """Periodic curve through ``values`` at ``times``, evaluated at ``phase`` (any shape, in cycles).

    Quintic between keys with no acceleration at a key (minimum-jerk from rest to rest), and a slope at a key only where
    the values go on in the same direction, so that a curve never leaves the range of its neighbouring keys.

    Args:
        phase: cycles, unbounded; only the fraction counts.
        times: increasing, at least two, from 0 to below 1.
        values: one for each time.
    """
    count = len(times)
    spans = [(times[(k + 1) % count] - times[k]) % 1.0 for k in range(count)]
    steps = [values[(k + 1) % count] - values[k] for k in range(count)]
    slopes = [_slope(steps[k - 1] / spans[k - 1], steps[k] / spans[k]) for k in range(count)]
    rows = zip(times, spans, values, steps, slopes, slopes[1:] + slopes[:1], strict=True)
    table = phase.new_tensor(list(rows))
    within = phase - phase.floor()
    key = (torch.bucketize(within, table[:, 0].contiguous(), right=True) - 1) % count
    start, span, value, step, leaving, arriving = table[key].unbind(-1)
    u = ((within - start) % 1.0) / span
    cubed = u**3
    glide = cubed * (10 + u * (6 * u - 15))
    leave = u + cubed * (u * (8 - 3 * u) - 6)
    arrive = cubed * (u * (7 - 3 * u) - 4)
    return value + step * glide + span * (leaving * leave + arriving * arrive)


def _slope(before: float, after: float) -> float:
    """Harmonic mean of the chords on both sides, 0 at a turning point."""
    return 2 * before * after / (before + after) if before * after > 0 else 0.0


def held(phase: Tensor, times: Sequence[float]) -> Tensor:
    """Periodic curve that rises from 0 to 1 between the first two of four times and falls between the last two."""
    return keyed(phase, times, (0.0, 1.0, 1.0, 0.0))


def eased(share: Tensor) -> Tensor:
    """From 0 to 1 at rest on both ends, for a share of the way in 0..1; constant beyond."""
    u = share.clamp(0, 1)
    return u**3 * (10 + u * (6 * u - 15))


def wave(phase: Tensor) -> Tensor:
    """Cosine of ``phase`` in cycles: 1 at the start of a cycle, -1 half way."""
    return torch.cos(2 * math.pi * phase)


def drift(seconds: Tensor, channels: int, seed: int) -> Tensor:
    """Slow aimless movement [channels T] of about unit size: sums of three sines of 0.08 to 0.5 Hz."""
    random = torch.Generator().manual_seed(seed)
    hertz, start = torch.rand(2, channels, 3, 1, generator=random).to(seconds)
    return torch.sin(2 * math.pi * ((0.08 + 0.42 * hertz) * seconds + start)).sum(dim=1) / math.sqrt(1.5)


def unevenness(phase: Tensor, seed: int) -> Tensor:
    """A number in -1..1 for each repetition, constant within it (so that a planted foot can depend on it)."""
    return torch.sin(2.6 * phase.floor() + seed % 1000)
