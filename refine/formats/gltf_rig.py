"""The skeleton of a glTF file: its joints, what they hang on, and the pose in which they were bound to the mesh."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.gltf import REMEDY, Gltf
from refine.formats.gltf_curves import Curve
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, quaternion_to_matrix

MAX_NODES = 2048  # joints and what they hang on
FAR = 1e9
LAST_ROW = (0.0, 0.0, 0.0, 1.0)
DEFAULTS = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Rig:
    """The joints of the largest skin and all that they hang on; without a skin, all that is animated.

    Attributes:
        nodes: N numbers of nodes, a parent before its children.
        names: of the nodes, no two alike.
        parents: N places in ``nodes``, -1 for the root, which is the first.
        locals: [N 4 4] node to parent, as the file leaves them.
        sizes: [N 3] the scale in it.
        bind: [N 4 4] node to world in the bind pose.
    """

    nodes: tuple[int, ...]
    names: tuple[str, ...]
    parents: tuple[int, ...]
    locals: Tensor
    sizes: Tensor
    bind: Tensor


def read_rig(file: Gltf) -> Rig:
    """Find the skeleton.

    Raises:
        UserError: there is none, it is damaged, or has more than ``MAX_NODES`` nodes.
    """
    above = _parents(file)
    skin = max(file.entries("skins"), key=lambda skin: len(_list(skin.get("joints"))), default={})
    joints = _joints(file, skin)
    moving = joints or sorted(_animated(file))
    lines = [_line(joint, above) for joint in moving[: MAX_NODES + 1]]
    if not lines:
        raise UserError(file.path, "has no skeleton", "export the skin or the animated skeleton too")
    roots = [line[0] for line in lines]
    root = max(roots, key=roots.count)  # what hangs on another root does not belong to the figure
    nodes = list(dict.fromkeys(node for line in lines if line[0] == root for node in line))
    if len(nodes) > MAX_NODES:
        raise UserError(file.path, f"has a skeleton of more than {MAX_NODES} nodes", "export fewer joints")
    place = {node: index for index, node in enumerate(nodes)}
    parents = tuple(place[above[node]] if above[node] >= 0 else -1 for node in nodes)
    standing, sizes = map(torch.stack, zip(*(_local(file, node) for node in nodes), strict=True))
    bind = world = _compose(parents, standing[None])[0]
    if joints and "inverseBindMatrices" in skin:
        bind = _bind(file, skin, joints, place, world)
    return Rig(tuple(nodes), _names(file, nodes), parents, standing, sizes, bind)


def pose(rig: Rig, curves: Mapping[tuple[int, str], Curve], seconds: np.ndarray, close: float) -> Tensor:
    """Node to world [T N 4 4] at the given seconds; ``close`` as in :meth:`Curve.at`."""
    frames = len(seconds)
    moved = {key: curve.at(seconds, close) for key, curve in curves.items()}
    local = rig.locals.repeat(frames, 1, 1, 1)
    turning = [index for index, node in enumerate(rig.nodes) if (node, "rotation") in moved]
    if turning:
        turns = torch.stack([moved[rig.nodes[index], "rotation"] for index in turning], dim=1)
        local[:, turning, :3, :3] = quaternion_to_matrix(turns) * rig.sizes[turning][:, None, :]
    for index, node in enumerate(rig.nodes):
        if (node, "translation") in moved:
            local[:, index, :3, 3] = moved[node, "translation"]
        if (node, "scale") in moved:
            grown = moved[node, "scale"] / rig.sizes[index].where(rig.sizes[index] != 0, 1.0)
            local[:, index, :3, :3] *= grown[:, None, :]
    return _compose(rig.parents, local)


def _compose(parents: tuple[int, ...], local: Tensor) -> Tensor:
    """[T N 4 4] node to parent -> node to world."""
    world: list[Tensor] = []
    for index, parent in enumerate(parents):
        world.append(world[parent] @ local[:, index] if parent >= 0 else local[:, index])
    return torch.stack(world, dim=1)


def _parents(file: Gltf) -> list[int]:
    """For each node the number of its parent, -1 for none.

    Raises:
        UserError: a node has two parents, or is below itself.
    """
    nodes = file.entries("nodes")
    above = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in _list(node.get("children")):
            file.entry("nodes", child)
            if above[child] >= 0:
                raise UserError(file.path, f"node {child} hangs on both {above[child]} and {index}", REMEDY)
            above[child] = index
    below = [_list(node.get("children")) for node in nodes]
    reached = [index for index, parent in enumerate(above) if parent < 0]
    for index in reached:
        reached.extend(below[index])
    if len(reached) < len(nodes):
        lost = min(set(range(len(nodes))) - set(reached))
        raise UserError(file.path, f"node {lost} hangs on itself, by way of others", REMEDY)
    return above


def _joints(file: Gltf, skin: Mapping[str, Any]) -> list[int]:
    joints = _list(skin.get("joints"))
    for joint in joints:
        file.entry("nodes", joint)
    if len(set(joints)) < len(joints):
        raise UserError(file.path, "a skin lists a joint twice", REMEDY)
    return joints


def _animated(file: Gltf) -> set[int]:
    """Nodes that an animation moves."""
    found = set()
    for animation in file.entries("animations"):
        for channel in _list(animation.get("channels")):
            target = channel.get("target") if isinstance(channel, dict) else None
            if isinstance(target, dict) and target.get("path") in tuple(DEFAULTS) and "node" in target:
                file.entry("nodes", target["node"])
                found.add(target["node"])
    return found


def _line(node: int, above: list[int]) -> list[int]:
    """From the root down to the node; of a longer line than is read, the lower end."""
    line = [node]
    while above[line[-1]] >= 0 and len(line) <= MAX_NODES:
        line.append(above[line[-1]])
    return line[::-1]


def _names(file: Gltf, nodes: list[int]) -> tuple[str, ...]:
    taken: dict[str, None] = {}
    for node in nodes:
        name = file.entries("nodes")[node].get("name")
        name = name if isinstance(name, str) and name else f"node {node}"
        taken[name if name not in taken else f"{name} (node {node})"] = None
    return tuple(taken)


def _local(file: Gltf, number: int) -> tuple[Tensor, Tensor]:
    """[4 4] node to parent, as the file leaves it, and the scale [3] in it."""
    node, where = file.entries("nodes")[number], f"{file.path}, node {number}"
    if "matrix" in node:
        local = torch.tensor(_floats(where, node["matrix"], 16), dtype=torch.float64).reshape(4, 4).mT
        local[3] = torch.tensor(LAST_ROW)
        return local, local[:3, :3].norm(dim=0)
    parts = {key: _floats(where, node.get(key, value), len(value)) for key, value in DEFAULTS.items()}
    x, y, z, w = parts["rotation"]
    if max(map(abs, parts["rotation"])) < 0.1:
        raise UserError(where, "has no rotation: its quaternion is near zero", REMEDY)
    local = torch.eye(4, dtype=torch.float64)
    turn = quaternion_to_matrix(torch.tensor([w, x, y, z], dtype=torch.float64))
    size = torch.tensor(parts["scale"], dtype=torch.float64)
    local[:3, :3] = turn * size
    local[:3, 3] = torch.tensor(parts["translation"], dtype=torch.float64)
    return local, size


def _bind(file: Gltf, skin: Mapping[str, Any], joints: list[int], place: Mapping[int, int], world: Tensor) -> Tensor:
    """[N 4 4] the bind pose; ``world`` [N 4 4] is how the nodes stand.

    A skin tells its pose up to a transform of the whole figure. It is turned as little as puts it upright, and takes
    the size that the figure has; where it looks is left as the mesh has it.
    """
    stored = file.numbers(skin["inverseBindMatrices"], "MAT4", MAX_NODES)
    if len(stored) < len(joints):
        raise UserError(file.path, f"has {len(stored)} inverse bind matrices for {len(joints)} joints", REMEDY)
    kept = [index for index, joint in enumerate(joints) if joint in place]
    places = [place[joints[index]] for index in kept]
    inverse = torch.from_numpy(stored[kept]).reshape(-1, 4, 4).mT.contiguous()
    inverse[:, 3] = torch.tensor(LAST_ROW)
    bound, failed = torch.linalg.inv_ex(inverse)
    moved = world[places] @ inverse  # since it was bound; the same for all joints of a figure that stands so
    if failed.any() or not bound.isfinite().all() or not moved.isfinite().all():
        raise UserError(file.path, "has an inverse bind matrix that has no inverse", REMEDY)
    turned = normalize(moved[:, :3, :3], dim=1)
    up = _nearest_axis(turned.mean(dim=0)[1])
    whole = torch.eye(4, dtype=world.dtype)
    whole[:3, :3] = _onto_y(up) * moved[:, :3, :3].norm(dim=1).median()
    typical = torch.cdist(turned.flatten(1), turned.flatten(1)).sum(dim=1).argmin()
    bind = whole @ torch.linalg.inv_ex(moved[typical])[0] @ world  # what holds the joints goes with them
    bind[places] = whole @ bound
    return bind


def _nearest_axis(direction: Tensor) -> Tensor:
    """The one of x, y, z and their opposites that a direction [3] is nearest to."""
    axis = torch.zeros_like(direction)
    longest = direction.abs().argmax()
    axis[longest] = 1.0 if direction[longest] >= 0 else -1.0
    return axis


def _onto_y(axis: Tensor) -> Tensor:
    """[3 3] the smallest rotation that takes an axis [3] to y; from -y it goes about x."""
    x, y, z = axis.tolist()
    if y:
        return torch.diag(axis.new_tensor([1.0, y, y]))
    return axis_angle_to_matrix(torch.pi / 2 * axis.new_tensor([-z, 0.0, x])).round()


def _floats(where: str, values: object, count: int) -> list[float]:
    values = _list(values) if not isinstance(values, tuple) else list(values)
    fine = all(isinstance(value, int | float) and abs(value) < FAR for value in values)
    if len(values) != count or not fine:
        raise UserError(where, f"has a place that is not given in {count} numbers below {FAR:g}", REMEDY)
    return [float(value) for value in values]


def _list(value: object) -> list:
    return value if isinstance(value, list) else []
