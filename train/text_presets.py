"""Presets of the programs that train text to motion, its judge and its diffusion model."""

from dataclasses import replace
from pathlib import Path

from refine.text.diffusion import DiffusionConfig
from refine.text.model import TextNetworkConfig
from train.loop import LoopConfig
from train.text import TextTraining
from train.text_data import TextDataConfig
from train.text_diffusion import DiffusionTraining
from train.text_steps import TextLoss

SMALL = TextNetworkConfig(latent=128, feedforward=256, layers=2, dropout=0.0, norm_first=True)
SMALL_DATA = TextDataConfig(fps=15.0, frames=45)
SMALL_LOOP = LoopConfig(
    steps=1500,
    learning_rate=2e-3,
    warmup=100,
    schedule="cosine",
    clip_gradients=1.0,
    log_every=10,
    save_every=500,
)
# As in a variational autoencoder whose prior is the text's: what is drawn moves, at the price of some error.
SMALL_LOSS = TextLoss(text=0.0, kl=5e-4, prior="learned", latent=0.0)
SINC_LOSS = TextLoss(kl=1e-4)
# 500 epochs of BABEL's 25,000 single actions and 2,500 pairs, 64 at a time.
PAPER_LOOP = LoopConfig(steps=215_000, learning_rate=3e-4, log_every=50, save_every=5000)

TEXT_PRESETS: dict[str, tuple[str, TextTraining]] = {
    "tiny": (
        "A small network for trying things out: a minute on one core.",
        TextTraining(
            data=replace(SMALL_DATA, builtin_clips=6),
            network=SMALL,
            loss=SMALL_LOSS,
            loop=replace(SMALL_LOOP, steps=400, warmup=20, save_every=200),
            batch=16,
            measured=64,
            precision="bfloat16",
        ),
    ),
    "small": (
        "A few dozen actions: six minutes on one core.",
        TextTraining(
            data=SMALL_DATA,
            network=SMALL,
            loss=SMALL_LOSS,
            loop=replace(SMALL_LOOP, steps=3000),
            batch=16,
            precision="bfloat16",
        ),
    ),
    "sinc": (
        "SINC's terms in a small network: three minutes on one core. Near the mean of what a text may mean, it glides.",
        TextTraining(data=SMALL_DATA, network=SMALL, loss=SINC_LOSS, loop=SMALL_LOOP, batch=16, precision="bfloat16"),
    ),
    "paper": (
        "SINC's network, batch and rates, for a graphics card; give --encoder the folder of DistilBERT.",
        TextTraining(loop=PAPER_LOOP, batch=64, device="cuda"),
    ),
}

SCORER_DATA = TextDataConfig(synthetic="none", pairs=False)

SCORER_PRESETS: dict[str, tuple[str, TextTraining]] = {
    "tiny": (
        "For trying things out: a minute on one core.",
        TextTraining(
            out=Path("runs/text-scorer"),
            data=replace(SCORER_DATA, fps=15.0, frames=45, builtin_clips=6),
            network=SMALL,
            loss=TextLoss(contrastive=0.1),
            loop=replace(SMALL_LOOP, steps=400, warmup=20, save_every=200, seed=20),
            measured=64,
            precision="bfloat16",
        ),
    ),
    "small": (
        "A few dozen actions: five minutes on one core.",
        TextTraining(
            out=Path("runs/text-scorer"),
            data=replace(SCORER_DATA, fps=15.0, frames=45),
            network=SMALL,
            loss=TextLoss(contrastive=0.1),
            loop=replace(SMALL_LOOP, seed=20),
            precision="bfloat16",
        ),
    ),
    "paper": (
        "TEMOS' network on single actions, as SINC's score has it, for a graphics card.",
        TextTraining(
            out=Path("runs/text-scorer"),
            data=SCORER_DATA,
            loss=TextLoss(kl=1e-5),
            loop=replace(PAPER_LOOP, steps=780_000, learning_rate=1e-4, seed=20),
            batch=32,
            device="cuda",
        ),
    ),
}

DIFFUSION_PRESETS: dict[str, tuple[str, DiffusionTraining]] = {
    "tiny": (
        "For trying things out: a minute on one core.",
        DiffusionTraining(
            data=replace(SMALL_DATA, builtin_clips=6),
            network=DiffusionConfig(feedforward=256, layers=5, dropout=0.0, guidance=2.5),
            loop=replace(SMALL_LOOP, steps=400, warmup=20, save_every=200),
            measured=64,
        ),
    ),
    "small": (
        "A few dozen actions: five minutes on one core.",
        DiffusionTraining(
            data=SMALL_DATA,
            network=DiffusionConfig(feedforward=256, layers=5, dropout=0.0, guidance=2.5),
            loop=replace(SMALL_LOOP, steps=3000),
            batch=16,
        ),
    ),
    "paper": (
        "MLD's denoiser, batch and rate, for a graphics card.",
        DiffusionTraining(loop=replace(PAPER_LOOP, steps=1_700_000, learning_rate=1e-4), batch=16, device="cuda"),
    ),
}
