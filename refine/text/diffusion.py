"""Motion latent diffusion (MLD): text to motion by denoising a latent of a text-to-motion model's motion encoder.

That model is frozen. What is learned is to tell the noise in a latent, given the text; see ``train.text_diffusion``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from refine.generator import draw_normal, positions
from refine.text.encoder import Words
from refine.text.model import Distribution, TextNetworkConfig, TextToMotion, TextToMotionConfig, layer_of
from renderers.checks import UserError, check_finite, check_range, check_shapes


@dataclass(frozen=True, kw_only=True)
class DiffusionConfig:
    """The denoiser and its noise. The defaults are MLD's; it is as wide as the latent."""

    feedforward: int = 1024
    heads: int = 4
    layers: int = 9
    """Odd: those of the first half are joined to those of the second."""
    dropout: float = 0.1
    times: int = 1000
    """Steps from a latent to noise."""
    first_noise: float = 0.00085
    """Variance that the first of them adds; its root grows linearly."""
    last_noise: float = 0.012
    steps: int = 50
    """Of them that are taken back to generate (DDIM)."""
    guidance: float = 7.5
    """How far to go beyond what is told without the text; at 1 not at all."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "feedforward", "heads", "layers", "times", "steps")
        check_range(self, 0, 0.99, "dropout")
        check_range(self, 0, 100, "guidance")
        if self.layers % 2 == 0:
            raise UserError("DiffusionConfig(layers)", f"{self.layers} is even", "choose an odd number")
        if not 0 < self.first_noise <= self.last_noise < 1 or self.steps > self.times:
            raise UserError("DiffusionConfig", "noise must grow between 0 and 1, over at least as many times as steps")


class Denoiser(nn.Module):
    """Tells the noise in a latent: a transformer over the latent, the time and the words, with long skips."""

    def __init__(self, config: DiffusionConfig, latent: int, text_width: int):
        super().__init__()
        self.latent = latent
        size = TextNetworkConfig(
            latent=latent,
            feedforward=config.feedforward,
            heads=config.heads,
            layers=config.layers,
            dropout=config.dropout,
        )
        self.read_time = nn.Sequential(nn.Linear(latent, latent), nn.SiLU(), nn.Linear(latent, latent))
        self.read_text = nn.Sequential(nn.ReLU(), nn.Linear(text_width, latent))
        self.nothing = nn.Parameter(torch.randn(latent))
        half = config.layers // 2
        blocks = [layer_of(nn.TransformerEncoderLayer, size) for _ in range(config.layers)]
        self.down, self.middle, self.up = nn.ModuleList(blocks[:half]), blocks[half], nn.ModuleList(blocks[half + 1 :])
        self.joints = nn.ModuleList(nn.Linear(2 * latent, latent) for _ in range(half))
        self.norm = nn.LayerNorm(latent)

    def forward(self, noisy: Tensor, times: Tensor, words: Words) -> Tensor:
        """The noise [B D] in latents [B D] at times [B]; a text without valid words is no text."""
        check_shapes(
            "Denoiser",
            {"D": self.latent},
            noisy=(noisy, "B D"),
            times=(times, "B"),
            states=(words.states, "B L E"),
            valid=(words.valid, "B L"),
        )
        rates = torch.exp(torch.arange(0, self.latent, 2, device=noisy.device) * (-math.log(10000.0) / self.latent))
        angles = times[:, None] * rates
        time = self.read_time(torch.cat([angles.cos(), angles.sin()], dim=-1).to(noisy))
        said = self.read_text(words.states)
        nothing = self.nothing.expand(len(noisy), 1, -1)
        sequence = torch.cat([noisy[:, None], time[:, None], nothing, said], dim=1)
        sequence = sequence + positions(sequence.shape[1], sequence.shape[2]).to(sequence)
        always = torch.ones_like(words.valid[:, :1])
        hidden = ~torch.cat([always, always, ~words.valid.any(1, keepdim=True), words.valid], dim=1)
        kept = []
        for block in self.down:
            sequence = block(sequence, src_key_padding_mask=hidden)
            kept.append(sequence)
        sequence = self.middle(sequence, src_key_padding_mask=hidden)
        for block, joint in zip(self.up, self.joints, strict=True):
            sequence = block(joint(torch.cat([sequence, kept.pop()], dim=-1)), src_key_padding_mask=hidden)
        return self.norm(sequence)[:, 0]


@dataclass(frozen=True, kw_only=True)
class LatentDiffusionConfig:
    """Everything needed to build the whole again."""

    motion: TextToMotionConfig
    denoiser: DiffusionConfig

    @property
    def encoder(self) -> str:
        return self.motion.encoder

    @property
    def text_width(self) -> int:
        return self.motion.text_width

    @property
    def fps(self) -> float:
        return self.motion.fps

    @property
    def separate(self) -> bool:
        return False


class LatentDiffusion(nn.Module):
    """A denoiser of latents, and the frozen model that they are of."""

    def __init__(self, config: LatentDiffusionConfig):
        super().__init__()
        self.config = config
        self.motion = TextToMotion(replace(config.motion)).requires_grad_(False)
        width = config.motion.latent
        self.denoiser = Denoiser(config.denoiser, width, config.motion.text_width)
        # Latents of a model with a small KL weight are not of variance 1, which the noise is measured by.
        self.register_buffer("centre", torch.zeros(width))
        self.register_buffer("spread", torch.ones(width))
        betas = torch.linspace(config.denoiser.first_noise**0.5, config.denoiser.last_noise**0.5, config.denoiser.times)
        self.register_buffer("kept", (1 - betas.double().square()).cumprod(0).float(), persistent=False)

    def train(self, mode: bool = True) -> "LatentDiffusion":
        super().train(mode)
        self.motion.eval()
        return self

    def standardise(self, latents: Tensor):
        """Take centre and spread from latents [N D] like those that it will be trained on."""
        check_finite("LatentDiffusion.standardise", latents, "clip feature")
        self.centre.copy_(latents.mean(0))
        self.spread.copy_(latents.std(0).clamp(min=1e-3))

    def encode_motion(self, features: Tensor, valid: Tensor) -> Distribution:
        return self.motion.encode_motion(features, valid)

    def noised(self, latent: Tensor, times: Tensor, noise: Tensor) -> Tensor:
        """What a latent [B D] has become at times [B], counted from 0 (DDPM)."""
        kept = self.kept[times][:, None]
        return kept.sqrt() * ((latent - self.centre) / self.spread) + (1 - kept).sqrt() * noise

    def sample(self, words: Sequence[Words], random: torch.Generator) -> Tensor:
        """A latent [B D] for each sentence: noise, taken back step by step (DDIM without new noise), away from what is
        told without the text."""
        (said,) = words
        unsaid = Words(said.states, torch.zeros_like(said.valid))
        both = Words(*(torch.cat(pair) for pair in zip(said, unsaid, strict=True)))
        config = self.config.denoiser
        sample = draw_normal(said.states.new_empty(len(said.states), len(self.centre)), random)
        times = torch.linspace(config.times - 1, 0, config.steps).round().long().tolist()
        for time, after in zip(times, [*times[1:], None], strict=True):
            at = torch.full((2 * len(sample),), time, device=sample.device)
            told, untold = self.denoiser(sample.repeat(2, 1), at, both).chunk(2)
            noise = untold + config.guidance * (told - untold)
            kept = self.kept[time]
            sample = (sample - (1 - kept).sqrt() * noise) / kept.sqrt()
            if after is not None:
                sample = self.kept[after].sqrt() * sample + (1 - self.kept[after]).sqrt() * noise
        return self.centre + self.spread * sample

    def decode(self, latent: Tensor, valid: Tensor) -> Tensor:
        """Features [B T 135] from latent [B D] and valid [B T]."""
        return self.motion.decode(latent, valid)
