"""Motions out of glTF 2.0 files, binary or text: any skeleton that is animated, with a skin or without.

The rest pose is the bind pose, in which the mesh was bound to the skeleton; it need not be the pose in which the nodes
stand. A joint's rotation is taken relative to it, in the axes of the world: with W the joint's transform in the world
and B the same in the bind pose, it is the rotation of W B^-1, whatever axes and scales the file gives its joints. So a
take becomes the same value as a BVH file whose zero pose is the bind pose.

Key frames lie anywhere in time. They are sampled at the frame rate of the file, which is ``extras.fps`` of the
animation if that is there, else that of its densest curve.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from refine.formats.bvh import CHANNEL_NAMES, Bvh
from refine.formats.gltf import REMEDY, Gltf, read_gltf, shown
from refine.formats.gltf_curves import Curve, read_curves
from refine.formats.gltf_rig import Rig, pose, read_rig
from refine.motion import Motion
from refine.skeletons.retarget import retarget
from renderers.checks import UserError, check_finite
from renderers.rotations import matrix_from_6d, matrix_to_6d

MAX_TAKES = 1000
MAX_JOINT_FRAMES = 2_000_000  # in all takes of a file
MAX_KEYS, MAX_FILE_KEYS = 2_000_000, 8_000_000  # of a take, of a file
GLANCE = 32  # frames that tell whether a skeleton is a body
AT_ONCE = 256  # frames that are posed together
SPARSE, USUAL = 5.0, 30.0  # keys rarer than the one, per second, were set by hand, and are sampled at the other
CLOSE = 0.01  # of a frame: as far as seconds in 32 bits may be off
FLAT = 1e-3  # least volume of a turned unit cube, whatever its size
MAX_BETAS = 400
GENDERS = ("neutral", "female", "male")
# What programs call a take that nobody named.
UNNAMED = ("", "animation", "motion", "take 001", "mixamo.com", "armature|mixamo.com|layer0", "armatureaction")


@dataclass(frozen=True, eq=False)
class Take:
    """One animation of a file: the skeleton in motion, and what the file says about the action and the performer."""

    bvh: Bvh
    label: str = ""
    gender: str = "neutral"
    betas: Tensor | None = None


def read_glb(
    path: str | Path, rest_joints: Tensor, fps: float | None = None, onto: Callable[[Bvh], Motion] | None = None
) -> list[Motion]:
    """Read every animation of a ``.glb`` or ``.gltf`` file onto a body with T-pose joints [24 3] in metres.

    Args:
        fps: the frame rate to sample at, for files that do not say theirs.
        onto: how the file's skeleton is put on the body; `retarget` without it.

    Raises:
        UserError: see :func:`read_takes`, or the skeleton is no body.
    """
    file = read_gltf(path)
    rig = read_rig(file)
    onto = onto or (lambda bvh: retarget(bvh, rest_joints))
    onto(next(_takes(file, rig, fps, GLANCE)).bvh)  # refuses a strange skeleton before all its frames are read
    return [
        replace(onto(take.bvh), label=take.label, gender=take.gender, betas=take.betas)
        for take in _takes(file, rig, fps)
    ]


def read_takes(path: str | Path, fps: float | None = None) -> list[Take]:
    """Read every animation of a ``.glb`` or ``.gltf`` file, on the file's own skeleton.

    Args:
        fps: the frame rate to sample at, for files that do not say theirs.

    Raises:
        UserError: the file is missing, damaged, has no skeleton or no animation of it, holds values that are not
            finite, or claims more than the limits of this package.
    """
    file = read_gltf(path)
    return list(_takes(file, read_rig(file), fps))


def _takes(file: Gltf, rig: Rig, fps: float | None, frames: int | None = None) -> Iterator[Take]:
    """The animations that move the skeleton, each when it is asked for; of each all frames, or about so many."""
    left, keys, animations = MAX_JOINT_FRAMES // len(rig.nodes), MAX_FILE_KEYS, file.entries("animations")
    nodes, found = set(rig.nodes), False
    if len(animations) > MAX_TAKES:
        raise UserError(file.path, f"has {len(animations)} animations, up to {MAX_TAKES} are read", "split it")
    for number, animation in enumerate(animations):
        curves = read_curves(file, number, nodes, min(keys, MAX_KEYS))
        keys -= sum(curve.keys for curve in curves.values())
        if not curves:
            continue
        found, where = True, f"{file.path}, animation {number}"
        extras = animation.get("extras")
        extras = extras if isinstance(extras, dict) else {}
        rate = _rate(where, curves, extras.get("fps", fps))
        seconds = _seconds(where, curves, rate, left)
        left -= len(seconds)
        if frames is not None:
            seconds = seconds[:: -(-len(seconds) // frames)]
        bvh = _bvh(file, rig, curves, seconds, rate)
        yield Take(bvh, _label(animation, extras), *_performer(extras))
    if not found:
        raise UserError(file.path, "no animation moves its skeleton", "export the animation too")


def _rate(where: str, curves: Mapping[Any, Curve], said: object) -> float:
    """Frames a second: what is ``said``, else what the curve with the most keys has."""
    if said is not None:
        if isinstance(said, bool) or not isinstance(said, int | float) or not 0 < said < 10_000:
            raise UserError(where, f"its frame rate {shown(said)} is no number of frames per second", REMEDY)
        return float(said)
    times = max((curve.times for curve in curves.values()), key=len)
    steps = np.diff(times)
    steps = steps[steps > 0]
    step = np.median(steps) if len(steps) else math.inf
    if not SPARSE <= 1 / step < 10_000:
        return USUAL
    span = steps.sum()  # over all of which 32 bits tell a step better than from key to key
    rate = (len(steps) if steps.max() < 1.5 * step else round(span / step)) / span
    return float(round(rate)) if abs(rate - round(rate)) < 2e-4 * rate else float(rate)


def _seconds(where: str, curves: Mapping[Any, Curve], rate: float, limit: int) -> np.ndarray:
    """[T] when the frames are, from the first key of all curves to not past the last."""
    start, end = (pick(curve.times[at] for curve in curves.values()) for pick, at in ((min, 0), (max, -1)))
    frames = math.floor((end - start) * rate + CLOSE) + 1
    if frames > limit:
        raise UserError(where, f"has {frames} frames, more than the {limit} that are left to read", "split it")
    return start + np.arange(frames) / rate


def _bvh(file: Gltf, rig: Rig, curves: Mapping[tuple[int, str], Curve], seconds: np.ndarray, rate: float) -> Bvh:
    """The skeleton at the given seconds, relative to its bind pose."""
    unbind = torch.linalg.inv_ex(rig.bind)[0]
    rotations, positions = [], []
    for start in range(0, len(seconds), AT_ONCE):
        world = pose(rig, curves, seconds[start : start + AT_ONCE], CLOSE / rate)
        check_finite(file.path, world, "frame joint row column", {"joint": rig.names})
        turns = _rotations(file, rig, world @ unbind)
        rotations.append(turns)
        positions.append(world[:, :, :3, 3])
    turned, placed = torch.cat(rotations), torch.cat(positions)
    above = list(rig.parents[1:])
    local, offsets = turned.clone(), placed.clone()
    local[:, 1:] = turned[:, above].mT @ turned[:, 1:]
    offsets[:, 1:] = (turned[:, above].mT @ (placed[:, 1:] - placed[:, above])[..., None])[..., 0]
    bound = rig.bind[:, :3, 3]
    return Bvh(
        names=rig.names,
        parents=rig.parents,
        offsets=torch.cat([bound[:1], bound[1:] - bound[above]]),
        channels=(CHANNEL_NAMES,) * len(rig.names),
        ends=(),
        rotations=local,
        positions=offsets,
        fps=rate,
        unit="m",
        source=str(file.path),
    )


def _rotations(file: Gltf, rig: Rig, transforms: Tensor) -> Tensor:
    """[T N 3 3] the rotations of transforms [T N 4 4] that may also scale.

    Raises:
        UserError: one flattens or mirrors.
    """
    linear = transforms[..., :3, :3]
    volume = torch.linalg.det(linear) / linear.norm(dim=-1).prod(dim=-1)
    flat = ~(volume > FLAT)
    if flat.any():
        frame, joint = flat.nonzero()[0].tolist()
        problem = f"joint {shown(rig.names[joint])} is flattened or mirrored in frame {frame}"
        raise UserError(file.path, problem, "export it without scaling its joints")
    return matrix_from_6d(matrix_to_6d(linear))


def _label(animation: Mapping[str, Any], extras: Mapping[str, Any]) -> str:
    label, name = extras.get("label"), animation.get("name")
    if isinstance(label, str):
        return label
    return name if isinstance(name, str) and name.strip().lower() not in UNNAMED else ""


def _performer(extras: Mapping[str, Any]) -> tuple[str, Tensor | None]:
    """Gender and shape, as far as a file says something sensible."""
    gender, betas = extras.get("gender"), extras.get("betas")
    betas = betas if isinstance(betas, list) and 0 < len(betas) <= MAX_BETAS else [None]
    known = all(isinstance(beta, int | float) and abs(beta) < 1e3 for beta in betas)
    return gender if gender in GENDERS else "neutral", torch.tensor(betas).float() if known else None
