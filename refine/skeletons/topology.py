"""A body found in a tree of joints: its limbs by symmetry and pose, its trunk between them.

Two pairs of like chains make the limbs. Of the ways in which they can be legs and arms the one counts in which a pose
of the file stands: legs straight on from the trunk. Names are not looked at.
"""

from collections.abc import Iterator
from functools import cached_property
from itertools import combinations, permutations
from typing import NamedTuple

import torch
from torch import Tensor

from refine.formats.bvh import Bvh
from refine.skeletons.known import SIDES
from refine.skeletons.rest_pose import Poses, standing

# How much shorter one of a pair may be, as a share.
LIKE = 0.2
# The least length of a limb, as a share of the longest chain of the skeleton.
LONG = 0.3
# The least ratio of thigh to shank, or of upper arm to forearm, whichever is shorter.
BALANCED = 0.55
TURNS = 5.0  # degrees that a joint bends at least, unless it is a helper along a bone
LINKS = 16  # joints of a limb that are looked at
PAIRS = 8  # pairs that are looked at, and chains from one joint, the longest ones


class Tree:
    """The joints as a tree with the lengths of their chains, metres."""

    def __init__(self, bvh: Bvh):
        self.parents, self.names = bvh.parents, bvh.names
        self.children: list[list[int]] = [[] for _ in bvh.parents]
        for joint, parent in enumerate(bvh.parents[1:], start=1):
            self.children[parent].append(joint)
        bones = bvh.positions.mean(dim=0).norm(dim=-1).tolist()
        self.reach = [0.0] * len(bones)  # from a joint along the longest way to an end
        self.onward = [-1] * len(bones)  # the child on that way
        for joint, offset in bvh.ends:
            self.reach[joint] = max(self.reach[joint], torch.tensor(offset).norm().item())
        for joint in range(len(bones) - 1, 0, -1):  # children come after their parent
            parent = bvh.parents[joint]
            if self.onward[parent] < 0 or self.reach[joint] + bones[joint] > self.reach[parent]:
                self.reach[parent] = max(self.reach[parent], self.reach[joint] + bones[joint])
                self.onward[parent] = joint
        still = (bvh.rotations - bvh.rotations[:1]).abs().amax(dim=(0, 2, 3)) < 1e-4
        self.still = still.tolist()

    @cached_property
    def longest(self) -> float:
        return max((self.reach[child] for child in self.children[0]), default=0.0)

    def chain(self, joint: int) -> tuple[int, ...]:
        """The joint and those on the longest way to an end."""
        found = []
        while joint >= 0:
            found.append(joint)
            joint = self.onward[joint]
        return tuple(found)

    def ancestors(self, joint: int) -> list[int]:
        """The joint itself, its parent and so on to the root."""
        found = []
        while joint >= 0:
            found.append(joint)
            joint = self.parents[joint]
        return found

    def common(self, first: int, second: int) -> int:
        """The last joint that is above, or is, both."""
        above = set(self.ancestors(second))
        return next(joint for joint in self.ancestors(first) if joint in above)

    def holds(self, joint: int, others: set[int]) -> bool:
        """Whether one of ``others`` is below, or is, a joint."""
        return any(joint in self.ancestors(other) for other in others)


class Pair(NamedTuple):
    """Two like chains that hang from a joint: from the joint's child to the far end, left and right as they come."""

    attach: int
    chains: tuple[tuple[int, ...], tuple[int, ...]]
    length: float


def by_topology(bvh: Bvh, poses: Poses) -> tuple[dict[str, int], float]:
    """The twelve joints of the limbs, toes and collars where there are any, as SMPL joint -> index, and how straight
    the best pose stands, -1 if nothing can be told. Which side is left is not known yet.

    Args:
        poses: the zero pose and some of the motion.
    """
    tree = Tree(bvh)
    pairs = _pairs(tree)
    three = {chain: _three(poses, chain) for pair in pairs for chain in pair.chains}
    best: tuple[dict[str, int], float] = ({}, -1.0)
    for legs, arms in _ways(pairs):
        joints = _limbs(legs, arms, three)
        if joints and _reach(poses, joints, "hip", "knee", "ankle") > _reach(
            poses, joints, "shoulder", "elbow", "wrist"
        ):
            quality = standing(poses.points, joints).nan_to_num(-1.0).max().item()
            if quality > best[1] + 0.02:  # of two that stand alike the longer one counts
                best = joints, quality
    return best


def with_trunk(bvh: Bvh, joints: dict[str, int], helpers: frozenset[int] = frozenset()) -> dict[str, int]:
    """The joints with pelvis, spine, neck and head, as far as there are any, between what is known.

    Args:
        joints: at least hips and shoulders.
        helpers: joints that are no part of a trunk.
    """
    tree, joints = Tree(bvh), dict(joints)
    inner = [joints.get(f"{side}_collar", joints[f"{side}_shoulder"]) for side in SIDES]
    hips, chest = tree.common(joints["left_hip"], joints["right_hip"]), tree.common(*inner)
    if joints.get("pelvis") not in tree.ancestors(hips):
        joints["pelvis"] = hips
    trunk = tree.ancestors(chest)
    trunk = trunk[: trunk.index(tree.common(joints["pelvis"], chest))]
    spine = [joint for joint in reversed(trunk) if joint != joints["pelvis"] and joint not in helpers]
    if joints.get("neck") in spine:  # collars that hang from the neck
        spine = spine[: spine.index(joints["neck"])]
    return joints | _spread(spine) | _neck(tree, joints, chest, helpers)


