"""BVH: any hierarchy, any channel order, any unit of length, in and out.

A joint's rotation is the product of its elementary rotations in the order its channels are listed, and position
channels take the place of its OFFSET (protocol A.8). On disk angles are degrees and lengths have an unknown
unit; inside they are matrices and metres.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from refine.formats.bvh_parsing import CHANNEL_NAMES, Tree, parse_bvh
from refine.formats.untrusted import MAX_MOTION_TEXT, START, kind_of_start, opened
from refine.motion import Motion
from renderers.checks import UserError, check_shapes
from renderers.outputs import replacing
from renderers.rotations import euler_to_matrix, matrix_to_euler
from renderers.skeleton import JOINT_NAMES, PARENTS

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
# An adult's longest chain of bones, from where the limbs branch off to the toes or the fingertips, in metres.
TYPICAL_REACH = 1.0


@dataclass(frozen=True, eq=False)
class Bvh:
    """One BVH file.

    Attributes:
        names: J joint names, a parent before its children.
        parents: J indices, -1 for the root.
        offsets: [J 3] OFFSETs in metres.
        channels: J tuples of channel names, each in the order of the file.
        ends: End Sites as (joint index, offset in metres).
        rotations: [T J 3 3] local rotations.
        positions: [T J 3] local positions in metres: the position channels, the OFFSET where there are none.
        fps: frames per second.
        unit: the unit of length on disk, a key of ``UNITS``.
        source: the file, for messages.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Tensor
    channels: tuple[tuple[str, ...], ...]
    ends: tuple[tuple[int, tuple[float, float, float]], ...]
    rotations: Tensor
    positions: Tensor
    fps: float
    unit: str = "cm"
    source: str = "bvh"

    def __len__(self) -> int:
        return self.rotations.shape[0]


def world(bvh: Bvh) -> tuple[Tensor, Tensor]:
    """World joints [T J 3] in metres and world rotations [T J 3 3]."""
    joints, rotations = [], []
    for joint, parent in enumerate(bvh.parents):
        position, rotation = bvh.positions[:, joint], bvh.rotations[:, joint]
        if parent >= 0:
            position = joints[parent] + (rotations[parent] @ position[..., None])[..., 0]
            rotation = rotations[parent] @ rotation
        joints.append(position)
        rotations.append(rotation)
    return torch.stack(joints, dim=1), torch.stack(rotations, dim=1)


def read_bvh(path: str | Path, unit: str | None = None) -> Bvh:
    """Read a BVH file.

    Args:
        unit: a key of ``UNITS``; without it the unit that makes the skeleton most nearly of human size.

    Raises:
        UserError: the file is missing, empty, cut short, not BVH, holds values that are not finite, or claims more
            than the limits of `bvh_parsing`; the message names the line.
    """
    with opened(path, MAX_MOTION_TEXT) as stream:
        if kind_of_start(stream.peek(START)[:START]) != "bvh":
            raise UserError(path, "is not a BVH file: it does not begin with HIERARCHY", "give a BVH file")
        tree, seconds, read = parse_bvh(path, stream)
    values = torch.from_numpy(read)
    offsets = torch.tensor(tree.offsets, dtype=torch.float64)
    unit = unit or _guess_unit(tree)
    rotations, positions = _local(values, tree, offsets)
    return Bvh(
        names=tuple(tree.names),
        parents=tuple(tree.parents),
        offsets=offsets * UNITS[unit],
        channels=tuple(tree.channels),
        ends=tuple((joint, tuple(x * UNITS[unit] for x in offset)) for joint, offset in tree.ends),
        rotations=rotations,
        positions=positions * UNITS[unit],
        fps=_rate(seconds),
        unit=unit,
        source=str(path),
    )


def write_bvh(path: str | Path, motion: Motion, rest_joints: Tensor) -> None:
    """Write a motion on a skeleton with T-pose joints [24 3] in metres: smplx's joint names, centimetres."""
    with replacing(path) as partial:
        partial.write_text(bvh_text(motion_to_bvh(motion, rest_joints)))


def motion_to_bvh(motion: Motion, rest_joints: Tensor) -> Bvh:
    """The motion on a skeleton with T-pose joints [24 3] in metres, leaves prolonged by an End Site."""
    check_shapes("motion_to_bvh", rest_joints=(rest_joints, "24 3"))
    rest = rest_joints.detach().to("cpu", torch.float64)
    offsets = torch.stack([rest[joint] - rest[max(parent, 0)] for joint, parent in enumerate(PARENTS)])
    positions = offsets.repeat(len(motion), 1, 1)
    positions[:, 0] = motion.root.detach().to(positions)
    turning = ("Zrotation", "Xrotation", "Yrotation")
    return Bvh(
        names=JOINT_NAMES,
        parents=PARENTS,
        offsets=offsets,
        channels=(CHANNEL_NAMES[:3] + turning,) + (turning,) * (len(JOINT_NAMES) - 1),
        ends=tuple(
            (joint, tuple((offsets[joint] / 2).tolist())) for joint in range(len(PARENTS)) if joint not in PARENTS
        ),
        rotations=motion.rotations.detach().to(positions),
        positions=positions,
        fps=motion.fps,
        source=motion.source,
    )


