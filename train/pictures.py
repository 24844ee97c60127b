"""Pictures of single actions, and what of them stays visible: what the MAE learns from.

Drawn as the decoupling loss draws, with the same body, rasteriser, pinning and camera, so that the MAE meets nothing
new there; turned, moved and zoomed at random, so that it does not learn one camera by heart.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from refine.attention import attention_map
from refine.energies import energy_signal, joint_energies
from refine.mae import MAEConfig
from refine.motion import Motion
from refine.patches import keep_random, keep_top, patch_means
from refine.seeing import Clips, Pinning, draw, pin, reach
from renderers.body import Body
from renderers.camera import frame
from renderers.checks import UserError, check_range
from renderers.mesh import Mesh
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import DRAWN_PARTS


@dataclass(frozen=True)
class PictureConfig:
    """How single actions are drawn and masked."""

    pinned: Pinning = "trunk"
    """What is taken out before drawing, as in ``DecouplingConfig``."""
    yaw: float = 120.0
    """Largest turn of the camera to either side, degrees."""
    pose_noise: float = 0.0
    """Standard deviation of a random turn of every joint, radians: poses beyond those of the clips."""
    shift: float = 0.05
    """Standard deviation of the body's place, metres."""
    zoom: float = 0.06
    """Largest margin about the frame, as a share of the picture; one margin for each batch."""
    kept: float = 1 / 3
    """Share of the patches that stays visible."""
    attention_share: float = 0.5
    """Share of the pictures that keep the patches of their action's attention field; the others keep random ones."""
    parts_hidden: float = 0.5
    """Share of the pictures that lack some body parts altogether, as the decoupling loss hides what it does not ask
    about. Nothing is hidden where parts have no channels of their own."""

    def __post_init__(self):
        check_range(self, 0.01, 0.99, "kept")
        check_range(self, 0, 1, "attention_share", "parts_hidden")
        check_range(self, 0, 180, "yaw")
        check_range(self, 0, 1, "shift", "zoom")


class Poses(NamedTuple):
    """Every frame of some clips, pinned, and the energies of the clip it is from."""

    rotations: Tensor  # [M 24 3 3]
    root: Tensor  # [M 3] metres
    energies: Tensor  # [M 24]


class Pictures(NamedTuple):
    """Drawn poses and their masks."""

    images: Tensor  # [N C H W] in 0..1, whole
    kept: Tensor  # [N P] bool, True = visible
    shown: Tensor  # [N C] bool, True = the part may be seen where the patch is visible


def poses_of(motions: list[Motion], rest_joints: Tensor, pinned: Pinning) -> Poses:
    """All frames of clips of two frames or more.

    Raises:
        UserError: there are none.
    """
    parts = []
    for motion in motions:
        if len(motion) > 1:
            clip = pin(Clips(motion.rotations[None], motion.root[None]), pinned)
            energies = joint_energies(energy_signal(motion.rotations, motion.root, rest_joints))
            parts.append(Poses(clip.rotations[0], clip.root[0], energies.expand(len(motion), -1)))
    if not parts:
        raise UserError(
            "poses", "every clip is a single frame, which has no energy", "give clips of two frames or more"
        )
    return Poses(*(torch.cat(values) for values in zip(*parts, strict=True)))


def draw_pictures(
    poses: Poses,
    count: int,
    body: Body,
    mesh: Mesh,
    network: MAEConfig,
    config: PictureConfig,
    random: torch.Generator,
) -> Pictures:
    """``count`` poses drawn at random, rendered and masked as the network reads them."""
    size, patch = network.size, network.patch
    index = torch.randint(len(poses.root), (count,), generator=random).to(poses.root.device)
    rotations, root, energies = (values[index] for values in poses)
    yaw = math.radians(config.yaw) * (2 * torch.rand(count, generator=random) - 1)
    turn = rotation_about("y", yaw).to(root)
    root = (turn @ root[..., None])[..., 0] + config.shift * torch.randn(count, 3, generator=random).to(root)
    noise = config.pose_noise * torch.randn(count, 23, 3, generator=random).to(root)
    posed = rotations[:, 1:] @ axis_angle_to_matrix(noise)
    rotations = torch.cat([(turn @ rotations[:, 0])[:, None], posed], dim=1)
    margin = config.zoom * float(torch.rand((), generator=random))
    camera = frame(reach(body.rest_joints, config.pinned), (size, size), margin=margin)
    with torch.no_grad():
        images, joints_px = draw(body, mesh, rotations, root, [camera], config.pinned, network.channels)
        attention = patch_means(attention_map(energies, joints_px, (size, size)), patch)
    by_attention = torch.rand(count, 1, generator=random) < config.attention_share
    at_random = keep_random(count, attention.shape[1], config.kept, random)
    kept = torch.where(by_attention.to(images.device), keep_top(attention, config.kept), at_random.to(images.device))
    hidden = config.parts_hidden if network.channels == len(DRAWN_PARTS) else 0.0
    shown = show_parts(count, network.channels, hidden, random).to(images.device)
    return Pictures(images, kept, shown)


def show_parts(count: int, channels: int, hidden: float, random: torch.Generator) -> Tensor:
    """[count channels] bool: a share ``hidden`` of the rows lacks each channel with an even chance, but never all."""
    lacking = (torch.rand(count, 1, generator=random) < hidden) & (torch.rand(count, channels, generator=random) < 0.5)
    return ~lacking | lacking.all(1, keepdim=True)
