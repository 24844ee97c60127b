"""The skeleton behind joint positions: a T-pose with the lengths that are seen."""

import torch
from torch import Tensor

from refine.positions.alignment import NOTHING, kabsch
from renderers.checks import UserError
from renderers.skeleton import JOINTS, PARENTS

HIPS = (JOINTS["left_hip"], JOINTS["right_hip"])
SPINE = tuple(JOINTS[f"spine{number}"] for number in (1, 2, 3))
NECK = JOINTS["neck"]
COLLARS = (JOINTS["left_collar"], JOINTS["right_collar"])
LEGS, ARMS = (
    tuple(tuple(JOINTS[f"{side}_{joint}"] for joint in limb) for side in ("left", "right"))
    for limb in (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist", "hand"))
)
# What no movement bends: joints that are rigid with another, and distances besides those along bones.
RIGID = {0: (*HIPS, SPINE[0]), SPINE[2]: (NECK, *COLLARS)}
ACROSS = (HIPS, (HIPS[0], SPINE[0]), (HIPS[1], SPINE[0]), COLLARS, (COLLARS[0], NECK), (COLLARS[1], NECK))

SAME = 0.01  # a skeleton whose lengths all differ by less, as a ratio, is taken for the body's own
MILLIMETRE = 1e-3
SHORTEST = 1e-6  # of its usual length; a bone of none at all would have no direction


def measured_skeleton(joints: Tensor, seen: list[bool], pose: Tensor, rest: Tensor, source: str) -> Tensor:
    """A T-pose [24 3] of the skeleton seen: ``rest`` itself if its lengths are the body's.

    Else bones point as in ``rest`` or as in ``pose``, whichever has more of its pelvis and chest, and are as long as
    they are seen; pelvis and chest have the shape that is seen. A joint that is not seen is scaled with the bone that
    it lies on, or with the whole where it ends one.
    """
    above = {joint: _seen_above(joint, seen) for joint in range(1, len(seen)) if seen[joint]}
    bones = [(parent, joint) for joint, parent in above.items()]
    across = [(a, b) for a, b in ACROSS if seen[a] and seen[b]]
    lengths = {(a, b): float((joints[:, b] - joints[:, a]).norm(dim=-1).median()) for a, b in (*bones, *across)}
    if min(sum(lengths[bone] for bone in (leg[:2], leg[1:3])) for leg in LEGS) < NOTHING:
        raise UserError(source, "a leg has no length", "give the joint positions of a body")

    def off(skeleton: Tensor, pair: tuple[int, int]) -> float:
        return abs(float((skeleton[pair[1]] - skeleton[pair[0]]).norm()) - lengths[pair])

    if all(off(rest, pair) < SAME * lengths[pair] + MILLIMETRE for pair in lengths):
        return rest
    stretched = [_stretched(skeleton, bones, above, lengths) for skeleton in (rest, pose)]
    model = min(stretched, key=lambda skeleton: sum(off(skeleton, pair) for pair in across))
    offsets = model - model[[0, *PARENTS[1:]]]
    for joint, ends in RIGID.items():
        if all(seen[end] for end in ends):
            there = joints[:, list(ends)] - joints[:, joint, None]
            turned = kabsch(offsets[list(ends)], there)
            offsets[list(ends)] = (there @ turned).median(dim=0).values
    return _joined(offsets)


def unsteadiness(joints: Tensor, seen: list[bool]) -> tuple[float, float]:
    """How much bones change their lengths, which those of a body never do: the standard deviation, as a ratio of the
    length and in units of the file, each of the median bone. Outliers do not count."""
    pairs = [(_seen_above(joint, seen), joint) for joint in range(1, len(seen)) if seen[joint]]
    lengths = torch.stack([(joints[:, b] - joints[:, a]).norm(dim=-1) for a, b in pairs]).sort(dim=1).values
    tenth = lengths.shape[1] // 10
    deviations = (lengths[:, -1 - tenth] - lengths[:, tenth]) / 2.56  # four fifths of a normal distribution
    middle = lengths[:, lengths.shape[1] // 2].clamp(min=NOTHING)
    return float((deviations / middle).median()), float(deviations.median())


def _stretched(
    pose: Tensor, bones: list[tuple[int, int]], above: dict[int, int], lengths: dict[tuple[int, int], float]
) -> Tensor:
    """A T-pose whose bones between joints that are seen have the given lengths."""
    size = sum(lengths[bone] for bone in bones) / sum(float((pose[b] - pose[a]).norm()) for a, b in bones)
    offsets = pose - pose[[0, *PARENTS[1:]]]
    for joint in range(1, len(pose)):
        end = next((below for below in _below(joint) if below in above), None)
        ratio = size if end is None else lengths[above[end], end] / float((pose[end] - pose[above[end]]).norm())
        offsets[joint] *= max(ratio, SHORTEST)
    return _joined(offsets)


def _joined(offsets: Tensor) -> Tensor:
    """Joints [24 3] from their offsets to their parents."""
    joints = offsets.clone()
    for joint in range(1, len(joints)):
        joints[joint] += joints[PARENTS[joint]]
    return joints


def _seen_above(joint: int, seen: list[bool]) -> int:
    parent = PARENTS[joint]
    return parent if seen[parent] else _seen_above(parent, seen)


def _below(joint: int) -> list[int]:
    """The joint, then all that it carries."""
    found = [joint]
    for other in range(joint + 1, len(PARENTS)):
        if PARENTS[other] in found:
            found.append(other)
    return found


def leg_length(skeleton: Tensor) -> float:
    return sum(float((skeleton[b] - skeleton[a]).norm()) for leg in LEGS for a, b in (leg[:2], leg[1:3]))
