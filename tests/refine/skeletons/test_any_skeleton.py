"""Any skeleton in: one motion told by many skeletons comes out the same."""

import math

import pytest
import skeleton_variants as variants
import torch
from torch import Tensor

from refine.formats.bvh import UNITS, Bvh, bvh_text, motion_to_bvh, read_bvh, world
from refine.motion import Motion
from refine.skeletons.known import BANDAI_NAMCO, LIMBS
from refine.skeletons.mapping import STRAIGHTEST, ZERO_POSE, mapping_of
from refine.skeletons.retarget import retarget
from refine.synthetic import draw, perform
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, heading, rotation_about, rotation_angle
from renderers.skeleton import JOINTS, forward_kinematics

SIDES = ("left", "right")


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    """A walk that goes round a corner, 40 frames."""
    motion = perform(draw("walk", torch.Generator().manual_seed(3), 30.0), 40, rest_joints)
    turn = rotation_about("y", torch.linspace(0.3, 1.2, 40))
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    return Motion(rotations, (turn @ motion.root[..., None])[..., 0], 30.0, "walk")


@pytest.fixture(scope="module")
def told(walk, rest_joints) -> Bvh:
    return motion_to_bvh(walk, rest_joints)


def angle(first: Tensor, second: Tensor) -> Tensor:
    """Degrees between vectors [... 3]; exact near 0."""
    cross = torch.linalg.cross(first, second).norm(dim=-1)
    return torch.rad2deg(torch.atan2(cross, (first * second).sum(dim=-1)))


def limbs(joints: Tensor) -> Tensor:
    """[T 8 3] from each limb's joint to the next, joints [T 24 3]."""
    return torch.stack([joints[:, JOINTS[end]] - joints[:, JOINTS[start]] for start, end in LIMBS.items()], dim=1)


def check_same(motion: Motion, walk: Motion, rest_joints: Tensor, trunk: float = 0.1, twist: float = 0.1) -> None:
    """Limbs within a tenth of a degree; trunk and twist of limbs within so many degrees."""
    ours, turns = forward_kinematics(motion.rotations, motion.root, rest_joints)
    theirs, expected = forward_kinematics(walk.rotations, walk.root, rest_joints)
    assert angle(limbs(ours), limbs(theirs)).max() < 0.1
    off = torch.rad2deg(rotation_angle(turns.mT @ expected)).amax(dim=0)
    for name in ("pelvis", "spine3", "head"):
        assert off[JOINTS[name]] < trunk, f"{name} is {off[JOINTS[name]]:.1f} degrees off"
    for name in LIMBS:
        assert off[JOINTS[name]] < twist, f"{name} is turned by {off[JOINTS[name]]:.1f} degrees"
    assert torch.rad2deg((heading(motion.rotations[:, 0]) - heading(walk.rotations[:, 0])).abs()).max() < trunk
    torch.testing.assert_close(motion.root[:, [0, 2]], walk.root[:, [0, 2]], atol=0.03, rtol=0)


@pytest.mark.parametrize("naming", variants.NAMINGS)
def test_names(told, walk, rest_joints, naming):
    bvh = variants.renamed(told, variants.smpl_names(naming))
    mapping = mapping_of(bvh)
    assert mapping.skeleton == (naming if naming not in ("another prefix", "Mixamo without prefix") else "Mixamo")
    needed = [name for name in JOINTS if not name.endswith("_hand")]
    assert {name: mapping.joints.get(name) for name in needed} == {name: bvh.names[JOINTS[name]] for name in needed}
    assert (mapping.up, mapping.rest) == ("y", ZERO_POSE)
    assert ("left_hand" in mapping.joints) == (naming in ("SMPL", "CMU (Acclaim)"))
    check_same(retarget(bvh, rest_joints, mapping), walk, rest_joints)


@pytest.mark.parametrize("order", range(4))
def test_names_that_say_nothing(told, walk, rest_joints, order):
    bvh = variants.shuffled(told, order)
    joints = dict(zip(bvh.names, variants.numbered(bvh).names, strict=True))
    bvh = variants.numbered(bvh)
    mapping = mapping_of(bvh)
    assert mapping.joints == {name: joints[name] for name in JOINTS if not name.endswith("_hand")}
    assert mapping.confidence > 0.8 and "left and right are told by where its toes point" in mapping.notes
    check_same(retarget(bvh, rest_joints, mapping), walk, rest_joints)


def turned(degrees: float, axis: str = "z") -> Tensor:
    return rotation_about(axis, torch.tensor(math.radians(degrees), dtype=torch.float64))


