"""Measuring a trained generator against a benchmark: what `refine evaluate` reports.

Every repeat draws as many new motions as the benchmark has test compositions, the same number of each pair, and
compares them with recognisers and compositions that are fixed. Beside the generator stands the operator itself:
compositions that the mask makes of the training clips, which is as near as one can come who learned nothing but it;
and, where there are such, the true test compositions: what a method would measure that composed perfectly. Both are the
same for every generator, so they are measured once and kept with the benchmark's recognisers.
"""

import hashlib
import json
import math
import platform
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from refine.coupling import CouplingConfig, couple_features
from refine.distributions import (
    accuracy,
    diversity,
    diversity_exact,
    frechet_distance,
    kernel_distance,
    multimodality,
    multimodality_exact,
)
from refine.formats.untrusted import read_json
from refine.generator import Generator, generate, label_weights, stand
from refine.metrics import floor_penetrations, foot_skates, jitters, motion_errors
from refine.motion import Motion, from_features
from refine.recogniser import Recogniser, both_actions, features_of
from renderers.body import Body
from renderers.checks import UserError, check_known, check_range
from renderers.rotations import matrix_to_6d
from renderers.skeleton import forward_kinematics
from train.benchmarks import Benchmark
from train.checkpoints import command, commit, replace_file, to_json
from train.data import ClipStore, DataConfig, draw_windows, index_pairs
from train.generator import load_generator
from train.loop import seed_of
from train.recogniser import load_recognisers, place_of
from train.tables import Evaluation

MEASURES = 1
"""Goes up when a measure changes, so that what was kept of the old one is measured anew."""
UNTOLD = ("fid_true", "kid_true", "accuracy_true", "nearest_true", "covered_true")
"""What says nothing of the true compositions, which are measured against themselves by a recogniser of themselves."""
LIBRARIES = ("refine-motion", "torch", "numpy", "timm")


@dataclass(frozen=True)
class EvaluationConfig:
    """How a generator is measured."""

    repeats: int = 20
    """Sets of motions that are drawn and measured."""
    batch: int = 256
    """Motions that are made at once; only memory and time depend on it."""
    seed: int = 0
    device: str = "cpu"
    """As torch names it, for example ``cuda``."""

    def __post_init__(self):
        check_range(self, 1, 10_000, "repeats", "batch")
        check_range(self, 0, 2**32 - 1, "seed")


@dataclass(frozen=True)
class Beside:
    """What stands beside every generator on a benchmark, values of each measure."""

    real: dict[str, list[float]]
    """Of the mask operator on training clips, one a repeat."""
    truth: dict[str, list[float]]
    """Of the true test compositions, once; empty where there are none."""


class Sample(NamedTuple):
    """Motions that are measured, one a test composition and in their order."""

    rotations: Tensor  # [N T 24 3 3]
    root: Tensor  # [N T 3] metres


class Reference(NamedTuple):
    """Test compositions as one recogniser sees them."""

    recogniser: Recogniser
    features: Tensor  # [N F]
    classes: Tensor  # [N] of the recogniser


Sampler = Callable[[torch.Generator], Sample]


def sample_of(motions: list[Motion]) -> Sample:
    return Sample(torch.stack([one.rotations for one in motions]), torch.stack([one.root for one in motions]))


class Judge:
    """A benchmark with its recognisers, ready to measure sets of motions.

    Raises:
        UserError: recognisers are missing, or were trained on another benchmark.
    """

    def __init__(self, benchmark: Benchmark, rest_joints: Tensor, device: str = "cpu"):
        self.benchmark, self.rest_joints = benchmark, rest_joints
        self.coupling = CouplingConfig(**benchmark.manifest["coupling"])
        recognisers = {kind: one.to(device) for kind, one in load_recognisers(benchmark).items()}
        self.recognisers = tuple(recognisers)
        self.legs, self.arms = (recognisers.pop(kind) for kind in ("legs", "arms"))
        masked = benchmark.compositions("mask")
        self.labels = [motion.label for motion in masked]
        self.compositions = {"mask": sample_of(masked)}
        if benchmark.has_true:
            self.compositions["true"] = sample_of(benchmark.compositions("true"))
            self.true_joints = self.joints(self.compositions["true"])
        self.references = {}
        for name, recogniser in recognisers.items():
            six = matrix_to_6d(self.compositions["true" if name == "true" else "mask"].rotations)
            classes = torch.tensor([recogniser.config.classes.index(label) for label in self.labels])
            self.references[name] = Reference(recogniser, features_of(recogniser, six).features, classes)

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """The two actions of each test composition."""
        return [tuple(label.split("+")) for label in self.labels]

    def joints(self, sample: Sample) -> Tensor:
        """[N T 24 3] metres."""
        return forward_kinematics(sample.rotations, sample.root, self.rest_joints)[0]

    def measure(self, sample: Sample, random: torch.Generator) -> dict[str, float]:
        """Every measure of one set; lengths in metres, shares of 1."""
        six, found = matrix_to_6d(sample.rotations), {}
        for name, (recogniser, features, classes) in self.references.items():
            suffix = {"mask": "c", "half": "half", "true": "true"}[name]
            seen = features_of(recogniser, six)
            found[f"fid_{suffix}"] = frechet_distance(seen.features, features)
            found[f"kid_{suffix}"] = kernel_distance(seen.features, features)
            found["accuracy" + ("" if name == "mask" else f"_{suffix}")] = accuracy(seen.logits, classes)
            if name == "mask":
                names = recogniser.config.classes
                found["diversity"] = diversity(seen.features, random)
                found["diversity_exact"] = diversity_exact(seen.features)
                found["multimodality"] = multimodality(seen.features, classes, names, random)
                found["multimodality_exact"] = multimodality_exact(seen.features, classes, names)
        recognised = both_actions(self.legs, self.arms, six, self.labels)
        for name, share in zip(("legs", "arms", "both_actions"), recognised, strict=True):
            found[name] = float(share.double().mean())
        joints = self.joints(sample)
        if "true" in self.compositions:
            found |= self.nearness(joints)
        fps = self.benchmark.fps
        found["foot_skate"] = float(foot_skates(joints, fps).mean())
        found["floor_penetration"] = float(floor_penetrations(joints).mean())
        found["jitter"] = float(jitters(joints, fps).mean())
        return found

    def nearness(self, joints: Tensor) -> dict[str, float]:
        """How near each motion is to a true composition of its pair, and each of these to a motion."""
        nearest, covered = [], []
        for label in dict.fromkeys(self.labels):
            same = torch.tensor([one == label for one in self.labels])
            errors = motion_errors(joints[same], self.true_joints[same])
            nearest.append(errors.amin(1))
            covered.append(errors.amin(0))
        return {"nearest_true": float(torch.cat(nearest).mean()), "covered_true": float(torch.cat(covered).mean())}