def _spread(spine: list[int]) -> dict[str, int]:
    """A spine of any number of joints as three at most; of a single one the chest is the better known."""
    match spine:
        case []:
            return {}
        case [chest]:
            return {"spine3": chest}
        case [low, chest]:
            return {"spine1": low, "spine3": chest}
    return {"spine1": spine[0], "spine2": spine[len(spine) // 2], "spine3": spine[-1]}


def _neck(tree: Tree, joints: dict[str, int], chest: int, helpers: frozenset[int]) -> dict[str, int]:
    """Neck and head: the head that is known, or the end of the longest chain that goes on from the chest."""
    if "head" in joints:
        above = tree.ancestors(joints["head"])
        path = above[: above.index(tree.common(chest, joints["head"]))][::-1]
    else:
        limbs = {joints[f"{side}_{joint}"] for side in SIDES for joint in ("hip", "shoulder")}
        free = [child for child in tree.children[chest] if child not in helpers and not tree.holds(child, limbs)]
        path = list(tree.chain(max(free, key=lambda child: tree.reach[child]))) if free else []
        while len(path) > 1 and tree.still[path[-1]]:
            path.pop()
    path = [joint for joint in path if joint not in helpers]
    if not path:
        return {}
    neck = joints.get("neck", path[0] if len(path) > 1 else None)
    return {"head": joints.get("head", path[-1])} | ({} if neck is None else {"neck": neck})


def _pairs(tree: Tree) -> list[Pair]:
    """Pairs of like chains, the longest first."""
    found = []
    for attach, below in enumerate(tree.children):
        long = [child for child in below if tree.reach[child] >= LONG * tree.longest > 0]
        long = sorted(long, key=lambda child: -tree.reach[child])[:PAIRS]
        chains = [chain for chain in map(tree.chain, long) if len(chain) >= 3]
        for first, second in combinations(chains, 2):
            if tree.reach[second[0]] >= (1 - LIKE) * tree.reach[first[0]]:
                found.append(Pair(attach, (first, second), tree.reach[first[0]]))
    return sorted(found, key=lambda pair: -pair.length)[:PAIRS]


def _ways(pairs: list[Pair]) -> Iterator[tuple[Pair, Pair]]:
    """(legs, arms): two pairs, no joint of which is another's; which arm is on a leg's side is open."""
    for legs, arms in permutations(pairs, 2):
        members, others = ({joint for chain in pair.chains for joint in chain} for pair in (legs, arms))
        if not members & others and legs.attach not in others and arms.attach not in members:
            yield legs, arms
            yield legs, arms._replace(chains=arms.chains[::-1])


def _limbs(legs: Pair, arms: Pair, three: dict[tuple[int, ...], tuple[int, int, int] | None]) -> dict[str, int]:
    joints: dict[str, int] = {}
    for pair, names in ((legs, ("hip", "knee", "ankle")), (arms, ("shoulder", "elbow", "wrist"))):
        for side, chain in zip(SIDES, pair.chains, strict=True):
            found = three[chain]
            if found is None:
                return {}
            joints |= {f"{side}_{name}": joint for name, joint in zip(names, found, strict=True)}
            before, after = chain[: chain.index(found[0])], chain[chain.index(found[-1]) + 1 :]
            if names[0] == "hip" and after:
                joints[f"{side}_foot"] = after[0]
            if names[0] == "shoulder" and before:
                joints[f"{side}_collar"] = before[-1]
    alone = [name for name in ("foot", "collar") if sum(f"{side}_{name}" in joints for side in SIDES) == 1]
    return {name: joint for name, joint in joints.items() if name.partition("_")[2] not in alone}


def _reach(poses: Poses, joints: dict[str, int], *chain: str) -> float:
    """The length of a limb, both sides together."""
    points = [poses.points[0, joints[f"{side}_{name}"]] for side in SIDES for name in chain]
    return sum((points[end] - points[end - 1]).norm().item() for end in (1, 2, 4, 5))


def _three(poses: Poses, chain: tuple[int, ...]) -> tuple[int, int, int] | None:
    """The joints at the ends of the two long bones of a limb, which are nearly as long as each other; what lies between
    them never bends, as joints that twist a bone do not."""
    chain = chain[:LINKS]
    points = poses.points[:, list(chain)]
    apart = (points[:, :, None] - points[:, None]).norm(dim=-1).mean(dim=0).tolist()
    stiff = [_stiff(points[:, place - 1 : place + 2]) for place in range(1, len(chain) - 1)]
    best, score = None, 0.0
    for first, middle, last in combinations(range(len(chain)), 3):
        between = [*range(first + 1, middle), *range(middle + 1, last)]
        low, high = sorted((apart[first][middle], apart[middle][last]))
        if low >= BALANCED * high > 0 and low * low / high > score and all(stiff[place - 1] for place in between):
            best, score = (chain[first], chain[middle], chain[last]), low * low / high
    return best


def _stiff(points: Tensor) -> bool:
    """Whether the second of three joints [T 3 3] never turns its bone against the one before by more than a helper."""
    first, second = points[:, 1] - points[:, 0], points[:, 2] - points[:, 1]
    if first.norm(dim=-1).max() < 1e-6 or second.norm(dim=-1).max() < 1e-6:
        return True
    angle = torch.atan2(torch.linalg.cross(first, second).norm(dim=-1), (first * second).sum(-1))
    return torch.rad2deg(angle).max().item() <= TURNS
