"""The two data sets as ACTOR packages them: HumanAct12 and UESTC, SMPL poses that were estimated from pictures.

Both are in the frame of a camera: y down, z away. Inside y is up, which is half a turn about x. Neither says where the
floor is, so each clip is put down with its lowest joint, over all its frames, as high as the lowest of the T-pose.
The frame rate of HumanAct12 is not stored; it is taken as HumanML3D has it.
"""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from refine.formats.unpickle import read_pickle
from refine.formats.untrusted import MAX_TABLE, read_bytes
from refine.motion import Motion
from renderers.checks import ShapeError, UserError, check_known, check_shapes
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import forward_kinematics

HUMANACT_FILE = "humanact12poses.pkl"
HUMANACT_FPS = 20.0
HUMANACT_ACTIONS = (
    "warm-up", "walk", "run", "jump", "drink", "lift-dumbbell", "sit", "eat", "turn-steering-wheel", "phone", "boxing",
    "throw",
)  # fmt: skip

UESTC_NAMES = Path("info", "names.txt")
UESTC_LENGTHS = Path("info", "num_frames_min.txt")
UESTC_POSES = "vibe_cache_refined.pkl"
UESTC_FPS = 30.0
UESTC_ACTIONS = (
    "punching-and-knee-lifting", "marking-time-and-knee-lifting", "jumping-jack", "squatting", "forward-lunging",
    "left-lunging", "left-stretching", "raising-hand-and-jumping", "left-kicking", "rotation-clapping", "front-raising",
    "pulling-chest-expanders", "punching", "wrist-circling", "single-dumbbell-raising", "shoulder-raising",
    "elbow-circling", "dumbbell-one-arm-shoulder-pressing", "arm-circling", "dumbbell-shrugging", "pinching-back",
    "head-anticlockwise-circling", "shoulder-abduction", "deltoid-muscle-stretching", "straight-forward-flexion",
    "spinal-stretching", "dumbbell-side-bend", "standing-opposite-elbow-to-knee-crunch", "standing-rotation",
    "overhead-stretching", "upper-back-stretching", "knee-to-chest", "knee-circling", "alternate-knee-lifting",
    "bent-over-twist", "rope-skipping", "standing-toe-touches", "standing-gastrocnemius-calf",
    "single-leg-lateral-hopping", "high-knees-running",
)  # fmt: skip
UESTC_TRAIN_SUBJECTS = frozenset((
    1, 2, 6, 12, 13, 16, 21, 24, 28, 29, 30, 31, 33, 35, 39, 41, 42, 45, 47, 50, 52, 54, 55, 57, 59, 61, 63, 64, 67, 69,
    70, 71, 73, 77, 81, 84, 86, 87, 88, 90, 91, 93, 96, 99, 102, 103, 104, 107, 108, 112, 113,
))  # fmt: skip
UESTC_VIDEO = re.compile(r"a(?P<action>\d+)_d(?P<view>\d+)_p(?P<subject>\d+)_c(?P<camera>\d+)_color\.avi")
UESTC_BYTES = 1 << 35  # 25,600 clips of some 350 frames
SPLITS = ("train", "test")
ROUND = 8  # the view in which the second camera goes round
PELVIS = 8  # the middle of the hips among VIBE's 49 joints
FOCAL_LENGTH, PICTURE = 500.0, 540.0  # pixels, as ACTOR assumes them

UPRIGHT = np.diag([1.0, -1.0, -1.0])  # from the camera's frame to ours
REMEDY = "give the package of https://github.com/Mathux/ACTOR as it is unpacked"


class Video(NamedTuple):
    """What the name of a UESTC video says."""

    action: str
    view: int
    subject: int
    camera: int


def is_humanact(path: str | Path) -> bool:
    return Path(path).name == HUMANACT_FILE


def is_uestc(path: str | Path) -> bool:
    return (Path(path) / UESTC_NAMES).is_file()


