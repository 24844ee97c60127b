"""One motion told by many skeletons: other names, rest poses, axes, units, orders, and joints that a body has not.

All change what a file says without moving a joint in the world (but for the turn of a world whose up is another axis).
The names are those that the programs and data sets write, typed in here once more, from their files.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh
from renderers.skeleton import JOINT_NAMES

SIDED = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist", "hand")
# Trunk (pelvis, spine1, spine2, spine3, neck, head), limbs in the order above, and how a side is written.
NAMINGS: dict[str, tuple[str, str, Callable[[str, str], str]]] = {
    "Mixamo": (
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand HandMiddle1",
        lambda side, name: f"mixamorig:{side.title()}{name}",
    ),
    "Mixamo without prefix": (
        "Hips Spine Spine1 Spine2 Neck Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand HandMiddle1",
        lambda side, name: f"{side.title()}{name}",
    ),
    "another prefix": (
        "Actor_03:Hips Actor_03:Spine Actor_03:Spine1 Actor_03:Spine2 Actor_03:Neck Actor_03:Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand HandMiddle1",
        lambda side, name: f"Actor_03:{side.title()}{name}",
    ),
    "LAFAN1": (
        "Hips Spine Spine1 Spine2 Neck Head",
        "UpLeg Leg Foot Toe Shoulder Arm ForeArm Hand HandEnd",
        lambda side, name: f"{side.title()}{name}",
    ),
    "CMU (BVH)": (
        "Hips LowerBack Spine Spine1 Neck Head",
        "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand FingerBase",
        lambda side, name: f"{side.title()}{name}",
    ),
    "CMU (Acclaim)": (
        "root lowerback upperback thorax lowerneck head",
        "femur tibia foot toes clavicle humerus radius wrist hand",
        lambda side, name: f"{side[0]}{name}",
    ),
    "Xsens MVN": (
        "Hips Chest Chest2 Chest3 Neck Head",
        "Hip Knee Ankle Toe Collar Shoulder Elbow Wrist HandTip",
        lambda side, name: f"{side.title()}{name}",
    ),
    "3ds Max Biped": (
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Spine2 Bip01_Neck Bip01_Head",
        "Thigh Calf Foot Toe0 Clavicle UpperArm Forearm Hand Finger2",
        lambda side, name: f"Bip01_{side[0].upper()}_{name}",
    ),
    "Unreal": (
        "pelvis spine_01 spine_02 spine_03 neck_01 head",
        "thigh calf foot ball clavicle upperarm lowerarm hand middle_01",
        lambda side, name: f"{name}_{side[0]}",
    ),
    "Blender": (
        "spine spine.001 spine.002 spine.003 spine.004 spine.006",
        "thigh shin foot toe shoulder upper_arm forearm hand f_middle.01",
        lambda side, name: f"{name}.{side[0].upper()}",
    ),
    "SMPL": (
        "Pelvis Spine1 Spine2 Spine3 Neck Head",
        "Hip Knee Ankle Foot Collar Shoulder Elbow Wrist Hand",
        lambda side, name: f"{side[0].upper()}_{name}",
    ),
}


def smpl_names(naming: str) -> tuple[str, ...]:
    """The 24 joints in SMPL's order as a program calls them."""
    trunk, limbs, sided = NAMINGS[naming]
    names = dict(zip(("pelvis", "spine1", "spine2", "spine3", "neck", "head"), trunk.split(), strict=True))
    for joint, name in zip(SIDED, limbs.split(), strict=True):
        names |= {f"{side}_{joint}": sided(side, name) for side in ("left", "right")}
    return tuple(names[name] for name in JOINT_NAMES)


def renamed(bvh: Bvh, names: Sequence[str]) -> Bvh:
    return replace(bvh, names=tuple(names))


def numbered(bvh: Bvh) -> Bvh:
    """Names that say nothing."""
    return renamed(bvh, [f"b{(7 * joint) % len(bvh.names):03d}" for joint in range(len(bvh.names))])


