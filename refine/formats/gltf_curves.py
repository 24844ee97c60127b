"""The animations of a glTF file as curves: key frames in time, and what lies between them."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from refine.formats.gltf import REMEDY, Gltf, is_count, shown
from renderers.checks import UserError, check_known
from renderers.rotations import slerp_quaternions

PATHS = {"rotation": "VEC4", "translation": "VEC3", "scale": "VEC3"}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


@dataclass(frozen=True, eq=False)
class Curve:
    """A property of a node in time.

    Attributes:
        path: a key of ``PATHS``.
        times: [n] seconds, never falling.
        values: [n k], unit quaternions as (w, x, y, z); of a cubic spline [3 n k]: tangents before, values, tangents
            after.
        interpolation: one of ``INTERPOLATIONS``.
    """

    path: str
    times: np.ndarray
    values: Tensor
    interpolation: str

    @property
    def keys(self) -> int:
        """How many values it holds, tangents among them."""
        return self.values.shape[:-1].numel()

    def at(self, seconds: np.ndarray, close: float) -> Tensor:
        """The property [T k] at the given seconds; quaternions between the keys of a spline are of any length.

        It is held before the first key and after the last. A key not further off than ``close`` seconds is met exactly.
        """
        low = np.clip(np.searchsorted(self.times, seconds + close, side="right") - 1, 0, None)
        high = np.minimum(low + 1, len(self.times) - 1)
        span = torch.from_numpy(self.times[high] - self.times[low])
        past = torch.from_numpy(seconds - self.times[low])
        share = (past / span.where(span > 0, 1.0)).clamp(max=1.0)
        share = share.where((past > close) & (self.interpolation != "STEP"), 0.0)
        if self.interpolation == "CUBICSPLINE":
            return self._spline(low, high, share[:, None], span[:, None])
        between = slerp_quaternions if self.path == "rotation" else _lerp
        return between(self.values[low], self.values[high], share)

    def _spline(self, low: np.ndarray, high: np.ndarray, t: Tensor, span: Tensor) -> Tensor:
        """Hermite's cubic between two keys, ``t`` of the way (glTF 2.0, appendix C)."""
        into, key, out = self.values
        start = (2 * t**3 - 3 * t**2 + 1) * key[low] + (t**3 - 2 * t**2 + t) * span * out[low]
        return start + (3 * t**2 - 2 * t**3) * key[high] + (t**3 - t**2) * span * into[high]


def _lerp(start: Tensor, end: Tensor, share: Tensor) -> Tensor:
    return torch.lerp(start, end, share[:, None])


def read_curves(file: Gltf, number: int, nodes: Collection[int], limit: int) -> dict[tuple[int, str], Curve]:
    """The curves of one animation that move the given nodes, by node and path.

    Raises:
        UserError: it is damaged, not finite, or has more than ``limit`` keys.
    """
    where, animation = f"{file.path}, animation {number}", file.entries("animations")[number]
    samplers, times, curves, left = animation.get("samplers"), {}, {}, limit
    for node, path, sampler in _channels(where, animation, nodes):
        if (node, path) in curves:
            raise UserError(where, f"moves the {path} of node {node} twice", REMEDY)
        if not isinstance(samplers, list) or not is_count(sampler) or sampler >= len(samplers):
            raise UserError(where, f"refers to sampler {shown(sampler)}, which it has not", REMEDY)
        chosen = samplers[sampler] if isinstance(samplers[sampler], dict) else {}
        clock = chosen.get("input")
        if not is_count(clock) or clock not in times:
            seconds = file.numbers(clock, "SCALAR", left)[:, 0]
            if (np.diff(seconds) < 0).any():
                raise UserError(where, f"the key frames of sampler {sampler} go back in time", REMEDY)
            times[clock] = seconds
        curves[node, path] = _curve(file, f"{where}, sampler {sampler}", path, chosen, times[clock], left)
        left -= curves[node, path].keys
    return curves


def _channels(where: str, animation: Mapping[str, Any], nodes: Collection[int]) -> list[tuple[int, str, object]]:
    """(node, path, number of the sampler) of the channels that move the given nodes."""
    channels = animation.get("channels")
    if not isinstance(channels, list) or not all(isinstance(channel, dict) for channel in channels):
        raise UserError(where, "its channels are no list of objects", REMEDY)
    found = []
    for channel in channels:
        target = channel.get("target")
        node, path = (target.get("node"), target.get("path")) if isinstance(target, dict) else (None, None)
        if is_count(node) and node in nodes and isinstance(path, str) and path in PATHS:
            found.append((node, path, channel.get("sampler")))
    return found


def _curve(file: Gltf, where: str, path: str, sampler: Mapping[str, Any], times: np.ndarray, limit: int) -> Curve:
    interpolation = sampler.get("interpolation", "LINEAR")
    check_known(where, interpolation if isinstance(interpolation, str) else shown(interpolation), INTERPOLATIONS)
    keys = 3 * len(times) if interpolation == "CUBICSPLINE" else len(times)
    values = file.numbers(sampler.get("output"), PATHS[path], limit)
    if len(values) != keys:
        raise UserError(where, f"has {len(values)} values for {len(times)} key frames", REMEDY)
    if interpolation == "CUBICSPLINE":
        values = values.reshape(len(times), 3, -1).swapaxes(0, 1)
    if path == "rotation":
        lengths = np.linalg.norm(values[1] if interpolation == "CUBICSPLINE" else values, axis=-1)
        if lengths.min() < 0.1:
            raise UserError(where, f"key frame {lengths.argmin()} is no rotation: a quaternion near zero", REMEDY)
        values = np.roll(values, 1, axis=-1)  # glTF has x, y, z, w
        if interpolation != "CUBICSPLINE":
            values = values / lengths[:, None]
    return Curve(path, times, torch.from_numpy(np.ascontiguousarray(values)), interpolation)