RESTS = {
    "A": {"left_shoulder": turned(-45), "right_shoulder": turned(45)},
    "arms down": {"left_shoulder": turned(-85), "right_shoulder": turned(85)},
    "arms ahead": {"left_shoulder": turned(-90, "y"), "right_shoulder": turned(90, "y")},
    "arms down, elbows bent": {
        "left_shoulder": turned(-70),
        "right_shoulder": turned(70),
        "left_elbow": turned(-40, "x"),
        "right_elbow": turned(-40, "x"),
    },
    "legs apart": {
        "left_hip": turned(20),
        "right_hip": turned(-20),
        "left_ankle": turned(-20),
        "right_ankle": turned(20),
    },
    "turned about": {"pelvis": turned(180, "y")},
    "facing x": {"pelvis": turned(90, "y")},
}


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("known", [True, False])
def test_rest_poses(told, walk, rest_joints, rest, known):
    bvh = variants.resting(told, RESTS[rest])
    torch.testing.assert_close(world(bvh)[0], world(told)[0])
    bvh = bvh if known else variants.numbered(bvh)
    # Forearms that are bent in the rest pose may be twisted in it as well: there is no telling.
    check_same(
        retarget(bvh, rest_joints),
        walk,
        rest_joints,
        twist={"arms down, elbows bent": 45, "legs apart": 2}.get(rest, 0.1),
    )


@pytest.mark.parametrize("known", [True, False])
def test_bones_along_x(told, walk, rest_joints, known):
    """The zero pose is a heap: limbs are exact, and trunk and twist are told by the straightest frames."""
    bvh = variants.along_x(told)
    torch.testing.assert_close(world(bvh)[0], world(told)[0])
    bvh = bvh if known else variants.numbered(bvh)
    mapping = mapping_of(bvh)
    assert mapping.rest == STRAIGHTEST
    check_same(retarget(bvh, rest_joints, mapping), walk, rest_joints, trunk=30.0, twist=30.0)


def test_axes_anyhow(told, walk, rest_joints):
    bvh = variants.along_x(told, seed=4)
    torch.testing.assert_close(world(bvh)[0], world(told)[0])
    check_same(retarget(bvh, rest_joints), walk, rest_joints, trunk=30.0, twist=45.0)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("rest", [True, False])
def test_z_up(told, walk, rest_joints, known, rest):
    bvh = variants.z_up(told, rest)
    bvh = bvh if known else variants.numbered(bvh)
    mapping = mapping_of(bvh)
    assert mapping.up == "z" and "z is up in it: turned to y up" in mapping.notes
    check_same(retarget(bvh, rest_joints, mapping), walk, rest_joints)


def test_z_up_with_bones_along_x(told, walk, rest_joints):
    bvh = variants.along_x(variants.z_up(told))
    assert mapping_of(bvh).up == "z"
    check_same(retarget(bvh, rest_joints), walk, rest_joints, trunk=30.0, twist=30.0)


def test_y_down(told, walk, rest_joints):
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    bvh = variants.replace(told, rotations=told.rotations.clone(), positions=told.positions.clone())
    bvh.rotations[:, 0], bvh.positions[:, 0] = flip @ bvh.rotations[:, 0], bvh.positions[:, 0] @ flip
    assert mapping_of(bvh).up == "-y"
    check_same(retarget(bvh, rest_joints), walk, rest_joints)


@pytest.mark.parametrize(("yaw", "knees"), [(37.0, 0.0), (18.0, 0.0), (0.0, 100.0)])
def test_someone_who_lies_is_not_set_up(told, yaw, knees):
    """The rest pose stands, so the motion may lie in any direction; along an axis if the legs are drawn up."""
    lying = variants.replace(told, rotations=torch.eye(3, dtype=torch.float64).repeat(len(told), 24, 1, 1))
    lying.rotations[:, 0] = turned(yaw, "y") @ turned(-90, "x")
    for side in SIDES:
        lying.rotations[:, JOINTS[f"{side}_hip"]] = turned(-0.5 * knees, "x")
        lying.rotations[:, JOINTS[f"{side}_knee"]] = turned(knees, "x")
    assert mapping_of(lying).up == "y"


