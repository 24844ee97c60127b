"""The generator: ACTOR's transformer CVAE with soft labels, as LFCA trains it on compositions.

A label is a row of weights over the classes: a composition of i and j is ``lam * e_i + (1 - lam) * e_j``. The weights
multiply into all three label tables; a one-hot row is exactly ACTOR's hard label.
"""

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel

from refine.motion import Motion, from_features
from renderers.checks import UserError, check_finite, check_known, check_range, check_shapes
from renderers.skeleton import JOINT_NAMES, forward_kinematics

ROWS, FEATURES = len(JOINT_NAMES) + 1, 6


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """The network's size; encoder and decoder are alike. The defaults are LFCA's."""

    latent: int = 256
    """Width of the latent and of every token."""
    feedforward: int = 1024
    heads: int = 4
    layers: int = 8
    """Of the encoder, and as many of the decoder."""
    dropout: float = 0.1
    memory: Literal["sum", "concat"] = "sum"
    """What the decoder looks at: the latent plus the label's bias as one token (ACTOR's final model), or each as a
    token of its own."""
    standardise: bool = False
    """Let the network read and write features less their mean and over their spread in training. ACTOR does neither:
    most of a feature is constant, and thousands of steps pass before anything but the mean pose is learned."""
    prior: Literal["normal", "fitted"] = "normal"
    """What latents are drawn from to generate: N(0, 1), as ACTOR does, or for each pair that is trained on the normal
    distribution that fits its latents. LFCA writes its prior as one given the label, and does not say which."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "latent", "feedforward", "heads", "layers")
        check_range(self, 0, 0.99, "dropout")
        if self.latent % self.heads or self.latent % 2:
            raise UserError(
                f"{type(self).__name__}(latent)",
                f"{self.latent} is not even and divisible by {self.heads} heads",
                "choose a multiple of both",
            )


PAPER = NetworkConfig()
TINY = NetworkConfig(latent=128, feedforward=256, layers=2, dropout=0.0, standardise=True, prior="fitted")
SMALL = TINY
SPREAD = 0.02  # added to every feature's: what hardly moves is not blown up


@dataclass(frozen=True)
class GeneratorConfig(NetworkConfig):
    """Everything needed to build the network again and to read its output."""

    classes: tuple[str, ...]
    """Names of the sub-actions, in the order of the label tables."""
    fps: float = 30.0
    """Frame rate of the motions it is trained on, hence of those it makes."""
    pairs: tuple[tuple[str, str], ...] = ()
    """Actions that are trained together and have a fitted prior; an action alone is a pair of equals."""

    def __post_init__(self):
        super().__post_init__()
        for name in {name for pair in self.pairs for name in pair}:
            check_known("GeneratorConfig(pairs)", name, self.classes)
        if not self.classes:
            raise UserError("GeneratorConfig(classes)", "there is no sub-action", "name at least one")

    @staticmethod
    def of(
        network: NetworkConfig,
        classes: tuple[str, ...],
        fps: float = 30.0,
        pairs: tuple[tuple[str, str], ...] = (),
    ) -> "GeneratorConfig":
        return GeneratorConfig(classes, fps, pairs if network.prior == "fitted" else (), **asdict(network))

    @staticmethod
    def paper(classes: tuple[str, ...], fps: float = 30.0) -> "GeneratorConfig":
        return GeneratorConfig.of(PAPER, classes, fps)

    @staticmethod
    def small(classes: tuple[str, ...], fps: float = 30.0) -> "GeneratorConfig":
        return GeneratorConfig.of(SMALL, classes, fps)

    @staticmethod
    def tiny(classes: tuple[str, ...], fps: float = 30.0) -> "GeneratorConfig":
        return GeneratorConfig.of(TINY, classes, fps)


class Reconstruction(NamedTuple):
    """features [B T 25 6], mean [B D] and log_variance [B D] of the posterior."""

    features: Tensor
    mean: Tensor
    log_variance: Tensor


def positions(length: int, width: int) -> Tensor:
    """Sinusoidal position encoding [length, width]: even features sine, odd cosine, base 10000."""
    rates = torch.exp(torch.arange(0, width, 2) * (-torch.log(torch.tensor(10000.0)) / width))
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1)


class Generator(nn.Module):
    """The CVAE. Features are those of ``refine.motion.to_features``: [B T 25 6]."""

    def __init__(self, config: GeneratorConfig):
        super().__init__()
        self.config = config
        table = (len(config.classes), config.latent)
        self.mean_tokens = nn.Parameter(torch.randn(table))
        self.variance_tokens = nn.Parameter(torch.randn(table))
        self.decoder_biases = nn.Parameter(torch.randn(table))
        self.read = nn.Linear(ROWS * FEATURES, config.latent)
        self.write = nn.Linear(config.latent, ROWS * FEATURES)
        self.dropout = nn.Dropout(config.dropout)
        if config.standardise:
            self.register_buffer("centre", torch.zeros(ROWS * FEATURES))
            self.register_buffer("spread", torch.ones(ROWS * FEATURES))
        if config.pairs:
            count, width = len(config.pairs), config.latent
            self.register_buffer("prior_means", torch.zeros(count, width))
            self.register_buffer("prior_roots", torch.eye(width).repeat(count, 1, 1))
        layer = (config.latent, config.heads, config.feedforward, config.dropout, "gelu")
        self.encoder = nn.TransformerEncoder(
            nn.TransformerEncoderLayer(*layer, batch_first=True), config.layers, enable_nested_tensor=False
        )
        self.decoder = nn.TransformerDecoder(nn.TransformerDecoderLayer(*layer, batch_first=True), config.layers)

    def standardise(self, features: Tensor):
        """Take centre and spread from features [B T 25 6] like those it will be trained on."""
        flat = features.flatten(2).flatten(0, 1)
        self.centre.copy_(flat.mean(0))
        self.spread.copy_(flat.std(0) + SPREAD)

    @torch.no_grad()
    def fit_prior(self, pair: int, mean: Tensor, log_variance: Tensor):
        """Take the prior of a pair from the posteriors [N D] of N compositions: their moments together.

        Raises:
            UserError: they are not finite.
        """
        check_finite("Generator.fit_prior(mean)", mean, "composition feature")
        check_finite("Generator.fit_prior(log_variance)", log_variance.exp(), "composition feature")
        covariance = torch.cov(mean.double().T) + log_variance.double().exp().mean(0).diag()
        self.prior_means[pair] = mean.mean(0)
        self.prior_roots[pair] = torch.linalg.cholesky(covariance).to(mean)

    def draw_latent(self, weights: Tensor, random: torch.Generator) -> Tensor:
        """Latents [B D] for rows of label weights [B C]: from the fitted prior of the actions that have weight, however
        much of it, or from N(0, 1) where these were not trained together."""
        latent = draw_normal(weights.new_empty(len(weights), self.config.latent), random)
        if not self.config.pairs:
            return latent
        classes = self.config.classes
        known = torch.zeros(len(self.config.pairs), len(classes), dtype=torch.bool, device=weights.device)
        for row, pair in enumerate(self.config.pairs):
            known[row, [classes.index(name) for name in pair]] = True
        same = ((weights > 0)[:, None] == known).all(-1)
        pair = same.float().argmax(1)
        fitted = self.prior_means[pair] + (self.prior_roots[pair] @ latent[..., None])[..., 0]
        return torch.where(same.any(1, keepdim=True), fitted, latent)

    def encode(self, features: Tensor, weights: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and log variance, each [B D].

        Args:
            features: [B T 25 6].
            weights: [B C] label weights, each row summing to 1.
            valid: [B T] True = a real frame.
        """
        features = features.flatten(2)
        if self.config.standardise:
            features = (features - self.centre) / self.spread
        tokens = torch.stack([mix(weights, self.mean_tokens), mix(weights, self.variance_tokens)], dim=1)
        sequence = torch.cat([tokens, self.read(features).to(tokens.dtype)], dim=1)
        sequence = self.dropout(sequence + positions(sequence.shape[1], sequence.shape[2]).to(sequence))
        hidden = torch.cat([torch.zeros_like(valid[:, :2]), ~valid], dim=1)
        encoded = self.encoder(sequence, src_key_padding_mask=hidden)
        return encoded[:, 0], encoded[:, 1]

    def decode(self, latent: Tensor, weights: Tensor, valid: Tensor) -> Tensor:
        """Features [B T 25 6] from latent [B D], label weights [B C] and valid [B T]; padded frames are zero."""
        frames = valid.shape[1]
        bias = mix(weights, self.decoder_biases)
        memory = torch.stack([latent, bias] if self.config.memory == "concat" else [latent + bias], dim=1)
        queries = self.dropout(positions(frames, latent.shape[1]).to(latent).expand(len(latent), -1, -1))
        decoded = self.write(self.decoder(queries, memory, tgt_key_padding_mask=~valid))
        if self.config.standardise:
            decoded = self.centre + self.spread * decoded
        return decoded.unflatten(-1, (ROWS, FEATURES)) * valid[:, :, None, None]

    def forward(self, features: Tensor, weights: Tensor, valid: Tensor, noise: Tensor) -> Reconstruction:
        """Encode, draw the latent by reparameterisation, decode.

        Under autocast the products are rounded; labels, posterior, latent and the results are not.

        Args:
            features, weights, valid: as in ``encode``.
            noise: [B D] standard normal.
        """
        check_shapes(
            "Generator",
            {"C": len(self.config.classes), "D": self.config.latent},
            features=(features, "B T 25 6"),
            weights=(weights, "B C"),
            valid=(valid, "B T"),
            noise=(noise, "B D"),
        )
        # The fused kernel's gradient is slow in bfloat16 on a processor.
        plain = features.device.type == "cpu" and torch.is_autocast_enabled("cpu")
        with sdpa_kernel(SDPBackend.MATH) if plain else nullcontext():
            mean, log_variance = (value.to(features.dtype) for value in self.encode(features, weights, valid))
            latent = mean + (log_variance / 2).exp() * noise
            return Reconstruction(self.decode(latent, weights, valid).to(features.dtype), mean, log_variance)


