"""GLB in: our own files exactly, and strange rigs as the specification says they move."""

import base64
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gltf_by_hand import Builder, Judge, pack, unpack
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from refine.formats import glb_read
from refine.formats.bvh import read_bvh, world
from refine.formats.files import Reading, load_motion, load_motions, save_motion
from refine.formats.glb import write_glb
from refine.formats.glb_read import read_glb, read_takes
from refine.formats.gltf_rig import pose
from refine.motion import Motion
from refine.skeletons.retarget import retarget
from refine.synthetic import ACTIONS, draw, perform
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import JOINTS

HALF_MILLIMETRE = 5e-4


@pytest.fixture(scope="module")
def walk(rest_joints) -> Motion:
    return perform(draw("walk", torch.Generator().manual_seed(1)), 60, rest_joints)


def off(motion: Motion, other: Motion, rest_joints) -> float:
    """Metres between two motions' joints, at most."""
    return (motion.joints(rest_joints) - other.joints(rest_joints)).norm(dim=-1).max().item()


def write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


# Our own files


@pytest.mark.parametrize("action", ACTIONS)
def test_built_in_actions_come_back(action, free_body, rest_joints, tmp_path):
    motion = perform(draw(action, torch.Generator().manual_seed(3)), 24, rest_joints)
    write_glb(tmp_path / "a.glb", motion, free_body)
    (back,) = read_glb(tmp_path / "a.glb", rest_joints)
    assert off(motion, back, rest_joints) < 1e-5
    torch.testing.assert_close(back.rotations, motion.rotations, atol=1e-5, rtol=0)
    assert (len(back), back.fps, back.label) == (24, 30.0, action)


def test_real_clips_come_back(real_clips, free_body, rest_joints, tmp_path):
    for path in real_clips[5::197]:
        motion = retarget(read_bvh(path), rest_joints, label="clip")
        write_glb(tmp_path / "a.glb", motion, free_body)
        (back,) = read_glb(tmp_path / "a.glb", rest_joints)
        assert (len(back), back.fps) == (len(motion), motion.fps)
        assert off(motion, back, rest_joints) < HALF_MILLIMETRE / 10


def test_takes_come_back_with_what_is_known_of_the_performer(walk, free_body, rest_joints, tmp_path):
    slow = replace(walk, label="slow walk", fps=59.94, betas=torch.tensor([1.5, -2.0]), gender="female")
    write_glb(tmp_path / "a.glb", [walk, slow], free_body)
    first, second = read_glb(tmp_path / "a.glb", rest_joints)
    assert (first.label, first.fps, first.betas, first.gender) == ("walk", 30.0, None, "neutral")
    assert (second.label, second.fps, second.gender) == ("slow walk", 59.94, "female")
    assert second.betas.tolist() == [1.5, -2.0]
    assert off(slow, second, rest_joints) < 1e-5


def test_a_file_is_known_by_its_content(walk, free_body, rest_joints, tmp_path):
    save_motion(walk, tmp_path / "a.glb", free_body)
    (tmp_path / "a.glb").rename(tmp_path / "a.dat")
    assert off(walk, load_motion(tmp_path / "a.dat", rest_joints), rest_joints) < 1e-5


def test_a_motion_without_a_label_is_called_after_its_file(walk, free_body, rest_joints, tmp_path):
    save_motion(replace(walk, label=""), tmp_path / "stroll_07.glb", free_body)
    assert load_motion(tmp_path / "stroll_07.glb", rest_joints).label == "stroll"


def test_one_frame_comes_back(walk, free_body, rest_joints, tmp_path):
    still = replace(walk, rotations=walk.rotations[:1], root=walk.root[:1], fps=24.0)
    write_glb(tmp_path / "a.glb", still, free_body)
    (back,) = read_glb(tmp_path / "a.glb", rest_joints)
    assert (len(back), back.fps) == (1, 24.0)
    assert off(still, back, rest_joints) < 1e-5


def test_a_long_clip_at_a_high_rate_keeps_every_frame(free_body, rest_joints, tmp_path):
    """Seconds in 32 bits are off by a thousandth of a frame, which must not blend neighbours."""
    frames = 3_000
    path = torch.zeros(frames, 3)
    path[:, 0] = torch.arange(frames) % 2
    motion = Motion(torch.eye(3).expand(frames, 24, 3, 3), path, 240.0)
    write_glb(tmp_path / "a.glb", motion, free_body)
    (back,) = read_glb(tmp_path / "a.glb", rest_joints)
    assert (len(back), back.fps) == (frames, 240.0)
    torch.testing.assert_close(back.root, path, atol=1e-6, rtol=0)