def read_humanact(path: str | Path, rest_joints: Tensor) -> list[Motion]:
    """Read ``humanact12poses.pkl``: its clips in the order of the file, which is that of the original file names, so
    that clips of one performer follow each other within a class.

    Args:
        rest_joints: [24 3] T-pose joints in metres.

    Raises:
        UserError: the file is missing, damaged, holds code or something else, or a value is not finite.
    """
    stored = _dictionary(path, read_pickle(path), ("poses", "joints3D", "y"))
    motions = []
    for index, (poses, joints, label) in enumerate(zip(*stored, strict=True)):
        source = f"{Path(path).name}/{index:04d}"
        if not isinstance(label, int | np.integer) or not 0 <= label < len(HUMANACT_ACTIONS):
            shown = int(label) if isinstance(label, int | np.integer) else f"a {type(label).__name__}"
            raise UserError(f"{path}, clip {index}", f"has class {shown}, not 0 to 11", REMEDY)
        poses, joints = _arrays(f"{path}, clip {index}", poses=(poses, "T 72"), joints=(joints, "T 24 3"))
        motions.append(_motion(poses, joints[:, 0], HUMANACT_FPS, HUMANACT_ACTIONS[int(label)], source, rest_joints))
    return motions


def read_uestc(
    folder: str | Path,
    rest_joints: Tensor,
    labels: Collection[str] = UESTC_ACTIONS,
    front_only: bool = False,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
    split: str | None = None,
) -> list[Motion]:
    """All clips of :func:`uestc_clips` at once."""
    return list(uestc_clips(folder, rest_joints, labels, front_only, progress, split))


def uestc_clips(
    folder: str | Path,
    rest_joints: Tensor,
    labels: Collection[str] = UESTC_ACTIONS,
    front_only: bool = False,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
    split: str | None = None,
) -> Iterator[Motion]:
    """Read ACTOR's UESTC folder: ``info/names.txt``, ``info/num_frames_min.txt`` and ``vibe_cache_refined.pkl``.

    The first camera sees everyone from the front; what the second sees is turned to the front by its view. Its eighth
    view goes round the performer and is left out. Paths are estimated as ACTOR does, from the camera's scale.

    Args:
        rest_joints: [24 3] T-pose joints in metres.
        labels: actions to read.
        front_only: the first camera alone.
        progress: wraps the list of videos that are read, as ``tqdm`` does.
        split: "train" or "test", the subjects of one side alone, see :func:`split_of`; none means both.

    Returns:
        Clips one after the other, in the order of the names, which are their sources; `video_of` reads them.

    Raises:
        UserError: a file is missing, damaged, holds code or something else, or a value is not finite.
    """
    folder = Path(folder)
    for label in labels:
        check_known(folder, label, UESTC_ACTIONS)
    if split is not None:
        check_known(folder, split, SPLITS)
    names, limits = _lines(folder / UESTC_NAMES), _lines(folder / UESTC_LENGTHS)
    videos = [video_of(name) for name in names]
    wanted = [
        index
        for index, video in enumerate(videos)
        if video.action in labels
        and (video.camera == 1 or not (front_only or video.view == ROUND))
        and (split is None or split_of(video) == split)
    ]
    path = folder / UESTC_POSES
    poses, cameras, joints = _dictionary(path, read_pickle(path, UESTC_BYTES), ("pose", "orig_cam", "joints3d"))
    if not len(names) == len(limits) == len(poses):
        problem = f"holds {len(poses)} clips for {len(names)} names and {len(limits)} lengths"
        raise UserError(path, problem, REMEDY)
    for index in progress(wanted):
        video, where = videos[index], f"{path}, {names[index]}"
        if not re.fullmatch(r"[0-9]{1,9}", limits[index].strip()):
            raise UserError(
                f"{folder / UESTC_LENGTHS}, line {index + 1}", f"is no number: {limits[index][:40]!r}", REMEDY
            )
        arrays = {"pose": (poses[index], "T 72"), "orig_cam": (cameras[index], "T 4")}
        pose, camera, joint = _arrays(where, **arrays, joints3d=(joints[index], "T 49 3"))
        frames = min(len(pose), int(limits[index]))
        root = (joint[:, PELVIS] + travel(camera, joint))[:frames]
        turn = _turn(video)
        yield _motion(pose[:frames], root, UESTC_FPS, video.action, names[index], rest_joints, turn)


def split_of(video: Video | str) -> str:
    """ACTOR's side of a video, or of the name of one: "train" for its 51 subjects, "test" for the other 67.

    Raises:
        UserError: it is not the name of a UESTC video.
    """
    video = video if isinstance(video, Video) else video_of(video)
    return "train" if video.subject in UESTC_TRAIN_SUBJECTS else "test"


