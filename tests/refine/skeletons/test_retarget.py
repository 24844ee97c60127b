"""Retargeting, measured on real clips against the source's own world joints.

Every twelfth clip is measured; ``REFINE_CLIP_STRIDE=1 pytest tests/refine/test_retarget.py -s`` takes all 594 and
prints the figures.
"""

import math
import os
import time
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from refine.formats.bvh import Bvh, motion_to_bvh, read_bvh, world
from refine.motion import Motion, canonicalise
from refine.skeletons.known import BANDAI_NAMCO, SMPL
from refine.skeletons.mapping import mapping_of, recognise
from refine.skeletons.retarget import retarget
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, rotation_about, rotation_angle
from renderers.skeleton import JOINTS, PARENTS, forward_kinematics

STRIDE = int(os.environ.get("REFINE_CLIP_STRIDE", "12"))
SOURCE_BONES = {"UpperArm": "LowerArm", "LowerArm": "Hand", "UpperLeg": "LowerLeg", "LowerLeg": "Foot"}
OUR_BONES = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
SIDES = {"left": "L", "right": "R"}
FEET = [JOINTS[f"{side}_{joint}"] for side in SIDES for joint in ("ankle", "foot")]


@dataclass(frozen=True)
class Clip:
    name: str
    bvh: Bvh
    motion: Motion
    joints: Tensor  # [T 24 3]
    world: Tensor  # [T 24 3 3]

    def theirs(self, joint: str) -> Tensor:
        return world(self.bvh)[0][:, self.bvh.names.index(joint)]


@pytest.fixture(scope="module")
def clips(real_clips, rest_joints) -> list[Clip]:
    retarget(read_bvh(real_clips[0]), rest_joints)  # the first call also imports
    clips, seconds = [], 0.0
    for path in real_clips[::STRIDE]:
        start = time.perf_counter()
        bvh = read_bvh(path)
        motion = retarget(bvh, rest_joints)
        seconds += time.perf_counter() - start
        joints, rotations = forward_kinematics(motion.rotations, motion.root, rest_joints)
        clips.append(Clip(path.stem, bvh, motion, joints, rotations))
    frames = sum(len(clip.motion) for clip in clips)
    print(f"\n{len(clips)} clips, {frames} frames, {frames / seconds:.0f} frames read and retargeted a second")
    assert frames / seconds > 3000
    return clips


def angle(first: Tensor, second: Tensor) -> Tensor:
    """Degrees between vectors [... 3]; exact near 0."""
    cross = torch.linalg.cross(first, second).norm(dim=-1)
    return torch.rad2deg(torch.atan2(cross, (first * second).sum(dim=-1)))


def report(name: str, values: Tensor) -> Tensor:
    """Print and return median, 99th percentile and maximum."""
    summary = torch.stack([values.median(), values.kthvalue(math.ceil(0.99 * len(values))).values, values.max()])
    print(f"{name}: median {summary[0]:.5f}, 99th percentile {summary[1]:.5f}, maximum {summary[2]:.5f}")
    return summary


def test_limbs_point_where_the_sources_point(clips):
    angles = []
    for clip in clips:
        for side, letter in SIDES.items():
            for (start, end), (first, last) in zip(OUR_BONES.items(), SOURCE_BONES.items(), strict=True):
                ours = clip.joints[:, JOINTS[f"{side}_{end}"]] - clip.joints[:, JOINTS[f"{side}_{start}"]]
                theirs = clip.theirs(f"{last}_{letter}") - clip.theirs(f"{first}_{letter}")
                angles.append(angle(ours.double(), theirs))
    median, high, _ = report("limb direction against the source, degrees", torch.cat(angles))
    assert median < 0.1 and high < 0.1


