"""Loss terms of text to motion, as functions of a batch and the model (TEMOS, SINC section 3.3, protocol D.4)."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from refine.text.features import from_text_features
from refine.text.model import Distribution, TextToMotion
from renderers.checks import UserError, check_range
from renderers.skeleton import forward_kinematics


@dataclass(frozen=True)
class TextLoss:
    """Weights of the terms. The defaults are those of SINC's code."""

    text: float = 1.0
    """Of the motion that is decoded from the text."""
    motion: float = 1.0
    """Of the motion that is decoded from itself."""
    kl: float = 32e-5
    """Of each of four KL terms: text and motion from N(0, 1) and from each other. TEMOS has 1e-5."""
    prior: Literal["matched", "learned"] = "matched"
    """Which KL terms there are: all four, as published; or only that of the motion from the text. A text is then as
    wide as the motions that it may mean, and what is drawn from it moves. The published terms and ``text`` make the
    mean of all of these of it, which glides."""
    latent: float = 1e-5
    """Of the distance of the two latents."""
    joints: float = 0.0
    """Of the distance of joints in metres, of both decoded motions; 0, as published, leaves it out."""
    contrastive: float = 0.0
    """Of the InfoNCE term that sets texts apart (TMR), for a space that is searched; SINC has none."""
    temperature: float = 0.1
    """Of that term."""
    alike: float = 0.8
    """Texts whose sentence embeddings are nearer than this cosine are not set apart (TMR)."""
    padding: Literal["masked", "legacy"] = "masked"
    """Mean over real frames; or over padded ones as well, where nothing can be wrong, so that in SINC's code short
    clips weigh less."""

    def __post_init__(self):
        check_range(self, 0, math.inf, "text", "motion", "kl", "latent", "joints", "contrastive")
        if not self.text and not self.motion:
            raise UserError(
                "TextLoss", "neither what is decoded from texts nor from motions counts", "weigh one of them"
            )
        check_range(self, 1e-3, 10, "temperature")
        check_range(self, -1, 1, "alike")


def kl_between(one: Distribution, other: Distribution) -> Tensor:
    """KL of one normal distribution from another, mean over batch and latent."""
    ratio = one.log_variance - other.log_variance
    distance = (one.mean - other.mean).square() / other.log_variance.exp()
    return 0.5 * (ratio.exp() + distance - 1 - ratio).mean()


def contrast(text: Tensor, motion: Tensor, sentences: Tensor, temperature: float, alike: float) -> Tensor:
    """InfoNCE in both directions (TMR, section 3): each text is nearest to its own motion.

    Args:
        text, motion: [B D] means.
        sentences: [B E] of unit length; pairs that mean about the same do not count as wrong.
    """
    similarity = torch.nn.functional.normalize(text, dim=-1) @ torch.nn.functional.normalize(motion, dim=-1).T
    own = torch.eye(len(text), dtype=torch.bool, device=text.device)
    similarity = (similarity / temperature).masked_fill((sentences @ sentences.T > alike) & ~own, -math.inf)
    places = torch.arange(len(text), device=text.device)
    cross = torch.nn.functional.cross_entropy
    return (cross(similarity, places) + cross(similarity.T, places)) / 2


def text_step(
    features: Tensor,
    valid: Tensor,
    text: Distribution,
    model: TextToMotion,
    noise: Tensor,
    loss: TextLoss,
    rest_joints: Tensor,
    sentences: Tensor | None = None,
) -> dict[str, Tensor]:
    """Terms of one batch.

    Args:
        features: [B T 135]; valid: [B T].
        text: what the model says of the texts.
        noise: [2 B D] standard normal, for text and motion.
        sentences: [B E], for the contrastive term.

    Returns:
        scalars ``text``, ``motion``, ``kl``, ``latent``, ``joints`` and ``contrastive`` (each unweighted, those of
        weight 0 absent but ``kl``), and ``total``.
    """
    said = {"text": text, "motion": model.encode_motion(features, valid)}
    latents = {name: each.draw(drawn) for (name, each), drawn in zip(said.items(), noise, strict=True)}
    made = {name: model.decode(latent, valid) for name, latent in latents.items() if getattr(loss, name)}
    count = valid.numel() if loss.padding == "legacy" else int(valid.sum())
    target = model.normal(features)[valid]
    terms = {
        name: smooth_l1_loss(model.normal(each)[valid], target, reduction="sum") / (count * target.shape[-1])
        for name, each in made.items()
    }
    pairs = [(said["motion"], text)]
    if loss.prior == "matched":
        standard = Distribution(torch.zeros_like(text.mean), torch.zeros_like(text.log_variance))
        pairs += [(text, standard), (said["motion"], standard), (text, said["motion"])]
    terms["kl"] = sum(kl_between(*pair) for pair in pairs)
    if loss.latent:
        terms["latent"] = smooth_l1_loss(*latents.values())
    if loss.joints:
        truth = positions_of(features, valid, rest_joints)
        errors = [(positions_of(each, valid, rest_joints) - truth).square().mean() for each in made.values()]
        terms["joints"] = sum(errors)
    if loss.contrastive and sentences is not None:
        means = [each.mean for each in said.values()]
        terms["contrastive"] = contrast(*means, sentences, loss.temperature, loss.alike)
    return terms | {"total": sum(getattr(loss, name) * value for name, value in terms.items())}


def positions_of(features: Tensor, valid: Tensor, rest_joints: Tensor) -> Tensor:
    """Joints [N 24 3] of the N real frames in metres, each body above its own pelvis."""
    # A padded frame is zero, which is no rotation.
    rotations, root = from_text_features(features[valid])
    height = torch.zeros_like(root) + root * root.new_tensor([0.0, 1.0, 0.0])
    return forward_kinematics(rotations, height, rest_joints)[0]
