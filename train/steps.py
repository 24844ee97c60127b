"""Loss terms of one training step, as functions of a batch and the models."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from refine.coupling import CouplingConfig, couple_features
from refine.decoupling import Decoupler
from refine.generator import Generator, label_weights, stand
from refine.mae import MAE
from refine.motion import from_features
from refine.patches import patchify
from refine.seeing import Clips
from renderers.checks import check_range
from renderers.skeleton import forward_kinematics
from train.data import Pairs
from train.pictures import Pictures


@dataclass(frozen=True)
class GeneratorLoss:
    """Weights of the generator's terms (LFCA: 1 : 1e-5 : 1e-2 with the batch's sum as KL; protocol B.4 no. 17)."""

    joints: float = 1.0
    """Of the error of joint positions ("rcxyz" with joints for vertices); 0 leaves it out."""
    kl: float = 2e-4
    """Of the KL term; ``kl_reduction="sum"`` goes with 1e-5."""
    kl_reduction: Literal["mean", "sum"] = "mean"
    """Over the batch; over the latent it is always the sum."""
    decoupling: float = 1e-2
    """Of the decoupling loss; 0 leaves it out and draws nothing."""
    decoupling_clips: int = 8
    """Clips of a batch that are drawn."""
    decoupling_frames: int = 2
    """Random frames of each that are drawn: an estimate of the mean over all (protocol B.4 no. 25)."""

    def __post_init__(self):
        check_range(self, 0, math.inf, "joints", "kl", "decoupling")
        check_range(self, 1, math.inf, "decoupling_clips", "decoupling_frames")


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL of N(mean, variance) from N(0, 1), summed over the latent: [B D], [B D] -> [B]."""
    return -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).sum(-1)


def mean_over_frames(errors: Tensor, valid: Tensor) -> Tensor:
    """Mean of errors [B T ...] over all entries of the real frames, valid [B T]."""
    return errors.flatten(2).mean(-1)[valid].mean()


def joint_errors(features: Tensor, target: Tensor, rest_joints: Tensor) -> Tensor:
    """Squared differences of joints [B T 24 3] in metres squared, both bodies at the origin (protocol B.2)."""
    joints = []
    for rotations, root in (from_features(features), from_features(target)):
        joints.append(forward_kinematics(rotations, torch.zeros_like(root), rest_joints)[0])
    return (joints[0] - joints[1]).square()


def generator_step(
    batch: Pairs,
    generator: Generator,
    rest_joints: Tensor,
    decoupler: Decoupler | None,
    loss: GeneratorLoss,
    coupling: CouplingConfig,
    random: torch.Generator,
) -> dict[str, Tensor]:
    """Terms of LFCA's objective: reconstruct the pseudo-composition of every pair, and look at some (Eqs. 4 to 7).

    Returns:
        scalars ``rc``, ``rcxyz``, ``kl``, ``dr`` (each unweighted, those with weight 0 absent) and ``total``.
    """
    target = couple_features(batch.features_i, batch.features_j, batch.lam, rest_joints, coupling)
    weights = label_weights(batch.class_i, batch.class_j, batch.lam, len(generator.config.classes))
    made = generator(target, weights, batch.valid, random)
    kl = kl_divergence(made.mean, made.log_variance)
    terms = {
        "rc": mean_over_frames((made.features - target).square(), batch.valid),
        "kl": kl.mean() if loss.kl_reduction == "mean" else kl.sum(),
    }
    total = terms["rc"] + loss.kl * terms["kl"]
    if loss.joints:
        terms["rcxyz"] = mean_over_frames(joint_errors(made.features, target, rest_joints), batch.valid)
        total = total + loss.joints * terms["rcxyz"]
    if loss.decoupling and decoupler is not None:
        terms["dr"] = decoupling_term(made.features, batch, decoupler, loss, random)
        total = total + loss.decoupling * terms["dr"]
    return terms | {"total": total}


def decoupling_term(
    made: Tensor, batch: Pairs, decoupler: Decoupler, loss: GeneratorLoss, random: torch.Generator
) -> Tensor:
    """The decoupling loss of random real frames of the batch's first clips; made [B T 25 6]."""
    some = slice(loss.decoupling_clips)
    valid = batch.valid[some]
    frames = (torch.rand(valid.shape, generator=random).to(made) + valid).topk(loss.decoupling_frames, dim=1).indices
    # Padded frames are zero, which is no rotation; any pose will do, since none of them is drawn.
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
