"""Measuring text to motion: what `refine evaluate` reports of a run of `refine train text` or `text-diffusion`.

For each test clip one motion is made from what is said of it, as long as the clip, and compared with it. Every repeat
draws new motions.
"""

import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor
from tqdm import tqdm

from refine.composition_by_parts import compose_by_parts
from refine.coupling_by_parts import divide, put_together
from refine.decoupling import Decoupler
from refine.distributions import diversity_exact
from refine.formats.untrusted import read_json
from refine.mae import load_mae
from refine.metrics import floor_penetration, foot_skate, jitter
from refine.motion import Motion, resample
from refine.refinement import refine_motion
from refine.text.described import Described
from refine.text.encoder import TextEncoder
from refine.text.features import canonical
from refine.text.generation import generate_alone, generate_by_parts, generate_described
from refine.text.parts import Labeller
from refine.text.positions import Heading, positional_errors
from refine.text.scores import retrieval, temos_score, variety
from refine.text.sentences import TEMPLATES, UNSEEN, combine
from renderers.body import Body
from renderers.checks import UserError, check_known, check_range
from train.checkpoints import command, commit, hash_motions
from train.evaluate import LIBRARIES, sha256
from train.loop import seed_of
from train.tables import Evaluation
from train.text import described_clips
from train.text_data import SHORTEST, TextDataConfig, batch_of
from train.text_models import TextModel, encoder_of, load_text_model, load_text_to_motion


@dataclass(frozen=True)
class TextEvaluationConfig:
    """How a text-to-motion model is measured."""

    repeats: int = 5
    """Times that a motion is drawn for every text."""
    actions: Literal["pairs", "singles", "all"] = "pairs"
    """Which test clips: of several actions at once, of one, or all."""
    conjunction: str = "while"
    """How the texts of a pair are said in one sentence."""
    by: Literal["sentence", "parts"] = "sentence"
    """Pairs from a sentence; or each action alone, put together by the parts that its text is about."""
    heading: Heading = "correct"
    """What a body's heading is; "sinc_legacy" takes it from SINC's code, mirrored."""
    refined: bool = False
    """Refine each motion through the decoupling loss, beside motions of its actions alone, before it is measured."""
    most: int | None = None
    """Measure no more test clips than these, spread evenly over them."""
    batch: int = 128
    """Motions that are made at once; only memory and time depend on it."""
    seed: int = 0
    device: str = "cpu"
    """As torch names it, for example ``cuda``."""

    def __post_init__(self):
        check_range(self, 1, 10_000, "repeats", "batch")
        check_range(self, 0, 2**32 - 1, "seed")
        if self.most is not None:
            check_range(self, 1, 1_000_000, "most")
        check_known("--conjunction", self.conjunction, TEMPLATES | UNSEEN)


MEASURED = ("actions", "by", "conjunction", "heading", "refined", "most")
"""What a table should say of how a row was measured."""


class TextJudge:
    """Test clips with the encoder that scores motions, ready to measure as many motions as there are clips.

    Args:
        items: the test clips.
        scorer: from `refine train text-scorer`.
        frames: longest stretch of a clip that is compared, from its first frame.
    """

    def __init__(
        self,
        items: Sequence[Described],
        scorer: Any,
        encoder: TextEncoder,
        frames: int,
        config: TextEvaluationConfig,
        rest_joints: Tensor,
    ):
        self.config, self.scorer, self.rest_joints, fps = config, scorer, rest_joints, scorer.config.fps
        self.texts = [item.phrasings[0] for item in items]
        self.sentences = [combine(texts, config.conjunction) for texts in self.texts]
        motions = [resample(item.motion, fps) for item in items]
        some = slice(0, frames)
        self.motions = [canonical(replace(one, rotations=one.rotations[some], root=one.root[some])) for one in motions]
        self.true = self.encode(self.motions)
        with torch.no_grad():
            self.said = torch.cat(
                [scorer.encode_text([encoder.words(some)]).mean for some in chunks(self.sentences, config.batch)]
            )
        self.alike = encoder.sentences(self.sentences)

    @torch.no_grad()
    def encode(self, motions: Sequence[Motion]) -> Tensor:
        """What the scorer says of motions: means [N D]."""
        means = []
        for some in chunks(motions, self.config.batch):
            batch = batch_of([canonical(one) for one in some], [("",)] * len(some), [""] * len(some))
            means.append(self.scorer.encode_motion(batch.features, batch.valid).mean)
        return torch.cat(means)

    def measure(self, motions: Sequence[Motion], encoded: Tensor, random: torch.Generator) -> dict[str, float]:
        """Every measure of one set; lengths in metres, shares of 1."""
        pairs = [
            (one.joints(self.rest_joints), true.joints(self.rest_joints))
            for one, true in zip(motions, self.motions, strict=True)
        ]
        found = {"temos": float(temos_score(encoded, self.true).mean())}
        found |= positional_errors(pairs, self.config.heading)
        return found | self.alone(motions, encoded, random)

    def alone(self, motions: Sequence[Motion], encoded: Tensor, random: torch.Generator) -> dict[str, float]:
        """What needs no clip to compare with."""
        joints = [one.joints(self.rest_joints) for one in motions]
        fps = [one.fps for one in motions]
        return {
            **retrieval(self.said, encoded, self.alike, random),
            "foot_skate": mean_of(foot_skate, joints, fps),
            "floor_penetration": sum(map(floor_penetration, joints)) / len(joints),
            "jitter": mean_of(jitter, joints, fps),
        }

    def truth(self, random: torch.Generator) -> dict[str, float]:
        """Of the clips themselves, what is not about nearness to them."""
        found = self.alone(self.motions, self.true, random)
        return found | {"text_diversity": diversity_exact(self.true)} if len(self.true) > 1 else found


