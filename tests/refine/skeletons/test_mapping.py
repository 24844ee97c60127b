"""Which joint is which: what is told, edited and read back, and what is no body."""

import json
import os
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
import skeleton_variants as variants
import torch

from refine.formats.bvh import Bvh, bvh_text, motion_to_bvh, read_bvh, world, write_bvh
from refine.formats.files import Reading, load_motion
from refine.motion import Motion
from refine.skeletons.mapping import STRAIGHTEST, ZERO_POSE, Mapping, mapping_of, parse_mapping, read_mapping
from refine.skeletons.retarget import retarget
from refine.synthetic import draw, perform
from renderers.checks import UserError
from renderers.rotations import rotation_angle
from renderers.skeleton import JOINTS, PARENTS, forward_kinematics

JUDGES = os.environ.get("JUDGES_PYTHON")


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return perform(draw("walk", torch.Generator().manual_seed(3), 30.0), 40, rest_joints)


@pytest.fixture(scope="module")
def told(walk, rest_joints) -> Bvh:
    return motion_to_bvh(walk, rest_joints)


@pytest.fixture(scope="module")
def mixamo(told) -> Bvh:
    return variants.renamed(told, variants.smpl_names("Mixamo"))


def test_json_there_and_back(mixamo, tmp_path):
    mapping = mapping_of(variants.z_up(mixamo))
    (tmp_path / "map.json").write_text(mapping.to_json())
    back = read_mapping(tmp_path / "map.json")
    assert (back.joints, back.up, back.rest, back.unit) == (mapping.joints, "z", ZERO_POSE, mapping.unit)
    assert list(json.loads(mapping.to_json())["joints"]) == [name for name in JOINTS if name in mapping.joints]


def test_the_report_says_what_was_done(mixamo):
    bvh = variants.with_fingers_and_more(variants.z_up(mixamo, rest=False))
    lines = mapping_of(bvh).report()
    assert lines[0] == f"skeleton: Mixamo, 22 joints followed, {len(bvh.names) - 22} ignored, confidence 1.00"
    assert lines[1] == "up: z; unit: cm; rest pose: the zero pose"
    assert "note: z is up in it: turned to y up" in lines
    assert "left_knee <- mixamorig:LeftLeg" in lines and "neck <- mixamorig:Neck" in lines
    assert "left_hand, right_hand" in lines[-2] and "skirt0" in lines[-1] and "left_Pinky3" in lines[-1]
    assert all("\n" not in line for line in lines)


def test_an_edited_mapping_is_followed(mixamo, walk, rest_joints, tmp_path):
    """Arms exchanged by hand: what was the left wrist's is the right one's."""
    path = tmp_path / "walk.bvh"
    path.write_text(bvh_text(mixamo))
    values = json.loads(mapping_of(mixamo).to_json())
    joints = values["joints"]
    for joint in ("hip", "knee", "ankle", "foot"):
        joints[f"left_{joint}"], joints[f"right_{joint}"] = joints[f"right_{joint}"], joints[f"left_{joint}"]
    (tmp_path / "map.json").write_text(json.dumps(values))
    motion = load_motion(path, rest_joints, Reading(mapping=tmp_path / "map.json"))
    shin = walk.joints(rest_joints)[:, JOINTS["right_ankle"]] - walk.joints(rest_joints)[:, JOINTS["right_knee"]]
    ours = motion.joints(rest_joints)[:, JOINTS["left_ankle"]] - motion.joints(rest_joints)[:, JOINTS["left_knee"]]
    torch.testing.assert_close(ours, shin, atol=2e-3, rtol=0)


def test_joints_may_be_left_out(mixamo, rest_joints):
    mapping = mapping_of(mixamo)
    spare = ("spine1", "spine2", "neck", "head", "left_collar", "right_collar", "left_foot", "right_foot")
    fewer = replace(mapping, joints={name: joint for name, joint in mapping.joints.items() if name not in spare})
    motion = retarget(mixamo, rest_joints, parse_mapping(json.loads(fewer.to_json())))
    turns = rotation_angle(motion.rotations)
    assert turns[:, [JOINTS[name] for name in ("head", "neck", "left_collar", "left_foot")]].max() < 1e-4
    assert turns[:, JOINTS["left_knee"]].max() > 0.3