@settings(max_examples=12, deadline=None)
@given(
    turns=arrays(np.float64, st.tuples(st.integers(1, 5), st.just(24), st.just(3)), elements=st.floats(-4, 4)),
    fps=st.floats(1, 500),
)
def test_any_rotations_come_back(free_body, rest_joints, tmp_path_factory, turns, fps):
    rotations = axis_angle_to_matrix(torch.from_numpy(turns)).float()
    motion = Motion(rotations, torch.from_numpy(turns[:, 0]).float(), fps, "x")
    path = tmp_path_factory.mktemp("any") / "a.glb"
    write_glb(path, motion, free_body)
    (back,) = read_glb(path, rest_joints)
    assert (len(back), back.fps) == (len(motion), fps)
    torch.testing.assert_close(back.rotations, rotations, atol=1e-5, rtol=0)
    assert off(motion, back, rest_joints) < 2e-5


# The same figure as other programs rig it


def rerigged(path: Path, turns: np.ndarray, size: float, lying: bool, posed_at: int | None) -> bytes:
    """The file with other local axes for every joint (``turns`` [24 3 3], as bones have in Blender), hung on an
    armature that lies on its back and counts in ``1 / size`` metres; the nodes stand as at a frame, or bound."""
    judge = Judge(path)
    animation, skin = judge.animation(0), judge.document["skins"][0]
    frames = len(animation[0, "translation"][0])
    armature = np.eye(4)
    armature[:3, :3] = size * (Rotation.from_euler("x", -90, degrees=True).as_matrix() if lying else np.eye(3))
    axes = np.tile(np.eye(4), (24, 1, 1))
    axes[:, :3, :3] = turns
    builder = Builder()
    worlds = np.stack(
        [[judge.world(joint, animation, frame) for joint in range(24)] for frame in range(frames)]
        + [[judge.world(joint, {}, 0) for joint in range(24)]]
    )
    inner = np.linalg.inv(armature) @ worlds
    inner[..., :3, :3] /= np.linalg.norm(inner[..., :3, :3], axis=-2, keepdims=True)  # joints themselves do not scale
    inner = inner @ axes
    local = inner.copy()
    for joint, parent in judge.above.items():
        local[:, joint] = np.linalg.inv(inner[:, parent]) @ inner[:, joint]
    quaternions = Rotation.from_matrix(local[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(frames + 1, 24, 4)
    clock = builder.add(np.arange(frames) / 30.0)
    samplers, channels, nodes = [], [], []
    stands = -1 if posed_at is None else posed_at
    for joint in range(24):
        for name, values, kind in (("rotation", quaternions, "VEC4"), ("translation", local[:, :, :3, 3], "VEC3")):
            channels.append({"sampler": len(samplers), "target": {"node": joint + 1, "path": name}})
            samplers.append({"input": clock, "output": builder.add(values[:-1, joint], kind)})
        node = {"name": judge.nodes[joint]["name"], "rotation": quaternions[stands, joint].tolist()}
        node["translation"] = local[stands, joint, :3, 3].tolist()
        children = [child + 1 for child, parent in judge.above.items() if parent == joint]
        nodes.append({**node, **({"children": children} if children else {})})
    top = {"name": "Armature", "matrix": armature.T.flatten().tolist(), "children": [1]}
    bound = np.linalg.inv(inner[-1]).transpose(0, 2, 1).reshape(24, 16)
    return builder.glb(
        nodes=[top, *nodes, {"mesh": 0, "skin": 0}],
        skins=[{"joints": [joint + 1 for joint in skin["joints"]], "inverseBindMatrices": builder.add(bound, "MAT4")}],
        animations=[{"name": "walk", "samplers": samplers, "channels": channels}],
        meshes=[{"primitives": []}],
    )


@pytest.mark.parametrize("posed_at", [None, 0, 30])
@pytest.mark.parametrize(("size", "lying"), [(1.0, False), (0.01, True)])
def test_axes_units_and_standing_pose_of_the_rig_do_not_matter(
    walk, free_body, rest_joints, tmp_path, size, lying, posed_at
):
    write_glb(tmp_path / "a.glb", walk, free_body)
    turns = Rotation.random(24, random_state=1).as_matrix()
    path = write(tmp_path / "b.glb", rerigged(tmp_path / "a.glb", turns, size, lying, posed_at))
    (back,) = read_glb(path, rest_joints)
    assert (back.fps, len(back), back.label) == (30.0, 60, "walk")
    assert off(walk, back, rest_joints) < HALF_MILLIMETRE / 10


@pytest.mark.parametrize("posed_at", [None, 30])
def test_the_zero_pose_is_the_bind_pose_upright_and_in_metres(walk, free_body, rest_joints, tmp_path, posed_at):
    """Of a rig that lies on its back and counts in centimetres, and whose nodes may stand in the middle of a step."""
    write_glb(tmp_path / "a.glb", walk, free_body)
    turns = Rotation.random(24, random_state=3).as_matrix()
    (take,) = read_takes(write(tmp_path / "b.glb", rerigged(tmp_path / "a.glb", turns, 0.01, True, posed_at)))
    bvh = replace(take.bvh, positions=take.bvh.offsets[None])
    points = world(replace(bvh, rotations=torch.eye(3, dtype=torch.float64).expand(1, 25, 3, 3)))[0][0]
    pelvis, points = points[1], points[1:]
    order = [take.bvh.names.index(f"{name}") - 1 for name in JOINTS]
    expected = rest_joints.double() - rest_joints[0].double()
    torch.testing.assert_close(points[order] - pelvis, expected, atol=1e-4, rtol=0)


def test_a_walk_is_upright_and_faces_z(walk, free_body, rest_joints, tmp_path):
    write_glb(tmp_path / "a.glb", walk, free_body)
    lying = rerigged(tmp_path / "a.glb", Rotation.random(24, random_state=2).as_matrix(), 0.01, True, None)
    for path in (tmp_path / "a.glb", write(tmp_path / "b.glb", lying)):
        joints = read_glb(path, rest_joints)[0].joints(rest_joints)
        assert (joints[:, JOINTS["head"], 1] - joints[:, JOINTS["pelvis"], 1]).min() > 0.5
        assert joints[-1, 0, 2] - joints[0, 0, 2] > 1.0
        assert (joints[:, JOINTS["left_hip"], 0] > joints[:, JOINTS["right_hip"], 0]).all()


def test_a_skeleton_without_a_skin_is_read_from_how_its_nodes_stand(walk, free_body, rest_joints, tmp_path):
    write_glb(tmp_path / "a.glb", walk, free_body)
    document, binary = unpack(tmp_path / "a.glb")
    del document["skins"], document["meshes"], document["nodes"][24]
    document["scenes"] = [{"nodes": [0]}]
    (back,) = read_glb(write(tmp_path / "b.glb", pack(document, binary)), rest_joints)
    assert off(walk, back, rest_joints) < 1e-5


# Curves


def arm(builder: Builder, sampler: dict, path: str = "rotation", **more) -> bytes:
    """Two joints, of which one property of the second is animated."""
    nodes = [{"name": "upper", "children": [1]}, {"name": "lower", "translation": [0, 1, 0], "children": [2]}]
    nodes.append({"name": "tip", "translation": [0, 1, 0]})
    channel = {"sampler": 0, "target": {"node": 1, "path": path}}
    animation = {"channels": [channel], "samplers": [sampler], **more}
    return builder.glb(nodes=nodes, skins=[{"joints": [0, 1, 2]}], animations=[animation])


def tips(path: Path, fps: float | None = None) -> np.ndarray:
    """[T 3] where the tip goes."""
    (take,) = read_takes(path, fps)
    return world(take.bvh)[0][:, 2].numpy()


UP = np.array([0.0, 1.0, 0.0])
TIMES = [0.5, 0.7, 1.3, 1.5]
AT = 0.5 + np.arange(11) / 10


def test_turns_between_keys_follow_the_shortest_arc(tmp_path):
    builder, keys = Builder(), Rotation.from_rotvec([[0, 0, 0], [2, 0, 0], [0, 0, 1], [0, 3, 0]])
    values = keys.as_quat() * np.array([[1], [-1], [1], [-1]])  # the same rotations, the long way round
    sampler = {"input": builder.add(TIMES), "output": builder.add(values, "VEC4")}
    path = write(tmp_path / "a.glb", arm(builder, sampler, extras={"fps": 10}))
    expected = Slerp(TIMES, keys)(AT).apply([0, 1, 0]) + UP
    np.testing.assert_allclose(tips(path), expected, atol=1e-6)


def test_steps_hold_until_the_next_key(tmp_path):
    builder = Builder()
    values = [[0, 1, 0], [0, 2, 0], [0, 3, 0], [0, 4, 0]]
    sampler = {"input": builder.add(TIMES), "output": builder.add(values, "VEC3"), "interpolation": "STEP"}
    path = write(tmp_path / "a.glb", arm(builder, sampler, "translation", extras={"fps": 10}))
    assert tips(path)[:, 1].round(6).tolist() == [2, 2, 3, 3, 3, 3, 3, 3, 4, 4, 5]


@pytest.mark.parametrize("turning", [False, True])
def test_cubic_splines(tmp_path, turning):
    rng, size = np.random.default_rng(0), 4 if turning else 3
    values, before, after = rng.normal(size=(3, 4, size))
    if turning:
        values = Rotation.from_rotvec([[0, 0, 0], [0.4, 0, 0], [0.4, 0.5, 0], [0, 0.6, 0.3]]).as_quat()
        before, after = 0.2 * before, 0.2 * after
    builder = Builder()
    keys = builder.add(np.stack([before, values, after], axis=1), f"VEC{size}")
    sampler = {"input": builder.add(TIMES), "output": keys, "interpolation": "CUBICSPLINE"}
    path = "rotation" if turning else "translation"
    written = write(tmp_path / "a.glb", arm(builder, sampler, path, extras={"fps": 10}))
    pieces = [
        CubicHermiteSpline(TIMES[k : k + 2], values[k : k + 2], [after[k], before[k + 1]], axis=0) for k in range(3)
    ]
    expected = np.stack([pieces[min(np.searchsorted(TIMES, t, side="right") - 1, 2)](t) for t in AT.round(6)])
    if turning:
        np.testing.assert_allclose(tips(written), Rotation.from_quat(expected).apply([0, 1, 0]) + UP, atol=1e-6)
    else:
        np.testing.assert_allclose(tips(written), expected + UP, atol=1e-6)


def test_scales_that_keep_angles_are_no_rotation(tmp_path):
    builder = Builder()
    sampler = {"input": builder.add([0.0, 1.0]), "output": builder.add([[1, 1, 1], [3, 3, 3]], "VEC3")}
    path = write(tmp_path / "a.glb", arm(builder, sampler, "scale", extras={"fps": 2}))
    np.testing.assert_allclose(tips(path)[:, 1], [2, 3, 4])
    (take,) = read_takes(path)
    torch.testing.assert_close(take.bvh.rotations, torch.eye(3, dtype=torch.float64).expand(3, 3, 3, 3))


@pytest.mark.parametrize(
    ("times", "said", "fps", "expected"),
    [
        (np.arange(50) / 24, {}, None, (24.0, 50)),
        (np.arange(50) * 1.001 / 30, {}, None, (30 / 1.001, 50)),
        (np.arange(900) * 1.001 / 60 + 300, {}, None, (60 / 1.001, 900)),
        (np.arange(50) / 24 + 10, {}, None, (24.0, 50)),
        (np.delete(np.arange(50), [3, 4, 30]) / 25, {}, None, (25.0, 50)),
        (np.arange(50) / 20_000, {}, None, (30.0, 1)),
        ([0.0, 0.5, 2.0], {}, None, (30.0, 61)),
        ([0.25], {}, None, (30.0, 1)),
        ([0.0, 0.5, 2.0], {}, 12.0, (12.0, 25)),
        ([0.0, 0.5, 2.0], {"fps": 60}, 12.0, (60.0, 121)),
        ([0.0, 1.99], {"fps": 2}, None, (2.0, 4)),
    ],
)
def test_the_rate_is_what_is_said_else_that_of_the_keys(tmp_path, times, said, fps, expected):
    builder = Builder()
    values = builder.add(np.tile([0, 0, 0, 1], (len(times), 1)), "VEC4")
    sampler = {"input": builder.add(times), "output": values}
    (take,) = read_takes(write(tmp_path / "a.glb", arm(builder, sampler, extras=said)), fps)
    assert (pytest.approx(expected[0], abs=1e-3), expected[1]) == (take.bvh.fps, len(take.bvh))


def test_whole_numbers_of_sixteen_bits_strides_and_sparse_values(tmp_path):
    """A quaternion as normalised integers, keys between other bytes, and one key that is told apart."""
    builder = Builder()
    quaternions = np.zeros((3, 4), "<i2")
    quaternions[:, 3] = 32767
    rows = np.zeros((3, 8), "<i2")
    rows[:, :4] = quaternions
    clock = builder.add([0.0, 0.1, 0.2])
    builder.add(np.zeros(1))  # a place for the bytes
    start = len(builder.data)
    builder.data += rows.tobytes() + np.array([2], "<u2").tobytes() + b"\0\0"
    half = round(32767 * math.sqrt(0.5))
    builder.data += np.array([half, 0, 0, half], "<i2").tobytes()
    builder.views += [
        {"buffer": 0, "byteOffset": start, "byteLength": rows.nbytes, "byteStride": 16},
        {"buffer": 0, "byteOffset": start + rows.nbytes, "byteLength": 2},
        {"buffer": 0, "byteOffset": start + rows.nbytes + 4, "byteLength": 8},
    ]
    view = len(builder.views) - 3
    sparse = {
        "count": 1,
        "indices": {"bufferView": view + 1, "componentType": 5123},
        "values": {"bufferView": view + 2},
    }
    accessor = {"bufferView": view, "componentType": 5122, "normalized": True, "type": "VEC4", "count": 3}
    builder.accessors.append(accessor | {"sparse": sparse})
    sampler = {"input": clock, "output": len(builder.accessors) - 1}
    path = write(tmp_path / "a.glb", arm(builder, sampler))
    np.testing.assert_allclose(tips(path), [[0, 2, 0], [0, 2, 0], [0, 1, 1]], atol=1e-4)


def test_whole_numbers_may_stand_for_fractions(tmp_path):
    builder = Builder()
    keys = builder.add([[0, 51, 0], [0, 255, 0]], "VEC3", 5121, normalized=True)
    sampler = {"input": builder.add([0.0, 1.0]), "output": keys}
    path = write(tmp_path / "a.glb", arm(builder, sampler, "translation", extras={"fps": 2}))
    np.testing.assert_allclose(tips(path)[:, 1], [1.2, 1.6, 2.0])


@pytest.mark.parametrize("name", ["", "Take 001", "Armature|mixamo.com|Layer0", None, 7])
def test_names_that_nobody_gave_are_no_labels(tmp_path, name):
    builder = Builder()
    sampler = {"input": builder.add([0.0]), "output": builder.add([[0, 0, 0, 1]], "VEC4")}
    more = {} if name is None else {"name": name}
    (take,) = read_takes(write(tmp_path / "a.glb", arm(builder, sampler, **more)))
    assert take.label == ""


# Text and what lies beside it


def as_text(path: Path, uri: str) -> bytes:
    document, binary = unpack(path)
    document["buffers"][0]["uri"] = uri or f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    return json.dumps(document).encode()


def test_text_with_its_bytes_inside_or_beside(walk, free_body, rest_joints, tmp_path):
    write_glb(tmp_path / "a.glb", walk, free_body)
    (tmp_path / "the walk.bin").write_bytes(unpack(tmp_path / "a.glb")[1])
    for name, uri in (("inside.gltf", ""), ("beside.gltf", "the%20walk.bin")):
        (back,) = load_motions(write(tmp_path / name, as_text(tmp_path / "a.glb", uri)), rest_joints)
        assert off(walk, back, rest_joints) < 1e-5


def test_text_is_known_whatever_comes_first_in_it(walk, free_body, rest_joints, tmp_path):
    write_glb(tmp_path / "a.glb", walk, free_body)
    document = json.loads(as_text(tmp_path / "a.glb", ""))
    path = write(tmp_path / "a.gltf", json.dumps(document, sort_keys=True, indent=1).encode())
    assert b'"asset"' not in path.read_bytes()[:4096]
    assert off(walk, load_motion(path, rest_joints), rest_joints) < 1e-5


def test_z_is_up_where_the_reader_says_so(walk, free_body, rest_joints, tmp_path):
    """By the standard it is y, whatever it looks like."""
    write_glb(tmp_path / "a.glb", walk, free_body)
    document, binary = unpack(tmp_path / "a.glb")
    quarter = math.sqrt(0.5)
    document["nodes"].append({"name": "stage", "rotation": [quarter, 0, 0, quarter], "children": [0]})
    document["scenes"] = [{"nodes": [25, 24]}]
    path = write(tmp_path / "b.glb", pack(document, binary))
    said = load_motion(path, rest_joints, Reading(up="z")).joints(rest_joints)
    assert (said[:, JOINTS["head"], 1] - said[:, 0, 1]).min() > 0.5
    plain = load_motion(path, rest_joints).joints(rest_joints)
    assert (plain[:, JOINTS["head"], 2] - plain[:, 0, 2]).min() > 0.5


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "/etc/hostname",
        "sub/a.bin",
        "..%2fsecret.bin",
        "http://host/a.bin",
        "C:a.bin",
        "sub\\a.bin",
        ".",
    ],
)
def test_bytes_elsewhere_are_not_read(walk, free_body, rest_joints, tmp_path, uri):
    folder = tmp_path / "inner"
    (folder / "sub").mkdir(parents=True)
    write_glb(folder / "a.glb", walk, free_body)
    for place in (tmp_path / "secret.bin", folder / "sub" / "a.bin"):
        place.write_bytes(unpack(folder / "a.glb")[1])
    with pytest.raises(UserError, match="only files in the same folder are read"):
        read_glb(write(folder / "a.gltf", as_text(folder / "a.glb", uri)), rest_joints)


