"""Which joint of a file is which of ours: found by names or by shape, told to the user, and edited by them as JSON."""

import json
from collections.abc import Mapping as Table
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import UNITS, Bvh
from refine.formats.untrusted import read_json
from refine.skeletons.finding_joints import check_human, find_joints
from refine.skeletons.joint_axes import places
from refine.skeletons.joint_names import NEEDED
from refine.skeletons.known import LIMBS, SIDES, SKELETONS, Skeleton
from refine.skeletons.rest_pose import (
    AXES,
    STANDS,
    TO_Y_UP,
    Poses,
    axis_of,
    body_up,
    moving,
    standing,
    up_axis,
    zero_pose,
)
from renderers.checks import UserError, check_known
from renderers.skeleton import JOINT_NAMES

MAX_BYTES = 1 << 20
FRAMES = 2000  # frames that are looked at
VERSION = 1
ZERO_POSE, STRAIGHTEST = "zero pose", "straightest frames"
REQUIRED = ("pelvis", *(f"{side}_{joint}" for joint in NEEDED for side in SIDES))
SPINE = ("pelvis", "spine1", "spine2", "spine3")


@dataclass(frozen=True)
class Mapping:
    """Where a file's skeleton has our joints.

    Attributes:
        skeleton: whose joint names these are, for the reader.
        joints: SMPL joint -> the file's joint. Those of ``REQUIRED`` are there; others turn with their neighbours.
        up: the axis of the file's world that points up in the motion, a key of ``rest_pose.AXES``.
        rest: ``ZERO_POSE``, ``STRAIGHTEST``, or the number of a frame: when the body stands as in a T- or A-pose.
        unit: the file's unit of length.
        confidence: how well a body is recognised, from 0 to 1.
        ignored: joints of the file that are not followed.
        notes: what the user should know.
        source: the file, for messages.
    """

    skeleton: str
    joints: Table[str, str]
    up: str = "y"
    rest: str | int = ZERO_POSE
    unit: str = "cm"
    confidence: float = 1.0
    ignored: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    source: str = "mapping"

    def report(self) -> list[str]:
        """What is mapped to what, in lines for a person."""
        rest = f"frame {self.rest}" if isinstance(self.rest, int) else f"the {self.rest}"
        lines = [
            f"skeleton: {self.skeleton}, {len(self.joints)} joints followed, {len(self.ignored)} ignored, "
            f"confidence {self.confidence:.2f}",
            f"up: {self.up}; unit: {self.unit}; rest pose: {rest}",
            *(f"note: {note}" for note in self.notes),
        ]
        lines += [f"{name} <- {self.joints[name]}" for name in JOINT_NAMES if name in self.joints]
        if missing := [name for name in JOINT_NAMES if name not in self.joints]:
            lines.append(f"not in the file, turned with their neighbours: {', '.join(missing)}")
        if self.ignored:
            lines.append(f"ignored: {', '.join(self.ignored)}")
        return lines

    def to_json(self) -> str:
        """The mapping as text to edit; :func:`parse_mapping` reads it."""
        joints = {name: self.joints[name] for name in JOINT_NAMES if name in self.joints}
        values = {
            "refine_mapping": VERSION,
            "skeleton": self.skeleton,
            "up": self.up,
            "rest": self.rest,
            "unit": self.unit,
            "joints": joints,
            "confidence": round(self.confidence, 3),
            "ignored": list(self.ignored),
            "notes": list(self.notes),
        }
        return json.dumps(values, indent=2, ensure_ascii=False) + "\n"


def read_mapping(path: str | Path) -> Mapping:
    """Read a mapping from a JSON file of at most ``MAX_BYTES``.

    Raises:
        UserError: the file is missing or no such mapping, or lacks a joint; the message says what is wrong with it.
    """
    return parse_mapping(read_json(path, MAX_BYTES), str(path))


