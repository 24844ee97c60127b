"""How files of joint positions number their joints, and how each stands in a T-pose.

Such files have no joint frames. What a bone's direction means for a posture is known only beside the direction that it
has in the T-pose of the body that the positions were taken from; the tables here hold these, in rounded centimetres.
Lengths are never taken from here: they are measured in each file.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from renderers.skeleton import JOINT_NAMES, JOINTS

# Joints in the middle and on the left; the right is the mirror image.
_SMPL_POSE = {
    "pelvis": (0, 0, 0), "left_hip": (6.9, -9.1, -0.6), "spine1": (0, 10.9, -2.7), "left_knee": (10.7, -46.9, -1.2),
    "spine2": (0, 24.4, -2.6), "left_ankle": (9.2, -86.8, -5.5), "spine3": (0, 29.7, 0), "left_foot": (11.8, -92, 6.6),
    "neck": (0, 51.1, -4.3), "left_collar": (8.1, 41.7, -3.7), "head": (0, 57.6, 0.8),
    "left_shoulder": (17.4, 44.9, -4.5), "left_elbow": (43, 43.6, -7), "left_wrist": (68.3, 44.4, -7.3),
    "left_hand": (76.7, 43.7, -8.6),
}  # fmt: skip
# The spine is straight and the hips lie level with the pelvis; feet dip as in the mean of the data set.
_KIT_POSE = {
    "pelvis": (0, 0, 0), "left_hip": (7, 0, 0), "spine1": (0, 12, 0), "left_knee": (7, -36, 0), "spine2": (0, 20, 0),
    "left_ankle": (7, -70, 0), "spine3": (0, 29, 0), "left_foot": (10, -76, 8.5), "neck": (0, 35, 0),
    "left_collar": (4, 35, 0), "head": (0, 39, 0), "left_shoulder": (15, 35, 0), "left_elbow": (37, 35, 0),
    "left_wrist": (53, 35, 0), "left_hand": (60, 35, 0),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Layout:
    """One numbering of joints.

    Attributes:
        joints: for each joint of the file the SMPL joint that it is, -1 for one that SMPL has not.
        rest: [24 3] T-pose of the body behind the files, metres; only its directions are used.
        fps: frame rate where a file has none.
    """

    name: str
    joints: tuple[int, ...]
    rest: Tensor
    fps: float


def _rest(pose: dict[str, tuple[float, ...]]) -> Tensor:
    rows = []
    for name in JOINT_NAMES:
        x, y, z = pose[name.replace("right", "left")]
        rows.append((-x if name.startswith("right") else x, y, z))
    return torch.tensor(rows, dtype=torch.float64) / 100


def _kit_joints() -> tuple[int, ...]:
    """The sides are those that one sees: the joints that the data set's papers call left lie on the right of a body
    whose feet point ahead, for the files are mirrored against the captures (their mean pose shows it)."""
    arms = [f"{side}_{joint}" for side in ("right", "left") for joint in ("shoulder", "elbow", "wrist")]
    legs = [f"{side}_{joint}" for side in ("right", "left") for joint in ("hip", "knee", "ankle", "", "foot")]
    names = ["pelvis", "spine1", "spine3", "neck", "head", *arms, *legs]
    return tuple(JOINTS.get(name, -1) for name in names)


SMPL_LAYOUT = Layout("SMPL", tuple(range(24)), _rest(_SMPL_POSE), 30.0)
HUMANML3D_LAYOUT = Layout("HumanML3D", tuple(range(22)), _rest(_SMPL_POSE), 20.0)
KIT_LAYOUT = Layout("KIT", _kit_joints(), _rest(_KIT_POSE), 12.5)
LAYOUTS = {len(layout.joints): layout for layout in (SMPL_LAYOUT, HUMANML3D_LAYOUT, KIT_LAYOUT)}
