"""The figures that "Language-free compositional action generation via decoupling refinement" (LFCA) prints, and SINC's.

They are kept as printed, for tables that show ours beside them. The sets they were measured on were never released, so
no figure of another set, and none of another recogniser, can be compared with them in size; only orders and ratios can.
"""

from dataclasses import dataclass

PLUS_MINUS = (
    "LFCA says neither how many repeats there were nor what ± means. Read as 1.96 standard errors of 20 repeats, the "
    "accuracies of one model would spread by 3.6 to 14.4 points (sd); read as ACTOR's 1.96 times the variance, by 0.9 "
    "to 1.8, near the 1.3 to 2.0 that chance makes of 625 or 900 samples. The latter, our `actor_pm`, is likely meant."
)


@dataclass(frozen=True)
class Figure:
    """A printed mean and what follows its ±."""

    mean: float
    plus_minus: float


@dataclass(frozen=True)
class Published:
    """One row of one table: a method on a set. Accuracy is in percent."""

    table: str
    benchmark: str
    method: str
    fid_c: Figure
    accuracy: Figure
    diversity: Figure
    multimodality: Figure
    doubt: str = ""


def row(table: str, benchmark: str, method: str, *figures: float, doubt: str = "") -> Published:
    pairs = [Figure(*pair) for pair in zip(figures[::2], figures[1::2], strict=True)]
    return Published(table, benchmark, method, *pairs, doubt=doubt)


CHANCE = "accuracy at chance and no variety within a class: it is deterministic"
FITTED = "0 and 100 because the recogniser was trained on this very set"
COPIED = "all eight figures are those of Ours (w/o DR) on the same set, so the row is probably a copy: no target"
ONE_DEVIATION = (
    "better than Ours (w/o DR) by 3.0 of FID-C and 0.5 points of accuracy, about one standard deviation of a repeat, "
    "and no spread over trainings is given"
)

UESTC, HUMANACT = "uestc-c", "humanact-c"
PUBLISHED = (
    row("Table 1", UESTC, "Real", 0.00, 0.00, 100.0, 0.00, 38.52, 0.76, 5.03, 0.00, doubt=FITTED),
    row("Table 1", UESTC, "Pre-train+Mask", 164.17, 47.51, 67.80, 3.13, 28.79, 0.42, 12.24, 0.23),
    row("Table 1", UESTC, "Latent Disentanglement", 121.27, 18.05, 83.20, 3.48, 32.69, 0.63, 9.50, 0.20),
    row("Table 1", UESTC, "MotionCLIP", 2502.81, 0.00, 4.00, 0.00, 15.00, 0.34, 0.00, 0.00, doubt=CHANCE),
    row("Table 1", UESTC, "Ours (w/ DR)", 90.13, 12.58, 87.20, 1.69, 33.06, 0.81, 10.12, 0.06),
    row("Table A.1", UESTC, "using full class", 102.48, 22.12, 84.80, 1.59, 33.25, 0.61, 10.56, 0.12, doubt=COPIED),
    row("Table A.1", UESTC, "w/o Gaussian", 188.66, 33.41, 59.90, 6.29, 29.60, 0.35, 13.12, 0.11),
    row("Table A.1", UESTC, "w/o Mask", 294.87, 71.4, 35.40, 4.30, 25.77, 0.41, 12.86, 0.27),
    row("Table A.1", UESTC, "Ours (w/o DR)", 102.48, 22.12, 84.80, 1.59, 33.25, 0.61, 10.56, 0.12),
    row("Table A.1", UESTC, "Ours (w/ DR)", 90.13, 12.58, 87.20, 1.69, 33.06, 0.81, 10.12, 0.06),
    row("Table 1", HUMANACT, "Real", 0.00, 0.00, 100.0, 0.00, 30.09, 0.73, 6.79, 0.06, doubt=FITTED),
    row("Table 1", HUMANACT, "Pre-train+Mask", 162.35, 34.72, 49.7, 2.95, 21.74, 0.60, 14.35, 0.52),
    row("Table 1", HUMANACT, "Latent Disentanglement", 123.08, 28.57, 52.2, 4.84, 21.0, 0.21, 14.79, 0.53),
    row("Table 1", HUMANACT, "MotionCLIP", 6908.91, 0.00, 11.1, 0.00, 14.81, 0.63, 0.00, 0.00, doubt=CHANCE),
    row("Table 1", HUMANACT, "Ours (w/ DR)", 83.43, 13.01, 64.1, 5.41, 21.36, 0.39, 14.01, 0.38),
    row("Table A.1", HUMANACT, "using full class", 86.47, 9.98, 63.6, 2.62, 21.31, 0.57, 14.04, 0.32),
    row("Table A.1", HUMANACT, "w/o Gaussian", 149.42, 24.48, 51.4, 4.54, 21.38, 0.50, 14.77, 0.31),
    row("Table A.1", HUMANACT, "w/o Mask", 251.85, 37.47, 31.6, 2.54, 18.39, 0.56, 13.92, 0.66),
    row("Table A.1", HUMANACT, "Ours (w/o DR)", 86.41, 19.8, 63.6, 5.26, 21.11, 0.58, 14.29, 0.13),
    row("Table A.1", HUMANACT, "Ours (w/ DR)", 83.43, 13.01, 64.1, 5.41, 21.36, 0.39, 14.01, 0.38, doubt=ONE_DEVIATION),
)