def mix(weights: Tensor, table: Tensor) -> Tensor:
    """Label weights [B C] times a table [C D]; never rounded, or a lambda would move by up to 1/256."""
    with torch.autocast(table.device.type, enabled=False):
        return weights @ table


def draw_normal(like: Tensor, generator: torch.Generator) -> Tensor:
    """Standard normal numbers of the shape, type and device of ``like``; the same ones on every device."""
    return torch.randn(like.shape, generator=generator, device=generator.device).to(like)


def label_weights(i: Tensor, j: Tensor, lam: Tensor, classes: int) -> Tensor:
    """Soft labels ``lam * e_i + (1 - lam) * e_j`` [B C] from class indices i [B], j [B] and lam [B]."""
    one_hot = torch.eye(classes, dtype=lam.dtype, device=lam.device)
    return lam[:, None] * one_hot[i] + (1 - lam)[:, None] * one_hot[j]


@torch.no_grad()
def generate(generator: Generator, weights: Tensor, frames: int, random: torch.Generator) -> Tensor:
    """Draw one latent from the prior for each row of label weights [B C] -> features [B T 25 6].

    The generator must be in evaluation mode, or its dropout adds noise of its own.
    """
    check_shapes("generate", {"C": len(generator.config.classes)}, weights=(weights, "B C"))
    latent = generator.draw_latent(weights, random)
    return generator.decode(latent, weights, torch.ones(len(weights), frames, dtype=torch.bool, device=weights.device))


