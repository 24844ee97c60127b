"""The Motion value: one clip of one body, and the plain operations on it."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from renderers.checks import UserError, check_finite, check_shapes, printable
from renderers.rotations import heading, matrix_from_6d, matrix_to_6d, rotation_about, slerp
from renderers.skeleton import JOINT_NAMES, MIRRORED, forward_kinematics

LONGEST_LABEL = 1000  # characters
SIDE = re.compile(r"(?<![A-Za-z])(left|Left|LEFT|right|Right|RIGHT)(?![a-z])")
EXCHANGED = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "right": "left", "Right": "Left", "RIGHT": "LEFT"}


@dataclass(frozen=True, eq=False)
class Motion:
    """One clip: y up, metres, seconds.

    Attributes:
        rotations: [T 24 3 3] local rotations relative to the T-pose in SMPL's order; joint 0 is the global orientation.
        root: [T 3] world position of the pelvis *joint* (SMPL's ``transl`` plus the rest pelvis).
        fps: frames per second.
        label: the action's name, for example ``"wave-both-hands"``; control characters in it are written as in Python.
        source: where the clip came from, for messages; likewise.
        betas: [B] shape of the body that performed it, as SMPL has it, if that is known.
        gender: "neutral", "female" or "male".

    Raises:
        ShapeError: the two tensors disagree.
        UserError: no frame, a value that is not finite, a frame rate that is not positive, or a label that is no name.
    """

    rotations: Tensor
    root: Tensor
    fps: float
    label: str = ""
    source: str = "motion"
    betas: Tensor | None = None
    gender: str = "neutral"

    def __post_init__(self):
        sizes = check_shapes("Motion", rotations=(self.rotations, "T 24 3 3"), root=(self.root, "T 3"))
        if sizes["T"] == 0:
            raise UserError(self.source, "has no frames", "give a clip of at least two frames")
        if len(self.label) > LONGEST_LABEL:
            raise UserError(self.source, f"has a label of {len(self.label)} characters", "give it a short one")
        for name in ("label", "source"):  # so that no output of them need care
            object.__setattr__(self, name, printable(getattr(self, name)))
        if not 0 < self.fps < 10_000:
            raise UserError(self.source, f"frame rate {self.fps} is not a number of frames per second")
        check_finite(self.source, self.rotations, "frame joint row column", {"joint": JOINT_NAMES})
        check_finite(self.source, self.root, "frame coordinate")

    def __len__(self) -> int:
        return self.root.shape[0]

    @property
    def seconds(self) -> float:
        return len(self) / self.fps

    @cached_property
    def six(self) -> Tensor:
        """[T 24 6] rotations as first two rows."""
        return matrix_to_6d(self.rotations)

    def joints(self, rest_joints: Tensor) -> Tensor:
        """World joints [T 24 3] in metres on a skeleton with the given T-pose joints [24 3]."""
        return forward_kinematics(self.rotations, self.root, rest_joints)[0]

    def to(self, *args, **kwargs) -> "Motion":
        """As ``Tensor.to`` on both tensors."""
        return replace(self, rotations=self.rotations.to(*args, **kwargs), root=self.root.to(*args, **kwargs))


def crop(motion: Motion, start: int, stop: int) -> Motion:
    """Frames ``start`` to ``stop`` (exclusive)."""
    if not 0 <= start < stop <= len(motion):
        raise UserError(motion.source, f"has {len(motion)} frames, {start} to {stop} asked for", "choose frames inside")
    return replace(motion, rotations=motion.rotations[start:stop], root=motion.root[start:stop])


def trimmed(motions: Sequence[Motion], centred: bool = False) -> list[Motion]:
    """All cut to as many frames as the shortest has: from their first frames on, or their middles."""
    frames = min(map(len, motions))
    starts = [(len(motion) - frames) // 2 if centred else 0 for motion in motions]
    return [crop(motion, start, start + frames) for motion, start in zip(motions, starts, strict=True)]


def cut(motion: Motion, start: float = 0.0, seconds: float | None = None) -> Motion:
    """The stretch of ``seconds`` from ``start``, to the nearest frames; none goes to the end.

    Nothing is made up: a stretch that reaches beyond the clip is refused, not filled with its last pose.

    Raises:
        UserError: it begins or ends outside the clip, or holds no frame.
    """
    first = round(start * motion.fps) if math.isfinite(start) else -1
    if first < 0 or first >= len(motion):
        problem = f"lasts {motion.seconds:.4g} s, a start at {start:g} s was asked for"
        raise UserError(motion.source, problem, "start inside the clip")
    if seconds is None:
        return crop(motion, first, len(motion))
    count = round(seconds * motion.fps) if math.isfinite(seconds) else 0
    if count < 1 or first + count > len(motion):
        left = (len(motion) - first) / motion.fps
        problem = f"has {left:.4g} s from {start:g} s on, {seconds:g} s were asked for"
        raise UserError(motion.source, problem, f"ask for at most {left:.4g}")
    return crop(motion, first, first + count)


def in_place(motion: Motion) -> Motion:
    """Without its travel: the pelvis stays where it is in the first frame; its height and all turns are kept."""
    root = motion.root.clone()
    root[:, [0, 2]] = motion.root[0, [0, 2]]
    return replace(motion, root=root)


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another frame rate: rotations by slerp, root linearly.

    Of T frames come ``floor((T - 1) * fps / motion.fps) + 1``: the first is kept, and none lies behind the last, so
    that nothing is made up. At the same rate the motion is the same to the last bit.
    """
    if not 0 < fps < 10_000:
        raise UserError("resample(fps)", f"expected a positive frame rate, got {fps}")
    if fps == motion.fps or len(motion) == 1:
        return replace(motion, fps=fps)
    frames = int((len(motion) - 1) * fps / motion.fps + 1e-6) + 1
    at = (torch.arange(frames, dtype=torch.float64) * (motion.fps / fps)).clamp(max=len(motion) - 1)
    low = at.floor().long().clamp(max=len(motion) - 2)
    weight = (at - low).to(motion.root)
    rotations = slerp(motion.rotations[low], motion.rotations[low + 1], weight[:, None].expand(-1, len(JOINT_NAMES)))
    root = torch.lerp(motion.root[low], motion.root[low + 1], weight[:, None])
    return replace(motion, rotations=rotations, root=root, fps=fps)


def lies(motion: Motion) -> bool:
    """Whether the body lies along z in more than nine frames of ten, as all do that are read with y up for z or z for
    y. Someone who sleeps that way lies as well."""
    along = motion.rotations[:, 0, 2, 1].abs()  # z of where the pelvis' own y points
    return bool((along > 0.7).float().mean() > 0.9)


def canonicalise(motion: Motion, yaw: Tensor | None = None) -> Motion:
    """Turned and moved so that the first frame faces +z and stands at x = z = 0; heights and later turns are kept.

    True yaw (swing-twist), protocol B.4 no. 24 and G.15.

    Args:
        yaw: radians that are turned back, if not the first frame's heading.
    """
    turn = rotation_about("y", -(heading(motion.rotations[0, 0]) if yaw is None else yaw))
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    start = motion.root[0] * motion.root.new_tensor([1.0, 0.0, 1.0])
    return replace(motion, rotations=rotations, root=(motion.root - start) @ turn.mT)


def other_side(name: str) -> str:
    """A name with the words left and right exchanged.

    >>> other_side("wave-left-hand"), other_side("Right turn, upright")
    ('wave-right-hand', 'Left turn, upright')
    """
    return re.sub(SIDE, lambda word: EXCHANGED[word[0]], name)


def mirror(motion: Motion) -> Motion:
    """Left and right exchanged (reflection in the plane x = 0), in the label as well."""
    flip = motion.root.new_tensor([-1.0, 1.0, 1.0])
    rotations = flip[:, None] * motion.rotations[:, list(MIRRORED)] * flip
    return replace(motion, rotations=rotations, root=motion.root * flip, label=other_side(motion.label))


def to_features(six: Tensor, root: Tensor) -> Tensor:
    """ACTOR's layout (protocol A.4): six [... T 24 6], root [... T 3] metres -> [... T 25 6].

    Row 24 holds the root relative to the first frame in its first three features and zeros behind.
    """
    check_shapes("to_features", six=(six, "... T 24 6"), root=(root, "... T 3"))
    relative = root - root[..., :1, :]
    row = torch.cat([relative, torch.zeros_like(relative)], dim=-1)
    return torch.cat([six, row[..., None, :]], dim=-2)


def from_features(features: Tensor) -> tuple[Tensor, Tensor]:
    """[... T 25 6] -> rotations [... T 24 3 3] and root relative to the first frame [... T 3] in metres."""
    check_shapes("from_features", features=(features, "... 25 6"))
    return matrix_from_6d(features[..., :24, :]), features[..., 24, :3]