def test_up_and_rest_can_be_said(told, mixamo, walk, rest_joints, tmp_path):
    """A lying person in a world with z up, read with and without being told so; a frame that is the T-pose."""
    path = tmp_path / "walk.bvh"
    path.write_text(bvh_text(variants.z_up(mixamo, rest=False)))
    wrong = load_motion(path, rest_joints, Reading(up="y"))
    right = load_motion(path, rest_joints, Reading(up="z"))
    assert (right.rotations - walk.rotations)[:, 0].abs().max() < 1e-3
    assert (wrong.rotations - walk.rotations)[:, 0].abs().max() > 0.5
    still = replace(told, rotations=told.rotations.clone())
    still.rotations[7] = torch.eye(3, dtype=torch.float64)
    heap = variants.along_x(still, seed=2)
    motion = retarget(heap, rest_joints, replace(mapping_of(heap), rest=7))
    ours, theirs = (forward_kinematics(m.rotations, m.root, rest_joints)[1] for m in (motion, walk))
    off = torch.rad2deg(rotation_angle(ours.mT @ theirs))
    off[7] = 0
    assert off[:, [JOINTS[name] for name in JOINTS if "hand" not in name]].max() < 0.5
    with pytest.raises(UserError, match="has no frame 40, which .* takes for the rest pose"):
        retarget(heap, rest_joints, replace(mapping_of(heap), rest=40))


def test_names_must_be_in_the_file(mixamo, rest_joints):
    mapping = mapping_of(mixamo)
    wrong = replace(mapping, joints=dict(mapping.joints) | {"left_knee": "mixamorig:LeftLag"}, source="map.json")
    with pytest.raises(
        UserError, match=r"map.json, joints: unknown name 'mixamorig:LeftLag'; did you mean mixamorig:L"
    ):
        retarget(mixamo, rest_joints, wrong)