def sides_exchanged(bvh: Bvh) -> Bvh:
    return renamed(bvh, [n.replace("left", "?").replace("right", "left").replace("?", "right") for n in bvh.names])


def refolded(bvh: Bvh, axes: Tensor) -> Bvh:
    """Each joint's frame turned by ``axes`` [J 3 3], bones and rotations told in the new ones."""
    parents = list(bvh.parents[1:])
    rotations, positions, offsets = bvh.rotations.clone(), bvh.positions.clone(), bvh.offsets.clone()
    rotations[:, 0] = rotations[:, 0] @ axes[0]
    rotations[:, 1:] = axes[parents].mT @ bvh.rotations[:, 1:] @ axes[1:]
    positions[:, 1:] = (axes[parents].mT @ bvh.positions[:, 1:, :, None])[..., 0]
    offsets[1:] = (axes[parents].mT @ bvh.offsets[1:, :, None])[..., 0]
    ends = tuple((joint, tuple((axes[joint].mT @ axes.new_tensor(end)).tolist())) for joint, end in bvh.ends)
    return replace(bvh, rotations=rotations, positions=positions, offsets=offsets, ends=ends)


def resting(bvh: Bvh, turns: dict[str, Tensor]) -> Bvh:
    """Another zero pose: that in which the named joints, and with them all below, are turned by [3 3] in the world."""
    world = []
    for name, parent in zip(bvh.names, bvh.parents, strict=True):
        above = world[parent] if parent >= 0 else torch.eye(3, dtype=torch.float64)
        world.append(turns.get(name, torch.eye(3, dtype=torch.float64)) @ above)
    return refolded(bvh, torch.stack(world).mT)


def along_x(bvh: Bvh, seed: int | None = None) -> Bvh:
    """Every joint's first bone lies along its local x; with a seed its other axes lie anyhow, else z ahead."""
    draw, axes = torch.Generator().manual_seed(seed or 0), []
    for joint in range(len(bvh.names)):
        bones = [bvh.offsets[child] for child, parent in enumerate(bvh.parents) if parent == joint]
        bones += [bvh.offsets.new_tensor(end) for owner, end in bvh.ends if owner == joint]
        x = normalize(bones[-1 if joint == 0 else 0], dim=0)
        other = x.new_tensor([0.0, 0.0, 1.0] if x[2].abs() < 0.8 else [0.0, 1.0, 0.0])
        other = other if seed is None else torch.randn(3, generator=draw, dtype=x.dtype)
        z = normalize(other - (other @ x) * x, dim=0)
        axes.append(torch.stack([x, torch.linalg.cross(z, x), z], dim=1))
    return refolded(bvh, torch.stack(axes))


