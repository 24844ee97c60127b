"""Measures of sets against analytic cases, other libraries and loops."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from refine.distributions import (
    Moments,
    accuracy,
    confusion,
    diversity,
    diversity_exact,
    frechet_distance,
    kernel_distance,
    kernel_distance_subsets,
    multimodality,
    multimodality_exact,
)
from renderers.checks import UserError

NAMES = ("walk+wave", "walk+drink", "run+wave")


@pytest.fixture
def sets(generator):
    """Two sets of correlated features: [40 6] and [50 6]."""
    mixing = torch.randn(6, 6, generator=generator, dtype=torch.float64)
    a = torch.randn(40, 6, generator=generator, dtype=torch.float64) @ mixing
    return a, torch.rand(50, 6, generator=generator, dtype=torch.float64) * 3 + 1


def gaussian(mean: list[float], deviation: list[float]) -> torch.Tensor:
    """Samples with exactly this mean and diagonal covariance: the corners of a box, widened for n - 1."""
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * len(mean)).view(-1, len(mean))
    widened = corners * ((len(corners) - 1) / len(corners)) ** 0.5
    return widened * torch.tensor(deviation, dtype=torch.float64) + torch.tensor(mean, dtype=torch.float64)


def frechet_by_scipy(a, b) -> float:
    a, b = a.double().numpy(), b.double().numpy()
    s1, s2 = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    return float(((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(s1 + s2 - 2 * sqrtm(s1 @ s2).real))


class TestMoments:
    def test_they_are_numpys(self, sets):
        mean, covariance = Moments().update(sets[0]).compute()
        assert mean.numpy() == pytest.approx(sets[0].numpy().mean(0), rel=1e-12)
        assert covariance.numpy() == pytest.approx(np.cov(sets[0].numpy(), rowvar=False), rel=1e-12)

    @settings(max_examples=50, deadline=None)
    @given(
        cuts=st.lists(st.integers(0, 40), max_size=6),
        seed=st.integers(0, 10**6),
        offset=st.sampled_from([0.0, 1.0, 1e4]),
    )
    @example(cuts=[4, 37], seed=62, offset=1e4)
    def test_neither_batches_nor_order_matter(self, cuts, seed, offset):
        source = torch.Generator().manual_seed(seed)
        features = torch.randn(40, 5, generator=source, dtype=torch.float64) + offset
        mean, covariance = Moments().update(features).compute()
        streamed = Moments()
        shuffled, edges = features[torch.randperm(40, generator=source)], [0, *sorted(cuts), 40]
        for start, end in pairwise(edges):
            streamed.update(shuffled[start:end])
        found_mean, found = streamed.compute()
        assert (found_mean - mean).abs().max() <= 1e-12 * (1 + offset)
        # A mean of 1e4 is rounded by 2e-12, and the covariance by as much; sums of squares would be by 1e-8.
        assert (found - covariance).abs().max() <= (1e-12 + 1e-15 * offset) * covariance.abs().max()

    def test_what_comes_in_is_measured_in_float64(self):
        features = torch.tensor([[1e8], [1e8 + 8], [1e8 + 16]], dtype=torch.float32)
        assert float(Moments().update(features).compute()[1]) == 64.0

    def test_too_few_or_other_features_are_refused(self):
        with pytest.raises(UserError, match="at least 2 samples, got 1"):
            Moments().update(torch.zeros(1, 3)).compute()
        with pytest.raises(UserError, match="at least 2 samples, got 0"):
            Moments().compute()
        with pytest.raises(UserError, match="F=4, got \\[3\\]"):
            Moments().update(torch.zeros(2, 3)).update(torch.zeros(2, 4))
        with pytest.raises(UserError, match="nan at sample 1, feature 2"):
            Moments().update(torch.tensor([[0.0, 0, 0], [0, 0, float("nan")]]))


class TestFrechetDistance:
    def test_diagonal_gaussians(self):
        """The sum of squared differences of means and of deviations."""
        assert frechet_distance(gaussian([1], [3]), gaussian([2], [1])) == pytest.approx(5, rel=1e-12)
        a, b = gaussian([0, 1, 2], [1, 2, 3]), gaussian([0, 3, 2], [4, 2, 0.5])
        assert frechet_distance(a, b) == pytest.approx(4 + 9 + 6.25, rel=1e-12)

    def test_gaussians_in_different_axes(self):
        """Turned by 45 degrees, diag(9, 1) becomes [[5, 4], [4, 5]]; tr √(Σ₁Σ₂) = √(tr Σ₁Σ₂ + 2 √det Σ₁Σ₂) in 2D."""
        turn = torch.tensor([[1.0, 1.0], [-1.0, 1.0]], dtype=torch.float64) / 2**0.5
        a, b = gaussian([0, 0], [3, 1]), gaussian([0, 0], [3, 1]) @ turn
        assert frechet_distance(a, b) == pytest.approx(20 - 2 * (50 + 2 * 9) ** 0.5, rel=1e-12)

    def test_it_is_scipys(self, sets):
        assert frechet_distance(*sets) == pytest.approx(frechet_by_scipy(*sets), rel=1e-9)

    def test_it_is_torchmetrics(self, sets):
        from torchmetrics.image.fid import _compute_fid

        theirs = _compute_fid(*Moments().update(sets[0]).compute(), *Moments().update(sets[1]).compute())
        assert frechet_distance(*sets) == pytest.approx(float(theirs), rel=1e-9)

    def test_moments_are_as_good_as_features(self, sets):
        a, b = sets
        assert frechet_distance(Moments().update(a[:7]).update(a[7:]), b) == pytest.approx(
            frechet_distance(a, b), rel=1e-12
        )

    @pytest.mark.parametrize("count", [5, 30, 300])
    def test_a_set_is_at_no_distance_from_itself(self, count, generator):
        """Also with fewer samples than features, where a covariance has no inverse."""
        features = torch.randn(count, 128, generator=generator) * torch.logspace(0, -6, 128) + 3
        spread = float(features.double().var(0).sum())
        assert frechet_distance(features, features) < 1e-12 * spread
        shuffled = features[torch.randperm(count, generator=generator)]
        assert frechet_distance(features, shuffled) < 1e-11 * spread
        step = torch.linspace(-1, 1, 128, dtype=torch.float64)
        moved = frechet_distance(features, features.double() + step)
        assert moved == pytest.approx(float(step.square().sum()), rel=1e-9)

    def test_singular_covariances_in_known_directions(self):
        """Lines along different axes share nothing; along the same axis they are one-dimensional Gaussians."""
        line = torch.zeros(2, 10, dtype=torch.float64)
        line[:, 3] = torch.tensor([-1.0, 1.0])
        assert frechet_distance(line, line.roll(1, dims=1)) == pytest.approx(4, rel=1e-12)
        assert frechet_distance(line, 3 * line) == pytest.approx(2 * (3 - 1) ** 2, rel=1e-12)
        assert frechet_distance(torch.ones(5, 10), torch.zeros(3, 10)) == pytest.approx(10, rel=1e-12)

    def test_fewer_samples_than_features(self, generator):
        """Against the nuclear norm of the product of the centred sets, which needs no covariance at all."""
        a = torch.randn(20, 64, generator=generator, dtype=torch.float64)
        b = torch.randn(30, 64, generator=generator, dtype=torch.float64) * 2
        centred = [(each - each.mean(0)).numpy() / (len(each) - 1) ** 0.5 for each in (a, b)]
        shared = np.linalg.norm(centred[0] @ centred[1].T, "nuc")
        expected = float((a.mean(0) - b.mean(0)).square().sum() + a.var(0).sum() + b.var(0).sum()) - 2 * shared
        assert frechet_distance(a, b) == pytest.approx(expected, rel=1e-12)

    @settings(max_examples=30, deadline=None)
    @given(seed=st.integers(0, 10**6), features=st.integers(1, 8), a=st.integers(2, 12), b=st.integers(2, 12))
    def test_properties(self, seed, features, a, b):
        """Symmetric, at least the distance of the means, and unchanged by turning and moving both sets."""
        source = torch.Generator().manual_seed(seed)
        a, b, turn = (torch.randn(n, features, generator=source, dtype=torch.float64) for n in (a, b, features))
        found = frechet_distance(a, b)
        assert frechet_distance(b, a) == pytest.approx(found, rel=1e-10)
        assert found >= float((a.mean(0) - b.mean(0)).square().sum()) * (1 - 1e-12)
        turn = torch.linalg.qr(turn)[0]
        assert frechet_distance(a @ turn + 2, b @ turn + 2) == pytest.approx(found, rel=1e-9)
        assert frechet_distance(3 * a, 3 * b) == pytest.approx(9 * found, rel=1e-9)

    def test_sets_that_do_not_fit_are_refused(self):
        with pytest.raises(UserError, match=r"frechet_distance\(b\): .* F=3, got \[4\]"):
            frechet_distance(torch.zeros(5, 3), torch.zeros(5, 4))
        with pytest.raises(UserError, match="at least 2 samples, got 1"):
            frechet_distance(torch.zeros(5, 3), torch.zeros(1, 3))


class TestKernelDistance:
    def test_loop(self, sets):
        def kernel(x, y):
            return (sum(p * q for p, q in zip(x, y, strict=True)) / len(x) + 1) ** 3

        a, b = (each[:9].tolist() for each in sets)
        expected = sum(kernel(x, y) for i, x in enumerate(a) for j, y in enumerate(a) if i != j) / (9 * 8)
        expected += sum(kernel(x, y) for i, x in enumerate(b) for j, y in enumerate(b) if i != j) / (9 * 8)
        expected -= 2 * sum(kernel(x, y) for x in a for y in b) / 81
        assert kernel_distance(sets[0][:9], sets[1][:9]) == pytest.approx(expected, rel=1e-12)

    def test_it_is_torchmetrics(self, sets):
        from torchmetrics.image.kid import poly_mmd

        a, b = sets[0], sets[1][:40]
        assert kernel_distance(a, b) == pytest.approx(float(poly_mmd(a, b)), rel=1e-12)

    def test_one_dimension_by_hand(self):
        """{0, 0} and {1, 1}: kernels 1 within the first, 8 within the second, 1 across."""
        assert kernel_distance(torch.zeros(2, 1), torch.ones(2, 1)) == 7.0

    def test_the_same_distribution_is_at_zero_on_average(self, generator):
        """Unbiased: within four standard errors of 0, where the biased estimate would be far off."""
        draws = torch.randn(300, 2, 10, 4, generator=generator, dtype=torch.float64)
        found = torch.tensor([kernel_distance(a, b) for a, b in draws])
        assert abs(float(found.mean())) < 4 * float(found.std()) / 300**0.5
        assert found.min() < 0

    def test_order_and_sides_do_not_matter(self, sets, generator):
        a, b = sets
        found = kernel_distance(a, b)
        assert kernel_distance(b, a) == pytest.approx(found, rel=1e-12)
        assert kernel_distance(a[torch.randperm(len(a), generator=generator)], b) == pytest.approx(found, rel=1e-12)

    def test_subsets_are_seeded_and_unbiased(self, sets):
        a, b = sets

        def drawn(seed: int, **settings) -> list[float]:
            return kernel_distance_subsets(a, b, torch.Generator().manual_seed(seed), **settings)

        found = drawn(1, subsets=400, size=20)
        assert found == drawn(1, subsets=400, size=20) != drawn(2, subsets=400, size=20)
        spread = torch.tensor(found).std() / 400**0.5
        assert abs(sum(found) / 400 - kernel_distance(a, b)) < 4 * spread
        whole = drawn(1, subsets=1, size=40)
        assert whole[0] != kernel_distance(a, b)  # b has 50

    def test_too_few_are_refused(self, generator):
        with pytest.raises(UserError, match="subset of 100 cannot be drawn from 40 and 300"):
            kernel_distance_subsets(torch.zeros(40, 3), torch.zeros(300, 3), generator)
        with pytest.raises(UserError, match="at least 2 samples of each, got 1 and 3"):
            kernel_distance(torch.zeros(1, 3), torch.zeros(3, 3))


class TestVariety:
    def test_exact_by_loop(self, sets):
        features = sets[0]
        pairs = [float((x - y).norm()) for x in features for y in features]
        assert diversity_exact(features) == pytest.approx(sum(pairs) / len(pairs), rel=1e-12)
        classes = torch.arange(40) % 3
        means = []
        for index in range(3):
            members = features[classes == index]
            means.append(np.mean([float((x - y).norm()) for x in members for y in members]))
        assert multimodality_exact(features, classes, NAMES) == pytest.approx(np.mean(means), rel=1e-12)

    def test_drawn_pairs_are_the_exact_ones_on_average(self, sets, generator):
        features, classes = sets[0], torch.arange(40) % 3
        drawn = diversity(features, generator, pairs=40_000)
        assert drawn == pytest.approx(diversity_exact(features), rel=0.01)
        drawn = multimodality(features, classes, NAMES, generator, pairs=20_000)
        assert drawn == pytest.approx(multimodality_exact(features, classes, NAMES), rel=0.01)

    def test_classes_weigh_alike_whatever_their_size(self):
        """One class of 2 at distance 4, one of 38 that are all alike."""
        features, classes = torch.zeros(40, 1), torch.ones(40, dtype=torch.int64)
        features[0], classes[:2] = 4.0, 0
        assert multimodality_exact(features, classes, NAMES[:2]) == pytest.approx((2 + 0) / 2)

    def test_no_variety(self, generator):
        features, classes = torch.full((30, 4), 0.1), torch.arange(30) % 3
        assert diversity(features, generator) == diversity_exact(features) == 0.0
        features = features + classes[:, None]
        assert multimodality(features, classes, NAMES, generator) == 0.0
        assert multimodality_exact(features, classes, NAMES) == 0.0
        assert diversity_exact(features) > 1

    def test_drawing_is_seeded(self, sets):
        def drawn(seed: int) -> float:
            return diversity(sets[0], torch.Generator().manual_seed(seed))

        assert drawn(3) == drawn(3) != drawn(4)

    @pytest.mark.parametrize("measure", ["drawn", "exact"])
    def test_a_missing_class_is_named(self, measure, generator):
        """ACTOR's own loop would never end here."""
        features, classes = torch.zeros(10, 2), torch.arange(10) % 2
        with pytest.raises(UserError, match="no samples of run.wave"):
            if measure == "drawn":
                multimodality(features, classes, NAMES, generator)
            else:
                multimodality_exact(features, classes, NAMES)

    def test_a_class_without_a_name_is_refused(self, generator):
        with pytest.raises(UserError, match="class 3 is not one of the 3 from 0 to 2"):
            multimodality(torch.zeros(8, 2), torch.arange(8) % 4, NAMES, generator)

    def test_an_empty_set_is_refused(self, generator):
        with pytest.raises(UserError, match="there are no samples"):
            diversity(torch.zeros(0, 2), generator)


