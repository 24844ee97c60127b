"""Text to motion: TEMOS' two encoders into one latent space and a decoder out of it, as SINC trains it.

A motion and a text are each encoded as a normal distribution over the latent. What is drawn from either is decoded to
the motion; see ``train.text_steps`` for what makes the two alike. Texts arrive as what a frozen language model says of
each of their tokens (``refine.text.encoder``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor, nn

from refine.generator import draw_normal, positions
from refine.text.encoder import TextEncoder, Words
from refine.text.features import WIDTH
from renderers.checks import UserError, check_finite, check_range, check_shapes

if TYPE_CHECKING:
    from refine.text.diffusion import LatentDiffusion

LEAST_SPREAD = 0.005


@dataclass(frozen=True, kw_only=True)
class TextNetworkConfig:
    """The network's size; both encoders and the decoder are alike. The defaults are those that SINC's code ran with:
    the paper says 6 heads, which do not divide 256."""

    latent: int = 256
    """Width of the latent and of every token."""
    feedforward: int = 1024
    heads: int = 4
    layers: int = 6
    """Of each encoder and of the decoder."""
    dropout: float = 0.1
    norm_first: bool = False
    """Normalise what a block reads and not, as published, what it writes: learns several times faster."""
    separate: bool = False
    """Encode the texts of several actions one by one, and join them with a learned separator (SINC-STE), instead of
    one sentence that says them all."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "latent", "feedforward", "heads", "layers")
        check_range(self, 0, 0.99, "dropout")
        if self.latent % self.heads or self.latent % 2:
            problem = f"{self.latent} is not even and divisible by {self.heads} heads"
            raise UserError(f"{type(self).__name__}(latent)", problem, "choose a multiple of both")


@dataclass(frozen=True, kw_only=True)
class TextToMotionConfig(TextNetworkConfig):
    """Everything needed to build the network again and to read its output."""

    encoder: str
    """Name of the text encoder that it was trained with."""
    text_width: int
    """Of that encoder's states."""
    fps: float = 30.0


class Distribution(NamedTuple):
    """A normal distribution over the latent; mean and log_variance [B D]."""

    mean: Tensor
    log_variance: Tensor

    def draw(self, noise: Tensor) -> Tensor:
        """By reparameterisation, noise [B D] standard normal."""
        return self.mean + (self.log_variance / 2).exp() * noise


class SequenceEncoder(nn.Module):
    """ACTOR's encoder of a sequence into a distribution: two learned tokens stand before it, and what they have become
    is read."""

    def __init__(self, config: TextNetworkConfig):
        super().__init__()
        self.tokens = nn.Parameter(torch.randn(2, config.latent))
        self.dropout = nn.Dropout(config.dropout)
        block = layer_of(nn.TransformerEncoderLayer, config)
        self.layers = nn.TransformerEncoder(block, config.layers, enable_nested_tensor=False)

    def forward(self, sequence: Tensor, valid: Tensor) -> Distribution:
        """sequence [B L D], valid [B L] True = there is something."""
        tokens = self.tokens.expand(len(sequence), -1, -1)
        sequence = torch.cat([tokens, sequence], dim=1)
        sequence = self.dropout(sequence + positions(sequence.shape[1], sequence.shape[2]).to(sequence))
        hidden = torch.cat([torch.zeros_like(valid[:, :1]).expand(-1, 2), ~valid], dim=1)
        encoded = self.layers(sequence, src_key_padding_mask=hidden)
        return Distribution(*(encoded[:, index].to(self.tokens.dtype) for index in (0, 1)))


def layer_of(kind: type[nn.Module], config: TextNetworkConfig) -> nn.Module:
    size = (config.latent, config.heads, config.feedforward, config.dropout, "gelu")
    return kind(*size, batch_first=True, norm_first=config.norm_first)