def z_up(bvh: Bvh, rest: bool = True) -> Bvh:
    """The world with z up, facing -y where it faced z; without ``rest`` the zero pose stays as it was."""
    turn = torch.tensor([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)
    rotations, positions = bvh.rotations.clone(), bvh.positions.clone()
    rotations[:, 0], positions[:, 0] = turn @ rotations[:, 0], positions[:, 0] @ turn.mT
    turned = replace(bvh, rotations=rotations, positions=positions)
    return refolded(turned, turn.mT.repeat(len(bvh.names), 1, 1)) if rest else turned


def with_children(bvh: Bvh, joint: str, chain: Sequence[tuple[str, Tensor]]) -> Bvh:
    """A chain of joints that are not turned, hung from a joint: names and bones [3]."""
    parent = bvh.names.index(joint)
    for name, bone in chain:
        frames = len(bvh)
        bvh = replace(
            bvh,
            names=(*bvh.names, name),
            parents=(*bvh.parents, parent),
            offsets=torch.cat([bvh.offsets, bone[None]]),
            channels=(*bvh.channels, bvh.channels[-1]),
            ends=tuple(end for end in bvh.ends if end[0] != parent),
            rotations=torch.cat([bvh.rotations, torch.eye(3, dtype=torch.float64).repeat(frames, 1, 1, 1)], dim=1),
            positions=torch.cat([bvh.positions, bone.expand(frames, 1, 3)], dim=1),
        )
        parent = len(bvh.names) - 1
    return replace(bvh, ends=(*bvh.ends, (parent, tuple((0.5 * chain[-1][1]).tolist()))))


def with_twist(bvh: Bvh, end: str, name: str, angle: Tensor) -> Bvh:
    """A joint in the middle of the bone that ends in ``end``, which turns about the bone by [T] radians."""
    from renderers.rotations import axis_angle_to_matrix

    joint = bvh.names.index(end)
    half = bvh.offsets[joint] / 2
    turns = axis_angle_to_matrix(angle[:, None].double() * normalize(half, dim=0))
    rotations, positions, offsets = bvh.rotations.clone(), bvh.positions.clone(), bvh.offsets.clone()
    rotations[:, joint] = turns.mT @ rotations[:, joint]
    positions[:, joint], offsets[joint] = half, half

    def before(values, value):
        return (*values[:joint], value, *values[joint:])

    shifted = [parent + (parent >= joint) for parent in bvh.parents]
    shifted[joint] = joint
    return replace(
        bvh,
        names=before(bvh.names, name),
        parents=before(tuple(shifted), bvh.parents[joint]),
        offsets=torch.stack(before(list(offsets), half)),
        channels=before(bvh.channels, bvh.channels[joint]),
        ends=tuple((owner + (owner >= joint), end) for owner, end in bvh.ends),
        rotations=torch.stack(before(list(rotations.unbind(1)), turns), dim=1),
        positions=torch.stack(before(list(positions.unbind(1)), half.expand(len(bvh), 3)), dim=1),
    )


def with_fingers_and_more(bvh: Bvh) -> Bvh:
    """Hands of five fingers, a jaw and eyes, a skirt, twist joints beside upper arms."""
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for index, finger in enumerate(("Thumb", "Index", "Ring", "Pinky")):
            bone = torch.tensor([sign * 0.03, -0.005, 0.02 * (1.5 - index)], dtype=torch.float64)
            chain = [(f"{side}_{finger}{number}", bone) for number in (1, 2, 3)]
            bvh = with_children(bvh, bvh.names[_find(bvh, side, "wrist")], chain)
        shoulder = bvh.names[_find(bvh, side, "shoulder")]
        bvh = with_children(bvh, shoulder, [(f"{side}_twist", torch.tensor([sign * 0.1, 0.0, 0.0]).double())])
        head = bvh.names[JOINT_NAMES.index("head")]
        bvh = with_children(bvh, head, [(f"{side}_eye", torch.tensor([sign * 0.03, 0.06, 0.08]).double())])
    bvh = with_children(bvh, bvh.names[JOINT_NAMES.index("head")], [("jaw", torch.tensor([0.0, -0.02, 0.06]).double())])
    skirt = [(f"skirt{number}", torch.tensor([0.0, -0.15, -0.03]).double()) for number in range(4)]
    return with_children(bvh, bvh.names[0], skirt)


def _find(bvh: Bvh, side: str, joint: str) -> int:
    return JOINT_NAMES.index(f"{side}_{joint}")


def shuffled(bvh: Bvh, seed: int = 1) -> Bvh:
    """Siblings in another order."""
    draw, order, waiting = torch.Generator().manual_seed(seed), [], [0]
    while waiting:
        order.append(waiting.pop(int(torch.randint(len(waiting), (), generator=draw))))
        waiting += [child for child, parent in enumerate(bvh.parents) if parent == order[-1]]
    place = {joint: index for index, joint in enumerate(order)}
    return replace(
        bvh,
        names=tuple(bvh.names[joint] for joint in order),
        parents=tuple(place.get(bvh.parents[joint], -1) for joint in order),
        offsets=bvh.offsets[order],
        channels=tuple(bvh.channels[joint] for joint in order),
        ends=tuple((place[joint], end) for joint, end in bvh.ends),
        rotations=bvh.rotations[:, order],
        positions=bvh.positions[:, order],
    )


def told_otherwise(bvh: Bvh, axes: str, unit: str = "cm", all_positions: bool = False) -> Bvh:
    """Written with another order of rotations, another unit, positions for every joint."""
    turning = tuple(f"{axis.upper()}rotation" for axis in axes)
    moving = ("Xposition", "Yposition", "Zposition")
    channels = [(moving + turning) if joint == 0 or all_positions else turning for joint in range(len(bvh.names))]
    return replace(bvh, channels=tuple(channels), unit=unit)


def like_lafan1(bvh: Bvh) -> Bvh:
    """LAFAN1's names, order and frames: every bone along x; of the body's directions y is forward in trunk and legs and
    back in arms. Its zero pose is a heap."""
    left, up, ahead = torch.eye(3, dtype=torch.float64)
    axes = []
    for joint, name in enumerate(JOINT_NAMES):
        bones = [bvh.offsets[child] for child, parent in enumerate(bvh.parents) if parent == joint]
        limb = name.partition("_")[2] in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
        arm = name.partition("_")[2] in ("collar", "shoulder", "elbow", "wrist", "hand")
        leg = name.partition("_")[2] in ("hip", "knee", "ankle")
        x = normalize(bones[0], dim=0) if limb else up
        if arm and not limb:
            x = left if name.startswith("left") else -left
        if name.endswith("foot"):
            x = ahead
        y = (
            -ahead
            if arm
            else ahead
            if leg and "ankle" not in name
            else up
            if "ankle" in name or "foot" in name
            else ahead
        )
        y = normalize(y - (y @ x) * x, dim=0)
        axes.append(torch.stack([x, y, torch.linalg.cross(x, y)], dim=1))
    return told_otherwise(renamed(refolded(bvh, torch.stack(axes)), smpl_names("LAFAN1")), "zyx")


def still(names: list[str], parents: list[int], offsets: list[tuple[float, float, float]], frames: int) -> Bvh:
    """A skeleton that stands still in its zero pose."""
    bones = torch.tensor(offsets, dtype=torch.float64)
    return Bvh(
        names=tuple(names),
        parents=tuple(parents),
        offsets=bones,
        channels=(("Zrotation", "Xrotation", "Yrotation"),) * len(names),
        ends=(),
        rotations=torch.eye(3, dtype=torch.float64).repeat(frames, len(names), 1, 1),
        positions=bones.repeat(frames, 1, 1),
        fps=30.0,
        source="thing.bvh",
    )


def on_fours(hind: float = 0.3, fore: float = 0.3, trunk: float = 0.6, frames: int = 8, tail: bool = True) -> Bvh:
    """A dog that stands: a level trunk along z, four legs down, a head and a tail; lengths in metres."""
    names, parents, offsets = ["root"], [-1], [(0.0, 0.6, 0.0)]

    def chain(parent: str, *bones: tuple[str, tuple[float, float, float]]) -> None:
        for name, offset in bones:
            parents.append(names.index(parent))
            names.append(name)
            offsets.append(offset)
            parent = name

    chain("root", ("back", (0, 0.02, trunk / 2)), ("chest", (0, 0.0, trunk / 2)))
    chain("chest", ("neck", (0, 0.1, 0.1)), ("skull", (0, 0.1, 0.1)))
    for letter, side in (("L", 0.1), ("R", -0.1)):
        chain(
            "root", (f"ham{letter}", (side, 0, 0)), (f"hock{letter}", (0, -hind, 0.05)), (f"paw{letter}", (0, -hind, 0))
        )
        chain(f"paw{letter}", (f"claw{letter}", (0, 0, 0.06)))
        chain(
            "chest",
            (f"blade{letter}", (side, 0, 0)),
            (f"fore{letter}", (0, -fore, 0)),
            (f"wrist{letter}", (0, -fore, 0)),
        )
        chain(f"wrist{letter}", (f"digit{letter}", (0, 0, 0.06)))
    if tail:
        chain("root", ("tail1", (0, 0, -0.15)), ("tail2", (0, 0, -0.15)), ("tail3", (0, 0, -0.15)))
    return still(names, parents, offsets, frames)
