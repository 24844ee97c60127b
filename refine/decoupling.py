"""Decoupling: is each sub-action still recognisable in the composition's picture? (Eqs. 4 to 7)

The composition is drawn, the patches where one sub-action lives are kept, the MAE completes the rest into a picture of
a single action, and the difference to that sub-action's own picture is the loss.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from refine.attention import attention_map
from refine.energies import energy_signal, joint_energies, part_energies
from refine.ownership import Divided, Owned, as_divided, by_standing, everything
from refine.patches import keep_top, paste, patch_means, patchify, unpatchify
from refine.seeing import Clips, Pinning, Seen, check_drawn, draw, flesh, joints_to_draw, mesh_to_draw, pin, reach
from renderers.body import Body
from renderers.camera import Camera, frame_each
from renderers.checks import UserError, check_shapes
from renderers.silhouette import blur
from renderers.skeleton import DRAWN_PART_NAMES

SPARE = 0.05  # metres that stay free about a motion; a picture is at least 2.3 metres wide
# Bodies or pictures that are worked on at once: long clips must not need memory by their length.
CHUNK, CHUNK_ON_CARD = 128, 1024


@dataclass(frozen=True)
class DecouplingConfig:
    """How compositions are looked at. The defaults are ours; ``PAPER`` is as published."""

    kept: float = 1 / 3
    """Share of the patches that stays visible."""
    views: tuple[float, ...] = (0.0, 90.0)
    """Yaw of each camera, degrees; 0 sees the front, 90 the left side."""
    pinned: Pinning = "trunk"
    """What is taken out of all three bodies alike before they are drawn, see ``seeing.Pinning``."""
    ownership: Literal["none", "standing"] = "standing"
    """Whether a sub-action answers for the whole picture (the paper) or for the parts that it lives in, and is asked
    with these alone; see ``ownership``."""
    contested: float = 0.5
    """Where the smaller standing (an action's energy in a part over that in its most energetic part) is this fraction
    of the larger, nobody owns the part; at half of it the owner is certain."""
    quiet: float = 0.3
    """Standing that an action must have in a part to own it for certain; with half of it it owns nothing."""
    attention_joints: Literal["sub_action", "composition", "both"] = "both"
    """Whose projected joints carry the attention (protocol B.4 no. 26). With the sub-action's alone (the paper) a limb
    that is elsewhere in the composition is cut off where the visible patches end, and the loss pushes it back there."""
    blurs: tuple[float, ...] = (0.0, 3.0)
    """Pixels; the difference is squared at each of these blurs. A sharp difference alone (the paper) has no pull
    between limbs that do not overlap."""
    epsilon: float = 1.0
    """Pixels squared, in Eq. 6."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the MAE's products; bfloat16 is more than twice as fast where the processor knows it, and turns the gradient
    by less than two degrees."""
    through_mae: bool = True
    """Whether the gradient also follows what the MAE makes of the visible patches, as published, or the visible pixels
    alone, which nearly halves a step's time. The MAE's part is some 5 % of the gradient's norm here, and some 40 %
    with the loss as published (benchmarks/ladder.py)."""


PAPER = DecouplingConfig(views=(0.0,), pinned="sequence", ownership="none", attention_joints="sub_action", blurs=(0.0,))


def default_for(channels: int) -> DecouplingConfig:
    """Our configuration, as far as an MAE's pictures allow it: without a channel for each part there is none to own."""
    ours = DecouplingConfig()
    return ours if channels == len(DRAWN_PART_NAMES) else replace(ours, ownership="none", pinned="body")


class Reference(NamedTuple):
    """A sub-action's half of the question: what is looked at, and what should be seen there."""

    seen: Seen
    energies: Tensor  # [N 24] of its joints (Eq. 2)
    owned: Owned  # [N C] each


class Side(NamedTuple):
    """A sub-action's half of the answer."""

    attention: Tensor  # [N H W] Eq. 6
    kept: Tensor  # [N P] bool, True = visible
    inpainted: Tensor  # [N C H W] the composition's kept patches, completed by the MAE
    loss: Tensor  # [N] Eq. 7's term of each picture


class Trace(NamedTuple):
    """Every stage of the loss, for training and for looking."""

    loss: Tensor  # scalar, the mean over pictures of both sides
    composed: Seen
    references: tuple[Reference, Reference]  # of i and j
    sides: tuple[Side, Side]


def at_once(values: Tensor) -> int:
    return CHUNK if values.device.type == "cpu" else CHUNK_ON_CARD


def frames_of(clips: Clips, frames: Tensor) -> Clips:
    """The frames [B K] of motions as one batch: rotations [B*K 24 3 3], root [B*K 3]."""
    clip = torch.arange(len(frames), device=frames.device)[:, None]
    return Clips(*(value[clip, frames].flatten(0, 1) for value in clips))


def take(camera: Camera, index: Tensor) -> Camera:
    """The cameras at ``index``; a single one serves all."""
    return camera if len(camera) == 1 else camera[index.to(camera.focal.device)]


def joined(*values: NamedTuple) -> NamedTuple:
    """Named tuples of tensors, also within one another, as one: all rows of the first, then those of the next."""
    first = values[0]
    return torch.cat(values) if isinstance(first, Tensor) else type(first)(*map(joined, *values))


def rows_of(value: NamedTuple, rows: slice | Tensor) -> NamedTuple:
    """Some rows of every tensor in a named tuple, also within one another."""
    return value[rows] if isinstance(value, Tensor) else type(value)(*(rows_of(one, rows) for one in value))


class Decoupler(nn.Module):
    """Eq. 7 as a module around a body and a frozen MAE; without a configuration ours, as far as its pictures allow.

    Pictures are compared in 0..1, whatever the MAE makes of them inside. In the units of ImageNet's deviation, which
    the official networks read, the same error is 1 / 0.229^2, 1 / 0.224^2 and 1 / 0.225^2 times as large in red, green
    and blue: about 19.6 times.

    ``forward`` does everything for a training step. ``references`` and ``compare`` are its two halves, for a caller
    whose sub-actions stay while the composition changes.
    """

    def __init__(self, body: Body, mae: nn.Module, config: DecouplingConfig | None = None):
        super().__init__()
        channels = mae.config.channels
        self.config = config = config or default_for(channels)
        self.body, self.mae = body, mae.eval().requires_grad_(False)
        check_drawn(channels, "body")
        if channels != len(DRAWN_PART_NAMES) and (config.ownership != "none" or config.pinned == "trunk"):
            problem = f"a picture of {channels} channels has no parts to own or to draw apart"
            raise UserError("Decoupler(config)", problem, 'use ownership="none" and another pinning')
        self.mesh = mesh_to_draw(body, config.pinned, channels)
        self.register_buffer("flesh", flesh(body), persistent=False)
        self.size = (mae.config.size, mae.config.size)

    def forward(self, composed: Clips, i: Clips, j: Clips, frames: Tensor) -> Trace:
        """Compare compositions with their sub-actions.

        Args:
            composed, i, j: B clips of T frames each.
            frames: [B K] the frames that are drawn, of all three alike.
        """
        cameras = self.cameras(composed, i, j)
        return self.compare(self.see(composed, frames, cameras), self.references(i, j, frames, cameras))

    def cameras(self, *motions: Clips) -> list[Camera]:
        """B cameras for each view: one for each clip of ``motions``, which sees every usual pose and, of all motions,
        that clip whole. What a pair's loss is does not hang on the other pairs of a batch."""
        usual = reach(self.body.rest_joints, self.config.pinned)
        points = torch.cat([usual.expand(len(motions[0].root), -1, -1), *self.boxes(*motions)], dim=1)
        return [frame_each(points, self.size, yaw=math.radians(yaw), margin=0.0) for yaw in self.config.views]

    @torch.no_grad()
    def boxes(self, *motions: Clips) -> list[Tensor]:
        """[B 8 3] metres of each: corners of upright boxes about motions as drawn: joints, the flesh on them, and
        `SPARE`."""
        pinned = [Clips(*(value.flatten(0, 1) for value in pin(clips, self.config.pinned))) for clips in motions]
        drawn = joints_to_draw(self.body, *joined(*pinned), self.config.pinned)
        around = self.flesh[:, None] + SPARE
        upper = torch.cartesian_prod(*[torch.tensor([False, True])] * 3).to(drawn.device)
        boxes = []
        for clips, joints in zip(motions, drawn.split([len(flat.root) for flat in pinned]), strict=True):
            joints = joints.unflatten(0, clips.root.shape[:2])
            low, high = (joints - around).amin((1, 2)), (joints + around).amax((1, 2))
            boxes.append(torch.where(upper, high[:, None], low[:, None]))
        return boxes

    def see(self, clips: Clips, frames: Tensor, cameras: list[Camera]) -> Seen:
        """Draw the frames [B K] of motions in every view, by one camera or one for each motion; differentiable in the
        motions."""
        return self.see_each([clips], frames, cameras)[0]

    def see_each(self, motions: Sequence[Clips], frames: Tensor, cameras: list[Camera]) -> list[Seen]:
        """``see`` of several batches of motions, drawn together: on a graphics card a call costs more than what it
        draws. Their lengths may differ."""
        for clips in motions:
            check_shapes(
                "Decoupler.see",
                rotations=(clips.rotations, "B T 24 3 3"),
                root=(clips.root, "B T 3"),
                frames=(frames, "B K"),
            )
        posed = joined(*(frames_of(pin(clips, self.config.pinned), frames) for clips in motions))
        clip = torch.arange(len(frames)).repeat_interleave(frames.shape[1]).repeat(len(motions))
        bodies = zip(*(value.split(at_once(posed.root)) for value in (*posed, clip)), strict=True)
        mesh, channels = self.mesh.to(posed.root.device), self.mae.config.channels
        seen = [
            draw(self.body, mesh, *some, [take(camera, of) for camera in cameras], self.config.pinned, channels)
            for *some, of in bodies
        ]
        pictures = frames.numel() * len(cameras)
        whole = joined(*seen)
        return [rows_of(whole, slice(n * pictures, (n + 1) * pictures)) for n in range(len(motions))]

    @torch.no_grad()
    def references(
        self,
        i: Clips,
        j: Clips,
        frames: Tensor,
        cameras: list[Camera],
        divided: Divided | None = None,
    ) -> tuple[Reference, Reference]:
        """Draw the sub-actions and measure their energies; the part of Eq. 7 that is constant.

        Args:
            divided: of one pair, B = 1, that is composed by parts; see ``ownership``.
        """
        pictures_of_clip = frames.shape[1] * len(cameras)
        references = []
        owned = self.ownership(i, j, divided)
        for clips, mine, seen in zip((i, j), owned, self.see_each((i, j), frames, cameras), strict=True):
            energies = joint_energies(energy_signal(*clips, self.body.rest_joints))
            per_clip = (energies, *(value.to(energies.device) for value in mine))
            energies, *mine = (value.repeat_interleave(pictures_of_clip, 0) for value in per_clip)
            references.append(Reference(seen, energies, Owned(*mine)))
        return tuple(references)

    def ownership(self, i: Clips, j: Clips, divided: Divided | None = None) -> tuple[Owned, Owned]:
        """What each sub-action owns of its B pairs' channels: by energies, unless it is known how one is divided."""
        if self.config.ownership == "none":
            return everything(len(i.root), self.mae.config.channels)
        if divided:
            return as_divided(divided)
        turning = [part_energies(energy_signal(*clips, self.body.rest_joints, "rot6d")) for clips in (i, j)]
        return by_standing(*turning, self.config.contested, self.config.quiet)

    def compare(self, composed: Seen, references: tuple[Reference, Reference]) -> Trace:
        """Eqs. 5 to 7 on pictures that are already drawn, both sides in one pass."""
        count = len(composed.pictures)
        twice, asked = joined(composed, composed), joined(*references)
        step = at_once(composed.pictures)
        chunks = [slice(start, start + step) for start in range(0, 2 * count, step)]
        both = joined(*(self.complete(rows_of(twice, rows), rows_of(asked, rows)) for rows in chunks))
        sides = rows_of(both, slice(count)), rows_of(both, slice(count, None))
        return Trace((sides[0].loss + sides[1].loss).mean(), composed, references, sides)

    def complete(self, composed: Seen, reference: Reference) -> Side:
        """Keep what belongs to one sub-action, inpaint the rest, and compare with its own picture.

        Where a gradient is wanted, pictures in which the sub-action answers for nothing are not inpainted, but left as
        they are: their loss is 0 in any case.
        """
        patch = self.mae.config.patch
        attention = self.attention(composed, reference)
        kept = keep_top(patch_means(attention, patch), self.config.kept)
        # What another action owns says nothing about this one, and the MAE knows pictures of single actions only.
        shown = composed.pictures * reference.owned.shown[..., None, None]
        visible = patchify(composed.pictures, patch)
        answering = reference.owned.answers.any(1)
        if not torch.is_grad_enabled() or answering.all():
            predicted = self.inpaint(shown, kept)
        elif answering.any():
            rows = answering.nonzero()[:, 0]
            predicted = visible.index_copy(0, rows, self.inpaint(shown[rows], kept[rows]))
        else:
            predicted = visible
        inpainted = unpatchify(paste(visible, predicted, kept), patch, self.size)
        difference = inpainted - reference.seen.pictures
        blurred = [blur(difference, sigma) for sigma in self.config.blurs]
        errors = torch.stack([scale.square().mean((2, 3)) for scale in blurred]).mean(0)
        return Side(attention, kept, inpainted, (errors * reference.owned.answers).mean(1))

    def inpaint(self, pictures: Tensor, kept: Tensor) -> Tensor:
        """The MAE's patches, float32 in any precision."""
        half = torch.autocast(pictures.device.type, torch.bfloat16, self.config.precision == "bfloat16")
        with half, torch.set_grad_enabled(self.config.through_mae and torch.is_grad_enabled()):
            return self.mae(pictures, kept).float()

    def attention(self, composed: Seen, reference: Reference) -> Tensor:
        """Eq. 6 at the joints that the configuration names, [N H W]."""
        own, made = reference.seen.joints_px, composed.joints_px.detach()
        carriers = {"sub_action": (own,), "composition": (made,), "both": (own, made)}[self.config.attention_joints]
        return sum(attention_map(reference.energies, joints, self.size, self.config.epsilon) for joints in carriers)
