"""The frozen text encoder: from the package of the extra, or from any local folder; never from a network."""

import socket

import pytest
import torch

from refine.text.encoder import LONGEST, HuggingFaceEncoder, has_default, load_encoder
from renderers.checks import UserError

pytestmark = pytest.mark.skipif(not has_default(), reason="the extra [text] is not installed")


@pytest.fixture(scope="module")
def distilbert(tmp_path_factory):
    """A DistilBERT as a user would have it in a folder, but small and untrained."""
    from transformers import BertTokenizerFast, DistilBertConfig, DistilBertModel

    folder = tmp_path_factory.mktemp("distilbert")
    words = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", "walk", "wave", "while", "##ing", "the", "right", "hand"]
    (folder / "vocab.txt").write_text("\n".join(words))
    BertTokenizerFast(vocab_file=str(folder / "vocab.txt")).save_pretrained(folder)
    torch.manual_seed(0)
    size = {"vocab_size": len(words), "dim": 16, "n_layers": 1, "n_heads": 2, "hidden_dim": 32}
    DistilBertModel(DistilBertConfig(**size)).save_pretrained(folder)
    return folder


@pytest.fixture
def offline(monkeypatch):
    def refuse(*arguments, **named):
        raise AssertionError("a network was asked")

    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)


@pytest.mark.parametrize("which", ["default", "folder"])
def test_words_and_sentences(which, distilbert, offline):
    encoder = load_encoder(distilbert if which == "folder" else None)
    short, long = "walk", "wave the right hand"
    states, valid = encoder.words([short, long])
    assert states.shape == (2, valid.shape[1], encoder.width) and valid[1].sum() > valid[0].sum() >= 3
    assert not states[~valid].any() and not states.requires_grad
    alone = encoder.words([short])
    torch.testing.assert_close(alone.states[0], states[0, valid[0]], atol=1e-5, rtol=1e-4)
    sentences = encoder.sentences([short, long, short])
    torch.testing.assert_close(sentences.norm(dim=1), torch.ones(3))
    torch.testing.assert_close(sentences[0], sentences[2])
    expected = states[1, valid[1]].mean(0)
    torch.testing.assert_close(sentences[1], expected / expected.norm(), atol=1e-5, rtol=1e-4)


def test_the_default_knows_what_means_the_same(offline):
    walk, stroll, drink = load_encoder().sentences(["walk forwards", "stroll ahead", "drink from a cup"])
    assert float(walk @ stroll) > float(walk @ drink) + 0.2
    assert load_encoder().name == "all-MiniLM-L6-v2" and load_encoder().width == 384


def test_very_long_texts_are_cut_and_longer_ones_refused(distilbert):
    encoder = load_encoder(distilbert)
    assert encoder.words(["walk " * 190]).states.shape[1] == 128
    with pytest.raises(UserError, match=f"{LONGEST + 1:,} characters"):
        encoder.words(["a" * (LONGEST + 1)])
    with pytest.raises(UserError, match="is empty"):
        encoder.words(["walk", "  "])


def test_folders_that_hold_no_encoder(tmp_path, distilbert):
    with pytest.raises(UserError, match="holds no text encoder"):
        load_encoder(tmp_path / "missing")
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(UserError, match="cannot be read as a text encoder"):
        HuggingFaceEncoder(tmp_path).words(["walk"])
    for path in distilbert.iterdir():  # its weights are a pickle: not read
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "model.safetensors").rename(tmp_path / "pytorch_model.bin")
    with pytest.raises(UserError, match="safetensors"):
        HuggingFaceEncoder(tmp_path).words(["walk"])