class TextToMotion(nn.Module):
    """The model. Features [B T 135] are those of ``refine.text.features``; they are standardised inside, so that what
    goes in and comes out is in metres."""

    def __init__(self, config: TextToMotionConfig):
        super().__init__()
        self.config = config
        self.register_buffer("centre", torch.zeros(WIDTH))
        self.register_buffer("spread", torch.ones(WIDTH))
        self.read_motion = nn.Linear(WIDTH, config.latent)
        self.read_text = nn.Sequential(nn.ReLU(), nn.Linear(config.text_width, config.latent))
        if config.separate:
            self.separator = nn.Parameter(torch.randn(config.latent))
        self.motion_encoder = SequenceEncoder(config)
        self.text_encoder = SequenceEncoder(config)
        self.dropout = nn.Dropout(config.dropout)
        self.decoder = nn.TransformerDecoder(layer_of(nn.TransformerDecoderLayer, config), config.layers)
        self.write = nn.Linear(config.latent, WIDTH)

    def standardise(self, features: Tensor):
        """Take centre and spread from features [N 135] like those that it will be trained on.

        What hardly moves (SINC adds 1e-5 to its spread) is not blown up into noise that has to be learned.
        """
        check_finite("TextToMotion.standardise", features, "frame feature")
        self.centre.copy_(features.mean(0))
        self.spread.copy_(features.std(0).clamp(min=LEAST_SPREAD))

    def normal(self, features: Tensor) -> Tensor:
        """Less their mean and over their spread."""
        return (features - self.centre) / self.spread

    def encode_motion(self, features: Tensor, valid: Tensor) -> Distribution:
        """features [B T 135], valid [B T] True = a real frame."""
        check_shapes("TextToMotion", features=(features, "B T 135"), valid=(valid, "B T"))
        normal = self.normal(features) * valid[..., None]
        return self.motion_encoder(self.read_motion(normal), valid)

    def encode_text(self, texts: Sequence[Words]) -> Distribution:
        """Texts that say it together: one of each, a sentence; or, of a model with ``separate``, one an action.

        Args:
            texts: each of states [B L E] and valid [B L]; a clip that has no such text is not valid anywhere.
        """
        if len(texts) != 1 and not self.config.separate:
            raise UserError("TextToMotion.encode_text", f"one sentence was expected, got {len(texts)} texts")
        parts, valid = [], []
        for index, words in enumerate(texts):
            check_shapes(
                "TextToMotion",
                {"E": self.config.text_width},
                states=(words.states, "B L E"),
                valid=(words.valid, "B L"),
            )
            there = words.valid.any(1, keepdim=True)
            if index:
                parts.append(self.separator.expand(len(there), 1, -1))
                valid.append(there)
            parts.append(self.read_text(words.states))
            valid.append(words.valid)
        return self.text_encoder(torch.cat(parts, 1), torch.cat(valid, 1))

    def decode(self, latent: Tensor, valid: Tensor) -> Tensor:
        """Features [B T 135] from latent [B D] and valid [B T]; padded frames are zero."""
        check_shapes("TextToMotion", {"D": self.config.latent}, latent=(latent, "B D"), valid=(valid, "B T"))
        queries = self.dropout(positions(valid.shape[1], latent.shape[1]).to(latent).expand(len(latent), -1, -1))
        decoded = self.write(self.decoder(queries, latent[:, None], tgt_key_padding_mask=~valid))
        return (self.centre + self.spread * decoded.to(latent.dtype)) * valid[..., None]

    def sample(self, words: Sequence[Words], random: torch.Generator) -> Tensor:
        """A latent [B D] for each text."""
        said = self.encode_text(words)
        return said.draw(draw_normal(said.mean, random))


def words_of(
    model: TextToMotion, encoder: TextEncoder, texts: Sequence[Sequence[str]], conjunction: str
) -> list[Words]:
    """What the model reads of each clip's texts [B][actions]: their sentence, or each by itself."""
    from refine.text.sentences import combine

    if not model.config.separate:
        return [encoder.words([combine(each, conjunction) for each in texts])]
    return separate_words(encoder, texts)


def separate_words(encoder: TextEncoder, texts: Sequence[Sequence[str]]) -> list[Words]:
    """The first text of every clip, the second, and so on; a clip that has fewer is not valid there."""
    found = []
    for index in range(max(map(len, texts))):
        there = [n for n, each in enumerate(texts) if index < len(each)]
        said = encoder.words([texts[n][index] for n in there])
        states = said.states.new_zeros(len(texts), *said.states.shape[1:])
        valid = said.valid.new_zeros(len(texts), said.valid.shape[1])
        states[there], valid[there] = said.states, said.valid
        found.append(Words(states, valid))
    return found


@torch.no_grad()
def generate_features(
    model: "TextToMotion | LatentDiffusion", words: Sequence[Words], valid: Tensor, random: torch.Generator
) -> Tensor:
    """One motion for each text -> features [B T 135], zero where valid [B T] is not. The model must be in evaluation
    mode."""
    return model.decode(model.sample(words, random), valid)