@torch.no_grad()
def generated(
    generator: Generator,
    judge: Judge,
    coupled: CouplingConfig | None,
    config: EvaluationConfig,
) -> Sampler:
    """Draws from a generator, for each test composition one of its pair, at equal weights.

    Args:
        coupled: for a generator that learned single actions alone: make both actions and couple them in this way
            (LFCA's baseline "Pre-train+Mask").

    Raises:
        UserError: the generator has not learned an action, or runs at another frame rate.
    """
    classes = generator.config.classes
    for name in {name for pair in judge.pairs for name in pair}:
        check_known("evaluate", name, classes)
    if generator.config.fps != judge.benchmark.fps:
        problem = f"the generator makes {generator.config.fps:g} frames a second"
        raise UserError(judge.benchmark.folder, f"has {judge.benchmark.fps:g}, {problem}", "train one on the benchmark")
    generator = generator.to(config.device)
    i, j = (torch.tensor([classes.index(pair[side]) for pair in judge.pairs], device=config.device) for side in (0, 1))
    half = torch.full((len(i),), 0.5, device=config.device)

    def make(weights: Tensor, random: torch.Generator) -> Tensor:
        parts = [generate(generator, some, judge.benchmark.frames, random) for some in weights.split(config.batch)]
        return torch.cat(parts).float().cpu()

    def draw(random: torch.Generator) -> Sample:
        if coupled is None:
            features = make(label_weights(i, j, half, len(classes)), random)
        else:
            singles = [make(label_weights(one, one, half, len(classes)), random) for one in (i, j)]
            features = couple_features(*singles, half.cpu(), judge.rest_joints, coupled)
        return Sample(*stand(*from_features(features), judge.rest_joints))

    return draw


def operated(judge: Judge) -> Sampler:
    """The mask operator on random windows of the training clips, at lambda a half: for each test composition one of
    its pair. Nothing is learned."""
    benchmark = judge.benchmark
    store = ClipStore.build(benchmark.clips("train"))
    config = DataConfig(fps=benchmark.fps, frames=benchmark.frames, lam="half")
    pairs = index_pairs(store, judge.pairs)

    def draw(random: torch.Generator) -> Sample:
        batch = store.pairs(draw_windows(store, pairs, config, random), config)
        features = couple_features(batch.features_i, batch.features_j, batch.lam, judge.rest_joints, judge.coupling)
        return Sample(*stand(*from_features(features), judge.rest_joints))

    return draw


def repeat(sampler: Sampler, judge: Judge, config: EvaluationConfig, name: str) -> dict[str, list[float]]:
    """``config.repeats`` sets, each from a seed of its own: the values of every measure."""
    rows = []
    for number in tqdm(range(config.repeats), desc=name, disable=None, leave=False):
        random = torch.Generator().manual_seed(seed_of(config.seed, number))
        rows.append(judge.measure(sampler(random), random))
    return {measure: [row[measure] for row in rows] for measure in rows[0]}


