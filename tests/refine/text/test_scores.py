"""TEMOS score, retrieval and variety: by hand, and against plain loops."""

import pytest
import torch
from scipy.stats import rankdata

from refine.text.scores import (
    all_retrieval,
    cosines,
    precision,
    ranks,
    ranks_among,
    retrieval,
    same_meaning,
    temos_score,
    variety,
)
from renderers.checks import UserError


def some(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def random() -> torch.Generator:
    return torch.Generator().manual_seed(5)


def test_temos_score_is_1_a_half_and_0():
    one = torch.tensor([[2.0, 0], [2.0, 0], [2.0, 0]])
    other = torch.tensor([[5.0, 0], [0.0, 3], [-1.0, 0]])
    score = temos_score(one, other)
    assert score.dtype == torch.float64 and score.tolist() == [1.0, 0.5, 0.0]


def test_ranks_by_hand():
    similarity = torch.tensor([[0.9, 0.1, 0.2], [0.8, 0.3, 0.5], [0.1, 0.4, 0.3]])
    assert ranks(similarity).tolist() == [0, 2, 1]
    right = torch.eye(3, dtype=torch.bool)
    right[1, 2] = right[2, 1] = True
    assert ranks(similarity, right).tolist() == [0, 1, 0]


def test_ranks_of_ties_are_means_of_their_places():
    similarity = some(7, 7).mul(2).round()
    expected = [rankdata(-row, "average")[index] - 1 for index, row in enumerate(similarity.numpy())]
    assert ranks(similarity).tolist() == expected


def test_a_space_that_knows_nothing_finds_by_chance():
    """32 candidates: on average 15.5 are before the right one."""
    found = ranks_among(some(3000, 3000), random())
    assert float(found.mean()) == pytest.approx(15.5, abs=0.7)  # 4 standard errors
    assert precision(found)["top1"] == pytest.approx(1 / 32, abs=0.013)
    assert found.max() <= 31


def test_a_space_that_knows_everything_finds_all():
    texts = some(40, 16)
    found = retrieval(texts, texts * 3, some(40, 8, seed=1), random())
    assert found == {"text_top1": 1.0, "text_top3": 1.0, "text_rank": 1.0}


def test_what_means_the_same_is_never_among_the_wrong_ones():
    """Every text is there twice, said a little differently; the space takes each for its twin, which must not count."""
    said = some(20, 16).repeat(2, 1) + some(40, 16, seed=2) / 20
    encoded = said.roll(20, 0)
    sentences = some(20, 8, seed=1).repeat(2, 1)
    found = all_retrieval(said, encoded, sentences, random())
    for direction in ("text_to_motion", "motion_to_text"):
        assert found[direction]["all"]["top1"] == 0.0 and found[direction]["all"]["rank"] == 2.0
        assert found[direction]["threshold"]["top1"] == found[direction]["among"]["top1"] == 1.0


def test_both_directions_differ_as_the_matrix_does():
    said, encoded, sentences = some(50, 4), some(50, 4, seed=1) + some(50, 4), some(50, 32, seed=2)
    found = all_retrieval(said, encoded, sentences, random())
    similarity = cosines(said, encoded)
    for direction, matrix in (("text_to_motion", similarity), ("motion_to_text", similarity.T)):
        before = [sum(float(other) > float(row[index]) for other in row) for index, row in enumerate(matrix)]
        assert found[direction]["all"]["top5"] == sum(place < 5 for place in before) / 50
        assert found[direction]["all"]["rank"] == pytest.approx(torch.tensor(before).double().quantile(0.5) + 1)
    assert found["text_to_motion"]["all"] != found["motion_to_text"]["all"]


def test_fewer_than_31_wrong_ones_are_all_taken():
    similarity = some(6, 6)
    assert torch.equal(ranks_among(similarity, random()), ranks(similarity))


def test_the_threshold_is_on_a_scale_of_0_to_1():
    angle = torch.arccos(torch.tensor([0.91, 0.89], dtype=torch.float64))
    sentences = torch.stack([torch.tensor([1.0, 0.0]).double(), *torch.stack([angle.cos(), angle.sin()], 1)])
    assert same_meaning(sentences)[0].tolist() == [True, True, False]


def test_variety_by_hand():
    """Two texts of two motions: 3-4-5 apart, and those of a text 1 apart."""
    encoded = torch.tensor([[[0.0, 0.0], [0.0, 1.0]], [[3.0, 4.0], [3.0, 5.0]]])
    found = variety(encoded)
    across = [5.0, 34**0.5, 18**0.5, 5.0]
    assert found["text_multimodality"] == pytest.approx(0.5)
    assert found["text_diversity"] == pytest.approx((2 * sum(across) + 4 * 1.0) / 16)


def test_drawn_variety_is_the_exact_one_on_average():
    encoded = some(30, 5, 8)
    exact, drawn = variety(encoded), variety(encoded, random(), pairs=20_000)
    assert drawn == pytest.approx(exact, rel=0.02)


def test_bad_input_is_refused():
    with pytest.raises(UserError, match="1 motions of each of 4 texts"):
        variety(some(4, 1, 8))
    with pytest.raises(UserError):
        temos_score(torch.full((2, 3), torch.nan), some(2, 3))
    with pytest.raises(UserError, match="no samples"):
        ranks(some(0, 0))