@pytest.mark.parametrize(("upper", "lower", "ahead"), [("hip", "knee", -1), ("shoulder", "elbow", 1)])
def test_knees_bend_back_and_elbows_forward(clips, rest_joints, upper, lower, ahead):
    """In the upper bone's frame, a lower bone bent by more than 20 degrees lies behind (knee) or before (elbow)."""
    right = []
    for clip in clips:
        for side in SIDES:
            joint, end = JOINTS[f"{side}_{lower}"], JOINTS[f"{side}_{OUR_BONES[lower]}"]
            frame = clip.world[:, JOINTS[f"{side}_{upper}"]]
            bone = (frame.mT @ (clip.joints[:, end] - clip.joints[:, joint])[..., None])[..., 0]
            straight = rest_joints[joint] - rest_joints[JOINTS[f"{side}_{upper}"]]
            bent = angle(bone, straight.expand_as(bone)) > 20
            right.append(ahead * bone[bent, 2] > 0)
    right = torch.cat(right).float()
    print(f"{lower} bends the right way in {right.mean():.6f} of {len(right)} bent frames")
    assert len(right) > 2000 and right.mean() > 0.999


def test_no_joint_jumps_that_the_source_does_not(clips):
    """The turn of every joint against its parent from frame to frame, ours less the source's, degrees."""
    extra = []
    for clip in clips:
        rotations = world(clip.bvh)[1]
        for name, place in BANDAI_NAMCO.places.items():
            parent = PARENTS[JOINTS[name]]
            while parent >= 0 and (parent_name := list(JOINTS)[parent]) not in BANDAI_NAMCO.places:
                parent = PARENTS[parent]
            theirs = rotations[:, clip.bvh.names.index(place.joint)]
            ours = clip.world[:, JOINTS[name]].double()
            if parent >= 0:
                theirs = rotations[:, clip.bvh.names.index(BANDAI_NAMCO.places[parent_name].joint)].mT @ theirs
                ours = clip.world[:, parent].double().mT @ ours
            extra.append(
                torch.rad2deg(rotation_angle(ours[:-1].mT @ ours[1:]) - rotation_angle(theirs[:-1].mT @ theirs[1:]))
            )
    assert report("turn between frames beyond the source's, degrees", torch.cat(extra))[2] < 0.1


def test_standing_feet_are_on_the_floor(clips, rest_joints):
    """The lowest of ankles and toes, over its height in the T-pose, while a foot stands still; metres."""
    heights = []
    for clip in clips:
        feet = clip.joints[:, FEET]
        still = (feet.diff(dim=0).norm(dim=-1) * clip.motion.fps).amin(dim=1) < 0.1
        heights.append((feet[..., 1] - rest_joints[FEET, 1]).amin(dim=1)[1:][still])
    median, high, _ = report("standing feet over the floor, metres", torch.cat(heights).abs())
    assert median < 0.002 and high < 0.03


def test_canonical_clips_face_ahead(clips, rest_joints):
    """The line between the hips runs along x, left on +x."""
    yaws = []
    for clip in clips:
        joints = canonicalise(clip.motion).joints(rest_joints)[0]
        line = joints[JOINTS["left_hip"]] - joints[JOINTS["right_hip"]]
        yaws.append(torch.rad2deg(torch.atan2(line[2], line[0])))
    assert report("hips' yaw after canonicalise, degrees", torch.stack(yaws).abs())[2] < 10


def test_walks_go_ahead(clips):
    ways = {clip.name: canonicalise(clip.motion).root for clip in clips if clip.name.startswith("dataset-2_walk_")}
    assert ways
    aside = [math.degrees(math.atan2(abs(way[-1, 0]), way[-1, 2])) for way in ways.values()]
    assert report(f"degrees off +z of {len(aside)} walks", torch.tensor(aside))[2] < 30
    assert min(way[-1, 2] for way in ways.values()) > 1


def test_left_is_left(clips):
    for clip in clips:
        side = next((side for side in SIDES if f"raise-up-{side}-hand" in clip.name), None)
        if side:
            other = "right" if side == "left" else "left"
            highest = clip.joints[:, :, 1].amax(dim=0)
            assert highest[JOINTS[f"{side}_wrist"]] > highest[JOINTS[f"{other}_wrist"]] + 0.2, clip.name


