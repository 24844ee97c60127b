"""Sixteen still poses of a person, from plain to tangled: what a renderer is judged on when no motion is given."""

from math import radians

import torch
from torch import Tensor

from renderers.rotations import axis_angle_to_matrix
from renderers.skeleton import JOINTS, MIRRORED

# Degrees about x, y, z of the joint's parent, as one axis-angle. With the body facing +z: about x a leg swings back and
# a spine bends forward, about y a body turns to its left, about z the left arm rises. "both" mirrors the left side.
_HANGING = {"both_shoulder": (0, 0, -72)}
_BENT_KNEES = {"both_hip": (-60, 0, 8), "both_knee": (95, 0, 0)}
_POSES: dict[str, dict[str, tuple[float, float, float]]] = {
    "t-pose": {},
    "a-pose": {"both_shoulder": (0, 0, -45), "both_hip": (0, 0, 6)},
    "standing": {**_HANGING, "both_elbow": (0, -12, 0)},
    "stride": {
        **_HANGING, "left_hip": (-32, 0, 0), "left_knee": (10, 0, 0), "right_hip": (25, 0, 0), "right_knee": (22, 0, 0),
        "left_elbow": (0, -25, 0), "right_elbow": (0, 35, 0), "pelvis": (0, 40, 0),
    },
    "running": {
        "both_shoulder": (0, 0, -65), "left_elbow": (0, -95, 0), "right_elbow": (0, 95, 0), "left_hip": (-70, 0, 0),
        "left_knee": (85, 0, 0), "right_hip": (35, 0, 0), "right_knee": (70, 0, 0), "spine1": (14, 0, 0),
        "pelvis": (0, 75, 0),
    },
    "waving": {**_HANGING, "left_shoulder": (0, 0, 35), "left_elbow": (0, 0, 75), "head": (0, 20, 8)},
    "hands up": {"both_shoulder": (0, 0, 78), "both_elbow": (0, -10, 8), "pelvis": (0, -35, 0)},
    "arms crossed": {"both_shoulder": (20, -48, -55), "both_elbow": (0, -105, 0), "spine3": (0, 12, 0)},
    "hands on hips": {"both_shoulder": (0, 12, -48), "both_elbow": (60, -70, -40), "pelvis": (0, 20, 0)},
    "crouching": {**_HANGING, **_BENT_KNEES, "spine1": (30, 0, 0), "pelvis": (8, -60, 0)},
    "sitting": {**_HANGING, "both_hip": (-88, 0, 4), "both_knee": (86, 0, 0), "both_elbow": (0, -70, 0)},
    "bowing": {**_HANGING, "spine1": (38, 0, 0), "spine2": (28, 0, 0), "head": (18, 0, 0), "pelvis": (0, 90, 0)},
    "kicking": {
        "both_shoulder": (0, -20, -25), "left_hip": (-85, 0, 12), "left_knee": (8, 0, 0), "spine1": (-12, 0, 0),
        "right_knee": (6, 0, 0), "pelvis": (0, 55, 0),
    },
    "bending aside": {"left_shoulder": (0, 0, 75), "right_shoulder": (0, 0, 60), "spine1": (0, 0, 20),
                      "spine2": (0, 0, 18), "both_hip": (0, 0, 14)},
    "lying": {"pelvis": (-88, 0, 12), "both_shoulder": (0, 0, -30), "left_hip": (-20, 0, 8), "left_knee": (40, 0, 0)},
    "curled up": {
        "both_hip": (-118, 0, 4), "both_knee": (128, 0, 0), "spine1": (32, 0, 0), "spine2": (25, 0, 0),
        "head": (30, 0, 0), "both_shoulder": (20, -60, -50), "both_elbow": (0, -80, 0), "pelvis": (0, 50, 25),
    },
}  # fmt: skip
POSE_NAMES = tuple(_POSES)


def sixteen_poses() -> Tensor:
    """Local rotations [16 24 3 3] of the poses named in `POSE_NAMES`, relative to the T-pose."""
    turns = torch.zeros(len(_POSES), len(JOINTS), 3)
    for pose, joints in zip(turns, _POSES.values(), strict=True):
        for name, degrees in joints.items():
            turn = torch.tensor([radians(angle) for angle in degrees])
            left = JOINTS[name.replace("both", "left")]
            pose[left] = turn
            if name.startswith("both"):
                pose[MIRRORED[left]] = turn * torch.tensor([1.0, -1.0, -1.0])
    return axis_angle_to_matrix(turns)