def beside(judge: Judge, config: EvaluationConfig, measures: Iterable[str]) -> Beside:
    """What is the same for every generator, from ``beside.json`` with the recognisers or else measured and put there.

    It is measured anew when the file is missing or damaged, or is of another benchmark, recogniser, number of repeats,
    seed, device or version, or lacks one of ``measures``. Where it cannot be written it is not kept.
    """
    path, measures = place_of(judge.benchmark, "beside").with_suffix(".json"), set(measures)
    key = {"measures": MEASURES, "repeats": config.repeats, "seed": config.seed, "device": config.device}
    key |= hashes_of(judge) | {name: metadata.version(name) for name in LIBRARIES}
    found = read_beside(path, key)
    told = measures.difference(UNTOLD) if judge.benchmark.has_true else set()
    if found and found.real.keys() == measures and found.truth.keys() == told:
        return found
    measured = Beside(repeat(operated(judge), judge, config, "mask on training clips"), truth_of(judge, config))
    with suppress(UserError):
        replace_file(path, to_json({"key": key, **asdict(measured)}))
    return measured


def read_beside(path: Path, key: dict[str, Any]) -> Beside | None:
    """What ``beside`` has kept under ``key``; none if it is not all there."""
    try:
        found = json.loads(path.read_text())
        for group, count in (("real", key["repeats"]), ("truth", 1)):
            for values in found[group].values():
                if len(values) != count or not all(map(math.isfinite, values)):
                    return None
        return Beside(found["real"], found["truth"]) if found["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return None


def truth_of(judge: Judge, config: EvaluationConfig) -> dict[str, list[float]]:
    """Measures of the true test compositions, those left out that compare them with themselves."""
    if not judge.benchmark.has_true:
        return {}
    measured = judge.measure(judge.compositions["true"], torch.Generator().manual_seed(seed_of(config.seed, 0)))
    return {name: [value] for name, value in measured.items() if name not in UNTOLD}


def evaluate(run: Path, benchmark: Benchmark, config: EvaluationConfig, row: str = "") -> Evaluation:
    """Measure the last weights of a run of `refine train generator`.

    The last and not the best, since the methods that are compared train for equally long, as the paper's do.

    Args:
        run: its folder, which says how it was trained.
        row: the method's name in tables; none takes the run's variant, or else the folder's name.

    Raises:
        UserError: no such run, recognisers that are missing or of another benchmark, or a generator that does not fit.
    """
    started = time.monotonic()
    weights = run / "last.safetensors"
    generator, trained, described = load_generator(weights), read_config(run), description_of(weights)
    check_run(run, trained, described, benchmark)
    judge = Judge(benchmark, Body.free("light").rest_joints, config.device)
    alone = trained["data"]["pairs"] == "single"
    coupled = trained["coupling"] if alone else None
    name = row or trained.get("variant") or run.name
    metrics = repeat(generated(generator, judge, coupled, config), judge, config, name)
    others = beside(judge, config, metrics)
    return Evaluation(
        row=name,
        seed=trained["loop"]["seed"],
        benchmark=benchmark.name,
        n=len(judge.labels),
        metrics=metrics,
        real=others.real,
        truth=others.truth,
        versions={"python": platform.python_version()} | {name: metadata.version(name) for name in LIBRARIES},
        hashes={"model": sha256(weights)} | hashes_of(judge),
        provenance={
            "command": command(),
            "commit": commit(),
            "hardware": f"{platform.machine()}, {torch.get_num_threads()} threads, {config.device}",
            "seconds": round(time.monotonic() - started, 1),
            "trained": {"steps": trained["loop"]["steps"], "config": trained},
        },
    )


def read_config(run: Path) -> dict:
    """The configuration that a run of `refine train generator` was started with."""
    path = run / "config.json"
    if not path.exists():
        raise UserError(run, "holds no run", "give a folder that `refine train generator` wrote")
    try:
        found = read_json(path, finite=False)
        found["data"]["pairs"], found["loop"]["seed"], found["loop"]["steps"]
        found["coupling"] = CouplingConfig(**found["coupling"])
    except (KeyError, TypeError) as error:
        raise UserError(path, f"is no configuration of a generator ({error})", "train it again") from error
    return found


def check_run(run: Path, trained: dict, described: dict, benchmark: Benchmark):
    """Refuse a run that is not finished, or that did not learn the benchmark's training clips."""
    if described["step"] != trained["loop"]["steps"]:
        done = f"is at step {described['step']} of {trained['loop']['steps']}"
        raise UserError(run, done, "finish it with --resume")
    if described["data"]["benchmark"] != benchmark.hash:
        raise UserError(run, f"was not trained on {benchmark.folder}", f"train with --data.source {benchmark.folder}")


def description_of(weights: Path) -> dict:
    return read_json(weights.with_suffix(".json"), finite=False)


def hashes_of(judge: Judge) -> dict[str, str]:
    """SHA-256 of what measures: the benchmark and its recognisers."""
    recognisers = {kind: hash_recogniser(place_of(judge.benchmark, kind)) for kind in judge.recognisers}
    return {"benchmark": judge.benchmark.hash} | recognisers


def hash_recogniser(weights: Path) -> str:
    """SHA-256 of a recogniser's weights and of its configuration, which says what counts as right."""
    described = json.dumps(description_of(weights)["config"], sort_keys=True)
    return hashlib.sha256(weights.read_bytes() + described.encode()).hexdigest()


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