def test_arms_turned_in_all_the_time(told, walk, rest_joints):
    """Elbows bend forward in the frame of the upper arm: that tells its twist where no rest pose does."""
    rotations = walk.rotations.clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder, elbow = JOINTS[f"{side}_shoulder"], JOINTS[f"{side}_elbow"]
        rotations[:, shoulder] = turned(sign * -75).float() @ turned(-60, "x").float()
        rotations[:, elbow] = turned(sign * -70, "y").float()
    motion = variants.replace(walk, rotations=rotations)
    bvh = variants.along_x(motion_to_bvh(motion, rest_joints), seed=5)
    ours = retarget(bvh, rest_joints)
    found, expected = (forward_kinematics(m.rotations, m.root, rest_joints)[1] for m in (ours, motion))
    off = torch.rad2deg(rotation_angle(found.mT @ expected)).amax(dim=0)
    for side in SIDES:
        assert off[JOINTS[f"{side}_shoulder"]] < 10 and off[JOINTS[f"{side}_elbow"]] < 10


def test_what_a_hand_holds_is_no_hand(told, walk, rest_joints):
    """A thing that hangs aside from the wrist does not turn it."""
    bvh = variants.replace(told, positions=told.positions.clone(), offsets=told.offsets.clone(), ends=())
    for side in SIDES:
        aside = torch.tensor([0.0, 0.0, 0.2], dtype=torch.float64)
        bvh.positions[:, JOINTS[f"{side}_hand"]], bvh.offsets[JOINTS[f"{side}_hand"]] = aside, aside
    names = [name.replace("HandMiddle1", "Torch") for name in variants.smpl_names("Mixamo")]
    motion = retarget(variants.renamed(bvh, names), rest_joints)
    check_same(motion, walk, rest_joints)
    turns = [forward_kinematics(m.rotations, m.root, rest_joints)[1] for m in (motion, walk)]
    off = torch.rad2deg(rotation_angle(turns[0].mT @ turns[1])).amax(dim=0)
    assert max(off[JOINTS[f"{side}_wrist"]] for side in SIDES) < 5


@pytest.mark.parametrize("unit", UNITS)
def test_units(told, walk, rest_joints, tmp_path, unit):
    path = tmp_path / "walk.bvh"
    path.write_text(
        bvh_text(variants.told_otherwise(variants.renamed(told, variants.smpl_names("Mixamo")), "zxy", unit))
    )
    bvh = read_bvh(path)
    assert f"unit: {unit}" in mapping_of(bvh).report()[1]
    check_same(retarget(bvh, rest_joints), walk, rest_joints)


@pytest.mark.parametrize(("axes", "all_positions"), [("xyz", False), ("zyx", True), ("yxz", False), ("yzx", True)])
def test_orders_of_rotations_and_positions_of_joints(told, walk, rest_joints, tmp_path, axes, all_positions):
    path = tmp_path / "walk.bvh"
    bvh = variants.renamed(told, variants.smpl_names("LAFAN1"))
    path.write_text(bvh_text(variants.told_otherwise(bvh, axes, all_positions=all_positions)))
    check_same(retarget(read_bvh(path), rest_joints), walk, rest_joints)


@pytest.mark.parametrize("known", [True, False])
def test_fingers_helpers_and_siblings_in_any_order(told, walk, rest_joints, known):
    bvh = variants.with_fingers_and_more(told)
    bend = torch.sin(torch.linspace(0.0, 6.0, len(bvh)))
    for side in SIDES:
        bvh = variants.with_twist(bvh, f"{side}_elbow", f"{side}_arm_twist", bend)
        bvh = variants.with_twist(bvh, f"{side}_knee", f"{side}_leg_twist", 0.5 * bend)
    places = [bvh.names.index(name) for name in told.names]
    torch.testing.assert_close(world(bvh)[0][:, places], world(told)[0])
    bvh = variants.renamed(bvh, [name if "_" not in name else name.title().replace("_", "") for name in bvh.names])
    bvh = variants.shuffled(bvh)
    names = {name.title().replace("_", ""): name for name in told.names}
    nameless = bvh if known else variants.numbered(bvh)
    mapping = mapping_of(nameless)
    for name, joint in mapping.joints.items():
        if not name.endswith("hand"):
            said = bvh.names[nameless.names.index(joint)]
            assert names.get(said, said) == name
    assert len(mapping.ignored) >= len(bvh.names) - 24
    check_same(retarget(nameless, rest_joints, mapping), walk, rest_joints)


