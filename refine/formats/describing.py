"""What a motion file is: its kind, its frame of reference, its skeleton; and the motions in it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from refine.formats.asf_amc import CMU_FPS, read_amc
from refine.formats.bvh import Bvh, read_bvh, world
from refine.formats.clips import is_packed
from refine.formats.files import Reading, label_from_name, load_motions
from refine.formats.glb_read import read_takes
from refine.formats.joints import read_joints
from refine.formats.untrusted import kind_of
from refine.motion import Motion, lies
from refine.oddities import Oddity
from refine.skeletons.mapping import Mapping, mapping_of, read_mapping, thinned
from refine.skeletons.retarget import retarget
from renderers.skeleton import JOINTS, PARENTS

LOOKED_AT = 64  # frames by which the lengths of bones are measured
STANDING = 1.18  # a body's height over its thigh, shank, and trunk up to the head joint
BY_FORMAT, AS_SAID = "by the format", "as said"


@dataclass(frozen=True)
class Clip:
    """One motion of a file."""

    source: str
    label: str
    frames: int
    fps: float
    seconds: float
    facing: float  # degrees to the left of +z in the first frame
    travel: float  # metres from the first to the last frame, along the floor
    oddities: tuple[Oddity, ...] = ()


@dataclass(frozen=True)
class File:
    """What one file is.

    Attributes:
        kind: in words.
        up: the axis of the file that points up.
        unit: of length, and ``unit_by`` how that is known.
        skeleton: whose joints it has.
        mapping: which joint is which, for formats that bring a skeleton.
        problem: why it cannot be read; "" if it can.
    """

    source: str = ""
    path: str = ""
    kind: str = ""
    up: str = "y"
    unit: str = "m"
    unit_by: str = BY_FORMAT
    skeleton: str = "SMPL"
    notes: tuple[str, ...] = ()
    mapping: Mapping | None = None
    clips: tuple[Clip, ...] = ()
    problem: str = ""


Described = tuple[File, list[Motion], dict[str, float]]
UESTC = File(kind="ACTOR's package of UESTC", up="-y")


def describe(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    """A file, its motions on a body with T-pose joints [24 3] in metres, and the lengths of bones in the skeleton that
    the file brings, see `bones_of`.

    Raises:
        UserError: it cannot be read.
    """
    file, motions, bones = DESCRIBE.get(kind_of(path), _other)(path, rest_joints, reading)
    return file, [motion if motion.label else replace(motion, label=label_from_name(path)) for motion in motions], bones


def bones_of(bvh: Bvh, mapping: Mapping) -> dict[str, float]:
    """Metres from each joint to the one before it, by SMPL's names, and the "height" of a body that stands."""
    few = thinned(bvh, LOOKED_AT)
    joints = world(few)[0]
    at = {name: joints[:, few.names.index(joint)] for name, joint in mapping.joints.items() if joint in few.names}
    names = list(JOINTS)
    bones = {}
    for name, joint in JOINTS.items():
        parent = PARENTS[joint]
        while parent > 0 and names[parent] not in at:
            parent = PARENTS[parent]
        if joint and name in at and names[parent] in at:
            bones[name] = float((at[name] - at[names[parent]]).norm(dim=-1).median())
    legs = [bones[f"{side}_{joint}"] for side in ("left", "right") for joint in ("knee", "ankle")]
    trunk = [bones[name] for name in ("spine1", "spine2", "spine3", "neck", "head") if name in bones]
    if "head" in at and trunk:
        bones["height"] = STANDING * (sum(legs) / 2 + sum(trunk))
    return bones


def _bvh(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    return _of_skeletons("BVH", [read_bvh(path, reading.unit)], rest_joints, reading)


def _amc(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    file, motions, bones = _of_skeletons("AMC", [read_amc(path, reading.fps, reading.unit)], rest_joints, reading)
    assumed = () if reading.fps is not None else (f"it does not say its frame rate: taken for {CMU_FPS:g} fps",)
    return replace(file, notes=(*file.notes, *assumed)), motions, bones


def _glb(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    takes = read_takes(path, reading.fps)
    reading = replace(reading, up=reading.up or "y")
    file, motions, bones = _of_skeletons("GLB", [take.bvh for take in takes], rest_joints, reading)
    labelled = [replace(motion, label=take.label) for motion, take in zip(motions, takes, strict=True)]
    return replace(file, unit="m", unit_by=BY_FORMAT, notes=(*file.notes, *_turned(motions, file.up))), labelled, bones


def _of_skeletons(kind: str, skeletons: list[Bvh], rest_joints: Tensor, reading: Reading) -> Described:
    mapping = read_mapping(reading.mapping) if reading.mapping else mapping_of(skeletons[0])
    mapping = replace(mapping, up=reading.up) if reading.up else mapping
    unit_by = AS_SAID if reading.unit else "guessed from the size of the skeleton"
    about = {"up": mapping.up, "unit": skeletons[0].unit, "unit_by": unit_by}
    file = File(kind=kind, skeleton=mapping.skeleton, notes=mapping.notes, mapping=mapping, **about)
    return file, [retarget(bvh, rest_joints, mapping) for bvh in skeletons], bones_of(skeletons[0], mapping)


def _turned(motions: list[Motion], up: str) -> tuple[str, ...]:
    """A note on motions that were read with ``up`` by their format, or because someone said so."""
    other = "y" if up == "z" else "z"
    return (f"it lies: likely {other} is up in it; then read it with --up {other}",) if all(map(lies, motions)) else ()


def _npz(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    motions = load_motions(path, rest_joints, reading)
    if is_packed(path):
        return File(kind="packed clips"), motions, {}
    up = reading.up or "z"
    return File(kind="AMASS-style .npz", up=up, notes=_turned(motions, up)), motions, {}


def _npy(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    fit = read_joints(path, rest_joints, reading.fps, reading.up or "y")
    notes = [f"rotations are fitted to its joints, {1000 * fit.error:.0f} mm off on average"]
    if fit.swapped:
        notes.append("its feet pointed backwards: left and right were exchanged")
    up = reading.up or "y"
    about = {"up": up, "unit": f"{fit.scale:.4g} m", "unit_by": "by the length of the legs"}
    notes = (*notes, *_turned([fit.motion], up))
    return File(kind="joints .npy", skeleton="positions", notes=notes, **about), [fit.motion], {}


def _pickle(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    return File(kind="ACTOR's package of HumanAct12", up="-y"), load_motions(path, rest_joints, reading), {}


def _json(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    return File(kind="motion as JSON"), load_motions(path, rest_joints, reading), {}


def _other(path: Path, rest_joints: Tensor, reading: Reading) -> Described:
    motions = load_motions(path, rest_joints, reading)
    return File(kind=kind_of(path), unit_by="as its reader has it"), motions, {}


# By what a file holds, see `kind_of`.
DESCRIBE: dict[str, Callable[[Path, Tensor, Reading], Described]] = {
    "bvh": _bvh,
    "amc": _amc,
    "glb": _glb,
    "gltf": _glb,
    "npz": _npz,
    "npy": _npy,
    "pickle": _pickle,
    "json": _json,
}
