"""Refinement: push a composed motion through the decoupling loss, without a generator."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from refine.decoupling import Decoupler, Reference, Trace, rows_of
from refine.energies import spread_to_joints
from refine.metrics import FEET, planted_feet
from refine.motion import Motion, crop
from refine.ownership import Divided
from refine.seeing import Clips
from renderers.checks import UserError
from renderers.rotations import matrix_from_6d
from renderers.skeleton import DRAWN_PARTS, JOINT_NAMES, PARTS, forward_kinematics, part_of_joint


@dataclass(frozen=True)
class RefinementConfig:
    """How far, how fast, and what must not be lost on the way."""

    steps: int = 40
    frames: int = 8
    """Frames drawn in each step, spread over the clip, in one view; the views take turns."""
    rate: float = 0.06
    """Adam's step for the shares along the line between the sub-actions."""
    free_rate: float = 0.002
    """Adam's step for the free 6D offsets."""
    smooth_frames: float = 2.0
    """Standard deviation, in frames, of the smoothing that the free offsets pass through."""
    stay: float = 1e-3
    """Weight of the squared free offsets, and of the squared shares."""
    smooth: float = 1.0
    """Weight of the squared second difference of the free offsets, per frame to the fourth."""
    feet: float = 10.0
    """Weight of the squared distance (m) of planted feet from where the composition planted them."""
    seed: int = 0


BY_PARTS = RefinementConfig(free_rate=2e-4, stay=1e-5)
"""For compositions by parts: what is left out of them is small, and so is what the loss says of it."""


class Refined(NamedTuple):
    """The refined motion, with the loss before, after and in between."""

    motion: Motion
    before: Trace
    after: Trace
    history: dict[str, list[float]]


def refine_motion(
    composed: Motion,
    i: Motion,
    j: Motion,
    decoupler: Decoupler,
    config: RefinementConfig | None = None,
    progress: Callable[[int, dict[str, float]], None] | None = None,
    divided: Divided | None = None,
) -> Refined:
    """Make both sub-actions recognisable in a composition again.

    The local rotations move in two ways: each body part along the line between the two sub-actions' rotations, by one
    share for the whole clip (a half-blended limb can go to its owner); and freely, smooth in time. Travel, global
    orientation and parts that nobody answers for stay.

    Where the composition is divided, a part that an action claims is its own already, and stays as well. What nobody
    claims takes up, by its share, how the action that it is not from moves there about its mean posture: who walks and
    punches turns the trunk with the punches too.

    Args:
        composed: the motion to refine; i, j: the sub-actions it was made of, frame for frame (longer ones are cut).
        progress: called after every step with its number and its loss terms.
        divided: which parts are from which, if it is a composition by parts; else energies say who answers for what.

    Raises:
        UserError: a sub-action is shorter than the composition, or frame rates differ.
    """
    config = config or (BY_PARTS if divided else RefinementConfig())
    frames = len(composed)
    for clip in (i, j):
        if clip.fps != composed.fps or len(clip) < frames:
            problem = f"{len(clip)} frames at {clip.fps:g} fps cannot judge {frames} at {composed.fps:g} fps"
            raise UserError(clip.source, problem, "resample and crop it to the composition")
    i, j = crop(i, 0, frames), crop(j, 0, frames)
    problem = Problem.build(composed, i, j, decoupler, config, divided)
    shares = torch.zeros(len(PARTS)).to(composed.root).requires_grad_()
    offsets = torch.zeros_like(composed.six).requires_grad_()
    optimiser = torch.optim.Adam(
        [{"params": [shares], "lr": config.rate}, {"params": [offsets], "lr": config.free_rate}], betas=(0.8, 0.95)
    )
    generator = torch.Generator().manual_seed(config.seed)
    history: dict[str, list[float]] = {}
    for step in range(config.steps):
        chosen = spread_frames(frames, config.frames, generator)
        terms = problem.terms(shares, offsets, chosen, step % len(problem.cameras))
        total = sum(terms.values())
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        terms = {"total": total, **terms}
        for name, value in terms.items():
            history.setdefault(name, []).append(value.item())
        if progress:
            progress(step, {name: value.item() for name, value in terms.items()})
    with torch.no_grad():
        rotations = problem.rotations(shares, offsets)
        motion = replace(composed, rotations=rotations, source=f"{composed.source} refined")
        before, after = (problem.compare(clip.rotations, torch.arange(frames)[None]) for clip in (composed, motion))
    return Refined(motion, before, after, history)


