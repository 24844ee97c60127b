"""The text-to-motion network: what is hidden does not matter, what is said does."""

from dataclasses import replace

import pytest
import torch

from refine.text.encoder import Words
from refine.text.features import WIDTH
from refine.text.model import TextToMotion, TextToMotionConfig, generate_features, separate_words
from renderers.checks import ShapeError, UserError

TINY = TextToMotionConfig(latent=16, feedforward=32, heads=2, layers=2, dropout=0.0, encoder="test", text_width=12)


def network(config: TextToMotionConfig = TINY) -> TextToMotion:
    torch.manual_seed(0)
    return TextToMotion(config).eval().double()


def words(lengths: list[int], seed: int = 1) -> Words:
    states = torch.randn(len(lengths), max(lengths), 12, generator=torch.Generator().manual_seed(seed)).double()
    valid = torch.arange(max(lengths)) < torch.tensor(lengths)[:, None]
    return Words(states * valid[..., None], valid)


def clip(frames: int = 7, count: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    features = torch.randn(count, frames, WIDTH, generator=torch.Generator().manual_seed(2)).double()
    return features, torch.ones(count, frames, dtype=torch.bool)


def test_padding_changes_nothing():
    model, (features, valid) = network(), clip()
    longer = torch.cat([features, torch.full((3, 4, WIDTH), 9.0).double()], 1)
    hidden = torch.cat([valid, torch.zeros(3, 4, dtype=torch.bool)], 1)
    plain, padded = model.encode_motion(features, valid), model.encode_motion(longer, hidden)
    torch.testing.assert_close(plain, padded)
    said = words([5, 3])
    wide = Words(
        torch.nn.functional.pad(said.states, (0, 0, 0, 6), value=9.0), torch.nn.functional.pad(said.valid, (0, 6))
    )
    torch.testing.assert_close(model.encode_text([said]), model.encode_text([wide]))
    latent = torch.randn(3, 16).double()
    made = model.decode(latent, hidden)
    torch.testing.assert_close(made[:, :7], model.decode(latent, valid))
    assert not made[:, 7:].any()


def test_standardisation_is_undone():
    model, (features, valid) = network(), clip()
    constant = features[valid].clone()
    constant[:, 3] = 2.0
    model.standardise(constant)
    assert model.centre[3] == 2.0
    normal = model.normal(constant)
    assert normal.mean(0).abs().max() < 1e-6 and (normal.std(0)[[0, 1, 2, 4]] - 1).abs().max() < 1e-6
    with torch.no_grad():
        model.write.weight.zero_()
        model.write.bias.zero_()
    torch.testing.assert_close(model.decode(torch.zeros(1, 16).double(), valid[:1])[0, 0], model.centre)


class Speller:
    """An encoder whose states are letters."""

    name, width = "test", 12

    def to(self, device):
        return self

    def words(self, texts):
        lengths = [len(text) for text in texts]
        states = torch.zeros(len(texts), max(lengths), 12, dtype=torch.double)
        for row, text in enumerate(texts):
            for place, letter in enumerate(text):
                states[row, place, ord(letter) % 12] = 1.0
        return Words(states, torch.arange(max(lengths)) < torch.tensor(lengths)[:, None])

    def sentences(self, texts):
        return torch.nn.functional.normalize(self.words(texts).states.sum(1), dim=-1)


def test_separate_texts_are_read_whole_and_nothing_else():
    model = network(replace(TINY, separate=True))
    pair = [("ab", "cdefg"), ("abcd", "e")]
    together = model.encode_text(separate_words(Speller(), pair))
    for index, each in enumerate(pair):  # a text beside longer ones is what it is alone: the mask fits the tokens
        alone = model.encode_text(separate_words(Speller(), [each]))
        # Positions count from the first text's padded length, so only the row with the longest first text is alike.
        if index == 1:
            torch.testing.assert_close(together.mean[1:], alone.mean)
    first, second = separate_words(Speller(), pair)
    for words_, where in ((first, 0), (second, 1)):
        for row in range(2):
            for place in range(words_.states.shape[1]):
                changed = words_.states.clone()
                changed[row, place] += 1.0
                texts = [first, second]
                texts[where] = Words(changed, words_.valid)
                moved = (model.encode_text(texts).mean - together.mean).abs().amax(1) > 1e-9
                assert moved.tolist() == [row == n and bool(words_.valid[row, place]) for n in range(2)]


def test_one_action_beside_two():
    model = network(replace(TINY, separate=True))
    mixed = model.encode_text(separate_words(Speller(), [("abc",), ("abc", "de")]))
    alone = model.encode_text(separate_words(Speller(), [("abc",)]))
    torch.testing.assert_close(mixed.mean[:1], alone.mean)
    with pytest.raises(UserError, match="one sentence"):
        network().encode_text(separate_words(Speller(), [("a", "b")]))


def test_generating_draws_from_the_text():
    model, said = network(), words([4, 2])
    valid = torch.ones(2, 5, dtype=torch.bool)
    made = [generate_features(model, [said], valid, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1)]
    assert made[0].shape == (2, 5, WIDTH)
    assert torch.equal(made[0], made[1]) and not torch.equal(made[0], made[2])
    swapped = Words(said.states.flip(0), said.valid.flip(0))
    torch.testing.assert_close(model.encode_text([swapped]).mean.flip(0), model.encode_text([said]).mean)


def test_shapes_and_sizes_are_checked():
    with pytest.raises(UserError, match="6 heads"):
        replace(TINY, latent=256, heads=6)
    with pytest.raises(ShapeError):
        network().encode_motion(torch.zeros(2, 5, 134).double(), torch.ones(2, 5, dtype=torch.bool))
    with pytest.raises(ShapeError):
        network().encode_text([Words(torch.zeros(2, 5, 11).double(), torch.ones(2, 5, dtype=torch.bool))])
