"""The free body's arrays, and the Body against smplx, forward kinematics, finite differences."""

import numpy as np
import pytest
import torch

from renderers.body import Body, BodyArrays, _free_arrays, face_parts
from renderers.camera import frame
from renderers.checks import ShapeError
from renderers.mesh import Mesh
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.silhouette import silhouette
from renderers.skeleton import DRAWN_PART_NAMES, JOINT_NAMES, JOINTS, MIRRORED, PARENTS, forward_kinematics

LEVELS = ("light", "full")
MIRROR = torch.tensor([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module", params=LEVELS)
def arrays(request) -> BodyArrays:
    return _free_arrays(request.param)


@pytest.fixture(scope="module")
def light() -> Body:
    return Body.free("light")


def random_poses(count: int, generator: torch.Generator, spread: float = 0.4) -> tuple[torch.Tensor, torch.Tensor]:
    rotations = axis_angle_to_matrix(torch.randn(count, 24, 3, generator=generator, dtype=torch.float64) * spread)
    return rotations, torch.randn(count, 3, generator=generator, dtype=torch.float64)


def natural_poses(count: int, generator: torch.Generator) -> torch.Tensor:
    """People seen from all sides with lowered arms, more movement in the limbs than in the trunk."""
    spread = torch.full((24,), 0.15)
    for joint, angle in {"hip": 0.4, "knee": 0.5, "shoulder": 0.7, "elbow": 0.6}.items():
        spread[[JOINTS[f"left_{joint}"], JOINTS[f"right_{joint}"]]] = angle
    turns = torch.randn(count, 24, 3, generator=generator) * spread[:, None]
    turns[:, JOINTS["left_shoulder"], 2] -= 0.8
    turns[:, JOINTS["right_shoulder"], 2] += 0.8
    rotations = axis_angle_to_matrix(turns)
    rotations[:, 0] = rotation_about("y", torch.rand(count, generator=generator) * 2 * torch.pi) @ rotations[:, 0]
    return rotations


# -- the baked arrays


def test_sizes_are_those_of_the_two_levels():
    assert 1000 <= len(_free_arrays("light").v_template) <= 2000
    assert len(_free_arrays("full").v_template) <= 14_000


def test_weights_and_regressor_are_averages(arrays):
    np.testing.assert_allclose(arrays.weights.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(arrays.J_regressor.sum(axis=1), 1, atol=1e-6)
    assert arrays.weights.min() >= 0


def test_the_regressor_looks_only_at_what_is_around_the_joint(arrays):
    joints = arrays.J_regressor @ arrays.v_template
    for row, joint in zip(arrays.J_regressor, joints, strict=True):
        used = arrays.v_template[row != 0]
        assert len(used) <= 32
        assert np.linalg.norm(used - joint, axis=1).max() < 0.2
        assert (used.min(axis=0) < joint).all() and (used.max(axis=0) > joint).all()
    assert np.abs(arrays.J_regressor).max() < 0.5


def test_each_edge_has_two_faces_that_pass_it_in_opposite_directions(arrays):
    edges = np.concatenate([arrays.faces[:, [0, 1]], arrays.faces[:, [1, 2]], arrays.faces[:, [2, 0]]])
    directed = {(int(a), int(b)) for a, b in edges}
    assert len(directed) == len(edges)
    assert all((b, a) in directed for a, b in directed)
    euler = len(arrays.v_template) - len(edges) // 2 + len(arrays.faces)
    assert euler == 2 and len(np.unique(arrays.faces)) == len(arrays.v_template)


def test_faces_look_outwards(arrays):
    corners = arrays.v_template[arrays.faces].astype(np.float64)
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.055 < volume < 0.070  # litres of a person of 1.70 m


def test_the_mesh_is_its_own_mirror_image(arrays):
    vertices, image = arrays.v_template, mirror_of(arrays)
    np.testing.assert_allclose(vertices[image] * [-1, 1, 1], vertices, atol=1e-4)
    np.testing.assert_array_equal(image[image], np.arange(len(vertices)))
    np.testing.assert_allclose(arrays.weights[image][:, MIRRORED], arrays.weights, atol=1e-6)
    np.testing.assert_allclose(arrays.J_regressor[:, image][list(MIRRORED)], arrays.J_regressor, atol=1e-6)
    np.testing.assert_allclose(arrays.shapedirs[image] * [[[-1], [1], [1]]], arrays.shapedirs, atol=1e-6)
    faces = {frozenset(face) for face in arrays.faces.tolist()}
    assert {frozenset(image[list(face)].tolist()) for face in faces} == faces


def mirror_of(arrays: BodyArrays) -> np.ndarray:
    """The vertex at the mirrored place, found by rounding to 0.01 mm."""
    keys = np.round(arrays.v_template.astype(np.float64) * 1e5).astype(int)
    place = {tuple(key): index for index, key in enumerate(keys)}
    assert len(place) == len(keys)
    return np.array([place[tuple(key)] for key in keys * [-1, 1, 1]])


def test_the_rest_pose_is_a_t_pose_on_the_floor(arrays):
    vertices, joints = arrays.v_template, dict(zip(JOINT_NAMES, arrays.J_regressor @ arrays.v_template, strict=True))
    assert vertices[:, 1].min() == pytest.approx(0, abs=1e-4)
    assert vertices[:, 1].max() == pytest.approx(1.70, abs=0.02)
    arm = joints["left_wrist"] - joints["left_shoulder"]
    assert arm[0] / np.linalg.norm(arm) > 0.999  # left is +x
    leg = joints["left_ankle"] - joints["left_hip"]
    assert -leg[1] / np.linalg.norm(leg) > 0.99
    assert joints["left_foot"][2] - joints["left_ankle"][2] > 0.1  # faces +z
    palm = vertices[arrays.vertex_ids["lthumb"]] - vertices[arrays.vertex_ids["lpinky"]]
    assert palm[2] > 0.1  # thumbs to the front: palms down
    heights = [joints[name][1] for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
    assert heights == sorted(heights) and np.diff(heights).min() > 0.05
    middle = [name for name in JOINT_NAMES if "left" not in name and "right" not in name]
    np.testing.assert_allclose([joints[name][0] for name in middle], 0, atol=1e-6)


def test_the_first_shape_direction_makes_taller_most(arrays):
    crown = arrays.v_template[:, 1].argmax()
    taller = arrays.shapedirs[crown, 1]
    assert taller[0] > 0.05
    assert taller[0] > 5 * np.abs(taller[1:]).max()
    size = np.linalg.norm(arrays.shapedirs, axis=(0, 1))
    assert size[0] > 5 * size[1:].max()


def test_shapes_keep_the_soles_on_the_floor(arrays):
    soles = arrays.v_template[:, 1] < 0.005
    np.testing.assert_allclose(arrays.shapedirs[soles, 1].mean(axis=0), 0, atol=2e-3)


def test_landmarks_are_where_their_names_say(arrays):
    place = {name: arrays.v_template[index] for name, index in arrays.vertex_ids.items()}
    assert len({*arrays.vertex_ids.values()}) == len(place) == 21
    joints = dict(zip(JOINT_NAMES, arrays.J_regressor @ arrays.v_template, strict=True))
    head = arrays.v_template[arrays.weights[:, JOINTS["head"]] > 0.9]
    assert place["nose"][2] == pytest.approx(head[:, 2].max(), abs=3e-3)
    assert place["nose"][0] == pytest.approx(0, abs=1e-6)
    assert place["leye"][1] > place["nose"][1] and place["leye"][2] > joints["head"][2] + 0.05
    assert place["lear"][0] == pytest.approx(head[:, 0].max(), abs=3e-3)
    for tip in ("thumb", "index", "middle", "ring", "pinky"):
        assert place[f"l{tip}"][0] > joints["left_hand"][0]
        np.testing.assert_allclose(place[f"r{tip}"] * [-1, 1, 1], place[f"l{tip}"], atol=1e-4)
    fingers = [place[f"l{tip}"][2] for tip in ("pinky", "ring", "middle", "index", "thumb")]
    assert fingers == sorted(fingers)
    assert place["LBigToe"][2] > place["LSmallToe"][2] > joints["left_foot"][2] > joints["left_ankle"][2]
    assert place["LBigToe"][0] < place["LSmallToe"][0]
    assert place["LHeel"][2] < joints["left_ankle"][2] - 0.03 and place["LHeel"][1] < 0.05


# -- posing


def test_rest_joints_are_the_same_on_both_levels():
    torch.testing.assert_close(Body.free("light").rest_joints, Body.free("full").rest_joints, atol=1e-5, rtol=0)


@pytest.mark.parametrize("level", LEVELS)
def test_joints_are_those_of_forward_kinematics(level, generator):
    body = Body.free(level).to(dtype=torch.float64)
    rotations, root = random_poses(5, generator)
    joints, _ = forward_kinematics(rotations, root, body.rest_joints)
    torch.testing.assert_close(body(rotations, root).joints, joints, atol=1e-6, rtol=0)


def test_the_body_is_smplx_itself(light, generator):
    """Against smplx.SMPL's other entry: axis-angle, zero pose correctives written out, its own translation."""
    import smplx
    from smplx.utils import Struct

    free = _free_arrays("light")
    data = Struct(
        v_template=free.v_template,
        shapedirs=np.concatenate([free.shapedirs, np.zeros((len(free.v_template), 3, 290))], axis=-1),
        posedirs=np.zeros((len(free.v_template), 3, 207)),
        J_regressor=free.J_regressor,
        weights=free.weights,
        f=free.faces,
        kintree_table=np.array([PARENTS, range(24)]),
    )
    model = smplx.SMPL("", data_struct=data, vertex_ids=free.vertex_ids, batch_size=3)
    turns = torch.randn(3, 24, 3, generator=generator) * 0.4
    transl, shape = torch.randn(3, 3, generator=generator), torch.randn(3, 10, generator=generator)
    with torch.no_grad():
        expected = model(betas=shape, global_orient=turns[:, 0], body_pose=turns[:, 1:].flatten(1), transl=transl)
    posed = light(axis_angle_to_matrix(turns), expected.joints[:, 0], shape)
    torch.testing.assert_close(posed.vertices, expected.vertices, atol=1e-5, rtol=0)
    torch.testing.assert_close(posed.joints, expected.joints[:, :24], atol=1e-5, rtol=0)
    assert (posed.vertices - light(axis_angle_to_matrix(turns), transl, shape).vertices).abs().max() > 0.1


def test_root_is_the_pelvis_whatever_the_shape(light, generator):
    rotations, root = random_poses(4, generator)
    rotations, root = rotations.float(), root.float()
    shape = torch.randn(4, 10, generator=generator) * 2
    torch.testing.assert_close(light(rotations, root, shape).joints[:, 0], root, atol=1e-6, rtol=0)
    torch.testing.assert_close(light(rotations, root).joints[:, 0], root, atol=1e-6, rtol=0)


def test_no_shape_is_shape_zero(light, generator):
    rotations, root = (tensor.float() for tensor in random_poses(2, generator))
    expected = light(rotations, root, torch.zeros(2, 10)).vertices
    torch.testing.assert_close(light(rotations, root).vertices, expected, atol=0, rtol=0)


def test_at_rest_the_body_is_its_template(light):
    posed = light(torch.eye(3).expand(1, 24, 3, 3), light.rest_joints[:1])
    torch.testing.assert_close(posed.vertices[0], light.rest_vertices, atol=1e-5, rtol=0)


@pytest.mark.parametrize("joint", ("left_knee", "neck", "right_shoulder"))
def test_a_joint_moves_only_what_hangs_on_it(light, joint):
    subtree = {JOINTS[joint]}
    for index, parent in enumerate(PARENTS):
        if parent in subtree:
            subtree.add(index)
    rotations = torch.eye(3).repeat(1, 24, 1, 1)
    rotations[0, JOINTS[joint]] = rotation_about("x", torch.tensor(0.7))
    moved = (light(rotations, light.rest_joints[:1]).vertices[0] - light.rest_vertices).norm(dim=-1)
    share = torch.as_tensor(_free_arrays("light").weights)[:, sorted(subtree)].sum(dim=1)
    assert moved[share == 0].max() < 1e-5
    assert moved[share > 0.99].median() > 0.02


def test_gradients_are_those_of_finite_differences(light, generator):
    body = Body.free("light").to(dtype=torch.float64)
    rotations, root = random_poses(2, generator)
    inputs = (rotations, root, torch.randn(2, 10, generator=generator, dtype=torch.float64))
    directions = [torch.randn(tensor.shape, generator=generator, dtype=torch.float64) for tensor in inputs]
    cotangent = torch.randn(2, len(body.rest_vertices), 3, generator=generator, dtype=torch.float64)

    def value(*tensors: torch.Tensor) -> torch.Tensor:
        return (body(*tensors).vertices * cotangent).sum()

    for index, direction in enumerate(directions):
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        (gradient,) = torch.autograd.grad(value(*leaves), leaves[index])
        above, below = (
            [tensor + sign * 1e-5 * direction if at == index else tensor for at, tensor in enumerate(inputs)]
            for sign in (1, -1)
        )
        numeric = (value(*above) - value(*below)) / 2e-5
        assert (gradient * direction).sum().item() == pytest.approx(numeric.item(), rel=1e-6)


def test_frames_of_a_batch_do_not_touch_each_other(light, generator):
    rotations, root = (tensor.float() for tensor in random_poses(3, generator))
    alone = torch.cat([light(rotations[[i]], root[[i]]).vertices for i in range(3)])
    torch.testing.assert_close(light(rotations, root).vertices, alone, atol=1e-5, rtol=0)


def test_pose_correctives_of_a_user_body_count(generator):
    from dataclasses import replace

    free = _free_arrays("light")
    directions = np.zeros((*free.v_template.shape, 207), dtype=np.float32)
    directions[:, 1, 0] = 0.1  # the first entry of the left hip's rotation, minus the identity's
    rotations = torch.eye(3).repeat(1, 24, 1, 1)
    rotations[0, JOINTS["left_hip"]] = rotation_about("y", torch.tensor(0.5))
    root = torch.zeros(1, 3)
    lifted = Body(replace(free, posedirs=directions))(rotations, root).vertices
    offset = (lifted - Body(free)(rotations, root).vertices)[0]
    expected = 0.1 * (np.cos(0.5) - 1)
    torch.testing.assert_close(offset[:, 1], torch.full_like(offset[:, 1], expected), atol=1e-5, rtol=0)


def test_shapes_that_do_not_fit_are_refused(light):
    with pytest.raises(ShapeError, match=r"Body\(root\): expected shape \[N 3\] with N=2, got \[1, 3\]"):
        light(torch.eye(3).expand(2, 24, 3, 3), torch.zeros(1, 3))
    with pytest.raises(ShapeError, match="Body\\(shape\\)"):
        light(torch.eye(3).expand(2, 24, 3, 3), torch.zeros(2, 3), torch.zeros(2, 9))


def test_nothing_is_printed(capfd):
    Body.free("light")
    assert capfd.readouterr() == ("", "")


# -- parts and silhouettes


def test_parts_lie_where_they_should(light):
    centres = light.rest_vertices[light.faces].mean(dim=1)
    part = {name: centres[light.face_parts == index] for index, name in enumerate(DRAWN_PART_NAMES)}
    assert part["left_arm"][:, 0].min() > 0 > part["right_arm"][:, 0].max()
    assert part["left_leg"][:, 0].min() > 0 > part["right_leg"][:, 0].max()
    assert part["head"][:, 1].min() > part["torso"][:, 1].mean() > part["left_leg"][:, 1].mean()
    assert len(part["left_arm"]) == len(part["right_arm"])


def test_a_face_belongs_to_the_part_with_the_most_weight():
    weights = torch.zeros(3, 24)
    weights[0, JOINTS["left_shoulder"]] = weights[1, JOINTS["spine3"]] = 1
    weights[2, JOINTS["left_elbow"]], weights[2, JOINTS["spine3"]] = 0.6, 0.4
    assert face_parts(torch.tensor([[0, 1, 2], [1, 1, 2]]), weights).tolist() == [
        DRAWN_PART_NAMES.index("left_arm"),
        DRAWN_PART_NAMES.index("torso"),
    ]


def test_the_light_silhouette_stands_for_the_full_one(light, generator):
    full, rotations, root = Body.free("full"), natural_poses(50, generator), torch.zeros(50, 3)
    vertices = {body: body(rotations, root).vertices for body in (light, full)}
    cameras = [frame(vertices[full][[i]], (112, 112)) for i in range(50)]
    images = []
    for body in (light, full):
        mesh = Mesh.build(body.faces)
        images.append(torch.cat([silhouette(vertices[body][[i]], mesh, cameras[i]) for i in range(50)]))
    iou = torch.minimum(*images).sum((1, 2, 3)) / torch.maximum(*images).sum((1, 2, 3))
    assert iou.min() >= 0.98
