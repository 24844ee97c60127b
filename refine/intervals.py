"""95 % intervals of what is measured on a sample."""

import math
from collections.abc import Sequence
from functools import lru_cache
from statistics import NormalDist, mean, pvariance, stdev, variance

from renderers.checks import UserError

Z = NormalDist().inv_cdf(0.975)


def mean_interval(values: list[float]) -> dict:
    """Mean, standard deviation and normal interval of independent values; a single one has no width."""
    middle, spread = mean(values), stdev(values) if len(values) > 1 else 0.0
    half = Z * spread / len(values) ** 0.5
    return {"mean": middle, "sd": spread, "ci95": [middle - half, middle + half], "n": len(values)}


def share_interval(hits: int, count: int) -> dict:
    """Share of successes among independent trials and its Wilson interval, which stays within 0..1."""
    share = hits / count
    widened = 1 + Z**2 / count
    centre = (share + Z**2 / (2 * count)) / widened
    half = Z / widened * (share * (1 - share) / count + Z**2 / (4 * count**2)) ** 0.5
    return {"share": share, "ci95": [centre - half, centre + half], "n": count}


def summarise_repeats(values: Sequence[float]) -> dict:
    """A few independent repeats of one measurement.

    Returns:
        n, mean, sd (of n - 1), ci95 (Student's t, since repeats are few), and the two plus-minus of the literature on
        action-conditioned motion: sem196, 1.96 sd/√n (Action2Motion), and actor_pm, 1.96 times the variance of n
        (ACTOR's tables). actor_pm is in squared units: scale the values first. All but n and mean are None for a
        single value, which says nothing of how far others would lie.

    Raises:
        UserError: there are no values, or one is not finite.
    """
    check_values("summarise_repeats", values)
    count, middle = len(values), mean(values)
    if count == 1:
        return {"n": 1, "mean": middle, "sd": None, "ci95": None, "sem196": None, "actor_pm": None}
    spread = stdev(values)
    error = spread / count**0.5
    return {
        "n": count,
        "mean": middle,
        "sd": spread,
        "ci95": around(middle, error, count - 1),
        "sem196": 1.96 * error,
        "actor_pm": 1.96 * pvariance(values),
    }


def compare(a: Sequence[float], b: Sequence[float], paired: bool = False) -> dict:
    """How much lower or higher a is than b on average, as a difference and as a ratio.

    Args:
        a, b: independent values, such as one a training seed.
        paired: the values belong together one by one, so that what pairs have in common cancels.

    Returns:
        n of a and b; difference, mean(a) - mean(b), and difference_ci95 (Welch's t, or that of the paired differences);
        ratio, mean(a) / mean(b), and ratio_ci95 (the same t of the logarithm by the delta method, so that "10 % lower"
        holds beyond the interval where its upper end is at most 0.9). The ratio is None where a mean is not positive;
        intervals are None where a or b is a single value.

    Raises:
        UserError: there are no values, one is not finite, or pairs are not complete.
    """
    check_values("compare", a)
    check_values("compare", b)
    if paired and len(a) != len(b):
        raise UserError("compare", f"{len(a)} and {len(b)} values are not pairs")
    mean_a, mean_b = mean(a), mean(b)
    found = {"n": [len(a), len(b)], "difference": mean_a - mean_b, "difference_ci95": None}
    found |= {"ratio": None, "ratio_ci95": None}
    many = min(len(a), len(b)) > 1
    if many:
        found["difference_ci95"] = around(mean_a - mean_b, *spread_of_difference(a, b, paired))
    if mean_a > 0 and mean_b > 0:
        found["ratio"] = mean_a / mean_b
        if many:
            relative = [value / mean_a for value in a], [value / mean_b for value in b]
            logarithms = around(math.log(mean_a / mean_b), *spread_of_difference(*relative, paired))
            found["ratio_ci95"] = [math.exp(end) for end in logarithms]
    return found


def spread_of_difference(a: Sequence[float], b: Sequence[float], paired: bool) -> tuple[float, float]:
    """Standard error of mean(a) - mean(b) and its degrees of freedom (Welch 1947, or of pairs)."""
    if paired:
        return stdev(x - y for x, y in zip(a, b, strict=True)) / len(a) ** 0.5, len(a) - 1
    parts = [(variance(values) / len(values), len(values) - 1) for values in (a, b)]
    total = sum(part for part, _ in parts)
    if total == 0:
        return 0.0, sum(free for _, free in parts)
    return total**0.5, 1 / sum((part / total) ** 2 / free for part, free in parts)


def around(middle: float, error: float, freedom: float) -> list[float]:
    """Student's 95 % interval."""
    half = student_quantile(freedom) * error
    return [middle - half, middle + half]


@lru_cache
def student_quantile(freedom: float) -> float:
    """The t that |T| stays under with probability 0.95, for 1 or more degrees of freedom, to seven digits.

    With t = √ν tan θ the density becomes cosine to the power ν - 1, which Simpson's rule integrates at once.
    """
    scale = 2 / math.sqrt(math.pi) * math.exp(math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2))

    def covered(angle: float, panels: int = 100) -> float:
        step = angle / (2 * panels)
        heights = [math.cos(n * step) ** (freedom - 1) for n in range(2 * panels + 1)]
        return scale * step / 3 * (heights[0] + heights[-1] + 4 * sum(heights[1::2]) + 2 * sum(heights[2:-1:2]))

    low, high = 0.0, min(math.pi / 2, 20 / math.sqrt(freedom))
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if covered(middle) < 0.95 else (low, middle)
    return math.sqrt(freedom) * math.tan(low)


def check_values(where: str, values: Sequence[float]):
    if not len(values):
        raise UserError(where, "there are no values")
    for index, value in enumerate(values):
        if not math.isfinite(value):
            raise UserError(where, f"value {index} of {len(values)} is {value}")