def chunks(values: Sequence, size: int) -> list:
    return [values[start : start + size] for start in range(0, len(values), size)]


def mean_of(measure: Any, joints: Sequence[Tensor], fps: Sequence[float]) -> float:
    return sum(measure(each, rate) for each, rate in zip(joints, fps, strict=True)) / len(joints)


def made_by(
    model: TextModel,
    encoder: TextEncoder,
    judge: TextJudge,
    config: TextEvaluationConfig,
    labeller: Labeller,
    random: torch.Generator,
) -> list[Motion]:
    """One motion for each test clip, of its length."""
    made: list[Motion] = []
    for some in chunks(range(len(judge.texts)), config.batch):
        texts, frames = [judge.texts[n] for n in some], [len(judge.motions[n]) for n in some]
        if config.by == "parts":
            about = iter(labeller([text for each in texts for text in each]))
            parts = [[next(about).parts for _ in each] for each in texts]
            made += generate_by_parts(model, encoder, texts, parts, frames, random, config.conjunction)
        else:
            made += generate_described(model, encoder, texts, frames, random, config.conjunction)
    return made


def evaluate_text(
    run: Path,
    scorer: Path,
    texts: Path | None,
    config: TextEvaluationConfig,
    row: str = "",
    encoder: Path | None = None,
) -> Evaluation:
    """Measure the last weights of a run of `refine train text` or `text-diffusion`.

    Args:
        run: its folder, which says how it was trained.
        scorer: run of `refine train text-scorer`.
        texts: a folder of described clips; none takes what the run was trained on. Those of the split "test" are
            measured, or where there are none of "val".
        row: the method's name in tables; none takes the folder's name.
        encoder: folder of the text encoder, unless it is the default one.

    Raises:
        UserError: no such run or scorer, frame rates that differ, or no test clip.
    """
    from refine.text.labellers import labeller

    started = time.monotonic()
    trained, learned_from = read_run(run)
    model = load_text_model(run / "last.safetensors").to(config.device)
    judging = load_text_to_motion(scorer / "last.safetensors", "text-scorer")
    if judging.config.fps != model.config.fps:
        problem = f"scores {judging.config.fps:g} frames a second, {run} makes {model.config.fps:g}"
        raise UserError(scorer, problem, "train both at the same --data.fps")
    said, scored = encoder_of(model, encoder), encoder_of(judging, encoder)
    rest_joints, frames = Body.free("light").rest_joints, learned_from.frames
    source = replace(learned_from, source=str(texts)) if texts else learned_from
    tested = spread(tested_clips(described_clips(source), config.actions), config.most)
    judge = TextJudge(tested, judging, scored, frames, config, rest_joints)
    name, rows, embedded = row or run.name, [], []
    refiner = Refiner(model, said, judge) if config.refined else None
    for number in tqdm(range(config.repeats), desc=name, disable=None, leave=False):
        random = torch.Generator().manual_seed(seed_of(config.seed, number))
        if refiner and config.by == "parts":
            motions = refiner.by_parts(labeller(), random)
        else:
            motions = made_by(model, said, judge, config, labeller(), random)
            motions = refiner.sentences(motions, random) if refiner else motions
        embedded.append(judge.encode(motions))
        rows.append(judge.measure(motions, embedded[-1], random))
    metrics = {measure: [each[measure] for each in rows] for measure in rows[0]}
    if config.repeats > 1:
        found = variety(torch.stack(embedded, dim=1))
        metrics |= {measure: [value] for measure, value in found.items()}
    return Evaluation(
        row=name,
        seed=trained["loop"]["seed"],
        benchmark=Path(source.source).name,
        n=len(tested),
        metrics=metrics,
        truth={measure: [value] for measure, value in judge.truth(random).items()},
        versions={"python": platform.python_version()} | {each: metadata.version(each) for each in LIBRARIES},
        hashes={
            "model": sha256(run / "last.safetensors"),
            "scorer": sha256(scorer / "last.safetensors"),
            "clips": hash_motions(judge.motions),
        },
        provenance={
            "command": command(),
            "commit": commit(),
            "hardware": f"{platform.machine()}, {torch.get_num_threads()} threads, {config.device}",
            "seconds": round(time.monotonic() - started, 1),
            "measured": {
                name: getattr(config, name) for name in ("actions", "by", "conjunction", "heading", "refined")
            },
            "trained": {"steps": trained["loop"]["steps"], "config": trained},
        },
    )