def test_soles_lie_flat_where_the_source_stands(clips):
    """How far a foot's own up axis leans while the foot hardly turns."""
    tilts = []
    for clip in clips:
        ankles = clip.world[:, [JOINTS["left_ankle"], JOINTS["right_ankle"]]]
        still = torch.rad2deg(rotation_angle(ankles[:-1].mT @ ankles[1:])) < 0.05
        tilts.append(torch.rad2deg(torch.acos(ankles[:-1, :, 1, 1].clamp(-1, 1)))[still])
    assert report("tilt of still soles, degrees", torch.cat(tilts))[0] < 5


def test_bodies_that_wave_stand_as_the_t_pose_does(clips):
    """Toes, trunk, head and collars of someone who stands and moves the arms are nearly as in the T-pose; degrees."""
    turns = torch.cat([rotation_angle(clip.motion.rotations) for clip in clips if "hand" in clip.name])
    turns = torch.rad2deg(turns.median(dim=0).values)
    limits = {"spine": 15, "neck": 15, "head": 20, "collar": 20, "foot": 5}
    for joint, index in JOINTS.items():
        limit = next((limit for name, limit in limits.items() if name in joint), None)
        assert limit is None or turns[index] < limit, f"{joint} turns by {turns[index]:.1f} degrees"


def test_the_middle_of_the_spine_shares_the_turn(clips):
    for clip in clips[::5]:
        lower, upper = (rotation_angle(clip.motion.rotations[:, JOINTS[name]]) for name in ("spine2", "spine3"))
        torch.testing.assert_close(lower, upper, atol=1e-3, rtol=0)


def test_our_own_files_come_back(generator, rest_joints):
    """By the same joint frames: SMPL's names with our T-pose give the identity for every joint."""
    rotations = axis_angle_to_matrix(torch.randn(9, 24, 3, generator=generator))
    motion = Motion(rotations, torch.randn(9, 3, generator=generator), 30.0)
    back = retarget(motion_to_bvh(motion, rest_joints), rest_joints)
    torch.testing.assert_close(back.rotations, motion.rotations, atol=1e-5, rtol=0)
    torch.testing.assert_close(back.root, motion.root, atol=1e-5, rtol=0)


def test_a_smaller_body_takes_smaller_steps(generator, rest_joints):
    rotations = axis_angle_to_matrix(0.1 * torch.randn(9, 24, 3, generator=generator))
    motion = Motion(rotations, torch.randn(9, 3, generator=generator), 30.0)
    small = retarget(motion_to_bvh(motion, rest_joints), rest_joints / 2)
    torch.testing.assert_close(small.root, motion.root / 2, atol=1e-5, rtol=0)
    torch.testing.assert_close(small.rotations, motion.rotations, atol=1e-5, rtol=0)


def test_a_rest_pose_that_is_not_a_t_pose(generator, rest_joints):
    """The same motion told from arms that hang: bones are redrawn along -y, the joints' rotations make up for it."""
    motion = Motion(torch.eye(3).repeat(2, 24, 1, 1), torch.zeros(2, 3), 30.0)
    bvh = motion_to_bvh(motion, rest_joints)
    elbow, wrist, hand = (JOINTS[f"left_{joint}"] for joint in ("elbow", "wrist", "hand"))
    lift = rotation_about("z", torch.tensor(math.pi / 2, dtype=torch.float64))
    rotations, positions = bvh.rotations.clone(), bvh.positions.clone()
    rotations[:, elbow] = lift
    for joint in (wrist, hand):
        positions[:, joint] = positions[:, joint] @ lift
    rotations[:, wrist] = lift.mT
    hanging = replace(bvh, rotations=rotations, positions=positions)
    torch.testing.assert_close(world(hanging)[0][:, wrist].float(), motion.joints(rest_joints)[:, wrist])
    joints = retarget(hanging, rest_joints).joints(rest_joints)
    torch.testing.assert_close(joints[:, wrist], motion.joints(rest_joints)[:, wrist], atol=1e-5, rtol=0)
    copied = forward_kinematics(rotations.float(), motion.root, rest_joints)[0]
    assert (copied[:, wrist] - joints[:, wrist]).norm(dim=-1).min() > 0.2


