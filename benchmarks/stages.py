"""Where the time of a decoupling step goes: wall time of its stages, forward and backward.

Functions of the engine are wrapped for the measurement. A stage's backward is the time of the autograd nodes that it
made. What belongs to no stage (checks, energies, the optimiser's own terms, autograd's sums) is the rest.
"""

import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import torch
from torch import Tensor

from refine import decoupling, synthetic
from refine.coupling import couple
from refine.decoupling import Decoupler
from refine.mae import load_mae
from refine.motion import Motion
from refine.refinement import Problem, RefinementConfig, spread_frames
from refine.seeing import Clips
from renderers import camera, silhouette
from renderers.body import Body
from renderers.skeleton import PARTS

FRAMES = 60
WARM_UP = 2
Watched = tuple[object, str, str]
"""A function's owner, its name there, and the stage it counts as."""

PATCHES = ("attention_map", "patch_means", "keep_top", "patchify", "unpatchify", "paste")


def clock_of(device: str) -> Callable[[], float]:
    """Seconds of wall time; on a GPU when all work that was asked for is done."""

    def now() -> float:
        if device != "cpu":
            torch.cuda.synchronize()
        return time.perf_counter()

    return now


class Stages:
    """Seconds of each stage of a step; stages inside others count for themselves alone."""

    def __init__(self, device: str = "cpu"):
        self.now = clock_of(device)
        self.forward, self.backward = Counter(), Counter()
        self._inside = [0.0]  # seconds of inner stages and their bookkeeping, for the step and each open stage
        self._stage_of = {}

    def wrap(self, stage: str, function: Callable) -> Callable:
        def timed(*args, **options):
            self._inside.append(0.0)
            start = self.now()
            result = function(*args, **options)
            seconds = self.now() - start
            self.forward[stage] += seconds - self._inside.pop()
            start = self.now()
            self._claim(stage, result, args)
            # The bookkeeping counts for no stage, this one or one around it.
            self._inside[-1] += seconds + self.now() - start
            return result

        return timed

    def _claim(self, stage: str, results: object, args: tuple):
        """Time the backward of all nodes between ``args`` and ``results`` that no inner stage has claimed."""
        seen = {None} | {tensor.grad_fn for tensor in tensors(args)}
        waiting = [tensor.grad_fn for tensor in tensors(results)]
        while waiting:
            node = waiting.pop()
            if node in seen:
                continue
            seen.add(node)
            waiting += [before for before, _ in node.next_functions]
            if node not in self._stage_of:
                self._stage_of[node] = stage
                node.register_prehook(lambda _: self._begin())
                node.register_hook(lambda *_, node=node: self._end(node))

    def _begin(self):
        self._start = self.now()

    def _end(self, node):
        self.backward[self._stage_of[node]] += self.now() - self._start

    def seconds(self, forward: float, backward: float) -> dict[str, tuple[float, float]]:
        """Forward and backward of each stage and, from the whole step's, of the rest."""
        found = {stage: (self.forward[stage], self.backward[stage]) for stage in self.forward}
        rest = forward - self._inside[0], backward - self.backward.total()
        return found | {"rest": rest}


def tensors(values: object) -> Iterator[Tensor]:
    """All tensors with a gradient in nested tuples and objects."""
    if isinstance(values, Tensor):
        if values.requires_grad:
            yield values
    elif isinstance(values, (tuple, list)):
        for value in values:
            yield from tensors(value)
    elif hasattr(values, "__dict__") and not isinstance(values, torch.nn.Module):
        yield from tensors(list(vars(values).values()))


@contextmanager
def watched(judge: Decoupler, device: str = "cpu", others: Iterable[Watched] = ()) -> Iterator[Stages]:
    """Time the stages of everything that ``judge`` does meanwhile, and of other functions."""
    stages = Stages(device)
    with ExitStack() as patches:
        for owner, name, stage in (
            (judge.body, "forward", "body"),
            (camera.Camera, "view", "projection"),
            (camera.Camera, "pixels", "projection"),
            (judge.mae, "forward", "MAE"),
            (decoupling, "blur", "blur"),
            *((decoupling, name, "attention, patches") for name in PATCHES),
            *others,
        ):
            patches.enter_context(patch.object(owner, name, stages.wrap(stage, getattr(owner, name))))
        fold = stages.wrap("renderer", silhouette.BACKENDS["fold"])
        patches.enter_context(patch.dict(silhouette.BACKENDS, fold=fold))
        yield stages


def shares(judge: Decoupler, loss: Callable[[], Tensor], repeats: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of a step, by stage: ``forward``, ``backward``, and ``share`` of all."""
    found = []
    for _ in range(WARM_UP + repeats):
        with watched(judge) as stages:
            start = time.perf_counter()
            value = loss()
            middle = time.perf_counter()
            value.backward()
            end = time.perf_counter()
        found.append(stages.seconds(middle - start, end - middle))
    return medians(found[WARM_UP:])


def medians(steps: list[dict[str, tuple[float, float]]]) -> dict[str, dict[str, float]]:
    """Of several steps' `Stages.seconds` the median milliseconds of each stage and its share of their sum."""
    rows = {}
    for stage in steps[0]:
        forward, backward = (1e3 * statistics.median(step[stage][way] for step in steps) for way in (0, 1))
        rows[stage] = {"forward": forward, "backward": backward}
    total = sum(row["forward"] + row["backward"] for row in rows.values())
    return {stage: row | {"share": (row["forward"] + row["backward"]) / total} for stage, row in rows.items()}


def decoupling_steps(repeats: int, threads: int) -> dict[str, dict]:
    """The two steps that use the loss, with either body: refining a clip, and training a generator."""
    torch.set_num_threads(threads)
    found = {}
    for level in ("light", "full"):
        body = Body.free(level)
        judge = Decoupler(body, load_mae())
        generator = torch.Generator().manual_seed(0)
        draws = [synthetic.draw(name, generator) for name in ("walk", "wave-left-hand")]
        i, j = (synthetic.perform(draw, FRAMES, body.rest_joints) for draw in draws)
        composed = couple(i, j, body.rest_joints).motion
        for name, step in (("refining", refining), ("training", training)):
            found[f"{name}, {level} body"] = shares(judge, step(judge, composed, i, j), repeats)
    return found


def refining(judge: Decoupler, composed: Motion, i: Motion, j: Motion) -> Callable[[], Tensor]:
    """A step of `refine_motion`: 8 frames in one view, the sub-actions already drawn."""
    config = RefinementConfig()
    problem = Problem.build(composed, i, j, judge, config)
    shares, offsets = torch.zeros(len(PARTS)), torch.zeros_like(composed.six).requires_grad_()
    frames = spread_frames(FRAMES, config.frames, torch.Generator().manual_seed(0))
    return lambda: sum(problem.terms(shares, offsets, frames, 0).values())


def training(judge: Decoupler, composed: Motion, i: Motion, j: Motion) -> Callable[[], Tensor]:
    """The loss of a training step: 2 frames of 8 clips in two views, the sub-actions drawn as well."""
    made, *given = (Clips(clip.rotations.repeat(8, 1, 1, 1, 1), clip.root.repeat(8, 1, 1)) for clip in (composed, i, j))
    made.rotations.requires_grad_()
    frames = torch.randint(FRAMES, (8, 2), generator=torch.Generator().manual_seed(0))
    return lambda: judge(made, *given, frames).loss
