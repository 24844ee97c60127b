"""The random side of a performance: everything that makes one clip differ from the next, as plain numbers."""

from dataclasses import dataclass
from functools import cached_property
from math import radians

import torch
from torch import Tensor

from refine.procedural.curves import drift, unevenness

# Half widths of the uniform ranges that styles are drawn from: radians, leg lengths, or shares of the usual size.
STYLE_RANGES = {
    "lean": radians(4),
    "nod": radians(7),
    "look": radians(9),
    "head_tilt": radians(4),
    "arms_apart": radians(6),
    "elbow": radians(7),
    "arm_swing": 0.35,
    "feet_apart": 0.05,
    "toes_out": radians(6),
    "twist": 0.35,
    "reach": 1.0,
    "plane": 1.0,
}


@dataclass(frozen=True)
class Style:
    """How this performer holds and moves the body, as offsets from the usual; ``reach`` and ``plane`` are in -1..1."""

    lean: float
    nod: float
    look: float
    head_tilt: float
    arms_apart: float
    elbow: float
    arm_swing: float
    feet_apart: float
    toes_out: float
    twist: float
    reach: float
    plane: float


@dataclass(frozen=True)
class Draw:
    """One performance of one action.

    Attributes:
        action: its name.
        fps: frames per second.
        tempo: repetitions per second (for walk and run: strides, two steps each).
        amplitude: size of the movement, 1 is the usual.
        phase: where in a repetition the first frame stands, 0..1.
        hand: the hand that acts, where the action leaves it open.
        style: posture and manner.
        seed: of the slow noise on posture, timing and size.
    """

    action: str
    fps: float
    tempo: float
    amplitude: float
    phase: float
    hand: str
    style: Style
    seed: int


def draw_parameters(action: str, tempo: tuple[float, float], generator: torch.Generator, fps: float) -> Draw:
    """A new performance of an action whose tempo lies in the given range."""
    share, amplitude, phase, hand, *style = torch.rand(4 + len(STYLE_RANGES), generator=generator).tolist()
    manner = {name: (2 * value - 1) * STYLE_RANGES[name] for name, value in zip(STYLE_RANGES, style, strict=True)}
    return Draw(
        action=action,
        fps=fps,
        tempo=tempo[0] + share * (tempo[1] - tempo[0]),
        amplitude=0.82 + 0.36 * amplitude,
        phase=phase,
        hand="left" if hand < 0.3 else "right",
        style=Style(**manner),
        seed=int(torch.randint(2**31, (1,), generator=generator)),
    )


NOISE = ("timing", "swell", "shift", "advance", "lean", "turn", "tilt", "nod", "look", "left_forward", "left_sideways",
         "left_bend", "right_forward", "right_sideways", "right_bend")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Beat:
    """A draw laid out in time: what an action's curves are made of.

    Attributes:
        draw: the performance.
        seconds: [T] time of each frame.
    """

    draw: Draw
    seconds: Tensor

    @cached_property
    def noise(self) -> dict[str, Tensor]:
        """Slow drift [T] of about unit size, for each name in ``NOISE``."""
        return dict(zip(NOISE, drift(self.seconds, len(NOISE), self.draw.seed), strict=True))

    @cached_property
    def cycle(self) -> Tensor:
        """[T] repetitions so far, with an uneven pulse."""
        return self.draw.phase + self.draw.tempo * self.seconds + 0.02 * self.noise["timing"]

    @cached_property
    def swell(self) -> Tensor:
        """[T] size of a movement that never rests: the amplitude, slowly rising and falling."""
        return self.draw.amplitude * (1 + 0.05 * self.noise["swell"])

    def size(self, phase: Tensor) -> Tensor:
        """[T] size of a movement at rest at whole values of ``phase``: the amplitude, another for each repetition."""
        return self.draw.amplitude * (1 + 0.06 * unevenness(phase, self.draw.seed))
