"""The training program of motion latent diffusion (MLD) on the latents of a trained text-to-motion model."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from refine.text.diffusion import DiffusionConfig, LatentDiffusion, LatentDiffusionConfig
from refine.text.encoder import Words
from refine.text.labellers import labeller
from renderers.body import Body
from renderers.checks import UserError, check_range
from train.checkpoints import hash_motions, hash_tensors, provenance
from train.loop import LoopConfig, check_device, check_folder, check_loop, fit, open_run, seed_of
from train.text import MEASURED, TYPICAL, described_clips, refuse_other_clips
from train.text_data import TextBatch, TextDataConfig, TextStore
from train.text_models import encoder_of, load_text_to_motion


@dataclass(frozen=True)
class DiffusionTraining:
    """Train a latent diffusion model (MLD) on the latents of a text-to-motion model."""

    start: Path = Path("runs/text")
    """Run of `refine train text` whose motion encoder and decoder are used as they are; the paper takes one that was
    trained on single actions."""
    out: Path = Path("runs/diffusion")
    """Run folder."""
    encoder: Path | None = None
    """Local folder of the text encoder that run had, unless it was the default one."""
    data: TextDataConfig = field(default_factory=TextDataConfig)
    network: DiffusionConfig = field(default_factory=DiffusionConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    text_dropout: float = 0.1
    """Share of clips whose text is not told, so that the model learns to do without (guidance)."""
    batch: int = 32
    measured: int = 128
    """Held-out clips that are measured at a checkpoint."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``."""
    resume: bool = False
    """Go on with the run in ``out``."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "batch", "measured")
        check_range(self, 0, 1, "text_dropout")


def train_diffusion(config: DiffusionTraining) -> Path:
    """Run the whole program and return the path of the best weights, which ``load_diffusion`` reads.

    Raises:
        UserError: see ``train.text.train_text`` and ``load_text_to_motion``.
    """
    check_device(config.device)
    check_loop(config.loop)
    check_folder(config.out, config.resume)
    return Training(config).run()


class Training:
    """One run."""

    def __init__(self, config: DiffusionTraining):
        frozen = load_text_to_motion(config.start)
        if config.data.fps != frozen.config.fps:
            problem = f"is {config.data.fps:g}, {config.start} makes {frozen.config.fps:g} frames a second"
            raise UserError("--data.fps", problem, "give the same")
        self.config, self.device = config, torch.device(config.device)
        self.encoder = encoder_of(frozen, config.encoder).to(config.device)
        clips = described_clips(config.data)
        learned = [clip for clip in clips if clip.split == "train"]
        unseen = [clip for clip in clips if clip.split == "val"]
        self.learned = TextStore.build(learned, config.data, labeller(), Body.free("light").rest_joints)
        self.unseen = TextStore.build(unseen or learned, replace(config.data, synthetic="none"))
        with torch.random.fork_rng():
            torch.manual_seed(seed_of(config.loop.seed))
            self.model = LatentDiffusion(LatentDiffusionConfig(motion=frozen.config, denoiser=config.network))
        self.model.motion.load_state_dict(frozen.state_dict())
        typical = self.learned.draw(512, torch.Generator().manual_seed(TYPICAL))
        with torch.no_grad():
            said = self.model.eval().encode_motion(typical.features, typical.valid)
        self.model.standardise(said.mean)
        self.model.to(self.device)
        self.record = {
            "provenance": provenance(config.loop.seed, hash_motions([clip.motion for clip in clips])),
            "motion_sha256": hash_tensors(frozen),
        }

    def run(self) -> Path:
        config = self.config
        open_run(config.out, config, config.resume)
        refuse_other_clips(config.out / "last.json", self.record)
        return fit(
            self.model, self.losses, config.loop, config.out, "text-diffusion", self.record, self.measure, config.resume
        )

    def losses(self, step: int, random: torch.Generator) -> Iterator[dict[str, Tensor]]:
        yield self.terms(self.learned.draw(self.config.batch, random), random, self.config.text_dropout)

    def terms(self, batch: TextBatch, random: torch.Generator, dropout: float) -> dict[str, Tensor]:
        """The mean squared error of the noise, at a random time of each clip."""
        count, width = len(batch.texts), self.model.config.motion.latent
        draws = torch.randn(2, count, width, generator=random).to(self.device)
        times = torch.randint(self.config.network.times, (count,), generator=random).to(self.device)
        told = (torch.rand(count, generator=random) >= dropout).to(self.device)
        with torch.no_grad():
            posterior = self.model.encode_motion(batch.features.to(self.device), batch.valid.to(self.device))
        states, valid = self.encoder.words(batch.sentences)
        noisy = self.model.noised(posterior.draw(draws[0]), times, draws[1])
        found = self.model.denoiser(noisy, times, Words(states, valid & told[:, None]))
        return {"total": mse_loss(found, draws[1])}

    def measure(self) -> dict[str, float]:
        """The error on held-out clips, always the same ones."""
        random = torch.Generator().manual_seed(MEASURED)
        terms = self.terms(self.unseen.draw(self.config.measured, random), random, 0.0)
        return {name: float(value) for name, value in terms.items()}
