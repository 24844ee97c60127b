"""Decoupling: is each sub-action still recognisable in the composition's picture? (Eqs. 4 to 7)

The composition is drawn, the patches where one sub-action lives are kept, the MAE completes the rest into a picture of
a single action, and the difference to that sub-action's own picture is the loss.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from refine.attention import attention_map
from refine.energies import energy_signal, part_energies, spread_to_joints
from refine.patches import keep_top, paste, patch_means, patchify, unpatchify
from renderers.body import Body
from renderers.camera import Camera, frame
from renderers.checks import UserError, check_shapes
from renderers.mesh import Mesh
from renderers.rotations import heading, rotation_about
from renderers.silhouette import blur, silhouette
from renderers.skeleton import DRAWN_PART_NAMES, DRAWN_PARTS, PARTS, forward_kinematics, part_of_joint


@dataclass(frozen=True)
class DecouplingConfig:
    """How compositions are looked at. The defaults are ours; ``PAPER`` is as published."""

    kept: float = 1 / 3
    """Share of the patches that stays visible."""
    views: tuple[float, ...] = (0.0, 90.0)
    """Yaw of each camera, degrees; 0 sees the front, 90 the left side."""
    pinned: Literal["sequence", "frame", "body"] = "body"
    """What is taken out before drawing, from all three bodies alike: the first frame's place and heading (the paper);
    every frame's; or every frame's pelvis position and orientation."""
    ownership: Literal["none", "share"] = "share"
    """Whether a sub-action answers for the whole picture (the paper) or for the parts that hold more of its own energy
    than of the other's, and is asked with these alone."""
    sharpness: float = 2.0
    """Power of the energy shares before they are compared; larger makes ownership all or nothing."""
    attention_joints: Literal["sub_action", "composition", "both"] = "both"
    """Whose projected joints carry the attention (protocol B.4 no. 26). With the sub-action's alone (the paper) a limb
    that is elsewhere in the composition is cut off where the visible patches end, and the loss pushes it back there."""
    blurs: tuple[float, ...] = (0.0, 3.0)
    """Pixels; the difference is squared at each of these blurs. A sharp difference alone (the paper) has no pull
    between limbs that do not overlap."""
    epsilon: float = 1.0
    """Pixels squared, in Eq. 6."""


PAPER = DecouplingConfig(views=(0.0,), pinned="sequence", ownership="none", attention_joints="sub_action", blurs=(0.0,))


class Clips(NamedTuple):
    """A batch of motions of equal length."""

    rotations: Tensor  # [B T 24 3 3] local, joint 0 the global orientation
    root: Tensor  # [B T 3] metres, the pelvis


class Seen(NamedTuple):
    """Motions as the cameras see them; N runs over clips, frames and views, in this order."""

    pictures: Tensor  # [N C H W] part silhouettes, 0..1
    joints_px: Tensor  # [N 24 2] pixels (x, y)


class Reference(NamedTuple):
    """A sub-action's half of the question: what is looked at, and what should be seen there."""

    seen: Seen
    energies: Tensor  # [N 24] of its joints (Eq. 2)
    owned: Tensor  # [N C] how much it answers for each channel


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


def pin(clips: Clips, mode: str) -> Clips:
    """Take place and heading out of motions, so that pictures compare poses (protocol B.4 no. 24)."""
    rotations, root = clips
    first = slice(0, 1) if mode == "sequence" else slice(None)
    if mode == "body":
        turn = rotations[..., 0, :, :].mT
        origin = root
    else:
        turn = rotation_about("y", -heading(rotations[:, first, 0]))
        origin = root[:, first] * root.new_tensor([1.0, 0.0, 1.0])
    pelvis = (turn @ rotations[..., 0, :, :])[..., None, :, :]
    placed = (turn @ (root - origin)[..., None])[..., 0]
    return Clips(torch.cat([pelvis, rotations[..., 1:, :, :]], dim=-3), placed)


def reach(rest_joints: Tensor, mode: str) -> Tensor:
    """[32 3] metres: the rims of an upright drum that holds a body in any usual pose, pinned in ``mode``.

    Round, so that every view shows the body equally large.
    """
    height = float(rest_joints[:, 1].max() - rest_joints[:, 1].min())
    angle = torch.arange(16) * (2 * math.pi / 16)
    rim = torch.stack([angle.sin(), torch.zeros(16), angle.cos()], dim=1) * (0.73 * height)
    ends = (-0.73, 0.73) if mode == "body" else (-0.03, 1.43)
    return torch.cat([rim + torch.tensor([0.0, end * height, 0.0]) for end in ends]).to(rest_joints)


def take_frames(values: Tensor, frames: Tensor) -> Tensor:
    """values [B T ...], frames [B K] -> [B K ...]."""
    return values[torch.arange(len(frames), device=frames.device)[:, None], frames]