class TestAccuracy:
    def test_confusion_by_hand(self):
        """Rows are true classes: one of class 0 was taken for class 2."""
        logits = torch.tensor([[2.0, 0, 1], [0, 1, 3], [0, 5, 0], [0, 0, 1]])
        classes = torch.tensor([0, 0, 1, 2])
        assert confusion(logits, classes).tolist() == [[1, 0, 1], [0, 1, 0], [0, 0, 1]]
        assert accuracy(logits, classes) == 0.75
        assert accuracy(logits + 7, classes) == 0.75

    def test_a_class_that_does_not_occur_is_a_row_of_zeros(self):
        assert confusion(torch.eye(3)[:2], torch.tensor([0, 1])).tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 0]]

    def test_bad_input_is_refused(self):
        with pytest.raises(UserError, match="class -1 is not one of the 3"):
            confusion(torch.zeros(2, 3), torch.tensor([0, -1]))
        with pytest.raises(UserError, match="N=2, got"):
            accuracy(torch.zeros(2, 3), torch.tensor([0]))
        with pytest.raises(UserError, match="there are no samples"):
            accuracy(torch.zeros(0, 3), torch.tensor([], dtype=torch.int64))
        with pytest.raises(UserError, match="nan at sample 0, feature 1"):
            accuracy(torch.tensor([[0.0, float("nan")]]), torch.tensor([0]))
