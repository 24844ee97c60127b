"""Loss terms of one training step, as functions of a batch and the models."""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.coupling import CouplingConfig, couple_features
from refine.decoupling import Decoupler
from refine.generator import Generator, label_weights, stand
from refine.mae import MAE
from refine.motion import from_features
from refine.patches import patchify
from refine.seeing import Clips
from renderers.body import Body
from renderers.checks import UserError, check_range
from renderers.skeleton import forward_kinematics
from train.data import Pairs
from train.pictures import Pictures


@dataclass(frozen=True)
class GeneratorLoss:
    """Weights of the generator's terms (LFCA: 1 : 1e-5 : 1e-2, with the batch's sum as KL in ACTOR's code)."""

    joints: float = 1.0
    """Of the error of positions (ACTOR's "rcxyz"); 0 leaves it out."""
    positions: Literal["joints", "vertices"] = "joints"
    """Positions of what: the joints, or as in ACTOR the body's vertices, at many times the cost."""
    kl: float = 2e-4
    """Of the KL term: ACTOR's 1e-5 at its batch of 20; ``kl_reduction="sum"`` goes with 1e-5."""
    kl_first: float | None = None
    """Its weight at the first step, from where it goes to ``kl`` geometrically. A small one lets the latent carry the
    motion before it has to be like what is drawn from; none means ``kl`` from the start, as published."""
    kl_ramp: int = 0
    """Steps that it takes to get there."""
    kl_reduction: Literal["mean", "sum"] = "mean"
    """Over the batch; over the latent it is always the sum."""
    decoupling: float = 1e-2
    """Of the decoupling loss of generated motions; 0 leaves it out. With ``shares.looks`` 0 too nothing is drawn."""
    decoupling_clips: int = 8
    """Clips of a batch that are drawn."""
    decoupling_frames: int = 2
    """Random frames of each that are drawn: an estimate of the mean over all."""
    decoupling_start: int = 0
    """The first step with the decoupling loss."""
    decoupling_ramp: int = 0
    """Steps over which its weight then rises from zero."""
    decoupling_every: int = 1
    """It is taken at every so-manieth step, with as many times the weight: the same on average, at less cost."""

    def __post_init__(self):
        check_range(self, 0, math.inf, "joints", "kl", "decoupling", "decoupling_start", "decoupling_ramp")
        check_range(self, 0, math.inf, "kl_ramp")
        if self.kl_first is not None and min(self.kl_first, self.kl) <= 0:
            raise UserError("GeneratorLoss(kl_first)", "a weight that is zero cannot rise", "give positive weights")
        check_range(self, 1, math.inf, "decoupling_clips", "decoupling_frames", "decoupling_every")

    def at(self, step: int) -> "GeneratorLoss":
        """With the weights of a step."""
        return replace(self, kl=self.kl_at(step), kl_first=None, decoupling=self.decoupling_at(step))

    def kl_at(self, step: int) -> float:
        """Weight of the KL term at a step, counted from 0."""
        if self.kl_first is None or step >= self.kl_ramp:
            return self.kl
        return self.kl_first * (self.kl / self.kl_first) ** (step / self.kl_ramp)

    def decoupling_at(self, step: int) -> float:
        """Weight of the decoupling loss at a step, counted from 0; 0 where it is not taken."""
        done = step - self.decoupling_start
        if done < 0 or done % self.decoupling_every:
            return 0.0
        return self.decoupling * self.decoupling_every * min(1.0, (done + 1) / max(1, self.decoupling_ramp))


class Noise(NamedTuple):
    """What a step draws beside its batch; on the CPU, for the whole batch at once."""

    latent: Tensor  # [B D] standard normal
    chances: Tensor  # [S T] uniform: of the S clips that are looked at, the frames with the largest ones


class Share(NamedTuple):
    """What a shard is of its batch, as fractions. Its terms count by them: summed over shards they are the batch's."""

    frames: float = 1.0  # of the real frames
    pairs: float = 1.0
    drawn: float = 1.0  # of the clips that the decoupling loss looks at


WHOLE = Share()