def test_twist_joints_may_bend(told, walk, rest_joints):
    """A limb's bone is that between its joints, in every frame, whatever lies between them."""
    bvh = variants.with_twist(told, "left_elbow", "left_arm_twist", torch.zeros(len(told)))
    place = bvh.names.index("left_arm_twist")
    bvh.rotations[:, place] = turned(20, "y")
    motion = retarget(bvh, rest_joints)
    joints = world(bvh)[0]
    theirs = joints[:, bvh.names.index("left_elbow")] - joints[:, bvh.names.index("left_shoulder")]
    ours = motion.joints(rest_joints)
    ours = ours[:, JOINTS["left_elbow"]] - ours[:, JOINTS["left_shoulder"]]
    assert angle(ours.double(), theirs).max() < 0.1


@pytest.mark.parametrize("bones_along_x", [False, True])
def test_left_and_right_named_the_wrong_way_round(told, walk, rest_joints, bones_along_x):
    bvh = variants.along_x(told) if bones_along_x else told
    mapping = mapping_of(variants.sides_exchanged(bvh))
    assert mapping.joints["left_knee"] == "right_knee"
    assert any("named the wrong way round" in note for note in mapping.notes)
    motion = retarget(variants.sides_exchanged(bvh), rest_joints, mapping)
    loose = (30.0, 30.0) if bones_along_x else (0.1, 0.1)
    check_same(motion, walk, rest_joints, *loose)


def test_fewer_joints_of_the_trunk(told, walk, rest_joints):
    """The turn of a spine of one joint is shared out; a neck may be missing."""
    one = {name: name for name in ("spine1", "spine2", "neck")}
    keep = [joint for joint, name in enumerate(told.names) if name not in one]
    joints, turns = world(told)
    parents = []
    for joint in keep:
        parent = told.parents[joint]
        while parent >= 0 and parent not in keep:
            parent = told.parents[parent]
        parents.append(keep.index(parent) if parent >= 0 else -1)
    above = [keep[parent] if parent >= 0 else 0 for parent in parents]
    rotations, positions = turns[:, keep].clone(), joints[:, keep].clone()
    rotations[:, 1:] = turns[:, above[1:]].mT @ turns[:, keep[1:]]
    positions[:, 1:] = (turns[:, above[1:]].mT @ (joints[:, keep[1:]] - joints[:, above[1:]])[..., None])[..., 0]
    bvh = variants.replace(
        told, names=tuple(told.names[joint] for joint in keep), parents=tuple(parents), positions=positions,
        offsets=positions.mean(dim=0), rotations=rotations, channels=tuple(told.channels[joint] for joint in keep),
        ends=tuple((keep.index(joint), end) for joint, end in told.ends),
    )  # fmt: skip
    mapping = mapping_of(bvh)
    assert mapping.joints["spine3"] == "spine3" and not {"spine1", "spine2", "neck"} & set(mapping.joints)
    motion = retarget(bvh, rest_joints, mapping)
    check_same(motion, walk, rest_joints)
    for below, above in (("spine1", "spine3"), ("neck", "head")):
        first, second = (rotation_angle(motion.rotations[:, JOINTS[name]]) for name in (below, above))
        torch.testing.assert_close(first, second, atol=1e-4, rtol=0)
        assert first.max() > 0.01


def bandai_in_t_pose(bvh: Bvh) -> Bvh:
    """A real clip with SMPL's T-pose for its zero pose, by the known frames of its joints."""
    axes = torch.eye(3, dtype=torch.float64).repeat(len(bvh.names), 1, 1)
    for place in BANDAI_NAMCO.places.values():
        up, ahead = (torch.tensor(axis, dtype=torch.float64) for axis in (place.up, place.forward))
        axes[bvh.names.index(place.joint)] = torch.stack([torch.linalg.cross(up, ahead), up, ahead], dim=1)
    return variants.refolded(bvh, axes)


def test_a_real_clip_by_its_shape(real_clips, rest_joints):
    """As it is, and with a T-pose, under names that say nothing: limbs are those of the known frames, and so are trunk
    and twist but for the few degrees by which feet and shoulder blades were measured."""
    path = next(path for path in real_clips if "walk-turn-left_active" in path.name)
    bvh = read_bvh(path)
    expected = retarget(bvh, rest_joints, BANDAI_NAMCO)
    theirs, turns = forward_kinematics(expected.rotations, expected.root, rest_joints)
    for variant, rest in ((bvh, STRAIGHTEST), (bandai_in_t_pose(bvh), ZERO_POSE)):
        mapping = mapping_of(variants.numbered(variant))
        assert (mapping.rest, mapping.up) == (rest, "y")
        motion = retarget(variants.numbered(variant), rest_joints, mapping)
        ours, found = forward_kinematics(motion.rotations, motion.root, rest_joints)
        assert angle(limbs(ours), limbs(theirs)).max() < 0.1
        off = torch.rad2deg(rotation_angle(found.mT @ turns)).amax(dim=0)
        for name, joint in JOINTS.items():
            loose = any(word in name for word in ("collar", "ankle", "foot", "hand", "wrist"))
            assert off[joint] < (35 if loose else 4), f"{name} is {off[joint]:.1f} degrees off"
        assert (motion.root - expected.root).abs().max() < 0.03