def parse_mapping(values: Any, source: str = "mapping") -> Mapping:
    """The mapping that JSON values say; ``confidence``, ``ignored`` and ``notes`` are for people and not read.

    Raises:
        UserError: they are no mapping; the message says where.
    """
    if not isinstance(values, dict) or values.get("refine_mapping") != VERSION:
        raise UserError(source, f"is no mapping: 'refine_mapping' is not {VERSION}", "write one with --mapping")
    known = ("refine_mapping", "skeleton", "up", "rest", "unit", "joints", "confidence", "ignored", "notes")
    for key in values:
        check_known(source, key, known)
    joints, rest = values.get("joints"), values.get("rest", ZERO_POSE)
    if not isinstance(joints, dict) or not all(isinstance(joint, str) for joint in joints.values()):
        raise UserError(source, "'joints' is no table of joint names", 'expected {"pelvis": "Hips", ...}')
    for name in joints:
        check_known(f"{source}, joints", name, JOINT_NAMES)
    if missing := [name for name in REQUIRED if name not in joints]:
        raise UserError(source, f"'joints' lacks {', '.join(missing[:4])}", "a body needs them")
    of_joint: dict[str, str] = {}
    for name, joint in joints.items():
        if (first := of_joint.setdefault(joint, name)) != name:
            raise UserError(source, f"'joints' has {joint[:60]!r} for {first} and for {name}", "leave one of them out")
    for key, allowed in (("up", tuple(AXES)), ("unit", tuple(UNITS))):
        if values.get(key, allowed[0]) not in allowed:
            raise UserError(source, f"'{key}' is {values[key]!r}", f"known are {', '.join(allowed)}")
    if rest not in (ZERO_POSE, STRAIGHTEST) and not (type(rest) is int and 0 <= rest < 1 << 31):
        raise UserError(source, f"'rest' is {rest!r}", f'known are "{ZERO_POSE}", "{STRAIGHTEST}" and a frame number')
    return Mapping(
        skeleton=str(values.get("skeleton", "yours"))[:99],
        joints=joints,
        up=values.get("up", "y"),
        rest=rest,
        unit=values.get("unit", "cm"),
        source=source,
    )


def mapping_of(bvh: Bvh) -> Mapping:
    """Find our joints in a file: by known names, else by the shape of the tree and how it stands.

    Raises:
        UserError: it is no body, or none that can be made out; the message says why.
    """
    rest = zero_pose(bvh)
    if known := recognise(bvh):
        joints = _indices(bvh, known.joints)
        up = up_axis(moving(thinned(bvh, 32)), joints, _told(rest, joints))
        return _described(bvh, known.name, joints, up, ZERO_POSE, 1.0, _notes(up))
    motion = moving(thinned(bvh))
    joints, skeleton, confidence, notes = find_joints(bvh, rest, motion)
    stands, told = standing(rest.points, joints)[0].item(), _told(rest, joints)
    up = up_axis(motion, joints, told)
    check_human(bvh, joints, motion, up, stands)
    notes = [*notes, *_notes(up)]
    if told is None:
        notes.append("its zero pose is no pose of a body: joints' axes are told by the straightest frames")
    return _described(bvh, skeleton, joints, up, STRAIGHTEST if told is None else ZERO_POSE, confidence, notes)


def skeleton_of(bvh: Bvh, mapping: Mapping, ours: Tensor) -> Skeleton:
    """The frames of a file's joints against those of a body with T-pose joints ``ours`` [24 3].

    Raises:
        UserError: the mapping names joints or frames that the file has not.
    """
    for joint in mapping.joints.values():
        if joint not in bvh.names:
            check_known(f"{mapping.source}, joints", joint, bvh.names)
    known = recognise(bvh)
    if known and dict(mapping.joints) == known.joints and mapping.rest == ZERO_POSE:
        return replace(known, up=mapping.up)
    joints = _indices(bvh, mapping.joints)
    poses, up = moving(thinned(bvh)), mapping.up
    if mapping.rest == ZERO_POSE:
        poses = zero_pose(bvh)
        up = axis_of(body_up(poses.points, joints)[0])
    elif isinstance(mapping.rest, int):
        if mapping.rest >= len(bvh):
            raise UserError(bvh.source, f"has no frame {mapping.rest}, which {mapping.source} takes for the rest pose")
        poses = moving(_frames(bvh, torch.tensor([mapping.rest])))
    found = places(bvh, joints, poses, up, mapping.rest != STRAIGHTEST, ours)
    return Skeleton(mapping.skeleton, found, _between(found), mapping.skeleton != "SMPL", mapping.up)


def _told(rest: Poses, joints: dict[str, int]) -> str | None:
    """The axis along which a zero pose stands, if it does."""
    stands = standing(rest.points, joints)[0] > STANDS
    return axis_of(body_up(rest.points, joints)[0]) if stands else None


