"""GLB out: judged by a reader made of struct, json and NumPy, which poses the mesh from the file alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from gltf_by_hand import Judge

from refine.formats.bvh import read_bvh
from refine.formats.glb import GENERATOR, heaviest, write_glb
from refine.motion import Motion
from refine.skeletons.retarget import retarget
from refine.synthetic import draw, perform
from renderers.body import Body
from renderers.checks import UserError
from renderers.palette import PARTS
from renderers.rotations import axis_angle_to_matrix
from renderers.skeleton import DRAWN_PART_NAMES, JOINT_NAMES, JOINTS, PARENTS


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return perform(draw("walk", torch.Generator().manual_seed(1)), 60, rest_joints)


@pytest.fixture(scope="module")
def written(walk, free_body, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "walk.glb"
    write_glb(path, walk, free_body)
    return path


def test_the_mesh_posed_from_the_file_is_the_body(walk, free_body, written):
    """The same joints, and within 0.1 mm the vertices of the body, where no vertex has more than four joints."""
    judge = Judge(written)
    few = ((free_body.weights > 0).sum(dim=1) <= 4).numpy()
    assert few.mean() > 0.9
    for frame in (0, 17, 59):
        true = free_body(walk.rotations[frame : frame + 1], walk.root[frame : frame + 1])
        joints, vertices = judge.posed(0, frame)
        np.testing.assert_allclose(joints, true.joints[0], atol=2e-6)
        off = np.linalg.norm(vertices - true.vertices[0].numpy(), axis=1)
        assert off[few].max() < 1e-4
        assert off.max() < 6e-3 and off.mean() < 1e-4  # armpits and groin, where up to seven meet


def test_four_joints_a_vertex_cost_little(free_body):
    joints, weights = heaviest(free_body.weights)
    kept = np.take_along_axis(free_body.weights.numpy(), joints.astype(np.int64), axis=1).sum(axis=1)
    assert kept.min() > 0.85
    assert np.abs(weights.sum(axis=1) - 1).max() < 2e-7
    assert (joints[weights == 0] == 0).all()


def test_a_vertex_keeps_the_heaviest_of_its_joints():
    weights = torch.zeros(2, 24)
    weights[0, [3, 5, 7, 9, 11]] = torch.tensor([0.4, 0.1, 0.2, 0.05, 0.25])
    weights[1, 23] = 1.0
    joints, kept = heaviest(weights)
    assert joints.dtype == np.uint8 and kept.dtype == np.float32
    assert joints[0].tolist() == [3, 11, 7, 5]
    np.testing.assert_allclose(kept[0], np.array([0.4, 0.25, 0.2, 0.1]) / 0.95, rtol=1e-6)
    assert (joints[1].tolist(), kept[1].tolist()) == ([23, 0, 0, 0], [1, 0, 0, 0])


def test_the_skeleton_has_smpls_names_and_tree(written, rest_joints):
    judge = Judge(written)
    skin = judge.document["skins"][0]
    assert tuple(judge.nodes[joint]["name"] for joint in skin["joints"]) == JOINT_NAMES
    assert tuple(judge.above.get(joint, -1) for joint in skin["joints"]) == PARENTS
    rest = np.stack([judge.world(joint, {}, 0)[:3, 3] for joint in skin["joints"]])
    np.testing.assert_allclose(rest, rest_joints, atol=1e-6)


def test_a_walk_is_upright_and_faces_z(written):
    """And the wrong readings, y down and z behind, are not what the file holds."""
    joints = np.stack([Judge(written).posed(0, frame)[0] for frame in (0, 30, 59)])
    head, pelvis, toes = (joints[:, JOINTS[name]] for name in ("head", "pelvis", "left_foot"))
    assert ((head - pelvis)[:, 1] > 0.5).all()
    assert (joints[:, JOINTS["left_hip"], 0] > joints[:, JOINTS["right_hip"], 0]).all()
    assert pelvis[-1, 2] - pelvis[0, 2] > 1.0
    assert ((toes - joints[:, JOINTS["left_ankle"]])[:, 2] > 0).all()


def test_times_are_frames_over_the_rate(walk, free_body, tmp_path):
    odd = replace(walk, fps=23.976)
    write_glb(tmp_path / "a.glb", odd, free_body)
    judge = Judge(tmp_path / "a.glb")
    for times, _ in judge.animation(0).values():
        assert times.tolist() == [np.float32(k / 23.976) for k in range(60)]
    assert judge.document["animations"][0]["extras"]["fps"] == 23.976


def test_quaternions_have_length_one_and_do_not_flip(free_body, tmp_path):
    """Two turns of the body and an arm that swings by half a turn: each quaternion is near the one before."""
    angle = torch.linspace(0, 4 * math.pi, 80)
    rotations = torch.eye(3).repeat(80, 24, 1, 1)
    rotations[:, 0] = axis_angle_to_matrix(torch.stack([0 * angle, angle, 0 * angle], dim=-1))
    rotations[:, 16] = axis_angle_to_matrix(torch.stack([3.14 * angle.sin(), 0 * angle, 0 * angle], dim=-1))
    write_glb(tmp_path / "a.glb", Motion(rotations, torch.zeros(80, 3), 30.0), free_body)
    for (_, path), (_, values) in Judge(tmp_path / "a.glb").animation(0).items():
        if path == "rotation":
            assert np.abs(np.linalg.norm(values, axis=1) - 1).max() < 1e-6
            assert (values[1:] * values[:-1]).sum(axis=1).min() > 0.8


def test_every_motion_is_a_take_with_a_name_of_its_own(walk, free_body, tmp_path):
    nameless = replace(walk, label="")
    shaped = replace(walk, betas=torch.tensor([0.5, -1.0]), gender="female")
    write_glb(tmp_path / "a.glb", [walk, nameless, shaped], free_body)
    takes = Judge(tmp_path / "a.glb").document["animations"]
    assert [take["name"] for take in takes] == ["walk", "motion", "walk 2"]
    assert takes[1]["extras"] == {"fps": 30.0, "label": "", "gender": "neutral"}
    assert takes[2]["extras"] == {"fps": 30.0, "label": "walk", "gender": "female", "betas": [0.5, -1.0]}


def test_each_part_has_its_colour_and_all_faces_are_there(free_body, written):
    judge = Judge(written)
    primitives = judge.document["meshes"][0]["primitives"]
    faces = np.concatenate([judge.array(primitive["indices"]).reshape(-1, 3) for primitive in primitives])
    assert sorted(faces.tolist()) == sorted(free_body.faces.tolist())
    materials = judge.document["materials"]
    assert [materials[primitive["material"]]["name"] for primitive in primitives] == list(DRAWN_PART_NAMES)
    linear = np.array(materials[1]["pbrMetallicRoughness"]["baseColorFactor"])
    srgb = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    assert [round(255 * x) for x in srgb] == [*bytes.fromhex(PARTS[1][1:]), 255]


def test_normals_point_outwards(free_body, written):
    judge = Judge(written)
    primitive = judge.document["meshes"][0]["primitives"][0]
    points, normals = (judge.array(primitive["attributes"][name]) for name in ("POSITION", "NORMAL"))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    corner = points[judge.array(primitive["indices"])[:, 0].reshape(-1, 3)]
    faced = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    mean = normals[judge.array(primitive["indices"])[:, 0].reshape(-1, 3)].sum(axis=1)
    assert ((faced * mean).sum(axis=1) > 0).mean() > 0.99


def test_two_seconds_of_the_light_body_take_150_kilobytes(written):
    assert written.stat().st_size < 150_000


def test_the_full_body_is_written_too(walk, tmp_path):
    body = Body.free("full")
    write_glb(tmp_path / "a.glb", walk, body)
    judge = Judge(tmp_path / "a.glb")
    _, vertices = judge.posed(0, 30)
    few = ((body.weights > 0).sum(dim=1) <= 4).numpy()
    true = body(walk.rotations[30:31], walk.root[30:31]).vertices[0].numpy()
    assert np.linalg.norm(vertices - true, axis=1)[few].max() < 1e-4
    assert (tmp_path / "a.glb").stat().st_size < 800_000


def test_a_real_clip(real_clips, free_body, tmp_path):
    motion = retarget(read_bvh(real_clips[7]), free_body.rest_joints, label="clip")
    write_glb(tmp_path / "a.glb", motion, free_body)
    judge = Judge(tmp_path / "a.glb")
    last = len(motion) - 1
    true = motion.joints(free_body.rest_joints)
    for frame in (0, last // 2, last):
        np.testing.assert_allclose(judge.posed(0, frame)[0], true[frame], atol=1e-5)


def test_labels_stay_text(walk, free_body, tmp_path):
    motion = replace(walk, label='</script>"\x1b[31m\n\u00e9')
    write_glb(tmp_path / "a.glb", motion, free_body)
    judge = Judge(tmp_path / "a.glb")
    assert judge.document["animations"][0]["name"] == motion.label
    assert judge.document["asset"] == {"version": "2.0", "generator": GENERATOR}
    raw = (tmp_path / "a.glb").read_bytes()
    assert b"\x1b" not in raw[20 : raw.index(b"BIN\0")]


def test_nothing_to_write_and_no_place_are_said(walk, free_body, tmp_path):
    with pytest.raises(UserError, match="there is no motion to write"):
        write_glb(tmp_path / "a.glb", [], free_body)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        write_glb(tmp_path / "file" / "a.glb", walk, free_body)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
