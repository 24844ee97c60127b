"""What several verbs read alike: clips, bodies, the judge. Light to import."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from renderers.checks import UserError, check_known

if TYPE_CHECKING:
    from torch import Tensor

    from refine.decoupling import Decoupler
    from refine.motion import Motion
    from refine.refinement import RefinementConfig
    from renderers.body import Body


def say(message: str) -> None:
    """A line for the person who waits; results go to stdout, this goes to stderr."""
    print(message, file=sys.stderr)


def body_of(path: Path | None, level: str = "light") -> "Body":
    """The user's SMPL body, or the free one."""
    if path is None:
        from renderers.body import Body

        return Body.free(level)
    from refine.formats.smpl import load_body

    return load_body(path)


def clip_of(name: str, rest_joints: "Tensor", seed: int = 0, seconds: float = 4.0) -> "Motion":
    """A motion file, or a built-in action of that name.

    Raises:
        UserError: there is neither; the nearest names are offered.
    """
    from refine.formats.files import load_motion
    from refine.synthetic import ACTIONS

    if Path(name).exists() or Path(name).suffix:
        return load_motion(name, rest_joints)
    check_known("neither a file nor a built-in action", name, ACTIONS)
    return built_in(name, rest_joints, seed, seconds)


def built_in(name: str, rest_joints: "Tensor", seed: int, seconds: float = 4.0, fps: float = 30.0) -> "Motion":
    import torch

    from refine.synthetic import draw, perform

    return perform(draw(name, torch.Generator().manual_seed(seed), fps), round(seconds * fps), rest_joints)


def check_lam(lam: float) -> None:
    if not 0 <= lam <= 1:
        raise UserError("--lam", f"expected a weight between 0 and 1, got {lam}")


def pair_of(first: str, second: str, rest_joints: "Tensor", seed: int) -> tuple["Motion", "Motion"]:
    """Two clips, aligned; a change of frame rate is said."""
    from refine.composition import aligned

    i, j = clip_of(first, rest_joints, seed), clip_of(second, rest_joints, seed + 1)
    if i.fps != j.fps:
        say(f"refine: {second} has {j.fps:g} fps, resampled to the {i.fps:g} fps of {first}")
    for clip in (i, j):
        if len(clip) < 2:
            raise UserError(clip.source, "has a single frame, which holds no motion", "give at least two frames")
    return aligned(i, j)


def judge_of(body: "Body", mae: Path | None = None) -> "Decoupler":
    """The decoupling loss that refinement uses, with the shipped MAE unless another is given."""
    from refine.decoupling import Decoupler
    from refine.mae import load_mae

    return Decoupler(body, load_mae(mae))


def refinement_of(steps: int | None, seed: int) -> "RefinementConfig":
    """The engine's own configuration, with another number of steps if one is given."""
    from refine.refinement import RefinementConfig

    if steps is None:
        return RefinementConfig(seed=seed)
    if steps < 0:
        raise UserError("--steps", f"expected 0 or more, got {steps}")
    return RefinementConfig(steps=steps, seed=seed)


@contextmanager
def bar(total: int, label: str) -> Iterator[Callable[..., None]]:
    """A progress bar to call after every step; silent when stderr is no terminal."""
    from tqdm import tqdm

    with tqdm(total=total, desc=label, disable=None, leave=False) as progress:
        yield lambda *_: progress.update()
