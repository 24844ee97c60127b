"""Our joints among a file's: by their names, else by the shape of the tree, with left and right where they are."""

import torch
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh
from refine.skeletons.joint_names import by_name, read_names
from refine.skeletons.known import SIDES
from refine.skeletons.rest_pose import AXES, STANDS, Poses, forward, knees_ahead, standing, toes_ahead, trunk
from refine.skeletons.topology import by_topology, with_trunk
from renderers.checks import UserError

REMEDY = "give the motion of one person, or say which joint is which in a mapping"


def find_joints(bvh: Bvh, rest: Poses, motion: Poses) -> tuple[dict[str, int], str, float, list[str]]:
    """(SMPL joint -> index, skeleton's name, confidence, notes).

    Args:
        rest: the zero pose.
        motion: some of the motion.

    Raises:
        UserError: there is no body among the joints.
    """
    words, named = read_names(bvh.names), by_name(bvh.names)
    if named:
        helpers = frozenset(index for index, word in enumerate(words) if word.helper)
        joints = with_trunk(bvh, named.joints, helpers)
        toes, knees = toes_ahead(bvh, motion, joints), knees_ahead(motion, joints)
        if toes is not None and toes < -0.5 and (knees is None or knees < 0):
            note = "its toes point backwards: left and right are named the wrong way round and were exchanged"
            return exchanged(joints), named.skeleton, 0.8, [note]
        return joints, named.skeleton, 1.0, []
    few = motion._make(tensor[:: max(1, len(tensor) // 32)] for tensor in motion)
    joints, quality = by_topology(bvh, Poses(*(torch.cat(pair) for pair in zip(rest, few, strict=True))))
    if not joints:
        problem = f"no two legs and two arms among its {len(bvh.names)} joints: it is no body"
        raise UserError(bvh.source, problem, REMEDY)
    if quality < 0.5:
        raise UserError(bvh.source, "no pose of it stands on two legs: it is no person, or lies all the time", REMEDY)
    joints = with_trunk(bvh, joints)
    ours, sureness, note = _sided(bvh, rest, motion, joints, [word.side for word in words])
    notes = ["its joint names are not known: they were told by the shape of the skeleton", note]
    return ours, "of unknown names", sureness * quality, notes


def _sided(
    bvh: Bvh, rest: Poses, motion: Poses, joints: dict[str, int], named: list[str]
) -> tuple[dict[str, int], float, str]:
    """(the joints with left on the left, how sure that is, why): by toes, knees, words in the names, or a guess."""
    for ahead, by in ((toes_ahead(bvh, motion, joints), "toes"), (knees_ahead(motion, joints), "knees")):
        if ahead is not None and abs(ahead) > 0.3:
            told = f"left and right are told by where its {by} point"
            return joints if ahead > 0 else exchanged(joints), 0.9, told
    sides = [(named[joint], name.partition("_")[0]) for name, joint in joints.items() if named[joint]]
    right = sum(theirs == ours for theirs, ours in sides if ours in SIDES)
    wrong = sum(theirs != ours for theirs, ours in sides if ours in SIDES)
    if right != wrong:
        return joints if right > wrong else exchanged(joints), 0.8, "left and right are told by words in its names"
    poses = rest if standing(rest.points, joints)[0] > STANDS else motion
    ahead = forward(poses.points, joints).mean(dim=0)  # along z, or along -y where z is up
    note = "it has no toes and bends no knee: left and right are guessed, check that it faces ahead"
    return joints if ahead[2] - ahead[1] >= 0 else exchanged(joints), 0.5, note


def exchanged(joints: dict[str, int]) -> dict[str, int]:
    """Left and right the other way round."""
    other = dict(zip(SIDES, reversed(SIDES), strict=True))
    return {
        f"{other[name.partition('_')[0]]}_{name.partition('_')[2]}" if "_" in name else name: joint
        for name, joint in joints.items()
    }


def check_human(bvh: Bvh, joints: dict[str, int], motion: Poses, up: str, stands: float) -> None:
    """Refuse what goes on four legs: the trunk level, the arms down, legs hardly longer than the trunk."""
    if stands > STANDS:
        return
    points, vertical = motion.points, motion.points.new_tensor(AXES[up])

    def apart(start: str, end: str) -> float:
        return (points[:, joints[f"left_{end}"]] - points[:, joints[f"left_{start}"]]).norm(dim=-1).mean().item()

    arms = sum(
        normalize(points[:, joints[f"{side}_wrist"]] - points[:, joints[f"{side}_shoulder"]], dim=-1) for side in SIDES
    )
    on_fours = (trunk(points, joints) @ vertical < 0.6) & (arms @ vertical < -1.0)
    leg = apart("hip", "knee") + apart("knee", "ankle")
    if on_fours.double().mean() > 0.9 and leg < 1.2 * apart("hip", "shoulder"):
        raise UserError(bvh.source, "it goes on four legs in all its frames: it is no person", REMEDY)