def video_of(name: str) -> Video:
    """What the name of a UESTC video says.

    Raises:
        UserError: it is not such a name.
    """
    match = UESTC_VIDEO.fullmatch(name)
    if not match or int(match["action"]) >= len(UESTC_ACTIONS):
        raise UserError(name, "is not the name of a UESTC video", "expected one like a12_d1_p003_c1_color.avi")
    action, view, subject, camera = (int(match[key]) for key in ("action", "view", "subject", "camera"))
    return Video(UESTC_ACTIONS[action], view, subject, camera)


def travel(cameras: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The path that ACTOR reads from a weak-perspective camera; its depth is no measured one.

    Args:
        cameras: [T 4] scales and shifts sx, sy, tx, ty.
        joints: [T J 3] about the body's own origin.

    Returns:
        [T 3] in the camera's frame, from the first frame on.
    """
    shift = cameras[:, 2:]
    flat = joints[..., :2]
    drawn = (cameras[:, None, :1] * (flat + shift[:, None]) + 1) * 0.5 * PICTURE
    height, pixels = (np.linalg.norm(np.ptp(points, axis=1), axis=-1) for points in (flat, drawn))
    with np.errstate(divide="ignore", invalid="ignore"):  # the clip is refused for it
        depth = FOCAL_LENGTH * height / pixels
    path = np.concatenate([shift, depth[:, None]], axis=1)
    return path - path[:1]


def _turn(video: Video) -> np.ndarray:
    """[3 3] about the camera's y axis, to where the first camera stands."""
    eighths = 0 if video.camera == 1 else video.view
    return rotation_about("y", torch.tensor(-eighths * torch.pi / 4, dtype=torch.float64)).numpy()


def _motion(
    poses: np.ndarray,
    root: np.ndarray,
    fps: float,
    label: str,
    source: str,
    rest_joints: Tensor,
    turn: np.ndarray | None = None,
) -> Motion:
    """From the camera's frame, poses [T 72] and root [T 3], to a clip that stands on the floor."""
    upright = torch.from_numpy(UPRIGHT if turn is None else UPRIGHT @ turn)
    rotations = axis_angle_to_matrix(torch.from_numpy(poses).reshape(-1, 24, 3))
    rotations[:, 0] = upright @ rotations[:, 0]
    motion = Motion(rotations, torch.from_numpy(root) @ upright.mT, fps, label, source)
    rest = rest_joints.detach().cpu().double()
    lowest = forward_kinematics(motion.rotations, motion.root, rest)[0][..., 1].min()
    lift = torch.stack([torch.zeros_like(lowest), rest[:, 1].min() - lowest, torch.zeros_like(lowest)])
    return replace(motion, root=motion.root + lift).to(torch.float32)


def _lines(path: Path) -> list[str]:
    try:
        return read_bytes(path, MAX_TABLE).decode().splitlines()
    except (UserError, UnicodeDecodeError) as error:
        raise UserError(path, "is missing or no text", REMEDY) from error


def _dictionary(path: str | Path, stored: Any, keys: tuple[str, ...]) -> list[Sequence]:
    """The lists of a dictionary, one item a clip."""
    for key in keys:
        if not isinstance(stored, dict) or not isinstance(stored.get(key), list | tuple | np.ndarray):
            raise UserError(path, f"is another file than ACTOR's (no list '{key}')", REMEDY)
    lists = [stored[key] for key in keys]
    if len({len(values) for values in lists}) != 1:
        sizes = ", ".join(f"{len(values)} {key}" for key, values in zip(keys, lists, strict=True))
        raise UserError(path, f"is damaged ({sizes})", REMEDY)
    return lists


def _arrays(where: str, **arrays: tuple[Any, str]) -> list[np.ndarray]:
    """Numbers of the given shapes, as float64."""
    for name, (array, _) in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
            raise UserError(where, f"'{name}' is no array of numbers", REMEDY)
    try:
        check_shapes(where, **arrays)
    except ShapeError as error:
        raise UserError(error.where, error.problem, REMEDY) from error
    return [np.array(array, dtype=np.float64) for array, _ in arrays.values()]
