"""Shares of the pseudo-compositions, refined by decoupling before the generator learns them.

Eq. 3 compares energies, so a wild action keeps a say in limbs that it only swings along, and a generator that learns
its blends learns arms that do half of either action. Here the decoupling loss is asked of the pseudo-compositions
themselves. What moves is not a motion but, for each pair of actions and each body part, the log odds of its share:
few numbers, each seen in many compositions, so that what a single picture gets wrong averages out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from tqdm import tqdm

from refine.coupling import CouplingConfig, couple_features
from refine.decoupling import Decoupler
from renderers.checks import UserError, check_range
from renderers.skeleton import PART_NAMES
from train.data import Pairs
from train.steps import decoupling_term

FASTEST = 10.0  # log odds a step: with three of them a share is 0 or 1 to the last digit


@dataclass(frozen=True)
class SharesConfig:
    """How long the shares are refined, and how fast."""

    looks: int = 128
    """Compositions of each pair of actions that are looked at, one a step; 0 leaves the shares of Eq. 3."""
    frames: int = 1
    """Random frames of each that are drawn."""
    pairs: int = 16
    """Pairs of actions that are refined at once, each by itself: memory and time depend on it, and what is drawn."""
    rate: float = 0.1
    """Adam's step for the log odds."""
    stay: float = 1e-5
    """Weight of the squared log odds: how much a picture must gain for a share to leave that of Eq. 3."""

    def __post_init__(self):
        check_range(self, 0, math.inf, "looks", "stay")
        check_range(self, 1, math.inf, "frames", "pairs")
        if not 0 < self.rate <= FASTEST:
            raise UserError("SharesConfig(rate)", f"expected more than 0 and at most {FASTEST:g}, got {self.rate}")


def refine_shares(
    draw: Callable[[Tensor, torch.Generator], Pairs],
    pairs: Tensor,
    classes: int,
    decoupler: Decoupler,
    coupling: CouplingConfig,
    config: SharesConfig,
    random: torch.Generator,
) -> Tensor:
    """Find what every pair of actions leans to, each pair by itself.

    Args:
        draw: windows of pairs of classes [B 2].
        pairs: [P 2] long; a pair and its mirror image are one, and an action with itself leans to nothing.
        classes: how many there are.

    Returns:
        [classes classes 5] log odds for ``coupling_weights``: of a pair (i, j) the negative of those of (j, i), and 0
        for pairs that are not among ``pairs``.

    Raises:
        UserError: they are not finite.
    """
    leans = torch.zeros(classes, classes, len(PART_NAMES))
    ordered = torch.tensor(sorted({tuple(sorted(pair)) for pair in pairs.tolist() if pair[0] != pair[1]}))
    groups = ordered.split(config.pairs) if config.looks and len(ordered) else ()
    with tqdm(total=len(groups) * config.looks, desc="shares", disable=None) as bar:
        for some in groups:
            lean = refine_group(draw, some, decoupler, coupling, config, random, bar.update).cpu()
            leans[some[:, 0], some[:, 1]], leans[some[:, 1], some[:, 0]] = lean, -lean
    if not leans.isfinite().all():
        raise UserError("--shares", "the refined shares are not finite", "lower --shares.rate")
    return leans


def refine_group(
    draw: Callable[[Tensor, torch.Generator], Pairs],
    pairs: Tensor,
    decoupler: Decoupler,
    coupling: CouplingConfig,
    config: SharesConfig,
    random: torch.Generator,
    done: Callable[[], object],
) -> Tensor:
    """[B 5] what the pairs of classes [B 2] lean to."""
    rest_joints = decoupler.body.rest_joints
    lean = torch.zeros(len(pairs), len(PART_NAMES), device=rest_joints.device, requires_grad=True)
    optimiser = torch.optim.Adam([lean], config.rate, betas=(0.8, 0.95))
    for _ in range(config.looks):
        batch = draw(pairs, random)
        chances = torch.rand(batch.valid.shape, generator=random).to(batch.valid.device)
        made = couple_features(batch.features_i, batch.features_j, batch.lam, rest_joints, coupling, lean)
        looked = decoupling_term(made, batch, decoupler, config.frames, chances)
        loss = len(pairs) * looked + config.stay * lean.square().sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        done()
    return lean.detach()
