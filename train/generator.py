"""The training program of the generator."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from refine.coupling import couple_features
from refine.decoupling import Decoupler
from refine.generator import Generator, GeneratorConfig, label_weights
from refine.mae import load_mae
from renderers.body import Body
from renderers.checks import UserError
from renderers.skeleton import PART_NAMES
from train.checkpoints import hash_motions, hash_tensors, load_network, provenance
from train.config import GeneratorTraining
from train.data import ClipStore, Draw, Pairs, draw_batch, draw_windows, index_pairs, open_source, pair_labels, split
from train.loop import check_device, check_folder, check_loop, fit, open_run, seed_of
from train.processes import Processes, together
from train.shares import refine_shares
from train.steps import GeneratorLoss, Noise, Share, draw_noise, generator_step
from train.variants import VARIANTS

MEASURED = 3  # seed of what is drawn to measure with
TYPICAL, PRIOR = 4, 5  # seeds of what is drawn to standardise by, and to fit priors to
SHARES = 6  # and, with the run's seed, to refine shares with
AGAIN = "start again in another folder with --out"
FITTED = 256  # compositions of a pair that its prior is fitted to


def train_generator(config: GeneratorTraining) -> Path:
    """Run the whole program and return the path of the best weights, which ``load_generator`` reads.

    Started by ``torchrun`` it is one run on several processes.

    Raises:
        UserError: see ``open_run``, ``open_source``, ``load_mae`` and ``fit``.
    """
    with together(config.device) as (processes, device):
        check_device(device)
        check_loop(config.loop)
        with processes.agreeing():
            if processes.first:
                check_folder(config.out, config.resume)
        return Training(config, processes, device).run()


class Training:
    """One process's part of a run."""

    def __init__(self, config: GeneratorTraining, processes: Processes, device: str):
        body = Body.free("light")
        source = open_source(config.data, body.rest_joints)
        self.config = config = replace(config, data=source.config)
        self.processes, self.device, self.source, self.body = processes, device, source, body.to(device)
        self.shards = config.accumulate * processes.count
        if self.shards > config.batch:
            raise UserError("--batch", f"{config.batch} pairs cannot be cut in {self.shards}", "accumulate less")
        labels = pair_labels(source)
        learned, unseen = split(source.clips, config.data.held_out, config.data.seed)
        self.learned, self.unseen = ClipStore.build(learned), ClipStore.build(unseen)
        self.pairs = index_pairs(self.learned, labels)
        mae = load_mae(config.mae).to(device) if config.loss.decoupling or config.shares.looks else None
        if mae:
            check_looking(config, mae.config.channels)
        self.decoupler = Decoupler(self.body, mae, config.decoupling) if mae else None
        leans = known_leans(config.out / "last.json", self.learned.classes) if config.resume else None
        self.leans = self.refine_shares() if leans is None else leans
        with torch.random.fork_rng():
            torch.manual_seed(seed_of(config.loop.seed))
            paired = tuple(dict.fromkeys(tuple(sorted(pair)) for pair in labels))
            network = GeneratorConfig.of(config.network, self.learned.classes, config.data.fps, paired)
            self.generator = Generator(network)
        if network.standardise:
            random = torch.Generator().manual_seed(TYPICAL)
            some = self.pairs[torch.randint(len(self.pairs), (1024,), generator=random)]
            self.generator.standardise(self.compositions(some, random)[0])
        self.generator.to(device)
        self.record = {
            "provenance": provenance(config.loop.seed, hash_motions(source.clips)),
            "data": {
                "source": config.data.source,
                "benchmark": source.hash,
                "clips": len(learned),
                "short_clips": self.learned.short(config.data.frames),
                "pairs": len(labels),
            },
            "mae_sha256": hash_tensors(mae) if mae else None,
            "loss": config.loss,
            "leans": name_leans(self.leans, self.learned.classes),
            "processes": processes.count,
        }
        self.learned, self.unseen, self.leans = (held.to(device) for held in (self.learned, self.unseen, self.leans))

    def refine_shares(self) -> Tensor:
        """What pairs of classes lean to [C C 5], by decoupling: the first process finds it for all."""
        config, store = self.config, self.learned.to(self.device)
        leans = torch.zeros(len(store.classes), len(store.classes), len(PART_NAMES), device=self.device)
        with self.processes.agreeing():
            if self.processes.first:
                leans += refine_shares(
                    lambda classes, random: store.pairs(draw_windows(store, classes, config.data, random), config.data),
                    self.pairs,
                    len(store.classes),
                    self.decoupler,
                    config.coupling,
                    config.shares,
                    torch.Generator().manual_seed(seed_of(config.loop.seed, SHARES)),
                ).to(self.device)
        self.processes.sum([leans])  # the others' are zero
        return leans.cpu()

    def compositions(self, classes: Tensor, random: torch.Generator) -> tuple[Tensor, Pairs]:
        """Pseudo-compositions [B T 25 6] of pairs of classes [B 2], and what they are made of."""
        data, coupling = self.config.data, self.config.coupling
        drawn = self.learned.pairs(draw_windows(self.learned, classes, data, random), data)
        rest_joints, lean = self.body.rest_joints.to(drawn.lam), self.leans[drawn.class_i, drawn.class_j]
        return couple_features(drawn.features_i, drawn.features_j, drawn.lam, rest_joints, coupling, lean), drawn

    @torch.no_grad()
    def fit_priors(self):
        """Fit the prior of every pair to always the same compositions."""
        network, random = self.generator.config, torch.Generator().manual_seed(PRIOR)
        for index, pair in enumerate(network.pairs):
            classes = torch.tensor([[network.classes.index(name) for name in pair]]).expand(FITTED, 2)
            features, drawn = self.compositions(classes, random)
            weights = label_weights(drawn.class_i, drawn.class_j, drawn.lam, len(network.classes))
            self.generator.fit_prior(index, *self.generator.encode(features, weights, drawn.valid))

    def run(self) -> Path:
        config = self.config
        with self.processes.agreeing():
            if self.processes.first:
                open_run(config.out, config, config.resume)
                refuse_others(config.out / "last.json", self.record)
                self.say_short()
        return fit(
            self.generator,
            self.losses,
            config.loop,
            config.out,
            "generator",
            self.record,
            self.measure,
            config.resume,
            self.processes,
            self.describe,
        )

    def say_short(self):
        short, frames = self.record["data"]["short_clips"], self.config.data.frames
        if short:
            many = f"{short} of {len(self.learned.sources)} clips"
            print(f"refine: {many} are shorter than {frames} frames and stand still at their ends", file=sys.stderr)

    def draw(self, store: ClipStore, count: int, random: torch.Generator) -> tuple[Draw, Noise]:
        """All that is random about a step but dropout: the same on every process and device."""
        data, loss = self.config.data, self.config.loss
        drawn = draw_batch(store, self.pairs, count, data, random)
        return drawn, draw_noise(count, self.config.network.latent, data.frames, loss, random)

    def losses(self, step: int, random: torch.Generator) -> Iterator[dict[str, Tensor]]:
        """The terms of this process's shards: item n of a batch is in shard n modulo their number."""
        drawn, noise = self.draw(self.learned, self.config.batch, random)
        for index in range(self.processes.rank, self.shards, self.processes.count):
            some = slice(index, None, self.shards)
            yield self.terms(self.learned, drawn, noise, some, self.config.loss.at(step))

    def terms(self, store: ClipStore, drawn: Draw, noise: Noise, some: slice, loss: GeneratorLoss) -> dict[str, Tensor]:
        """What some items of a draw contribute to its terms."""
        real = store.real_frames(drawn, self.config.data)
        share = Share(
            float(real[some].sum() / real.sum()),
            len(real[some]) / len(real),
            len(noise.chances[some]) / len(noise.chances),
        )
        batch = store.pairs(Draw(*(values[some] for values in drawn)), self.config.data)
        return generator_step(
            batch,
            Noise(*(values[some].to(self.device) for values in noise)),
            self.generator,
            self.body,
            self.decoupler,
            loss,
            self.config.coupling,
            share,
            self.config.precision == "bfloat16",
            self.leans[batch.class_i, batch.class_j],
        )

    def measure(self) -> dict[str, float]:
        """The terms on pairs of held-out clips, always the same ones, at the full weights; and the priors, so that what
        is then written makes motions as it is."""
        if all(bool(value.isfinite().all()) for value in self.generator.parameters()):
            self.fit_priors()
        drawn, noise = self.draw(self.unseen, self.config.measured, torch.Generator().manual_seed(MEASURED))
        sums: dict[str, float] = {}
        for index in range(min(self.shards, self.config.measured)):
            some = slice(index, None, self.shards)
            terms = self.terms(self.unseen, drawn, noise, some, self.config.loss)
            sums = {name: sums.get(name, 0.0) + float(value) for name, value in terms.items()}
        return sums

    @torch.no_grad()
    def describe(self, step: int) -> str:
        """The pairs of a step whose losses are not finite alone, or its first pairs where that is so of none."""
        random = torch.Generator().manual_seed(seed_of(self.config.loop.seed, step, 0))
        drawn, noise = self.draw(self.learned, self.config.batch, random)
        self.generator.eval()
        bad = []
        for item in range(self.config.batch):
            terms = self.terms(self.learned, drawn, noise, slice(item, item + 1), self.config.loss.at(step))
            bad += [] if terms["total"].isfinite() else [item]
        bad = bad or list(range(self.config.batch))
        named = "; ".join(self.learned.describe(drawn, item) for item in bad[:3])
        return f"{named} and {len(bad) - 3} more" if len(bad) > 3 else named