def bvh_text(bvh: Bvh) -> str:
    """The file's text; joints come depth first, as the format wants them.

    Six decimals of a centimetre and of a degree keep a chain of ten bones within a micrometre.
    """
    scale = 1 / UNITS[bvh.unit]
    header, order = ["HIERARCHY"], []

    def describe(joint: int, depth: int) -> None:
        pad = "  " * depth
        order.append(joint)
        header.extend([f"{pad}{'JOINT' if depth else 'ROOT'} {bvh.names[joint]}", pad + "{"])
        header.append(f"{pad}  OFFSET {_numbers(bvh.offsets[joint] * scale)}")
        header.append(f"{pad}  CHANNELS {' '.join((str(len(bvh.channels[joint])), *bvh.channels[joint]))}")
        for child, parent in enumerate(bvh.parents):
            if parent == joint:
                describe(child, depth + 1)
        for owner, offset in bvh.ends:
            if owner == joint:
                end = _numbers(torch.tensor(offset) * scale)
                header.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET {end}", f"{pad}  }}"])
        header.append(pad + "}")

    describe(0, 0)
    values = torch.cat([_channel_values(bvh, joint, scale) for joint in order], dim=1)
    header += ["MOTION", f"Frames: {len(bvh)}", f"Frame Time: {1 / bvh.fps:.9f}"]
    return "\n".join([*header, *map(_numbers, values)]) + "\n"


def _numbers(values: Tensor) -> str:
    return " ".join(f"{value:.6f}" for value in values.tolist())


def _channel_values(bvh: Bvh, joint: int, scale: float) -> Tensor:
    """[T channels of the joint] in the file's unit and degrees."""
    axes = _rotation_axes(bvh.channels[joint])
    angles = torch.rad2deg(matrix_to_euler(bvh.rotations[:, joint], axes)) if axes else bvh.rotations.new_empty(0, 0)
    columns = []
    for name in bvh.channels[joint]:
        axis = name[0].lower()
        position = name.endswith("position")
        columns.append(bvh.positions[:, joint, "xyz".index(axis)] * scale if position else angles[:, axes.index(axis)])
    return torch.stack(columns, dim=1) if columns else bvh.positions.new_empty(len(bvh), 0)


def _rotation_axes(channels: tuple[str, ...]) -> str:
    return "".join(name[0].lower() for name in channels if name.endswith("rotation"))


def _rate(seconds: float) -> float:
    """Frames per second; a Frame Time cut to a few digits, such as 0.0333333, means a whole number."""
    rate = 1 / seconds
    return float(round(rate)) if abs(rate - round(rate)) < 2e-4 * rate else round(rate, 3)


def _guess_unit(tree: Tree) -> str:
    """The unit in which the skeleton's longest chain is nearest to a person's.

    The root may hang on a long offset from the origin, so chains are measured from the first joint that branches.
    """
    children = [tree.parents.count(joint) for joint in range(len(tree.names))]
    trunk = next((joint for joint, count in enumerate(children) if count > 1), 0)
    reach = {trunk: 0.0}
    for joint, parent in enumerate(tree.parents):
        if parent in reach:
            reach[joint] = reach[parent] + math.hypot(*tree.offsets[joint])
    longest = max([*reach.values(), *(reach.get(joint, 0.0) + math.hypot(*offset) for joint, offset in tree.ends)])
    if longest < 1e-9:
        return "m"
    return min(UNITS, key=lambda unit: abs(math.log(longest * UNITS[unit] / TYPICAL_REACH)))


def _local(values: Tensor, tree: Tree, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Local rotations [T J 3 3] and positions [T J 3] in the file's unit; joints with equal channels go together."""
    frames, joints = values.shape[0], len(tree.names)
    rotations = torch.eye(3, dtype=values.dtype).repeat(frames, joints, 1, 1)
    positions = offsets.repeat(frames, 1, 1)
    column = {key: index for index, key in enumerate(tree.columns)}
    for channels in set(tree.channels):
        members = [joint for joint, names in enumerate(tree.channels) if names == channels]
        turning = [name for name in channels if name.endswith("rotation")]
        if turning:
            angles = values[:, [[column[joint, name] for name in turning] for joint in members]]
            rotations[:, members] = euler_to_matrix(torch.deg2rad(angles), _rotation_axes(channels))
        for name in set(channels) - set(turning):
            positions[:, members, "XYZ".index(name[0])] = values[:, [column[joint, name] for joint in members]]
    return rotations, positions
