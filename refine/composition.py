"""The main job in one call: two actions in, one composed and refined motion out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch

from refine.coupling import Coupling, CouplingConfig, couple
from refine.decoupling import Decoupler, Trace
from refine.motion import Motion, resample, trimmed
from refine.ownership import Divided
from refine.refinement import RefinementConfig, refine_motion
from refine.seeing import Clips


@dataclass(frozen=True)
class Composition:
    """A composed motion with everything it was made of."""

    i: Motion
    j: Motion
    coupling: Coupling
    motion: Motion
    before: Trace | None = None
    """Of the coupled motion; None when nobody looked."""
    after: Trace | None = None
    history: dict[str, list[float]] | None = None
    """Loss terms of each refinement step."""
    made: Literal["coupled", "refined", "given"] = "refined"
    """What ``motion`` is: the coupled motion itself, refined from it, or another motion that was given."""
    owners: dict[str, str] | None = None
    """Where it was composed by parts: each body part, and the label of the action that it comes from."""

    def motions(self) -> dict[str, Motion]:
        """The coupled motion, and what was made of it if anything was, by name."""
        return {"coupled": self.coupling.motion, self.made: self.motion}

    def traces(self) -> dict[str, Trace]:
        """The loss's traces of ``motions``; empty when nobody looked."""
        traces = {"coupled": self.before, self.made: self.after}
        return {name: trace for name, trace in traces.items() if trace}


def compose(
    i: Motion,
    j: Motion,
    decoupler: Decoupler,
    lam: float = 0.5,
    coupling: CouplingConfig | None = None,
    refinement: RefinementConfig | None = None,
    progress: Callable[[int, dict[str, float]], None] | None = None,
) -> Composition:
    """Couple two clips and refine the result.

    Both run from their first frame; j is resampled to i's frame rate, and the length is that of the shorter.

    Args:
        lam: share of i where both move alike, 0..1.
        progress: called after every refinement step.

    Raises:
        UserError: a clip of a single frame, or ``lam`` outside 0..1.
    """
    i, j = aligned(i, j)
    coupled = couple(i, j, decoupler.body.rest_joints, lam, coupling)
    return refined(i, j, coupled, decoupler, refinement, progress)


def refined(
    i: Motion,
    j: Motion,
    coupled: Coupling,
    decoupler: Decoupler,
    refinement: RefinementConfig | None = None,
    progress: Callable[[int, dict[str, float]], None] | None = None,
    divided: Divided | None = None,
) -> Composition:
    """Refine what has been coupled, in whatever way, from two aligned clips."""
    result = refine_motion(coupled.motion, i, j, decoupler, refinement, progress, divided)
    made = "refined" if result.history else "coupled"
    return Composition(i, j, coupled, result.motion, result.before, result.after, result.history, made)


def aligned(first: Motion, *others: Motion, centred: bool = False) -> list[Motion]:
    """All at the first one's frame rate and as long as the shortest: from their first frames, or their middles."""
    return trimmed([first, *(resample(other, first.fps) for other in others)], centred)


def judge(motion: Motion, i: Motion, j: Motion, decoupler: Decoupler) -> Trace:
    """Eq. 7's trace of every frame of ``motion`` against two aligned sub-actions."""
    clips = [Clips(clip.rotations[None], clip.root[None]) for clip in (motion, i, j)]
    with torch.no_grad():
        return decoupler(*clips, torch.arange(len(motion))[None])
