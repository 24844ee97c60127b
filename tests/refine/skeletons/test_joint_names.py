"""Joint names as programs and data sets write them."""

import pytest

from refine.skeletons.joint_names import NEEDED, by_name, read_names


def sided(pattern: str, sides: str, names: str) -> list[str]:
    """All names of the first side, then all of the other."""
    return [pattern.format(s=side, n=name) for side in sides.split() for name in names.split()]


SIDED = {
    "mixamo": sided(
        "mixamorig:{s}{n}",
        "Left Right",
        "UpLeg Leg Foot ToeBase Toe_End Shoulder Arm ForeArm Hand HandThumb1 HandIndex1",
    ),
    "biped": sided(
        "Bip01 {s} {n}", "L R", "Thigh Calf Foot Toe0 Toe0Nub Clavicle UpperArm Forearm Hand Finger0 Finger01"
    ),
    "unreal": sided(
        "{n}_{s}",
        "l r",
        "thigh thigh_twist_01 calf foot ball clavicle upperarm upperarm_twist_01 lowerarm hand index_01",
    ),
    "rigify": sided("{n}.{s}", "L R", "pelvis thigh shin foot toe heel.02 shoulder upper_arm forearm hand f_index.01"),
    "vrm": sided("J_Bip_{s}_{n}", "L R", "UpperLeg LowerLeg Foot ToeBase Shoulder UpperArm LowerArm Hand Index1"),
    "daz": sided(
        "{s}{n}", "l r", "ThighBend ThighTwist Shin Foot Toe Collar ShldrBend ShldrTwist ForearmBend ForearmTwist Hand"
    ),
    "kinect": sided("{n}{s}", "Left Right", "Hip Knee Ankle Foot Shoulder Elbow Wrist HandTip"),
    "acclaim": sided(
        "{s}{n}", "l r", "hipjoint femur tibia foot toes clavicle humerus radius wrist hand fingers thumb"
    ),
    "makehuman": sided(
        "{n}.{s}",
        "L R",
        "upperleg01 upperleg02 lowerleg01 lowerleg02 foot toe1-1 clavicle shoulder01 upperarm01 upperarm02 lowerarm01 "
        "lowerarm02 wrist finger1-1",
    ),
    "rokoko": sided("{s}{n}", "Left Right", "Thigh Shin Foot Toe Shoulder Arm ForeArm Hand"),
    "loud": sided("{s}_{n}", "LEFT RIGHT", "HIP KNEE ANKLE FOOT COLLAR SHOULDER ELBOW WRIST HAND"),
}
TRUNK = {
    "mixamo": ["mixamorig:Hips", "mixamorig:Spine", "mixamorig:Spine1", "mixamorig:Neck", "mixamorig:Head"],
    "biped": ["Bip01", "Bip01 Pelvis", "Bip01 Spine", "Bip01 Neck", "Bip01 Head", "Bip01 HeadNub"],
    "unreal": ["root", "pelvis", "spine_01", "spine_02", "neck_01", "head"],
    "rigify": ["spine", "spine.001", "spine.003", "spine.006"],
    "vrm": ["J_Bip_C_Hips", "J_Bip_C_Spine", "J_Bip_C_Chest", "J_Bip_C_Neck", "J_Bip_C_Head"],
    "daz": ["hip", "abdomenLower", "chestUpper", "neckLower", "head"],
    "kinect": ["SpineBase", "SpineMid", "Neck", "Head"],
    "acclaim": ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"],
    "makehuman": ["root", "spine05", "spine01", "neck01", "head", "jaw"],
    "rokoko": ["Hips", "Spine", "Spine2", "Neck", "Head"],
    "loud": ["PELVIS", "SPINE1", "SPINE2", "NECK", "HEAD"],
}
# hip, knee, ankle, shoulder, elbow, wrist of the left; then the skeleton that it is taken for.
EXPECTED = {
    "mixamo": ("UpLeg Leg Foot Arm ForeArm Hand", "Mixamo"),
    "biped": ("Thigh Calf Foot UpperArm Forearm Hand", "3ds Max Biped"),
    "unreal": ("thigh calf foot upperarm lowerarm hand", "Unreal"),
    "rigify": ("thigh shin foot upper_arm forearm hand", "Blender"),
    "vrm": ("UpperLeg LowerLeg Foot UpperArm LowerArm Hand", "VRM"),
    "daz": ("ThighBend Shin Foot ShldrBend ForearmBend Hand", "Daz"),
    "kinect": ("Hip Knee Ankle Shoulder Elbow Wrist", "Kinect"),
    "acclaim": ("femur tibia foot humerus radius wrist", "CMU (Acclaim)"),
    "makehuman": ("upperleg01 lowerleg01 foot upperarm01 lowerarm01 wrist", "of mixed names"),
    "rokoko": ("Thigh Shin Foot Arm ForeArm Hand", "of mixed names"),
    "loud": ("HIP KNEE ANKLE SHOULDER ELBOW WRIST", "SMPL"),
}


@pytest.mark.parametrize("rig", SIDED)
def test_limbs(rig):
    names = [*TRUNK[rig], *SIDED[rig]]
    named = by_name(names)
    limbs, skeleton = EXPECTED[rig]
    assert named.skeleton == skeleton
    left = SIDED[rig][: len(SIDED[rig]) // 2]
    for joint, word in zip(NEEDED, limbs.split(), strict=True):
        found = names[named.joints[f"left_{joint}"]]
        assert found in left and word in found
        assert names[named.joints[f"right_{joint}"]] == SIDED[rig][len(left) + left.index(found)]
    head = next((name for name in TRUNK[rig] if name.lower().endswith("head")), None)
    assert ("head" in named.joints) == (head is not None)


@pytest.mark.parametrize("prefix", ["mixamorig1:", "Armature|Character:", "Hero_", "hero.rig:", "mixamorig"])
def test_prefixes_of_any_kind(prefix):
    plain = [name.removeprefix("mixamorig:") for name in (*TRUNK["mixamo"], *SIDED["mixamo"])]
    assert by_name([prefix + name for name in plain]) == by_name(plain)
    assert by_name(plain).skeleton == "Mixamo"


def test_helpers_are_told():
    words = read_names(
        ["LeftArm", "LeftArmTwist", "LeftHandIndex1", "LeftEye", "Jaw", "LeftToe_End", "IK_Foot_L", "Hips"]
    )
    assert [word.helper for word in words] == [False, True, True, True, True, True, True, False]


@pytest.mark.parametrize("left_out", ["Leg", "ForeArm", "Hand"])
def test_a_skeleton_without_a_joint_is_not_named(left_out):
    assert by_name([name for name in SIDED["mixamo"] if not name.endswith(f":Left{left_out}")]) is None


def test_strange_names():
    for names in ([], [""], ["L"], ["左腕", "右腕"], ["l_"] * 3, ["::|"], ["123"], ["x" * 256]):
        assert by_name(names) is None
        assert len(read_names(names)) == len(names)