def recognise(bvh: Bvh) -> Skeleton | None:
    """The skeleton that is known to the frame of each joint and whose joints the file has, if there is one.

    Programs in which another axis is up write it with all its frames turned, which is seen and turned as well.
    """
    names = set(bvh.names)
    for known in SKELETONS:
        if set(known.joints.values()) <= names:
            for frames in (known, *(_turned(known, up) for up in TO_Y_UP if up != "y")):
                if _fits(bvh, frames):
                    return frames
    return None


def _turned(known: Skeleton, up: str) -> Skeleton:
    """A skeleton as it is where that axis is up and not y."""
    back = torch.tensor(TO_Y_UP[up], dtype=torch.float64).mT

    def turned(vector: tuple[float, float, float]) -> tuple[float, ...]:
        return tuple((back @ torch.tensor(vector, dtype=back.dtype)).tolist())

    places = {
        name: replace(place, up=turned(place.up), forward=turned(place.forward)) for name, place in known.places.items()
    }
    return replace(known, places=places)


def _fits(bvh: Bvh, known: Skeleton) -> bool:
    """Whether the file's limbs and feet lie in their joints' frames nearly as in the known ones."""
    bones = dict(LIMBS) | {f"{side}_ankle": f"{side}_foot" for side in SIDES}
    mean = bvh.positions.mean(dim=0)
    for start, end in bones.items():
        place = known.places[start]
        axes = {"up": torch.tensor(place.up).to(mean), "forward": torch.tensor(place.forward).to(mean)}
        left = torch.linalg.cross(axes["up"], axes["forward"])
        theirs = normalize(mean[bvh.names.index(known.places[end].joint)], dim=0)
        side = 1.0 if start.startswith("left") else -1.0
        expected = {"hip": -axes["up"], "knee": -axes["up"], "ankle": axes["forward"] - 0.5 * axes["up"]}
        ours = expected.get(start.partition("_")[2], side * left)
        if theirs.any() and theirs @ normalize(ours, dim=0) < 0.5:
            return False
    # Bones along one axis fit however they are turned about it, as by a program in which another axis is up.
    for trunk, pair in (("pelvis", "hip"), ("spine3", "collar")):
        place = known.places[trunk]
        left = torch.linalg.cross(torch.tensor(place.up).to(mean), torch.tensor(place.forward).to(mean))
        ends = (mean[bvh.names.index(known.places[f"{side}_{pair}"].joint)] for side in SIDES)
        if normalize(torch.sub(*ends), dim=0) @ left < 0.5:
            return False
    return True


def thinned(bvh: Bvh, frames: int = FRAMES) -> Bvh:
    """At most so many frames, evenly."""
    step = -(-len(bvh) // frames)
    return bvh if step == 1 else _frames(bvh, torch.arange(0, len(bvh), step))


def _frames(bvh: Bvh, frames: Tensor) -> Bvh:
    return replace(bvh, rotations=bvh.rotations[frames], positions=bvh.positions[frames])


def _notes(up: str) -> list[str]:
    return [] if up == "y" else [f"{up} is up in it: turned to y up"]


def _described(
    bvh: Bvh, skeleton: str, joints: dict[str, int], up: str, rest: str, confidence: float, notes: list[str]
) -> Mapping:
    names = {name: bvh.names[joints[name]] for name in JOINT_NAMES if name in joints}
    ignored = tuple(name for name in bvh.names if name not in names.values())
    return Mapping(skeleton, names, up, rest, bvh.unit, min(1.0, confidence), ignored, tuple(notes), bvh.source)


def _indices(bvh: Bvh, joints: Table[str, str]) -> dict[str, int]:
    return {name: bvh.names.index(joint) for name, joint in joints.items()}


def _between(found: Table[str, Any]) -> dict[str, tuple[str, str, float]]:
    """Joints of the trunk that the file lacks, each between those that it has."""
    between = {}
    for place, name in enumerate(SPINE):
        before = [joint for joint in SPINE[:place] if joint in found]
        after = [joint for joint in SPINE[place:] if joint in found]
        if name not in found and before and after:
            low, high = SPINE.index(before[-1]), SPINE.index(after[0])
            between[name] = (before[-1], after[0], (place - low) / (high - low))
    if "neck" not in found and "head" in found:
        between["neck"] = ([joint for joint in SPINE if joint in found][-1], "head", 0.5)
    return between