class Decoupler(nn.Module):
    """Eq. 7 as a module around a body and a frozen MAE.

    ``forward`` does everything for a training step. ``references`` and ``compare`` are its two halves, for a caller
    whose sub-actions stay while the composition changes.
    """

    def __init__(self, body: Body, mae: nn.Module, config: DecouplingConfig | None = None):
        super().__init__()
        self.config = config = config or DecouplingConfig()
        self.body, self.mae = body, mae.eval().requires_grad_(False)
        channels = mae.config.channels
        if channels not in (1, len(DRAWN_PART_NAMES)):
            raise UserError("Decoupler(mae)", f"draws 1 or {len(DRAWN_PART_NAMES)} channels, the MAE wants {channels}")
        if channels == 1 and config.ownership != "none":
            raise UserError("Decoupler(ownership)", "a plain silhouette has no parts to own", 'use ownership="none"')
        self.mesh = Mesh.build(body.faces, body.face_parts if channels > 1 else None)
        self.size = (mae.config.size, mae.config.size)

    def forward(self, composed: Clips, i: Clips, j: Clips, frames: Tensor) -> Trace:
        """Compare compositions with their sub-actions.

        Args:
            composed, i, j: B clips of T frames each.
            frames: [B K] the frames that are drawn, of all three alike.
        """
        cameras = self.cameras(i, j)
        return self.compare(self.see(composed, frames, cameras), self.references(i, j, frames, cameras))

    def cameras(self, i: Clips, j: Clips) -> list[Camera]:
        """One camera for each view. All bodies of a call share them; they see every usual pose, and i and j whole."""
        points = [reach(self.body.rest_joints, self.config.pinned)]
        if self.config.pinned == "sequence":
            points += [
                forward_kinematics(*pin(clips, "sequence"), self.body.rest_joints)[0].reshape(-1, 3).detach()
                for clips in (i, j)
            ]
        points = torch.cat(points)
        return [frame(points, self.size, yaw=math.radians(yaw), margin=0.0) for yaw in self.config.views]

    def see(self, clips: Clips, frames: Tensor, cameras: list[Camera]) -> Seen:
        """Draw the frames [B K] of motions in every view; differentiable in the motions."""
        check_shapes(
            "Decoupler.see",
            rotations=(clips.rotations, "B T 24 3 3"),
            root=(clips.root, "B T 3"),
            frames=(frames, "B K"),
        )
        rotations, root = (take_frames(value, frames) for value in pin(clips, self.config.pinned))
        posed = self.body(rotations.flatten(0, 1), root.flatten(0, 1))
        pictures = [silhouette(posed.vertices, self.mesh, camera) for camera in cameras]
        joints_px = [camera.project(posed.joints) for camera in cameras]
        return Seen(torch.stack(pictures, 1).flatten(0, 1), torch.stack(joints_px, 1).flatten(0, 1))

    @torch.no_grad()
    def references(self, i: Clips, j: Clips, frames: Tensor, cameras: list[Camera]) -> tuple[Reference, Reference]:
        """Draw the sub-actions and measure their energies; the part of Eq. 7 that is constant."""
        energies = [part_energies(energy_signal(*clips, self.body.rest_joints)) for clips in (i, j)]
        pictures_of_clip = frames.shape[1] * len(cameras)
        owned = self.ownership(*energies)
        return tuple(
            Reference(
                self.see(clips, frames, cameras),
                spread_to_joints(of_parts).repeat_interleave(pictures_of_clip, 0),
                channels.repeat_interleave(pictures_of_clip, 0),
            )
            for clips, of_parts, channels in zip((i, j), energies, owned, strict=True)
        )

    def ownership(self, energies_i: Tensor, energies_j: Tensor) -> tuple[Tensor, Tensor]:
        """Part energies [B 5] of i and j -> how much each answers for every channel, [B C] in 0..1."""
        if self.config.ownership == "none":
            ones = energies_i.new_ones(len(energies_i), self.mesh.channels)
            return ones, ones
        shares = [energies / energies.sum(-1, keepdim=True).clamp(min=1e-12) for energies in (energies_i, energies_j)]
        of_i, of_j = (share**self.config.sharpness + 1e-12 for share in shares)
        part_of_channel = [part_of_joint(PARTS)[joints[-1]] for joints in DRAWN_PARTS.values()]
        of_i = (of_i / (of_i + of_j))[:, part_of_channel]
        return of_i, 1 - of_i

    def compare(self, composed: Seen, references: tuple[Reference, Reference]) -> Trace:
        """Eqs. 5 to 7 on pictures that are already drawn."""
        sides = tuple(self.complete(composed, reference) for reference in references)
        return Trace((sides[0].loss + sides[1].loss).mean(), composed, references, sides)

    def complete(self, composed: Seen, reference: Reference) -> Side:
        """Keep what belongs to one sub-action, inpaint the rest, and compare with its own picture."""
        patch = self.mae.config.patch
        attention = self.attention(composed, reference)
        kept = keep_top(patch_means(attention, patch), self.config.kept)
        # What another action owns says nothing about this one, and the MAE knows pictures of single actions only.
        shown = composed.pictures * (reference.owned >= 0.5)[..., None, None]
        visible = patchify(composed.pictures, patch)
        inpainted = unpatchify(paste(visible, self.mae(shown, kept), kept), patch, self.size)
        difference = inpainted - reference.seen.pictures
        blurred = [blur(difference, sigma) if sigma else difference for sigma in self.config.blurs]
        errors = torch.stack([scale.square().mean((2, 3)) for scale in blurred]).mean(0)
        return Side(attention, kept, inpainted, (errors * reference.owned).mean(1))

    def attention(self, composed: Seen, reference: Reference) -> Tensor:
        """Eq. 6 at the joints that the configuration names, [N H W]."""
        own, made = reference.seen.joints_px, composed.joints_px.detach()
        carriers = {"sub_action": (own,), "composition": (made,), "both": (own, made)}[self.config.attention_joints]
        return sum(attention_map(reference.energies, joints, self.size, self.config.epsilon) for joints in carriers)
