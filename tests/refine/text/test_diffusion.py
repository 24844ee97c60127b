"""Latent diffusion: its noise, its way back, and guidance."""

import pytest
import torch

from refine.text.diffusion import Denoiser, DiffusionConfig, LatentDiffusion, LatentDiffusionConfig
from refine.text.encoder import Words
from refine.text.model import TextToMotionConfig
from renderers.checks import UserError

MOTION = TextToMotionConfig(latent=8, feedforward=16, heads=2, layers=1, dropout=0.0, encoder="test", text_width=6)
SMALL = DiffusionConfig(feedforward=16, heads=2, layers=3, dropout=0.0)


def model(config: DiffusionConfig = SMALL) -> LatentDiffusion:
    torch.manual_seed(0)
    return LatentDiffusion(LatentDiffusionConfig(motion=MOTION, denoiser=config)).eval()


def words(count: int = 2) -> Words:
    return Words(torch.randn(count, 4, 6, generator=torch.Generator().manual_seed(1)), torch.ones(count, 4).bool())


def test_the_schedule_is_that_of_latent_diffusion():
    kept = model().kept
    # Products of 1 - beta with the root of beta linear from .00085 to .012, as Stable Diffusion's: known figures.
    assert float(kept[0]) == pytest.approx(0.99915, abs=1e-6)
    assert float(kept[-1]) == pytest.approx(0.0047, abs=1e-4)
    assert (kept.diff() < 0).all()


def test_a_perfect_denoiser_gives_the_latent_back():
    whole = model()
    whole.standardise(torch.randn(50, 8, generator=torch.Generator().manual_seed(3)) * 3 + 1)
    clean = torch.randn(2, 8, generator=torch.Generator().manual_seed(4))
    normal = (clean - whole.centre) / whole.spread

    class Perfect(torch.nn.Module):
        def forward(self, noisy, times, said):
            kept = whole.kept[times][:, None]
            return (noisy - kept.sqrt() * normal.repeat(len(noisy) // 2, 1)) / (1 - kept).sqrt()

    whole.denoiser = Perfect()
    found = whole.sample([words()], torch.Generator().manual_seed(5))
    torch.testing.assert_close(found, clean, atol=1e-3, rtol=1e-3)


def test_noise_grows_to_a_standard_normal():
    whole = model()
    latent, noise = torch.ones(1, 8).repeat(2000, 1), torch.randn(2000, 8, generator=torch.Generator().manual_seed(6))
    last = whole.noised(latent, torch.full((2000,), 999), noise)
    assert abs(float(last.mean()) - 0.0047**0.5) < 0.02 and abs(float(last.std()) - 1) < 0.02
    torch.testing.assert_close(whole.noised(latent, torch.zeros(2000).long(), noise * 0), latent * 0.99915**0.5)


def test_without_text_words_do_not_matter_and_with_it_they_do():
    whole = model()
    noisy, times, said = torch.randn(2, 8), torch.tensor([3, 900]), words()
    other = Words(said.states + 1, said.valid)
    unsaid = [Words(each.states, torch.zeros_like(each.valid)) for each in (said, other)]
    torch.testing.assert_close(*(whole.denoiser(noisy, times, each) for each in unsaid))
    assert not torch.allclose(whole.denoiser(noisy, times, said), whole.denoiser(noisy, times, other))
    padded = Words(
        torch.nn.functional.pad(said.states, (0, 0, 0, 3), value=7.0), torch.nn.functional.pad(said.valid, (0, 3))
    )
    torch.testing.assert_close(whole.denoiser(noisy, times, said), whole.denoiser(noisy, times, padded))


def test_guidance_of_one_listens_to_the_text_alone():
    told, free = model(DiffusionConfig(**{**vars(SMALL), "guidance": 1.0})), model()
    sampled = [one.sample([words()], torch.Generator().manual_seed(0)) for one in (told, free)]
    assert not torch.allclose(*sampled)
    told.denoiser.nothing.data += 5.0  # what the untold half reads
    torch.testing.assert_close(
        told.sample([words()], torch.Generator().manual_seed(0)), sampled[0], atol=1e-4, rtol=1e-4
    )


def test_only_the_denoiser_learns():
    whole = model().train()
    assert not whole.motion.training and whole.denoiser.training
    assert not any(value.requires_grad for value in whole.motion.parameters())
    assert all(value.requires_grad for value in whole.denoiser.parameters())


def test_odd_layers_and_sane_noise():
    with pytest.raises(UserError, match="odd"):
        DiffusionConfig(layers=4)
    with pytest.raises(UserError, match="noise"):
        DiffusionConfig(first_noise=0.5, last_noise=0.1)
    with pytest.raises(UserError, match="noise"):
        DiffusionConfig(times=10, steps=50)
    assert len(Denoiser(DiffusionConfig(), 256, 768).joints) == 4