def test_more_joints_of_the_spine(told, walk, rest_joints):
    """Of five the first, the middle and the last count; one that twists is none."""
    bvh = variants.renamed(told, variants.smpl_names("Xsens MVN"))
    for end, name in (("Chest2", "Waist"), ("Chest3", "Ribs"), ("Chest3", "RibsTwist")):
        bvh = variants.with_twist(bvh, end, name, torch.zeros(len(told)))
    mapping = mapping_of(bvh)
    assert [mapping.joints[f"spine{number}"] for number in (1, 2, 3)] == ["Chest", "Chest2", "Chest3"]
    check_same(retarget(bvh, rest_joints, mapping), walk, rest_joints)


@pytest.mark.parametrize(("naming", "note"), [("Blender", "words in its names"), ("", "guessed")])
def test_sides_without_toes_and_bent_knees(rest_joints, naming, note):
    """One pose with stiff legs that end at the ankles, its names unknown but for their sides, or wholly."""
    still = motion_to_bvh(Motion(torch.eye(3).repeat(1, 24, 1, 1), torch.zeros(1, 3), 30.0), rest_joints)
    names = [
        f"q{place}" + (f".{name[0].upper()}" if naming and "_" in name else "") for place, name in enumerate(JOINTS)
    ]
    feet = [JOINTS["left_foot"], JOINTS["right_foot"]]
    keep = [joint for joint in range(24) if joint not in feet]
    bvh = variants.replace(
        still, names=tuple(names[joint] for joint in keep), channels=tuple(still.channels[joint] for joint in keep),
        parents=tuple(keep.index(still.parents[joint]) if joint else -1 for joint in keep), offsets=still.offsets[keep],
        ends=tuple((keep.index(joint), end) for joint, end in still.ends if joint in keep),
        rotations=still.rotations[:, keep], positions=still.positions[:, keep],
    )  # fmt: skip
    about = variants.resting(bvh, {bvh.names[0]: turned(180, "y")})
    for variant in (bvh, *(variants.shuffled(bvh, seed) for seed in range(5)), about if naming else bvh):
        mapping = mapping_of(variant)
        assert any(note in line for line in mapping.notes)
        motion = retarget(variant, rest_joints, mapping)
        torch.testing.assert_close(motion.rotations, torch.eye(3).repeat(1, 24, 1, 1), atol=1e-3, rtol=0)


def test_whatever_comes_is_a_motion_or_one_line(rest_joints):
    """Skeletons of all kinds, poses that no body takes, bones without length, sizes of no body."""
    taken = refused = 0
    for seed in range(80):
        draw_from = torch.Generator().manual_seed(seed)

        def chance(draw_from=draw_from) -> float:
            return torch.rand((), generator=draw_from).item()

        frames = 1 + int(6 * chance())
        turns = axis_angle_to_matrix(1.5 * chance() * torch.randn(frames, 24, 3, generator=draw_from))
        bvh = motion_to_bvh(Motion(turns, torch.randn(frames, 3, generator=draw_from), 30.0), rest_joints)
        bvh = variants.renamed(bvh, variants.smpl_names(list(variants.NAMINGS)[seed % len(variants.NAMINGS)]))
        bvh = variants.along_x(bvh, seed) if chance() < 0.4 else bvh
        bvh = variants.z_up(bvh, chance() < 0.5) if chance() < 0.3 else bvh
        bvh = variants.numbered(bvh) if chance() < 0.4 else bvh
        bvh = variants.shuffled(bvh, seed) if chance() < 0.3 else bvh
        if chance() < 0.3:
            gone = torch.randint(24, (3,), generator=draw_from)
            bvh.positions[:, gone], bvh.offsets[gone] = 0.0, 0.0
        if chance() < 0.2:
            bvh.positions.mul_(10 ** (20 * chance() - 12))
        try:
            motion = retarget(bvh, rest_joints)
        except UserError as error:
            refused += 1
            assert "\n" not in str(error) and error.remedy
        else:
            taken += 1
            assert (torch.linalg.det(motion.rotations) - 1).abs().max() < 1e-3
    assert taken > 20 and refused > 5