def check_looking(config: GeneratorTraining, channels: int):
    """Refuse an inpainter that does not fit the row of the tables, or more frames than a window has."""
    if config.variant and VARIANTS[config.variant].plain and channels != 1:
        problem = f"looks at plain silhouettes, and {config.mae} reads {channels} channels"
        raise UserError(f"--variant {config.variant}", problem, "give one of `refine train mae plain`")
    for flag, frames in (
        ("--loss.decoupling-frames", config.loss.decoupling_frames),
        ("--shares.frames", config.shares.frames),
    ):
        if frames > config.data.frames:
            raise UserError(flag, f"{frames} of {config.data.frames} frames cannot be drawn", "ask for fewer")


def name_leans(leans: Tensor, classes: tuple[str, ...]) -> list[dict]:
    """The log odds [C C 5] of the pairs that lean, each pair once, in words."""
    return [
        {"pair": [classes[i], classes[j]], "log_odds": dict(zip(PART_NAMES, leans[i, j].tolist(), strict=True))}
        for i, j in (leans != 0).any(-1).triu().nonzero().tolist()
    ]


def known_leans(last: Path, classes: tuple[str, ...]) -> Tensor | None:
    """What ``name_leans`` wrote of a run that goes on; none if it wrote nothing yet, or of other classes.

    Raises:
        UserError: it cannot be read.
    """
    if not last.exists():
        return None
    leans = torch.zeros(len(classes), len(classes), len(PART_NAMES))
    try:
        for found in read_record(last).get("leans", []):
            if not set(found["pair"]) <= set(classes):
                return None  # the run is of other clips, and will be refused as such
            i, j = map(classes.index, found["pair"])
            leans[i, j] = torch.tensor([found["log_odds"][part] for part in PART_NAMES])
            leans[j, i] = -leans[i, j]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(last, f"has damaged leans ({error!r})", AGAIN) from error
    return leans


