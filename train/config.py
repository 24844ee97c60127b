"""Whole runs as values: what `refine train` takes, and its presets."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from refine.coupling import CouplingConfig
from refine.decoupling import DecouplingConfig
from refine.generator import SMALL, TINY, NetworkConfig
from refine.mae import MAEConfig
from refine.seeing import check_drawn
from renderers.checks import check_range
from train.data import DataConfig
from train.loop import LoopConfig
from train.pictures import PictureConfig
from train.shares import SharesConfig
from train.steps import GeneratorLoss


@dataclass(frozen=True)
class MAETraining:
    """Train the inpainting MAE on renders of single actions (protocol E.3)."""

    out: Path = Path("runs/mae")
    """Run folder."""
    start: Path | None = None
    """Weights to go on from, for example to tune the shipped ones to your clips; none starts from noise."""
    data: DataConfig = field(default_factory=DataConfig)
    network: MAEConfig = field(default_factory=MAEConfig)
    pictures: PictureConfig = field(default_factory=PictureConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the network's products; bfloat16 is nearly twice as fast where the processor knows it."""
    batch: int = 64
    body_weight: float = 4.0
    """How many times a hidden patch counts that the body touches; most of a picture is background."""
    measured: int = 512
    """Held-out pictures that are measured at a checkpoint."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``. Random numbers are the same on every device."""
    resume: bool = False
    """Go on with the run in ``out``."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "batch", "measured")
        check_drawn(self.network.channels, self.pictures.pinned)


@dataclass(frozen=True)
class GeneratorTraining:
    """Train the generator on pseudo-compositions of pairs, as LFCA does."""

    out: Path = Path("runs/generator")
    """Run folder."""
    variant: str = ""
    """A row of the result tables; what it stands for goes before other flags: pretrain-mask, disentanglement,
    without-mask, without-gaussian, all-classes, without-dr, dr-paper, dr-plain, dr-generated, dr-shares,
    dr-one-camera or with-dr. None leaves the preset as it is."""
    mae: Path | None = None
    """Weights of the MAE that the decoupling loss asks; none takes those that come with the package."""
    data: DataConfig = field(default_factory=DataConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    loss: GeneratorLoss = field(default_factory=GeneratorLoss)
    coupling: CouplingConfig = field(default_factory=CouplingConfig)
    shares: SharesConfig = field(default_factory=SharesConfig)
    decoupling: DecouplingConfig = field(default_factory=DecouplingConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    batch: int = 32
    """Pairs of a step, over all processes and parts."""
    accumulate: int = 1
    """Parts in which each process takes its share of a batch, one after the other: the same step in less memory. Only
    dropout, if there is any, falls otherwise."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the network's products; losses, bodies and pictures are float32."""
    measured: int = 128
    """Held-out pairs that are measured at a checkpoint."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``. Random numbers are the same on every device."""
    resume: bool = False
    """Go on with the run in ``out``."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "batch", "accumulate", "measured")


MAE_LOOP = LoopConfig(
    steps=20_000,
    learning_rate=1e-3,
    weight_decay=0.05,
    betas=(0.9, 0.95),
    warmup=500,
    schedule="cosine",
    clip_gradients=1.0,
    log_every=10,
    save_every=1000,
)

MAE_PRESETS: dict[str, tuple[str, MAETraining]] = {
    "tiny": (
        "A small network for trying things out: two minutes on one core.",
        MAETraining(
            data=DataConfig(synthetic_clips=6),
            network=MAEConfig(width=96, depth=3, decoder_width=64, decoder_depth=1, decoder_heads=2),
            loop=replace(MAE_LOOP, steps=1500, learning_rate=2e-3, warmup=50, log_every=1, save_every=300),
            batch=32,
            measured=256,
        ),
    ),
    "small": (
        "The network that comes with the package: about an hour on one core.",
        MAETraining(
            data=DataConfig(synthetic_clips=60),
            loop=replace(MAE_LOOP, steps=6000, warmup=200, save_every=500),
            precision="bfloat16",
        ),
    ),
    "plain": (
        "What the rows dr-paper and dr-plain ask: plain silhouettes, where the published loss shows them. Ten minutes.",
        MAETraining(
            data=DataConfig(synthetic_clips=60),
            network=MAEConfig(channels=1),
            pictures=PictureConfig(pinned="sequence"),
            loop=replace(MAE_LOOP, steps=1500, warmup=100, save_every=500),
            precision="bfloat16",
        ),
    ),
    "paper": (
        "Protocol E.3's larger network at 112 px, for a graphics card.",
        MAETraining(
            data=DataConfig(synthetic_clips=200),
            network=MAEConfig(size=112, width=256, depth=8, heads=4, decoder_width=128, decoder_depth=4),
            loop=replace(MAE_LOOP, steps=200_000, learning_rate=6e-4, warmup=2000, log_every=50, save_every=5000),
            precision="bfloat16",
            batch=256,
            device="cuda",
        ),
    ),
}

GENERATOR_PRESETS: dict[str, tuple[str, GeneratorTraining]] = {
    "tiny": (
        "A small network for trying things out: minutes on one core. Leaves the shares of Eq. 3.",
        GeneratorTraining(
            data=DataConfig(synthetic_clips=6),
            network=TINY,
            loss=GeneratorLoss(decoupling_clips=2, decoupling_frames=1),
            shares=SharesConfig(looks=0),
            loop=LoopConfig(steps=600, learning_rate=1e-3, warmup=20, clip_gradients=1.0, save_every=200),
            measured=64,
        ),
    ),
    "small": (
        "A benchmark's few actions: a quarter of an hour on one core.",
        GeneratorTraining(
            network=SMALL,
            loss=GeneratorLoss(
                kl=1e-4, kl_first=1e-5, kl_ramp=2500, decoupling_clips=2, decoupling_frames=1, decoupling_every=2
            ),
            decoupling=DecouplingConfig(precision="bfloat16"),
            loop=LoopConfig(
                steps=5000,
                learning_rate=1e-3,
                warmup=100,
                schedule="cosine",
                clip_gradients=1.0,
                log_every=10,
                save_every=1000,
            ),
            batch=16,
            precision="bfloat16",
        ),
    ),
    "paper": (
        "LFCA's network, batch and rates, for graphics cards.",
        GeneratorTraining(
            loss=GeneratorLoss(decoupling_clips=128, decoupling_every=3),
            decoupling=DecouplingConfig(precision="bfloat16"),
            # 1500 epochs of the 14,400 ordered pairs of 120 clips, 800 at a time.
            loop=LoopConfig(steps=27_000, log_every=10, save_every=1000),
            batch=800,
            precision="bfloat16",
            measured=800,
            device="cuda",
        ),
    ),
}