def test_the_floor_is_below_a_body_that_never_stands(rest_joints):
    """Without a planted sole the floor is under the lowest tenth of the frames."""
    skeleton = replace(SMPL, grounded=True)
    root = torch.stack([torch.zeros(11), torch.linspace(2.0, 3.0, 11), torch.arange(11.0)], dim=1)
    flying = Motion(torch.eye(3).repeat(11, 24, 1, 1), root, 30.0)
    heights = retarget(motion_to_bvh(flying, rest_joints), rest_joints, skeleton).root[:, 1] - rest_joints[0, 1]
    torch.testing.assert_close(heights, torch.linspace(-0.1, 0.9, 11), atol=1e-4, rtol=0)


def test_one_frame_is_enough(rest_joints):
    one = Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0)
    assert len(retarget(motion_to_bvh(one, rest_joints), rest_joints)) == 1


def test_skeletons_are_recognised(clips, rest_joints):
    assert recognise(clips[0].bvh) is BANDAI_NAMCO
    one = Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0)
    bvh = motion_to_bvh(one, rest_joints)
    assert recognise(bvh) is SMPL
    assert recognise(replace(bvh, names=("Hips", *bvh.names[1:]))) is None


def in_other_axes(bvh: Bvh, turn: Tensor) -> Bvh:
    """As a program writes it that takes it into its own axes and back out in these, such as Blender."""
    return replace(
        bvh,
        offsets=bvh.offsets @ turn.mT,
        rotations=turn @ bvh.rotations @ turn.mT,
        positions=bvh.positions @ turn.mT,
        ends=tuple((joint, tuple((turn @ turn.new_tensor(end)).tolist())) for joint, end in bvh.ends),
    )


@pytest.mark.parametrize(("up", "degrees"), [("z", 90.0), ("-z", -90.0), ("-y", 180.0)])
def test_skeletons_are_recognised_where_another_axis_is_up(clips, up, degrees, rest_joints):
    """Bones of a heap along one axis look the same however they are turned about it; runs seldom stand straight."""
    turn = rotation_about("x", torch.tensor(math.radians(degrees), dtype=torch.float64))
    runs = [clip for clip in clips if "_run_" in clip.name or "_dash_" in clip.name]
    assert runs
    for clip in (clips[0], clips[-1], *runs[:4]):
        for bvh in (
            in_other_axes(clip.bvh, turn),
            replace(  # or the root alone carries it
                clip.bvh,
                rotations=torch.cat([turn @ clip.bvh.rotations[:, :1], clip.bvh.rotations[:, 1:]], dim=1),
                positions=torch.cat([clip.bvh.positions[:, :1] @ turn.mT, clip.bvh.positions[:, 1:]], dim=1),
            ),
        ):
            mapping = mapping_of(bvh)
            assert (mapping.skeleton, mapping.up) == ("Bandai-Namco", up), clip.name
            joints = retarget(bvh, rest_joints).joints(rest_joints)
            torch.testing.assert_close(joints, clip.joints, atol=1e-4, rtol=0)


def test_a_bone_without_length_is_refused(rest_joints):
    one = Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0)
    bvh = motion_to_bvh(one, rest_joints)
    bvh.positions[:, JOINTS["left_knee"]] = 0
    with pytest.raises(UserError, match="the bone that ends in left_knee has no length"):
        retarget(bvh, rest_joints)


def test_vectors_of_the_table_are_unit_and_square():
    for place in BANDAI_NAMCO.places.values():
        up, forward = torch.tensor(place.up), torch.tensor(place.forward)
        torch.testing.assert_close(
            torch.stack([normalize(up, dim=0), normalize(forward, dim=0)]), torch.stack([up, forward])
        )
        assert abs(up @ forward) < 1e-6