def read_record(last: Path) -> dict:
    """What is written with a run's weights.

    Raises:
        UserError: it cannot be read, or does not say what was learned.
    """
    try:
        found = json.loads(last.read_text())
        found["provenance"]["data_sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(last, f"cannot be read ({error!r})", AGAIN) from error
    return found


def refuse_others(last: Path, record: dict):
    """Refuse to go on with a run whose clips or whose inpainter have changed meanwhile."""
    if not last.exists():
        return
    before = read_record(last)
    for what, was, now in (
        ("on other clips", before["provenance"]["data_sha256"], record["provenance"]["data_sha256"]),
        ("with another MAE", before.get("mae_sha256"), record["mae_sha256"]),
    ):
        if was != now:
            raise UserError(last, f"is of a run {what}", "give the same, or choose another folder with --out")


def load_generator(path: str | Path) -> Generator:
    """A trained generator in evaluation mode.

    Args:
        path: a ``.safetensors`` with its ``.json`` beside, or a run folder, whose best weights are taken.

    Raises:
        UserError: missing or damaged files, or the weights of something else.
    """

    def build(stored: dict[str, Any]) -> Generator:
        pairs = tuple(map(tuple, stored.get("pairs", ())))
        return Generator(GeneratorConfig(**stored | {"classes": tuple(stored["classes"]), "pairs": pairs}))

    return load_network(path, "generator", build, lambda stored: stored["layers"])