class Problem(NamedTuple):
    """What is optimised over, with everything that stays the same during the optimisation."""

    composed: Motion
    line: Tensor  # [T 24 6] along which a part's share moves it
    movable: Tensor  # [24 1] bool: the others stay
    smoother: Tensor  # [T T] rows sum to 1
    joints: Tensor  # [T 24 3] of the composition
    planted: Tensor  # [T 4] bool, for FEET
    references: tuple[Reference, Reference]  # of every frame
    cameras: list
    decoupler: Decoupler
    config: RefinementConfig

    @classmethod
    def build(
        cls,
        composed: Motion,
        i: Motion,
        j: Motion,
        decoupler: Decoupler,
        config: RefinementConfig,
        divided: Divided | None = None,
    ) -> "Problem":
        whole, *clips = [Clips(clip.rotations[None], clip.root[None]) for clip in (composed, i, j)]
        cameras = decoupler.cameras(whole, *clips)
        every = torch.arange(len(composed))[None]
        references = decoupler.references(*clips, every, cameras, divided)
        joints = composed.joints(decoupler.body.rest_joints)
        planted = planted_feet(joints, composed.fps)
        smoother = gaussian_rows(len(composed), config.smooth_frames).to(composed.root)
        line, movable = i.six - j.six, answered_joints(references)
        if divided:
            line, movable = movement_left_out(i, j, divided), divided.unclaimed[:, None]
        return cls(composed, line, movable, smoother, joints, planted, references, cameras, decoupler, config)

    def rotations(self, shares: Tensor, offsets: Tensor) -> Tensor:
        """[T 24 3 3]; the global orientation is the composition's."""
        along = spread_to_joints(shares)[:, None] * self.line
        moved = matrix_from_6d(self.composed.six + self.movable * (along + self.smoothed(offsets)))
        return torch.cat([self.composed.rotations[:, :1], moved[:, 1:]], dim=1)

    def smoothed(self, offsets: Tensor) -> Tensor:
        return (self.smoother @ offsets.flatten(1)).reshape(offsets.shape)

    def compare(self, rotations: Tensor, frames: Tensor, views: slice = slice(None)) -> Trace:
        """Eq. 7 of the frames [1 K] in some of the views."""
        clips = Clips(rotations[None], self.composed.root[None])
        seen = self.decoupler.see(clips, frames, self.cameras[views])
        rows = (frames[0, :, None] * len(self.cameras) + torch.arange(len(self.cameras))[views]).flatten()
        return self.decoupler.compare(seen, tuple(rows_of(reference, rows) for reference in self.references))

    def terms(self, shares: Tensor, offsets: Tensor, frames: Tensor, view: int) -> dict[str, Tensor]:
        """Weighted loss terms; the decoupling loss is drawn for ``frames`` [1 K] in one view."""
        config = self.config
        rotations = self.rotations(shares, offsets)
        joints = forward_kinematics(rotations, self.composed.root, self.decoupler.body.rest_joints)[0]
        moved = joints - self.joints
        return {
            "decoupling": self.compare(rotations, frames, slice(view, view + 1)).loss,
            "stay": config.stay * (offsets.square().mean() + shares.square().mean()),
            "smooth": config.smooth * self.smoothed(offsets).diff(n=2, dim=0).square().sum() / offsets.numel(),
            "feet": config.feet * (moved[:, FEET].square().sum(-1) * self.planted).mean(),
        }


def movement_left_out(i: Motion, j: Motion, divided: Divided) -> Tensor:
    """[T 24 6] how the action that each joint does not come from moves there, about its mean posture."""
    other = torch.where(divided.from_i[:, None], j.six, i.six)
    return other - other.mean(0)


def answered_joints(references: tuple[Reference, Reference]) -> Tensor:
    """[24 1] bool: joints in whose channel a sub-action is more likely than not to be the owner."""
    answers = sum(reference.owned.answers[0] for reference in references)
    by_part = len(answers) == len(DRAWN_PARTS)  # else all share the picture
    channels = part_of_joint(DRAWN_PARTS) if by_part else [0] * len(JOINT_NAMES)
    return (answers >= 0.5)[list(channels), None]


def spread_frames(frames: int, count: int, generator: torch.Generator) -> Tensor:
    """[1 min(count, frames)] ascending frames, one drawn from each equal stretch of the clip."""
    count = min(count, frames)
    return ((torch.arange(count) + torch.rand(count, generator=generator)) * frames / count).long()[None]


def gaussian_rows(count: int, deviation: float) -> Tensor:
    """[count count] smoothing over neighbours; each row sums to 1."""
    at = torch.arange(count, dtype=torch.float64)
    weights = torch.exp(-0.5 * ((at[:, None] - at) / max(deviation, 1e-6)).square())
    return weights / weights.sum(1, keepdim=True)
