"""SMPL's 24 joints: names, tree, sides, parts, and forward kinematics (protocol A.1, B.4 no. 7)."""

from functools import cache
from itertools import groupby, pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from renderers.checks import check_shapes
from renderers.rotations import product

JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
JOINTS = {name: index for index, name in enumerate(JOINT_NAMES)}
MIRRORED = tuple(
    JOINTS[name.replace("left", "?").replace("right", "left").replace("?", "right")] for name in JOINT_NAMES
)

# The five parts of Eq. 2. The pelvis (joint 0) is in none of them: it carries the root, which follows the legs.
PARTS: dict[str, tuple[int, ...]] = {
    "torso": (3, 6, 9, 12, 15),
    "left_arm": (13, 16, 18, 20, 22),
    "right_arm": (14, 17, 19, 21, 23),
    "left_leg": (1, 4, 7, 10),
    "right_leg": (2, 5, 8, 11),
}
PART_NAMES = tuple(PARTS)
LEGS = ("left_leg", "right_leg")

# What is drawn in a channel of its own: the parts above with the head apart and the pelvis in the torso.
DRAWN_PARTS: dict[str, tuple[int, ...]] = {
    "torso": (0, 3, 6, 9),
    "head": (12, 15),
    **{name: PARTS[name] for name in PART_NAMES if name != "torso"},
}
DRAWN_PART_NAMES = tuple(DRAWN_PARTS)


def part_of_joint(parts: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    """For each of the 24 joints the index of its part in ``parts``, -1 for a joint in none."""
    owner = {joint: index for index, joints in enumerate(parts.values()) for joint in joints}
    return tuple(owner.get(joint, -1) for joint in range(len(JOINT_NAMES)))


def forward_kinematics(rotations: Tensor, root: Tensor, rest_joints: Tensor) -> tuple[Tensor, Tensor]:
    """World joints of the SMPL tree.

    Args:
        rotations: [... 24 3 3] local rotations (joint 0: global orientation), relative to the T-pose.
        root: [... 3] world position of the pelvis joint, metres.
        rest_joints: [24 3] joints of the T-pose, metres; only their differences matter.

    Returns:
        joints [... 24 3] in metres, world rotations [... 24 3 3].
    """
    check_shapes(
        "forward_kinematics",
        rotations=(rotations, "... 24 3 3"),
        root=(root, "... 3"),
        rest_joints=(rest_joints, "24 3"),
    )
    tree = Tree.on(rotations.device)
    first, *levels = rotations.split([len(level) for level in LEVELS], dim=-3)
    world = [first]
    for places, turns in zip(tree.places, levels, strict=True):
        world.append(product(world[-1].index_select(-3, places), turns))
    world = torch.cat(world, dim=-3)
    bones = (rest_joints - rest_joints.index_select(0, tree.parents))[..., None]
    turned = product(world.index_select(-3, tree.parents), bones)[..., 0]
    return root[..., None, :] + (turned.mT @ tree.below.to(turned)).mT, world


def _depth(joint: int) -> int:
    return 1 + _depth(PARENTS[joint]) if joint else 0


# SMPL numbers its joints from the pelvis outwards: those of a level follow each other.
LEVELS = tuple(tuple(level) for _, level in groupby(range(len(PARENTS)), _depth))


class Tree(NamedTuple):
    """The tree as indices. A level at a time takes a third of the calls that a joint at a time does."""

    places: tuple[Tensor, ...]  # of the parents of each level but the first, among the level before
    parents: Tensor  # [24] each joint's, the pelvis its own
    below: Tensor  # [24 24] 1 where the second joint is the first or below it

    @staticmethod
    @cache
    def on(device: torch.device) -> "Tree":
        places = [
            torch.tensor([PARENTS[joint] - before[0] for joint in level], device=device)
            for before, level in pairwise(LEVELS)
        ]
        below = torch.eye(len(PARENTS))
        for joint, parent in enumerate(PARENTS[1:], start=1):
            below[:, joint] += below[:, parent]
        return Tree(tuple(places), torch.tensor((0, *PARENTS[1:]), device=device), below.to(device))