def read_run(run: Path) -> tuple[dict, TextDataConfig]:
    """The configuration that a run was started with, and of its data.

    Raises:
        UserError: there is none, it is of another kind, or the run is not finished.
    """
    path, last = run / "config.json", run / "last.json"
    if not path.exists() or not last.exists():
        raise UserError(run, "holds no run", "give a folder that `refine train text` or `text-diffusion` wrote")
    try:
        trained = read_json(path, finite=False)
        steps, done = trained["loop"]["steps"], read_json(last, finite=False)["step"]
        data = trained["data"]
        learned_from = TextDataConfig(**data | {"conjunctions": tuple(data["conjunctions"])})
        trained["loop"]["seed"]
    except (KeyError, TypeError) as error:
        raise UserError(path, f"is no configuration of text to motion ({error})", "train it again") from error
    if done != steps:
        raise UserError(run, f"is at step {done} of {steps}", "finish it with --resume")
    return trained, learned_from


def tested_clips(items: Sequence[Described], actions: str) -> list[Described]:
    """The clips that are measured, at least ``SHORTEST`` frames long.

    Raises:
        UserError: there are none.
    """
    for split in ("test", "val"):
        found = [item for item in items if item.split == split and len(item.motion) >= SHORTEST]
        if actions != "all":
            found = [item for item in found if (item.actions > 1) == (actions == "pairs")]
        if found:
            return found
    remedy = "measure others with --actions singles or all" if actions == "pairs" else "describe some for the test"
    raise UserError("refine evaluate", f"there are no test clips of {actions}", remedy)


def spread(items: list[Described], most: int | None) -> list[Described]:
    """At most so many, evenly among them all."""
    count = min(len(items), most or len(items))
    return [items[number * len(items) // count] for number in range(count)]


class Refiner:
    """Refines made motions through the decoupling loss, which asks whether each action can be recognised in them."""

    def __init__(self, model: TextModel, encoder: TextEncoder, judge: TextJudge):
        self.model, self.encoder, self.judge = model, encoder, judge
        self.decoupler = Decoupler(Body.free("light"), load_mae(None))

    def sentences(self, motions: Sequence[Motion], random: torch.Generator) -> list[Motion]:
        """Motions of sentences, beside motions of their actions alone."""
        texts = self.judge.texts
        alone = generate_alone(self.model, self.encoder, texts, [len(motion) for motion in motions], random)
        refined = []
        for motion, beside in zip(tqdm(motions, desc="refine", disable=None, leave=False), alone, strict=True):
            if len(beside) != 2:
                raise UserError("--refined", f"refines pairs, got {len(beside)} actions", "leave it out")
            refined.append(refine_motion(motion, *beside, self.decoupler).motion)
        return refined

    def by_parts(self, labeller: Labeller, random: torch.Generator) -> list[Motion]:
        """Actions made alone, and composed by parts."""
        texts, frames = self.judge.texts, [len(motion) for motion in self.judge.motions]
        alone = generate_alone(self.model, self.encoder, texts, frames, random)
        about = iter(labeller([text for each in texts for text in each]))
        refined = []
        for motions in tqdm(alone, desc="refine", disable=None, leave=False):
            parts = [next(about).parts for _ in motions]
            division = divide(parts)
            whole = all(action in division.owners for action in range(len(motions)))
            rest_joints, decoupler = self.judge.rest_joints, self.decoupler
            refined.append(
                compose_by_parts(motions, parts, rest_joints, decoupler).motion
                if whole and len(motions) > 1
                else put_together(motions, division)
            )
        return refined