def draw_noise(count: int, latent: int, frames: int, loss: GeneratorLoss, random: torch.Generator) -> Noise:
    """``Noise`` for a batch of ``count`` pairs of ``frames`` frames."""
    normal = torch.randn(count, latent, generator=random)
    return Noise(normal, torch.rand(min(count, loss.decoupling_clips), frames, generator=random))


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL of N(mean, variance) from N(0, 1), summed over the latent: [B D], [B D] -> [B]."""
    return -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).sum(-1)


def mean_over_frames(errors: Tensor, valid: Tensor) -> Tensor:
    """Mean of errors [B T ...] over all entries of the real frames, valid [B T]."""
    return errors.flatten(2).mean(-1)[valid].mean()


def position_errors(features: Tensor, target: Tensor, body: Body, of: str = "joints") -> Tensor:
    """Squared differences of joints [B T 24 3] or vertices [B T V 3] in metres squared, both bodies at the origin, as
    ACTOR compares them: where a body is counts in its features alone."""
    positions = []
    for rotations, root in (from_features(features), from_features(target)):
        if of == "joints":
            positions.append(forward_kinematics(rotations, torch.zeros_like(root), body.rest_joints)[0])
        else:
            vertices = body(rotations.flatten(0, 1), torch.zeros_like(root).flatten(0, 1)).vertices
            positions.append(vertices.unflatten(0, root.shape[:2]))
    return (positions[0] - positions[1]).square()


def generator_step(
    batch: Pairs,
    noise: Noise,
    generator: Generator,
    body: Body,
    decoupler: Decoupler | None,
    loss: GeneratorLoss,
    coupling: CouplingConfig,
    share: Share = WHOLE,
    half: bool = False,
    lean: Tensor | None = None,
) -> dict[str, Tensor]:
    """Terms of LFCA's objective: reconstruct the pseudo-composition of every pair, and look at some (Eqs. 4 to 7).

    Args:
        loss: with the weights of the step, see ``GeneratorLoss.at``.
        share: what ``batch`` and ``noise`` are of the whole batch.
        half: the network's products in bfloat16; everything else stays as it is.
        lean: [B 5] of the pseudo-compositions, see ``coupling_weights``.

    Returns:
        scalars ``rc``, ``rcxyz``, ``kl``, ``dr`` (each unweighted, those with weight 0 absent) and ``total``.
    """
    target = couple_features(batch.features_i, batch.features_j, batch.lam, body.rest_joints, coupling, lean)
    weights = label_weights(batch.class_i, batch.class_j, batch.lam, len(generator.config.classes))
    with torch.autocast(target.device.type, torch.bfloat16, enabled=half):
        made = generator(target, weights, batch.valid, noise.latent)
    kl = kl_divergence(made.mean, made.log_variance)
    terms = {
        "rc": share.frames * mean_over_frames((made.features - target).square(), batch.valid),
        "kl": share.pairs * kl.mean() if loss.kl_reduction == "mean" else kl.sum(),
    }
    total = terms["rc"] + loss.kl * terms["kl"]
    if loss.joints:
        errors = position_errors(made.features, target, body, loss.positions)
        terms["rcxyz"] = share.frames * mean_over_frames(errors, batch.valid)
        total = total + loss.joints * terms["rcxyz"]
    if loss.decoupling and decoupler is not None:
        frames, looked = loss.decoupling_frames, 0.0
        if len(noise.chances):
            looked = decoupling_term(made.features, batch, decoupler, frames, noise.chances)
        terms["dr"] = torch.as_tensor(share.drawn * looked).to(total)
        total = total + loss.decoupling * terms["dr"]
    return terms | {"total": total}


def decoupling_term(made: Tensor, batch: Pairs, decoupler: Decoupler, count: int, chances: Tensor) -> Tensor:
    """The decoupling loss of random real frames of the batch's first clips.

    Args:
        made: [B T 25 6].
        count: of frames that are drawn of each clip.
        chances: [S T] in 0..1, of the first S clips; the real frames with the largest ones are drawn.
    """
    some = slice(len(chances))
    valid = batch.valid[some]
    frames = (chances + valid).topk(count, dim=1).indices
    # Padded frames are zero, which is no rotation. One is drawn only where a pair has fewer real ones than are asked
    # for; it then shows i, and no gradient follows.
    made = torch.where(valid[:, :, None, None], made[some], batch.features_i[some])
    composed = Clips(*stand(*from_features(made), decoupler.body.rest_joints))
    i, j = (
        Clips(rotations, lift(root, height[some]))
        for (rotations, root), height in (
            (from_features(batch.features_i[some]), batch.height_i),
            (from_features(batch.features_j[some]), batch.height_j),
        )
    )
    return decoupler(composed, i, j, frames).loss


def lift(root: Tensor, height: Tensor) -> Tensor:
    """root [B T 3] moved up by height [B] metres."""
    return root + torch.nn.functional.pad(height[:, None, None], (1, 1))


def inpainting_terms(
    patches: Tensor, images: Tensor, hidden: Tensor, patch: int, body_weight: float
) -> dict[str, Tensor]:
    """Mean squared errors of what was hidden.

    Args:
        patches: [N P D], predicted; images: [N C H W].
        hidden: [N P C] bool, True = the inpainter could not see it.

    Returns:
        scalars ``total`` (patches that the body touches count ``body_weight`` times), ``hidden`` (the plain mean) and
        ``body`` (over the touched patches alone; 0 where there are none).
    """
    target = patchify(images, patch)
    errors = (patches - target).square().unflatten(-1, (patch * patch, -1)).mean(-2) * hidden
    touched = (target.amax(-1) > 0)[..., None] & hidden
    weights = torch.where(touched, body_weight, 1.0) * hidden
    return {
        "total": (errors * weights).sum() / weights.sum(),
        "hidden": errors.sum() / hidden.sum(),
        "body": (errors * touched).sum() / touched.sum().clamp(min=1),
    }


def mae_step(batch: Pictures, mae: MAE, body_weight: float) -> dict[str, Tensor]:
    """``inpainting_terms`` of the MAE: of hidden patches, and everywhere of parts that are not shown."""
    visible = batch.images * batch.shown[..., None, None]
    hidden = ~batch.kept[..., None] | ~batch.shown[:, None]
    return inpainting_terms(mae(visible, batch.kept), batch.images, hidden, mae.config.patch, body_weight)