def test_a_link_beside_is_not_followed(walk, free_body, rest_joints, tmp_path):
    (tmp_path / "inner").mkdir()
    write_glb(tmp_path / "a.glb", walk, free_body)
    (tmp_path / "a.bin").write_bytes(unpack(tmp_path / "a.glb")[1])
    (tmp_path / "inner" / "a.bin").symlink_to(tmp_path / "a.bin")
    with pytest.raises(UserError, match="is a link"):
        read_glb(write(tmp_path / "inner" / "a.gltf", as_text(tmp_path / "a.glb", "a.bin")), rest_joints)


def test_a_strange_skeleton_is_refused_before_its_frames_are_read(rest_joints, tmp_path, monkeypatch):
    posed = []

    def counted(rig, curves, seconds, close):
        posed.append(len(seconds))
        return pose(rig, curves, seconds, close)

    monkeypatch.setattr(glb_read, "pose", counted)
    builder = Builder()
    sampler = {"input": builder.add([0.0, 20_000.0]), "output": builder.add([[0, 0, 0, 1]] * 2, "VEC4")}
    with pytest.raises(UserError, match="skeleton"):
        read_glb(write(tmp_path / "a.glb", arm(builder, sampler)), rest_joints)
    assert sum(posed) < 100


def test_the_rate_may_be_given_by_the_reader(walk, free_body, rest_joints, tmp_path):
    write_glb(tmp_path / "a.glb", walk, free_body)
    document, binary = unpack(tmp_path / "a.glb")
    del document["animations"][0]["extras"]
    path = write(tmp_path / "b.glb", pack(document, binary))
    assert load_motion(path, rest_joints).fps == 30.0
    half = load_motion(path, rest_joints, Reading(fps=15.0))
    assert (half.fps, len(half)) == (15.0, 30)
    torch.testing.assert_close(half.root, walk.root[::2], atol=1e-5, rtol=0)


def test_turning_the_whole_figure_turns_its_motion(walk, free_body, rest_joints, tmp_path):
    """The wrong reading, a bind pose that does not see the armature above, would give the walk along +z again."""
    write_glb(tmp_path / "a.glb", walk, free_body)
    document, binary = unpack(tmp_path / "a.glb")
    quarter = math.sqrt(0.5)
    document["nodes"].append({"name": "stage", "rotation": [0, quarter, 0, quarter], "children": [0]})
    document["scenes"] = [{"nodes": [25, 24]}]
    (back,) = read_glb(write(tmp_path / "b.glb", pack(document, binary)), rest_joints)
    turn = rotation_about("y", torch.tensor(math.pi / 2))
    (take,) = read_takes(tmp_path / "b.glb")
    torch.testing.assert_close(take.bvh.rotations[:, 0].float(), turn.expand(60, 3, 3), atol=1e-5, rtol=0)
    torch.testing.assert_close(take.bvh.rotations[:, 1].float(), walk.rotations[:, 0], atol=1e-5, rtol=0)
    torch.testing.assert_close(back.joints(rest_joints), walk.joints(rest_joints) @ turn.mT, atol=1e-4, rtol=0)