SINC_MEASURES = (
    "temos",
    *(f"{measure}_{of}" for measure in ("ape", "ave") for of in ("root", "trajectory", "local", "global")),
)


@dataclass(frozen=True)
class PublishedText:
    """One row of SINC's tables: values of ``SINC_MEASURES``."""

    table: str
    method: str
    values: tuple[float, ...]
    doubt: str = ""


def sinc(table: str, method: str, *values: float, doubt: str = "") -> PublishedText:
    return PublishedText(table, method, values, doubt)


SINC = (
    sinc("Table 2", "single actions", 0.601, 0.592, 0.551, 0.286, 0.712, 0.076, 0.075, 0.013, 0.083),
    sinc("Table 2", "single actions, put together", 0.618, 0.546, 0.507, 0.282, 0.666, 0.076, 0.075, 0.013, 0.082),
    sinc("Table 2", "SINC-STE, pairs", 0.614, 0.636, 0.615, 0.275, 0.743, 0.082, 0.081, 0.014, 0.090),
    sinc("Table 2", "SINC, pairs", 0.631, 0.703, 0.682, 0.269, 0.815, 0.107, 0.106, 0.013, 0.114),
    sinc("Table 2", "SINC, pairs and singles", 0.640, 0.601, 0.573, 0.268, 0.724, 0.093, 0.092, 0.012, 0.100),
    sinc("Table 3", "random, 100 %", 0.539, 0.489, 0.434, 0.291, 0.595, 0.075, 0.074, 0.012, 0.082),
    sinc("Table 3", "random, 50 %", 0.540, 0.587, 0.535, 0.288, 0.687, 0.077, 0.076, 0.012, 0.083),
    sinc("Table 3", "pairs and random, 100 %", 0.619, 0.485, 0.438, 0.272, 0.602, 0.074, 0.073, 0.011, 0.081),
    sinc("Table 3", "pairs and random, 50 %", 0.617, 0.454, 0.394, 0.272, 0.560, 0.069, 0.068, 0.011, 0.075),
    sinc("Table 3", "parts, 100 %", 0.618, 0.478, 0.451, 0.265, 0.610, 0.063, 0.062, 0.012, 0.070),
    sinc(
        "Table 3", "parts, 50 %", 0.541, 0.646, 0.598, 0.290, 0.747, 0.078, 0.077, 0.012, 0.085,
        doubt="at the level of random composition, below both of its neighbours",
    ),
    sinc("Table 3", "pairs and parts, 100 %", 0.642, 0.553, 0.527, 0.266, 0.671, 0.061, 0.060, 0.011, 0.068),
    sinc("Table 3", "pairs and parts, 50 %", 0.644, 0.481, 0.452, 0.261, 0.605, 0.064, 0.062, 0.011, 0.070),
)  # fmt: skip
SINC_SCORES = {"MLD": (0.612, 0.638), "TEMOS": (0.640, 0.644)}
"""Table A.1: TEMOS scores without and with what is made of single actions."""
