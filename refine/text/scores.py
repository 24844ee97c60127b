"""What a space of motions and texts says of motions: TEMOS score, retrieval, diversity and multimodality.

Everything is float64 on the CPU, whatever comes in.
"""

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.distributions import checked, diversity, diversity_exact, multimodality, multimodality_exact
from renderers.checks import UserError, check_shapes

AMONG = 32  # the right one and 31 wrong ones (Guo et al. 2022)
TOPS = (1, 2, 3, 5, 10)
SAME = 0.95  # TMR: texts more similar than this, on a scale of 0 to 1, mean the same


def temos_score(mean_a: Tensor, mean_b: Tensor) -> Tensor:
    """(1 + cosine) / 2 of what a motion encoder says of two motions, [N D] each -> [N]: 1 the same, 0 opposite."""
    check_shapes("temos_score", mean_a=(mean_a, "N D"), mean_b=(mean_b, "N D"))
    mean_a, mean_b = checked("temos_score", mean_a), checked("temos_score", mean_b)
    return (1 + (normalize(mean_a, dim=1) * normalize(mean_b, dim=1)).sum(1)) / 2


def cosines(a: Tensor, b: Tensor) -> Tensor:
    """Of all pairs: a [N D], b [M D] -> [N M]."""
    check_shapes("cosines", a=(a, "N D"), b=(b, "M D"))
    return normalize(checked("cosines", a), dim=1) @ normalize(checked("cosines", b), dim=1).T


def same_meaning(sentences: Tensor, threshold: float = SAME) -> Tensor:
    """[N N] bool: texts whose sentence embeddings [N E] are alike, (1 + cosine) / 2 above ``threshold`` (TMR)."""
    return ((1 + cosines(sentences, sentences)) / 2 > threshold) | torch.eye(len(sentences), dtype=torch.bool)


def ranks(similarity: Tensor, right: Tensor | None = None) -> Tensor:
    """At which place each query finds its answer.

    Args:
        similarity: [N N] of queries (rows) and candidates; the answer of a query stands on the diagonal.
        right: [N N] bool, candidates that are as good; the best of them counts (TMR's threshold). None: only the own.

    Returns:
        [N] float64, 0 is the first place. Among equal similarities it is the mean of their places.
    """
    check_shapes("ranks", similarity=(similarity, "N N"))
    similarity = checked("ranks", similarity, at_least=1)
    own = torch.eye(len(similarity), dtype=torch.bool)
    best = similarity.masked_fill(~(own if right is None else own | right), -torch.inf).amax(1, keepdim=True)
    return place_among(similarity, best)


def place_among(similarity: Tensor, best: Tensor) -> Tensor:
    """[N] of each row of similarity [N M], which holds best [N 1]: how many are more alike, and half of the ties."""
    return (similarity > best).sum(1) + ((similarity == best).sum(1) - 1).double() / 2


def ranks_among(
    similarity: Tensor, generator: torch.Generator, right: Tensor | None = None, size: int = AMONG
) -> Tensor:
    """``ranks`` of each query's own answer among ``size - 1`` wrong ones, drawn anew for each without replacement.

    Args:
        right: [N N] bool, candidates that are not wrong and never drawn. Where there are fewer wrong ones they are all
            taken, and the figure flatters.

    Returns:
        [N] float64, 0 is the first place.
    """
    check_shapes("ranks_among", similarity=(similarity, "N N"))
    similarity = checked("ranks_among", similarity, at_least=1)
    own = torch.eye(len(similarity), dtype=torch.bool)
    lots = torch.rand(similarity.shape, generator=generator, dtype=torch.float64)
    lots = lots.masked_fill(own if right is None else own | right, torch.inf)
    drawn = lots.argsort(1)[:, : size - 1]
    wrong = similarity.gather(1, drawn).masked_fill(lots.gather(1, drawn).isinf(), -torch.inf)
    best = similarity.diagonal()[:, None]
    return place_among(torch.cat([best, wrong], dim=1), best)


def precision(places: Tensor) -> dict[str, float]:
    """R-precision at ``TOPS``, shares of 1, and the median rank, from 1 on, of ``ranks`` [N]."""
    return {
        **{f"top{top}": float((places < top).double().mean()) for top in TOPS},
        "rank": float(places.double().quantile(0.5)) + 1,
    }


def retrieval(said: Tensor, encoded: Tensor, sentences: Tensor, generator: torch.Generator) -> dict[str, float]:
    """How well motions find their texts: each among its own and 31 that mean something else.

    Args:
        said: [N D] what the space says of the texts; encoded: [N D] of the motions.
        sentences: [N E] embeddings of the texts as sentences, which tell what means the same.

    Returns:
        ``text_top1``, ``text_top3``, shares of 1, and ``text_rank``, the median from 1 on.
    """
    found = precision(ranks_among(cosines(encoded, said), generator, same_meaning(sentences)))
    return {f"text_{name}": found[name] for name in ("top1", "top3", "rank")}


def all_retrieval(
    said: Tensor, encoded: Tensor, sentences: Tensor, generator: torch.Generator, threshold: float = SAME
) -> dict[str, dict[str, dict[str, float]]]:
    """Every protocol in both directions, as TMR reports them; arguments as ``retrieval``.

    Returns:
        ``text_to_motion`` and ``motion_to_text``, of each ``all`` (the own one among all), ``threshold`` (one that
        means the same, among all) and ``among`` (the own one among 31 that mean something else), of each what
        ``precision`` returns.
    """
    alike, similarity = same_meaning(sentences, threshold), cosines(said, encoded)
    return {
        direction: {
            "all": precision(ranks(found)),
            "threshold": precision(ranks(found, alike)),
            "among": precision(ranks_among(found, generator, alike)),
        }
        for direction, found in (("text_to_motion", similarity), ("motion_to_text", similarity.T))
    }


def variety(encoded: Tensor, generator: torch.Generator | None = None, pairs: int = 300) -> dict[str, float]:
    """How different motions are, and those of one text.

    SINC takes 300 texts, 5 motions of each for diversity and 20 for multimodality.

    Args:
        encoded: [N S D] of S motions for each of N texts, S at least 2.
        generator: draws random pairs as Guo et al. 2022 do; without one all pairs count, a motion with itself
            included, which is what the draws are on average.
        pairs: drawn for diversity, and a twentieth of it for each text.

    Returns:
        ``text_diversity`` and ``text_multimodality``, distances in the space.
    """
    texts, samples = (check_shapes("variety", encoded=(encoded, "N S D"))[name] for name in "NS")
    if not texts or samples < 2:
        raise UserError("variety", f"{samples} motions of each of {texts} texts", "make two or more of each")
    motions, names = encoded.flatten(0, 1), [str(text) for text in range(texts)]
    classes = torch.arange(texts).repeat_interleave(samples)
    if generator is None:
        found = diversity_exact(motions), multimodality_exact(motions, classes, names)
    else:
        each = max(1, pairs // 20)
        found = diversity(motions, generator, pairs), multimodality(motions, classes, names, generator, each)
    return dict(zip(("text_diversity", "text_multimodality"), found, strict=True))
