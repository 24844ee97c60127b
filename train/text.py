"""The training program of text to motion, and of the encoder that judges it."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor
from torch.nn.attention import SDPBackend, sdpa_kernel

from refine.text.described import Described
from refine.text.encoder import TextEncoder, load_encoder
from refine.text.labellers import labeller
from refine.text.model import Distribution, TextNetworkConfig, TextToMotion, TextToMotionConfig, separate_words
from renderers.body import Body
from renderers.checks import UserError, check_range
from train.checkpoints import hash_motions, provenance
from train.generator import AGAIN, read_record
from train.loop import LoopConfig, check_device, check_folder, check_loop, fit, open_run, seed_of
from train.text_data import TextBatch, TextDataConfig, TextStore
from train.text_steps import TextLoss, text_step

MEASURED, TYPICAL = 3, 4  # seeds of what is drawn to measure with, and to standardise by


@dataclass(frozen=True)
class TextTraining:
    """Train text to motion as SINC does."""

    out: Path = Path("runs/text")
    """Run folder."""
    encoder: Path | None = None
    """Local Hugging Face folder of the frozen text encoder, such as DistilBERT's; none takes MiniLM, which the extra
    [text] installs."""
    data: TextDataConfig = field(default_factory=TextDataConfig)
    network: TextNetworkConfig = field(default_factory=TextNetworkConfig)
    loss: TextLoss = field(default_factory=TextLoss)
    loop: LoopConfig = field(default_factory=LoopConfig)
    batch: int = 32
    measured: int = 128
    """Held-out clips that are measured at a checkpoint."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the networks' products; losses are float32."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``. Random numbers are the same on every device."""
    resume: bool = False
    """Go on with the run in ``out``."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "batch", "measured")


def described_clips(config: TextDataConfig) -> list[Described]:
    """All clips of a configuration, of every split.

    Raises:
        UserError: no such folder, or it holds something else.
    """
    if config.source == "builtin":
        from refine.text.builtin import builtin_corpus

        rest_joints = Body.free("light").rest_joints
        return builtin_corpus(rest_joints, seed=config.seed, clips=config.builtin_clips, fps=config.fps)
    from refine.text.corpus import load_corpus

    return load_corpus(Path(config.source))


def train_text(config: TextTraining, kind: str = "text") -> Path:
    """Run the whole program and return the path of the best weights, which ``load_text_to_motion`` reads.

    Args:
        kind: what it is written as: "text", or "text-scorer" for what only judges.

    Raises:
        UserError: see ``open_run``, ``described_clips``, ``load_encoder`` and ``fit``.
    """
    check_device(config.device)
    check_loop(config.loop)
    check_folder(config.out, config.resume)
    return Training(config, kind).run()


class Training:
    """One run."""

    def __init__(self, config: TextTraining, kind: str):
        self.config, self.kind, self.device = config, kind, torch.device(config.device)
        self.encoder: TextEncoder = load_encoder(config.encoder).to(config.device)
        rest_joints = Body.free("light").rest_joints
        self.rest_joints = rest_joints.to(config.device)
        clips = described_clips(config.data)
        learned = [clip for clip in clips if clip.split == "train"]
        unseen = [clip for clip in clips if clip.split == "val"]
        self.learned = TextStore.build(learned, config.data, labeller(), rest_joints)
        # What is measured are recordings, not what is made of them.
        recorded = replace(config.data, synthetic="none")
        self.unseen = TextStore.build(unseen or learned, recorded)
        with torch.random.fork_rng():
            torch.manual_seed(seed_of(config.loop.seed))
            about = {"encoder": self.encoder.name, "text_width": self.encoder.width, "fps": config.data.fps}
            self.model = TextToMotion(TextToMotionConfig(**asdict(config.network), **about))
        typical = self.learned.draw(512, torch.Generator().manual_seed(TYPICAL))
        self.model.standardise(typical.features[typical.valid])
        self.model.to(self.device)
        self.record = {
            "provenance": provenance(config.loop.seed, hash_motions([clip.motion for clip in clips])),
            "data": {
                "source": config.data.source,
                "singles": sum(item.actions == 1 for item in self.learned.items),
                "pairs": sum(item.actions > 1 for item in self.learned.items),
                "unseen": len(self.unseen.items),
            },
            "loss": config.loss,
        }

    def run(self) -> Path:
        config = self.config
        open_run(config.out, config, config.resume)
        refuse_other_clips(config.out / "last.json", self.record)
        return fit(
            self.model,
            self.losses,
            config.loop,
            config.out,
            self.kind,
            self.record,
            self.measure,
            config.resume,
            describe=self.describe,
        )

    def losses(self, step: int, random: torch.Generator) -> Iterator[dict[str, Tensor]]:
        yield self.terms(self.learned.draw(self.config.batch, random), random)

    def terms(self, batch: TextBatch, random: torch.Generator) -> dict[str, Tensor]:
        noise = torch.randn(2, len(batch.texts), self.config.network.latent, generator=random).to(self.device)
        features, valid = batch.features.to(self.device), batch.valid.to(self.device)
        with rounded(self.config.precision, self.device.type):
            text = self.encode(batch)
            sentences = self.encoder.sentences(batch.sentences) if self.config.loss.contrastive else None
            return text_step(features, valid, text, self.model, noise, self.config.loss, self.rest_joints, sentences)

    def encode(self, batch: TextBatch) -> Distribution:
        if self.config.network.separate:
            return self.model.encode_text(separate_words(self.encoder, batch.texts))
        return self.model.encode_text([self.encoder.words(batch.sentences)])

    def measure(self) -> dict[str, float]:
        """The terms on held-out clips, always the same ones."""
        random = torch.Generator().manual_seed(MEASURED)
        terms = self.terms(self.unseen.draw(self.config.measured, random), random)
        return {name: float(value) for name, value in terms.items()}

    def describe(self, step: int) -> str:
        """The first clips of a step."""
        random = torch.Generator().manual_seed(seed_of(self.config.loop.seed, step, 0))
        batch = self.learned.draw(self.config.batch, random)
        some = zip(batch.sentences[:3], batch.sources[:3], strict=True)
        return "; ".join(f"{sentence!r} ({source})" for sentence, source in some)


@contextmanager
def rounded(precision: str, device: str) -> Iterator[None]:
    """Products in bfloat16, if that is asked for; attention then without the fused kernel, whose gradient is slow in it
    on a processor."""
    half = precision == "bfloat16"
    plain = sdpa_kernel(SDPBackend.MATH) if half and device == "cpu" else nullcontext()
    with torch.autocast(device, torch.bfloat16, enabled=half), plain:
        yield


def refuse_other_clips(last: Path, record: dict):
    """Refuse to go on with a run whose clips have changed meanwhile."""
    if last.exists() and read_record(last)["provenance"]["data_sha256"] != record["provenance"]["data_sha256"]:
        raise UserError(last, "is of a run on other clips", f"give the same, or {AGAIN}")
