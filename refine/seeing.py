"""Seeing: motions as pictures that can be compared, with gradients back to the motions (f_R of Eq. 4)."""

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from renderers.body import Body
from renderers.camera import Camera, cat
from renderers.checks import UserError, check_shapes
from renderers.mesh import Mesh
from renderers.rotations import heading, rotation_about
from renderers.silhouette import silhouette
from renderers.skeleton import DRAWN_PART_NAMES, DRAWN_PARTS, JOINTS, forward_kinematics, part_of_joint

Pinning = Literal["sequence", "frame", "body", "trunk"]
"""What is taken out of motions before they are drawn (protocol B.4 no. 24): the first frame's place and heading, as
published; every frame's; every frame's pelvis, place and orientation; or that, with the limbs on a straight trunk, so
that one action's arm can be compared though the trunk is the other's (the trunk itself is drawn as it bends)."""

SPINE = [JOINTS[name] for name in ("spine1", "spine2", "spine3")]
TRUNK_CHANNELS = [DRAWN_PART_NAMES.index(name) for name in ("torso", "head")]
COLOURED = 3  # channels of a picture whose parts are colours
# Of the drawn parts: light of two halves or of four quarters, on black. Red, green and blue each sum to 1 over the
# parts, so that parts before one another add up, as channels of their own would, and never leave 0..1.
COLOURS = (
    (0.0, 0.25, 0.25),  # torso
    (0.25, 0.25, 0.0),  # head
    (0.5, 0.0, 0.0),  # left arm
    (0.0, 0.5, 0.0),  # right arm
    (0.25, 0.0, 0.25),  # left leg
    (0.0, 0.0, 0.5),  # right leg
)
LIMB_JOINTS = [part not in TRUNK_CHANNELS for part in part_of_joint(DRAWN_PARTS)]


class Clips(NamedTuple):
    """A batch of motions of equal length."""

    rotations: Tensor  # [B T 24 3 3] local, joint 0 the global orientation
    root: Tensor  # [B T 3] metres, the pelvis


class Seen(NamedTuple):
    """Bodies as the cameras see them; N runs over bodies, then views."""

    pictures: Tensor  # [N C H W] in 0..1: one silhouette, one of each part, or the parts in colours (`COLOURED`)
    joints_px: Tensor  # [N 24 2] pixels (x, y)


def pin(clips: Clips, mode: Pinning) -> Clips:
    """Take out of motions what should not be compared."""
    rotations, root = clips
    if mode in ("body", "trunk"):
        upright = torch.eye(3).to(rotations).expand_as(rotations[:, :, :1])
        return Clips(torch.cat([upright, rotations[:, :, 1:]], dim=2), torch.zeros_like(root))
    first = slice(0, 1) if mode == "sequence" else slice(None)
    turn = rotation_about("y", -heading(rotations[:, first, 0]))
    origin = root[:, first] * root.new_tensor([1.0, 0.0, 1.0])
    pelvis = (turn @ rotations[:, :, 0])[:, :, None]
    return Clips(torch.cat([pelvis, rotations[:, :, 1:]], dim=2), (turn @ (root - origin)[..., None])[..., 0])


def straighten(rotations: Tensor) -> Tensor:
    """rotations [N 24 3 3] with the spine's joints as in the T-pose."""
    bent = torch.ones(24, 1, 1, dtype=torch.bool, device=rotations.device)
    bent[SPINE] = False
    return torch.where(bent, rotations, torch.eye(3).to(rotations))


def reach(rest_joints: Tensor, mode: Pinning) -> Tensor:
    """[32 3] metres: the rims of an upright drum that holds a body in any usual pose, pinned in ``mode``.

    Round, so that every view shows the body equally large.
    """
    height = float(rest_joints[:, 1].max() - rest_joints[:, 1].min())
    angle = torch.arange(16) * (2 * math.pi / 16)
    rim = torch.stack([angle.sin(), torch.zeros(16), angle.cos()], dim=1) * (0.77 * height)
    ends = (-0.12, 1.49) if mode in ("sequence", "frame") else (-0.77, 0.77)
    return torch.cat([rim + torch.tensor([0.0, end * height, 0.0]) for end in ends]).to(rest_joints)


