"""Trained text-to-motion models from disk."""

from pathlib import Path
from typing import Any

from refine.formats.untrusted import read_json
from refine.text.diffusion import DiffusionConfig, LatentDiffusion, LatentDiffusionConfig
from refine.text.encoder import TextEncoder, load_encoder
from refine.text.model import TextToMotion, TextToMotionConfig
from renderers.checks import UserError
from train.checkpoints import load_network, weights_of

TextModel = TextToMotion | LatentDiffusion
"""What makes motions of texts."""


def load_text_to_motion(path: str | Path, kind: str = "text") -> TextToMotion:
    """A trained model in evaluation mode.

    Args:
        path: a ``.safetensors`` with its ``.json`` beside, or a run folder, whose best weights are taken.
        kind: "text", or "text-scorer" for a judge.

    Raises:
        UserError: missing or damaged files, or the weights of something else.
    """

    def build(stored: dict[str, Any]) -> TextToMotion:
        return TextToMotion(TextToMotionConfig(**stored))

    return load_network(path, kind, build, lambda stored: stored["layers"])


def load_diffusion(path: str | Path) -> LatentDiffusion:
    """The same of ``refine train text-diffusion``."""

    def build(stored: dict[str, Any]) -> LatentDiffusion:
        motion, denoiser = TextToMotionConfig(**stored["motion"]), DiffusionConfig(**stored["denoiser"])
        return LatentDiffusion(LatentDiffusionConfig(motion=motion, denoiser=denoiser))

    def blocks(stored: dict[str, Any]) -> int:
        return stored["motion"]["layers"] + stored["denoiser"]["layers"]

    return load_network(path, "text-diffusion", build, blocks)


def load_text_model(path: str | Path) -> TextModel:
    """Either of the two that make motions, whichever it is."""
    described = weights_of(path).with_suffix(".json")
    found = read_json(described, finite=False) if described.is_file() else {}
    diffusion = isinstance(found, dict) and found.get("kind") == "text-diffusion"
    return load_diffusion(path) if diffusion else load_text_to_motion(path)


def encoder_of(model: TextModel, folder: Path | None = None) -> TextEncoder:
    """The text encoder that a model was trained with.

    Raises:
        UserError: the one that is given, or by default installed, is another.
    """
    encoder = load_encoder(folder)
    if (encoder.name, encoder.width) != (model.config.encoder, model.config.text_width):
        problem = f"is {encoder.name!r} of width {encoder.width}, the model was trained with {model.config.encoder!r}"
        raise UserError("text encoder", f"{problem} of width {model.config.text_width}", "pass that one's folder")
    return encoder
