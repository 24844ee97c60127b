"""Two clips, composed and exported as a person would; then other people's programs say where the joints are.

bvhio and trimesh are asked if JUDGES_PYTHON names a Python that has them, Blender if BPY_PYTHON names one with ``bpy``.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from other_programs import JUDGES, python, said

from refine.cli.main import main
from refine.formats.files import load_motion
from refine.motion import Motion
from renderers.body import Body
from renderers.skeleton import JOINT_NAMES, JOINTS

HALF_MILLIMETRE = 5e-4
FRAMES = (0, 1, 17, 44)


@pytest.fixture(scope="module")
def composed(tmp_path_factory) -> Path:
    """A folder with both.bvh, both.glb and frames/*.obj of one motion of 45 frames."""
    folder = tmp_path_factory.mktemp("composed")
    for name in ("walk", "wave-both-hands"):
        assert main(["export", name, "-o", str(folder / f"{name}.bvh"), "--seconds", "1.5", "--quiet"]) == 0
    clips = [str(folder / f"{name}.bvh") for name in ("walk", "wave-both-hands")]
    both = str(folder / "both.bvh")
    assert main(["compose", *clips, "-o", both, "--steps", "0", "--quiet"]) == 0
    assert main(["export", both, "-o", str(folder / "both.glb"), "--quiet"]) == 0
    obj = ["--format", "obj", "--start", str(FRAMES[2] / 30), "--seconds", str(1 / 30)]
    assert main(["export", both, "-o", str(folder / "frames"), *obj, "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def motion(composed, rest_joints) -> Motion:
    return load_motion(composed / "both.bvh", rest_joints)


def told(*command: object) -> list | dict:
    """The JSON that a judge prints, behind whatever else it prints."""
    printed = said(*command)
    return json.loads((printed.partition("FOUND ")[2] or printed).splitlines()[0])


def places(found: dict, unit: float = 1.0) -> torch.Tensor:
    """[F 24 3] metres."""
    return torch.tensor([[place[name] for name in JOINT_NAMES] for place in found["joints"]]) * unit


def assert_there(seen: torch.Tensor, motion: Motion, rest_joints):
    true = motion.joints(rest_joints)[list(FRAMES)]
    assert (seen - true).norm(dim=-1).max() < HALF_MILLIMETRE
    head, left, right = (seen[:, JOINTS[name]] for name in ("head", "left_hip", "right_hip"))
    assert (head[:, 1] > 1.2).all() and (left[:, 0] > right[:, 0]).all()
    assert seen[-1, 0, 2] - seen[0, 0, 2] > 0.5  # it walks towards +z


def test_bvhio_reads_the_bvh(composed, motion, rest_joints):
    found = told(python("JUDGES_PYTHON", "bvhio"), JUDGES / "bvhio_joints.py", composed / "both.bvh", *FRAMES)
    assert found["frames"] == len(motion) == 45
    assert_there(places(found, 0.01), motion, rest_joints)


def test_blender_reads_the_bvh(composed, motion, rest_joints):
    found = told(python("BPY_PYTHON", "bpy"), JUDGES / "blender_bvh_joints.py", composed / "both.bvh", *FRAMES)
    assert_there(places(found), motion, rest_joints)


def test_blender_reads_the_glb(composed, motion, rest_joints):
    found = told(python("BPY_PYTHON", "bpy"), JUDGES / "blender_joints.py", composed / "both.glb", "30.0", *FRAMES)
    assert_there(places(found), motion, rest_joints)


def test_trimesh_poses_the_glb(composed, motion, rest_joints):
    seconds = [repr(frame / 30) for frame in FRAMES]
    found = told(python("JUDGES_PYTHON", "trimesh"), JUDGES / "trimesh_joints.py", composed / "both.glb", *seconds)
    assert_there(places(found), motion, rest_joints)


def test_trimesh_reads_the_obj(composed, motion):
    code = """
import json, sys, trimesh
mesh = trimesh.load(sys.argv[1], process=False)
print(json.dumps([mesh.vertices.tolist(), mesh.faces.tolist(), bool(mesh.is_watertight), mesh.volume]))
"""
    path = composed / "frames" / "frame_00000.obj"
    vertices, faces, closed, volume = told(python("JUDGES_PYTHON", "trimesh"), "-c", code, path)
    body, frame = Body.free("full"), slice(FRAMES[2], FRAMES[2] + 1)
    np.testing.assert_allclose(vertices, body(motion.rotations[frame], motion.root[frame]).vertices[0], atol=2e-6)
    np.testing.assert_array_equal(faces, body.faces)
    assert closed and 0.03 < volume < 0.12  # cubic metres: a person, and its faces look outwards