def stand(rotations: Tensor, root: Tensor, rest_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Set clips on the floor: the lowest joint over all frames stands as high as the lowest joint of the rest pose.

    Features hold the root only relative to its first frame, so its height has to come from elsewhere.

    Args:
        rotations: [B T 24 3 3]; root: [B T 3] metres; rest_joints: [24 3] metres.
    """
    joints, _ = forward_kinematics(rotations, root, rest_joints)
    rise = rest_joints[:, 1].min() - joints[..., 1].flatten(1).min(dim=1).values
    return rotations, root + torch.nn.functional.pad(rise[:, None, None], (1, 1))


def generate_motions(
    generator: Generator,
    actions: Sequence[str],
    count: int,
    seconds: float,
    rest_joints: Tensor,
    random: torch.Generator,
) -> list[Motion]:
    """Draw ``count`` motions in which the named actions happen at once, at equal weights.

    Each stands on the floor (``stand``); ``rest_joints`` [24 3] are those of the T-pose, metres.

    Raises:
        UserError: an action the generator has not learned, no action, or a length outside 0.1 to 60 seconds.
    """
    classes = generator.config.classes
    if not actions:
        raise UserError("generate(actions)", "no action was named", f"choose from {', '.join(classes)}")
    if not 0.1 <= seconds <= 60:
        raise UserError("generate(seconds)", f"{seconds} s is not a length from 0.1 to 60 s")
    for action in actions:
        check_known("generate(actions)", action, classes)
    weights = torch.zeros(count, len(classes))
    for action in actions:
        weights[:, classes.index(action)] += 1 / len(actions)
    frames = max(2, round(seconds * generator.config.fps))
    rotations, root = stand(*from_features(generate(generator, weights, frames, random)), rest_joints)
    label = "+".join(actions)
    return [
        Motion(rotations[n], root[n], generator.config.fps, label, source=f"generated {label} {n}")
        for n in range(count)
    ]
