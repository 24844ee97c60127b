"""How far one set of motions is from another, and how varied a set is: measures of a recogniser's features.

Everything is float64 on the CPU, whatever comes in, and up to rounding independent of the order and the batches in
which the features come, except where a generator draws pairs.
"""

from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor

from renderers.checks import UserError, check_finite, check_shapes


class Moments:
    """Mean and covariance of features that come in batches (Chan, Golub and LeVeque 1979).

    >>> mean, covariance = Moments().update(features[:100]).update(features[100:]).compute()
    """

    def __init__(self):
        self.count, self.mean, self.scatter = 0, None, None

    def update(self, features: Tensor) -> Self:
        """Take in more features [N F]; returns itself.

        Raises:
            UserError: the features are not finite, or of another size than those before.
        """
        features = checked("Moments", features)
        if not len(features):
            return self
        mean = features.mean(0)
        centred = features - mean
        scatter = centred.T @ centred
        if self.mean is None:
            self.count, self.mean, self.scatter = len(features), mean, scatter
            return self
        check_shapes("Moments", features=(features, "N F"), before=(self.mean, "F"))
        total, step = self.count + len(features), mean - self.mean
        self.scatter = self.scatter + scatter + step[:, None] * step * (self.count * len(features) / total)
        self.mean = self.mean + step * (len(features) / total)
        self.count = total
        return self

    def compute(self) -> tuple[Tensor, Tensor]:
        """Mean [F] and unbiased covariance [F F].

        Raises:
            UserError: there are fewer than two features.
        """
        if self.count < 2:
            raise UserError("Moments", f"a covariance needs at least 2 samples, got {self.count}")
        return self.mean, self.scatter / (self.count - 1)


def frechet_distance(a: Moments | Tensor, b: Moments | Tensor) -> float:
    """|μ₁-μ₂|² + tr(Σ₁ + Σ₂ - 2 √(Σ₁Σ₂)), the squared Fréchet distance of two Gaussians (FID of features).

    The trace of the root is the sum of the singular values of R₁ᵀR₂ with Σ = RRᵀ, which needs no root of a product that
    is not symmetric and stays exact where covariances are singular. They are when there are no more samples N than
    features F: the rank is at most N-1. The distance is then well defined but biased upwards, the more the smaller N,
    so that only distances at equal N can be compared.

    Args:
        a, b: features [N F], or their moments.

    Raises:
        UserError: fewer than two samples, features of different sizes, or not finite.
    """
    (mean_a, cov_a), (mean_b, cov_b) = (moments(each).compute() for each in (a, b))
    check_shapes("frechet_distance", a=(mean_a, "F"), b=(mean_b, "F"))
    shared = torch.linalg.svdvals(root(cov_a).T @ root(cov_b)).sum()
    return max(float((mean_a - mean_b).square().sum() + cov_a.trace() + cov_b.trace() - 2 * shared), 0.0)


def moments(features: Moments | Tensor) -> Moments:
    return features if isinstance(features, Moments) else Moments().update(features)


def root(covariance: Tensor) -> Tensor:
    """R [F r] of full rank r with RRᵀ = the covariance [F F]; what is zero but for rounding is left out."""
    values, vectors = torch.linalg.eigh(covariance)
    kept = values > values.max() * len(values) * torch.finfo(values.dtype).eps
    return vectors[:, kept] * values[kept].sqrt()


def kernel_distance(a: Tensor, b: Tensor) -> float:
    """Unbiased squared maximum mean discrepancy with the kernel (x·y/F + 1)³ over the whole sets (KID of features).

    "Demystifying MMD GANs" (Binkowski et al. 2018) average it over subsets to save memory: ``kernel_distance_subsets``.
    Unbiased means that equal distributions give 0 on average, so that single values can be negative.

    Args:
        a [N F], b [M F]: features.

    Raises:
        UserError: fewer than two samples, features of different sizes, or not finite.
    """
    a, b = checked("kernel_distance", a), checked("kernel_distance", b)
    size = check_shapes("kernel_distance", a=(a, "N F"), b=(b, "M F"))
    if min(len(a), len(b)) < 2:
        raise UserError("kernel_distance", f"needs at least 2 samples of each, got {size['N']} and {size['M']}")

    def within(x: Tensor) -> Tensor:
        kernel = cubic(x, x)
        return (kernel.sum() - kernel.trace()) / (len(x) * (len(x) - 1))

    return float(within(a) + within(b) - 2 * cubic(a, b).mean())


def cubic(x: Tensor, y: Tensor) -> Tensor:
    return (x @ y.T / x.shape[1] + 1) ** 3


