"""Described clips into batches: single actions, pairs, and pairs that are made on the fly of two single actions (SINC).

A single action is, with some probability, joined with another one that its text is compatible with: each part of the
body from one of them, in a sentence that says both. What is random about a batch is drawn from the generator it is
given.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from refine.coupling import couple
from refine.coupling_by_parts import compatible, divide, put_together, random_parts
from refine.motion import Motion, resample, trimmed
from refine.text.described import Described
from refine.text.features import canonical, to_text_features
from refine.text.parts import Labeller, Parts
from refine.text.sentences import TEMPLATES, UNSEEN, combine
from renderers.checks import UserError, check_known, check_range

SHORTEST = 15  # frames; SINC's


@dataclass(frozen=True)
class TextDataConfig:
    """Which clips, in which mixture, how long, said how."""

    source: str = "builtin"
    """A folder that `refine data texts` wrote, or the built-in actions."""
    singles: bool = True
    """Take single actions, to be learned alone or joined with another one."""
    pairs: bool = True
    """Learn the pairs that were recorded together ("Real-Pairs")."""
    synthetic: Literal["parts", "energies", "random", "none"] = "parts"
    """What is made of two single actions: each part of the body from the one whose text is about it, where these do
    not contradict each other; or any two blended by their energies, as LFCA does; or any two cut at random; or
    nothing."""
    probability: float = 0.5
    """Of a single action to be joined with another one; at 1 none is learned alone."""
    conjunctions: tuple[str, ...] = tuple(TEMPLATES)
    """How the texts of a pair are joined: one is drawn each time."""
    fps: float = 30.0
    frames: int = 300
    """Longest stretch of a clip that is learned at once."""
    canon: Literal["true_yaw", "temos_legacy"] = "true_yaw"
    """How clips are turned to one direction; the legacy leaves up to 40 degrees between them."""
    builtin_clips: int = 20
    """Of each built-in action."""
    seed: int = 0
    """Of the built-in clips."""

    def __post_init__(self):
        check_range(self, 0, 1, "probability")
        check_range(self, 1, 1000, "fps")
        check_range(self, SHORTEST, 100_000, "frames")
        check_range(self, 1, 10_000, "builtin_clips")
        check_range(self, 0, 2**32 - 1, "seed")
        for name in self.conjunctions:
            check_known("--data.conjunctions", name, TEMPLATES | UNSEEN)
        if not self.conjunctions or not (self.singles or self.pairs):
            raise UserError("--data", "leaves nothing to learn", "leave singles or pairs in, and a conjunction")

    @property
    def composes(self) -> bool:
        return self.singles and self.synthetic != "none" and self.probability > 0


class TextBatch(NamedTuple):
    """A batch of clips, each canonical, and what is said of them."""

    features: Tensor  # [B T 135], zero where it is not valid
    valid: Tensor  # [B T] True = a real frame
    texts: list[tuple[str, ...]]  # of each clip, those of its actions
    sentences: list[str]  # of each clip, the texts joined
    sources: list[str]  # for messages


class Said(NamedTuple):
    """A single action in one of its phrasings."""

    clip: int
    text: str


@dataclass(frozen=True, eq=False)
class TextStore:
    """Described clips of one frame rate, ready to draw batches from."""

    items: Sequence[Described]
    config: TextDataConfig
    parts: dict[str, Parts] = field(default_factory=dict)
    """What the single actions' texts are about; needed to compose by parts."""
    rest_joints: Tensor | None = None
    """[24 3] T-pose joints, metres; needed to compose by energies."""

    @staticmethod
    def build(
        items: Sequence[Described],
        config: TextDataConfig,
        labeller: Labeller | None = None,
        rest_joints: Tensor | None = None,
    ) -> "TextStore":
        """Those that are learned, at the frame rate; ``labeller`` says what texts are about, where that is asked.

        Raises:
            UserError: nothing is left.
        """
        kept = []
        for item in items:
            wanted = config.singles if item.actions == 1 else config.pairs
            motion = resample(item.motion, config.fps) if wanted else item.motion
            if wanted and len(motion) >= SHORTEST:
                kept.append(replace(item, motion=motion))
        if not kept:
            raise UserError(config.source, f"holds no clips of {SHORTEST} frames to learn", "check --data")
        parts = {}
        if labeller is not None and config.composes and config.synthetic == "parts":
            texts = sorted({text for item in kept if item.actions == 1 for (text,) in item.phrasings})
            parts = {said.phrase: said.parts for said in (labeller(texts) if texts else ())}
        return TextStore(kept, config, parts, rest_joints)

    @cached_property
    def said(self) -> list[Said]:
        """Every single action in each of its phrasings."""
        singles = ((index, item) for index, item in enumerate(self.items) if item.actions == 1)
        return [Said(index, text) for index, item in singles for (text,) in item.phrasings]

    @cached_property
    def partners(self) -> dict[Parts, list[Said]]:
        """By what a text is about: all that can be done at the same time."""
        about = defaultdict(list)
        for said in self.said:
            about[self.parts[said.text]].append(said)
        return {
            parts: [said for other, many in about.items() if compatible(parts, other) for said in many]
            for parts in about
        }

    def draw(self, count: int, random: torch.Generator) -> TextBatch:
        """``count`` clips with replacement."""
        motions, texts, sentences = [], [], []
        for index in torch.randint(len(self.items), (count,), generator=random).tolist():
            motion, said = self.item(index, random)
            motions.append(motion)
            texts.append(said)
            sentences.append(self.sentence(said, random))
        return batch_of(motions, texts, sentences)

    def item(self, index: int, random: torch.Generator) -> tuple[Motion, tuple[str, ...]]:
        """A stretch of a clip, or of it and another at once, and the texts that say so."""
        item = self.items[index]
        texts = item.phrasings[below(len(item.phrasings), random)]
        composed = item.actions == 1 and self.config.composes
        if composed and float(torch.rand((), generator=random)) < self.config.probability:
            other = self.partner(texts[0], random)
            if other is not None:
                motion = self.join(item.motion, self.items[other.clip].motion, texts[0], other.text, random)
                return self.stretch(motion, random), (texts[0], other.text)
        return self.stretch(item.motion, random), texts

    def partner(self, text: str, random: torch.Generator) -> Said | None:
        """Another action to be done at once; none where nothing is compatible."""
        among = self.partners[self.parts[text]] if self.config.synthetic == "parts" else self.said
        return among[below(len(among), random)] if among else None

    def join(self, a: Motion, b: Motion, text_a: str, text_b: str, random: torch.Generator) -> Motion:
        """Both at once, from their first frames, as long as the shorter one (protocol D.2)."""
        if self.config.synthetic == "energies":
            return couple(*trimmed((a, b)), self.rest_joints).motion
        if self.config.synthetic == "random":
            return put_together((a, b), divide([random_parts(random), random_parts(random)]))
        return put_together((a, b), divide([self.parts[text_a], self.parts[text_b]]))

    def stretch(self, motion: Motion, random: torch.Generator) -> Motion:
        """At most ``frames`` frames of a clip, anywhere in it, turned and moved to the common place."""
        start = below(max(0, len(motion) - self.config.frames) + 1, random)
        some = slice(start, start + self.config.frames)
        return canonical(replace(motion, rotations=motion.rotations[some], root=motion.root[some]), self.config.canon)

    def sentence(self, texts: Sequence[str], random: torch.Generator) -> str:
        names = self.config.conjunctions
        return combine(texts, names[below(len(names), random)])


def batch_of(motions: Sequence[Motion], texts: list[tuple[str, ...]], sentences: list[str]) -> TextBatch:
    """Canonical motions padded to the longest."""
    features = [to_text_features(motion.rotations, motion.root) for motion in motions]
    lengths = torch.tensor([len(one) for one in features])
    valid = torch.arange(int(lengths.max())) < lengths[:, None]
    padded = torch.nn.utils.rnn.pad_sequence(features, batch_first=True)
    return TextBatch(padded, valid, texts, sentences, [motion.source for motion in motions])


def below(limit: int, random: torch.Generator) -> int:
    """A whole number from 0 to below ``limit``."""
    return min(math.floor(float(torch.rand((), generator=random, dtype=torch.float64)) * limit), limit - 1)
