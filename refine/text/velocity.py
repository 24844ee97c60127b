"""Parts of the body from how fast they move: the baseline of SINC's Table 1.

It needs no words, and cannot tell what an action is about from what merely moves along.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from refine.coupling_by_parts import JOINTS_OF
from refine.motion import Motion
from refine.text.parts import BODY_PARTS, Parts
from renderers.checks import UserError, check_shapes

HANDS = (22, 23)  # SMPL-H, which the rule was made for, has wrists alone


class Rule(NamedTuple):
    """A form of the baseline."""

    scores: Callable[[Tensor, float], Tensor]
    threshold: float
    """A part that scores more is one that the action is about."""


def paper_scores(joints: Tensor, fps: float) -> Tensor:
    """[T 24 3] metres, frames a second -> [6]: mean speed of each part, standardised over frames, as the paper says.

    A part's speed at a frame is the mean of its joints' speeds. The mean and the deviation are those of all frames and
    parts of the motion: over its own frames alone each part's mean would be zero.
    """
    speeds = _velocities(joints, fps).norm(dim=-1)  # [T-1 24]
    by_part = torch.stack([speeds[:, _joints(name)].mean(-1) for name in BODY_PARTS], -1)  # [T-1 6]
    deviation = by_part.std(unbiased=False)
    return (by_part.mean(0) - by_part.mean()) / deviation.clamp_min(1e-9)


def code_scores(joints: Tensor, fps: float) -> Tensor:
    """[T 24 3] metres, frames a second -> [6]: speed of each part, as the released code has it, scaled to 0 to 1.

    A part's velocity at a frame is the mean of its joints' velocity vectors; the mean over frames of its length is then
    scaled so that the slowest part of the motion has 0 and the fastest 1.
    """
    velocities = _velocities(joints, fps)
    by_part = torch.stack([velocities[:, _joints(name)].mean(1).norm(dim=-1).mean() for name in BODY_PARTS])
    return (by_part - by_part.min()) / (by_part.max() - by_part.min()).clamp_min(1e-9)


# The paper's threshold was found by eye and is not printed: 0 marks the parts that are faster than the mean.
RULES = {"paper": Rule(paper_scores, 0.0), "code": Rule(code_scores, 0.65)}


def scores_of(motion: Motion, rest_joints: Tensor, rule: str) -> dict[str, float]:
    """How much each part moves, by a rule of ``RULES``, on a body with T-pose joints [24 3] in metres.

    Raises:
        UserError: the motion has a single frame.
    """
    if len(motion) < 2:
        raise UserError(motion.source, "has a single frame, which holds no motion", "give at least two frames")
    scores = RULES[rule].scores(motion.joints(rest_joints), motion.fps)
    return dict(zip(BODY_PARTS, scores.tolist(), strict=True))


def parts_above(scores: dict[str, float], threshold: float) -> Parts:
    return Parts.of(name for name, score in scores.items() if score > threshold)


def _velocities(joints: Tensor, fps: float) -> Tensor:
    check_shapes("velocity", joints=(joints, "T 24 3"))
    return joints.diff(dim=0) * fps


def _joints(part: str) -> list[int]:
    return [joint for joint in JOINTS_OF[part] if joint not in HANDS]