def flesh(body: Body) -> Tensor:
    """[24] metres: how far the body reaches about each joint, of what is nearer to it than to any other, at rest."""
    distances, nearest = torch.cdist(body.rest_vertices, body.rest_joints).min(1)
    return torch.zeros(24).to(distances).scatter_reduce(0, nearest, distances, "amax")


def check_drawn(channels: int, mode: Pinning) -> None:
    """Refuse pictures that are not drawn: of another number of channels, or with parts apart where none has its own."""
    if channels not in (1, COLOURED, len(DRAWN_PART_NAMES)):
        drawn = f"1 (plain), {COLOURED} (colours) or {len(DRAWN_PART_NAMES)} (parts)"
        raise UserError("MAEConfig(channels)", f"bodies are drawn in {drawn} channels, not {channels}")
    if mode == "trunk" and channels != len(DRAWN_PART_NAMES):
        problem = f"limbs on a straight trunk need a channel for each part, not {channels}"
        raise UserError('pinned="trunk"', problem, 'use another, for example pinned="body"')


def mesh_to_draw(body: Body, mode: Pinning, channels: int) -> Mesh:
    """What `draw` draws: the body whole (1 channel) or by parts; for "trunk", one body's trunk and another's limbs.

    Raises:
        UserError: see ``check_drawn``.
    """
    check_drawn(channels, mode)
    if mode != "trunk":
        return Mesh.build(body.faces, body.face_parts if channels > 1 else None)
    limb = ~torch.isin(body.face_parts, torch.tensor(TRUNK_CHANNELS).to(body.face_parts))
    return Mesh.build(body.faces + limb[:, None] * len(body.rest_vertices), body.face_parts)


def joints_to_draw(body: Body, rotations: Tensor, root: Tensor, mode: Pinning) -> Tensor:
    """[N 24 3] metres: where the joints are of what `draw` draws."""
    if mode != "trunk":
        return forward_kinematics(rotations, root, body.rest_joints)[0]
    both = torch.stack([rotations, straighten(rotations)])
    joints, straight = forward_kinematics(both, root.expand(2, -1, -1), body.rest_joints)[0]
    return torch.where(torch.tensor(LIMB_JOINTS).to(joints.device)[:, None], straight, joints)


def draw(
    body: Body,
    mesh: Mesh,
    rotations: Tensor,
    root: Tensor,
    cameras: list[Camera],
    mode: Pinning,
    channels: int | None = None,
) -> Seen:
    """Draw pinned bodies in every view.

    Args:
        mesh: `mesh_to_draw` for this body, mode and channels.
        rotations: [N 24 3 3], root: [N 3] metres, both as ``pin`` leaves them.
        channels: of the pictures, if other than the mesh's: `COLOURED` for parts in colours.
    """
    count, views = len(root), len(cameras)
    if mode == "trunk":
        posed = body(torch.cat([rotations, straighten(rotations)]), root.repeat(2, 1))
        vertices = torch.cat(posed.vertices.split(count), dim=1)
    else:
        posed = body(rotations, root)
        vertices = posed.vertices
    every = cat([camera[torch.zeros(count, dtype=torch.long)] if len(camera) == 1 else camera for camera in cameras])
    pictures = silhouette(vertices.repeat(views, 1, 1), mesh, every)
    if channels == COLOURED:
        pictures = coloured(pictures)
    joints_px = every.project(posed.joints[:count].repeat(views, 1, 1))
    by_view = (values.unflatten(0, (views, count)) for values in (pictures, joints_px))
    return Seen(*(values.transpose(0, 1).flatten(0, 1) for values in by_view))


def coloured(parts: Tensor) -> Tensor:
    """Silhouettes of the drawn parts [N 6 H W] -> [N 3 H W] in 0..1: what they cover in `COLOURS`, added up.

    Linear in the coverages, so that gradients reach every part, also one behind another.
    """
    check_shapes("coloured", parts=(parts, f"N {len(COLOURS)} H W"))
    return torch.einsum("nphw,pc->nchw", parts, torch.tensor(COLOURS).to(parts))
