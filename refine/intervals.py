"""95 % intervals of what is measured on a sample."""

from statistics import NormalDist, mean, stdev

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