GOOD = {"refine_mapping": 1, "joints": {name: name for name in JOINTS}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"refine_mapping": 2}, "'refine_mapping' is not 1"),
        ({"joint": {}}, "unknown name 'joint'; did you mean joints"),
        ({"joints": ["Hips"]}, "'joints' is no table of joint names"),
        ({"joints": {"pelvis": 3}}, "'joints' is no table of joint names"),
        (
            {"joints": {"pelvis": "Hips"}},
            "'joints' lacks left_hip, right_hip, left_knee, right_knee; a body needs them",
        ),
        (
            {"joints": GOOD["joints"] | {"left_hip": "pelvis"}},
            "'joints' has 'pelvis' for pelvis and for left_hip; leave one of them out",
        ),
        ({"joints": {"left_kne": "Hips"}}, "unknown name 'left_kne'; did you mean left_knee"),
        ({"up": "up"}, "'up' is 'up'; known are x, -x, y, -y, z, -z"),
        ({"up": ["y"]}, r"'up' is \['y'\]"),
        ({"unit": "ell"}, "'unit' is 'ell'; known are m, cm, mm, in"),
        ({"rest": -1}, "'rest' is -1; known are"),
        ({"rest": True}, "'rest' is True"),
        ({"rest": ["zero pose"]}, r"'rest' is \['zero pose'\]"),
        ({"rest": 1e999}, "not JSON"),
    ],
)
def test_mappings_that_are_none(tmp_path, change, message):
    path = tmp_path / "map.json"
    path.write_text(json.dumps(GOOD))
    assert read_mapping(path) == Mapping("yours", GOOD["joints"], source=str(path))
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(UserError, match=message) as caught:
        read_mapping(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_hostile_mappings(tmp_path):
    path = tmp_path / "map.json"
    for text in (
        "[" * 100_000,
        "",
        "null",
        "{" * 20,
        '{"refine_mapping": 1, "joints": {"a": ',
        json.dumps(GOOD) + " " * (1 << 21),
    ):
        path.write_text(text)
        start = time.perf_counter()
        with pytest.raises(UserError) as caught:
            read_mapping(path)
        assert time.perf_counter() - start < 1 and "\n" not in str(caught.value)


def test_a_dog_is_no_person():
    dog = variants.on_fours()
    with pytest.raises(UserError, match="no pose of it stands on two legs: it is no person"):
        mapping_of(dog)
    names = {"root": "Hips", "back": "Spine", "chest": "Spine1", "neck": "Neck", "skull": "Head", "tail1": "Tail"}
    for letter, side in (("L", "Left"), ("R", "Right")):
        names |= {f"ham{letter}": f"{side}UpLeg", f"hock{letter}": f"{side}Leg", f"paw{letter}": f"{side}Foot"}
        names |= {f"blade{letter}": f"{side}Arm", f"fore{letter}": f"{side}ForeArm", f"wrist{letter}": f"{side}Hand"}
    with pytest.raises(UserError, match="it goes on four legs in all its frames: it is no person"):
        mapping_of(variants.renamed(dog, [names.get(name, name) for name in dog.names]))


def test_someone_on_hands_and_knees_is_a_person(told, rest_joints):
    """Of a rest pose that stands there is no doubt; without one legs are too long for a dog's."""
    crawling = replace(told, rotations=told.rotations.clone())
    tilt = torch.tensor([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)  # face down
    crawling.rotations[:, 0] = tilt
    down = torch.tensor([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=torch.float64)  # the left arm
    for side, turn in (("left", down), ("right", down.mT)):
        crawling.rotations[:, JOINTS[f"{side}_hip"]] = tilt.mT
        crawling.rotations[:, JOINTS[f"{side}_collar"]] = torch.eye(3, dtype=torch.float64)
        crawling.rotations[:, JOINTS[f"{side}_shoulder"]] = tilt.mT @ turn
    assert mapping_of(crawling).rest == ZERO_POSE
    heap = variants.along_x(variants.renamed(crawling, variants.smpl_names("LAFAN1")))
    assert mapping_of(heap).rest == STRAIGHTEST


def chain(names: list[str], parents: list[int]) -> Bvh:
    return variants.still(names, parents, [(0.1, 0.2, 0.0)] * len(names), frames=3)


@pytest.mark.parametrize(
    ("names", "parents"),
    [
        (["Camera01"], [-1]),
        (["root", "camera", "lens"], [-1, 0, 1]),
        ([f"s{number}" for number in range(40)], list(range(-1, 39))),
        (["face", "jaw", *[f"brow{number}" for number in range(20)]], [-1, *[0] * 21]),
    ],
)
def test_things_are_no_bodies(names, parents):
    with pytest.raises(UserError, match="thing.bvh: .*: it is no body; give the motion of one person"):
        mapping_of(chain(names, parents))


def test_half_a_body_is_refused(told):
    upper = [joint for joint, name in enumerate(told.names) if not name.endswith(("hip", "knee", "ankle", "foot"))]
    place = {joint: index for index, joint in enumerate(upper)}
    bvh = replace(
        told,
        names=tuple(told.names[joint] for joint in upper),
        parents=tuple(place.get(PARENTS[joint], -1) for joint in upper),
        offsets=told.offsets[upper],
        channels=tuple(told.channels[joint] for joint in upper),
        ends=tuple((place[joint], end) for joint, end in told.ends if joint in place),
        rotations=told.rotations[:, upper],
        positions=told.positions[:, upper],
    )
    with pytest.raises(UserError, match="no two legs and two arms among its 16 joints: it is no body"):
        mapping_of(bvh)


@pytest.mark.parametrize("shape", ["a star", "a binary tree", "a comb"])
def test_large_trees_take_no_time(shape):
    count = 1024
    parents = {
        "a star": [-1, *[0] * (count - 1)],
        "a binary tree": [(number - 1) // 2 if number else -1 for number in range(count)],
        "a comb": [-1 if not number else number - 2 if number % 2 == 0 else number - 1 for number in range(count)],
    }[shape]
    start = time.perf_counter()
    with pytest.raises(UserError):
        mapping_of(chain([f"n{number}" for number in range(count)], parents))
    assert time.perf_counter() - start < 2


def test_lafan1_like_files(told, walk, rest_joints, tmp_path):
    """Frames as LAFAN1 has them are found exactly, though its zero pose is a heap."""
    (tmp_path / "walk1.bvh").write_text(bvh_text(variants.like_lafan1(told)))
    bvh = read_bvh(tmp_path / "walk1.bvh")
    mapping = mapping_of(bvh)
    assert (mapping.skeleton, mapping.rest, mapping.confidence) == ("LAFAN1", STRAIGHTEST, 1.0)
    motion = retarget(bvh, rest_joints, mapping)
    ours, theirs = (forward_kinematics(m.rotations, m.root, rest_joints)[1] for m in (motion, walk))
    off = torch.rad2deg(rotation_angle(ours.mT @ theirs)).amax(dim=0)
    for name, joint in JOINTS.items():
        assert off[joint] < (6 if "collar" in name or "wrist" in name else 25 if "hand" in name else 0.1), name


# bvhio 1.5.4 on the file of the test below, centimetres.
BVHIO = {
    (0, "LeftToe"): (12.58277, 2.69798, 9.13970),
    (0, "RightHand"): (-22.60847, 86.51829, 9.42424),
    (0, "LeftForeArm"): (23.85763, 106.15836, 9.46619),
    (0, "Head"): (3.05252, 153.81372, 8.30939),
    (17, "LeftToe"): (12.58279, 8.78474, 20.58009),
    (17, "RightHand"): (-23.14639, 85.86573, 60.73994),
    (17, "LeftForeArm"): (21.43258, 106.31438, 51.85828),
    (17, "Head"): (-2.11662, 153.02280, 52.84969),
}


def test_another_reader_has_the_joints_there(told, tmp_path):
    path = tmp_path / "walk1.bvh"
    path.write_text(bvh_text(variants.like_lafan1(told)))
    bvh = read_bvh(path)
    joints = 100 * world(bvh)[0]
    for (frame, name), place in BVHIO.items():
        expected = torch.tensor(place, dtype=torch.float64)
        torch.testing.assert_close(joints[frame, bvh.names.index(name)], expected, atol=1e-3, rtol=0)


@pytest.mark.skipif(not JUDGES, reason="JUDGES_PYTHON names no Python that has bvhio")
def test_another_reader_is_asked(told, tmp_path):
    path = tmp_path / "walk1.bvh"
    path.write_text(bvh_text(variants.like_lafan1(told)))
    judge = Path(__file__).parents[1] / "formats" / "judges" / "bvhio_joints.py"
    done = subprocess.run([JUDGES, judge, path, "0", "17"], capture_output=True, text=True, check=True)
    bvh = read_bvh(path)
    for frame, there in zip((0, 17), json.loads(done.stdout)["joints"], strict=True):
        for joint, name in enumerate(bvh.names):
            expected = torch.tensor(there[name], dtype=torch.float64)
            torch.testing.assert_close(100 * world(bvh)[0][frame, joint], expected, atol=1e-3, rtol=0)


def test_our_own_files_are_known(walk, rest_joints, tmp_path):
    write_bvh(tmp_path / "a.bvh", walk, rest_joints)
    mapping = mapping_of(read_bvh(tmp_path / "a.bvh"))
    assert (mapping.skeleton, mapping.up, mapping.rest, mapping.notes, mapping.ignored) == (
        "SMPL",
        "y",
        ZERO_POSE,
        (),
        (),
    )