def kernel_distance_subsets(
    a: Tensor, b: Tensor, generator: torch.Generator, subsets: int = 100, size: int = 100
) -> list[float]:
    """``kernel_distance`` of random subsets without replacement, as KID is published: their mean is KID.

    Args:
        a [N F], b [M F]: features.
        size: samples a subset takes of each.

    Returns:
        one value a subset.

    Raises:
        UserError: there are fewer samples than a subset takes, or as ``kernel_distance``.
    """
    if min(len(a), len(b)) < size:
        raise UserError(
            "kernel_distance_subsets",
            f"a subset of {size} cannot be drawn from {len(a)} and {len(b)} samples",
            "draw smaller ones",
        )

    def some(features: Tensor) -> Tensor:
        return features[torch.randperm(len(features), generator=generator)[:size].to(features.device)]

    return [kernel_distance(some(a), some(b)) for _ in range(subsets)]


def diversity(features: Tensor, generator: torch.Generator, pairs: int = 200) -> float:
    """Mean distance of random pairs, drawn with replacement (ACTOR, Petrovich et al. 2021); features [N F]."""
    features = checked("diversity", features, at_least=1)
    first, second = (torch.randint(len(features), (pairs,), generator=generator) for _ in range(2))
    return float((features[first] - features[second]).norm(dim=1).mean())


def diversity_exact(features: Tensor) -> float:
    """What ``diversity`` is on average: the mean distance of all ordered pairs, a sample with itself included."""
    features = checked("diversity_exact", features, at_least=1)
    return mean_distance(features)


def mean_distance(features: Tensor) -> float:
    """Of all ordered pairs; by differences, since a product of norms would leave equal features apart."""
    return sum(float((features - row).norm(dim=1).sum()) for row in features) / len(features) ** 2


def multimodality(
    features: Tensor, classes: Tensor, names: Sequence[str], generator: torch.Generator, pairs: int = 20
) -> float:
    """Mean distance of random pairs of one class, drawn with replacement, over all classes (ACTOR).

    ACTOR's estimator never ends when a class has no samples; this one draws from the classes in turn, which has the
    same distribution.

    Args:
        features: [N F].
        classes: [N] integers, each an index of ``names``.
        pairs: of each class.

    Raises:
        UserError: a class has no samples; it is named.
    """
    total = 0.0
    for members in by_class("multimodality", features, classes, names):
        first, second = (torch.randint(len(members), (pairs,), generator=generator) for _ in range(2))
        total += float((members[first] - members[second]).norm(dim=1).mean())
    return total / len(names)


def multimodality_exact(features: Tensor, classes: Tensor, names: Sequence[str]) -> float:
    """What ``multimodality`` is on average: over all ordered pairs of a class, a sample with itself included."""
    grouped = by_class("multimodality_exact", features, classes, names)
    return sum(mean_distance(members) for members in grouped) / len(names)


def by_class(where: str, features: Tensor, classes: Tensor, names: Sequence[str]) -> list[Tensor]:
    """The features of every class in the order of ``names``; a class without any is refused."""
    features = checked(where, features)
    check_shapes(where, features=(features, "N F"), classes=(classes, "N"))
    classes = check_classes(where, classes, len(names))
    grouped = [features[classes == index] for index in range(len(names))]
    missing = [name for name, members in zip(names, grouped, strict=True) if not len(members)]
    if missing:
        raise UserError(where, f"no samples of {', '.join(missing)}", "make some of every class")
    return grouped


def accuracy(logits: Tensor, classes: Tensor) -> float:
    """Share of samples whose largest logit is their class's: logits [N C], classes [N], N at least 1."""
    matrix = confusion(logits, classes)
    return float(matrix.trace() / matrix.sum())


def confusion(logits: Tensor, classes: Tensor) -> Tensor:
    """How often a class (row) was recognised as which (column).

    Args:
        logits: [N C].
        classes: [N] integers under C.

    Returns:
        [C C] int64.

    Raises:
        UserError: there are no samples, a class is not one of C, or a logit is not finite.
    """
    logits = checked("confusion", logits, at_least=1)
    count = check_shapes("confusion", logits=(logits, "N C"), classes=(classes, "N"))["C"]
    classes = check_classes("confusion", classes, count)
    return torch.bincount(classes * count + logits.argmax(1), minlength=count**2).view(count, count)


def checked(where: str, features: Tensor, at_least: int = 0) -> Tensor:
    """[N F] as float64 on the CPU."""
    check_shapes(where, features=(features, "N F"))
    if len(features) < at_least:
        raise UserError(where, "there are no samples")
    check_finite(where, features, "sample feature")
    return features.detach().to("cpu", torch.float64)


def check_classes(where: str, classes: Tensor, count: int) -> Tensor:
    classes = classes.detach().to("cpu", torch.int64)
    strange = classes[(classes < 0) | (classes >= count)].tolist()
    if strange:
        raise UserError(where, f"class {strange[0]} is not one of the {count} from 0 to {count - 1}")
    return classes
