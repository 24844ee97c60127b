"""Other people's programs open what is written and find the joints where they are.

Each judge is asked where it is installed and skipped where it is not:

- Khronos' validator and three.js: ``npm install gltf-validator three`` in a folder, NODE_MODULES=folder/node_modules
- trimesh: JUDGES_PYTHON, a Python that has it
- Blender: BPY_PYTHON, a Python that has ``bpy``
"""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from other_programs import JUDGES, python, said

from refine.formats.bvh import world
from refine.formats.fbx import write_fbx
from refine.formats.glb import write_glb
from refine.formats.glb_read import read_takes
from refine.motion import Motion
from refine.synthetic import draw, perform
from renderers.body import Body
from renderers.skeleton import DRAWN_PART_NAMES, JOINT_NAMES

HALF_MILLIMETRE = 5e-4
FRAMES = (0, 1, 23, 59)


@pytest.fixture(scope="module")
def motions(rest_joints) -> list[Motion]:
    names = ("walk", "wave-left-hand")
    return [perform(draw(name, torch.Generator().manual_seed(1)), 60, rest_joints) for name in names]


@pytest.fixture(scope="module")
def written(motions, free_body, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("judged") / "two.glb"
    write_glb(path, motions, free_body)
    return path


@pytest.fixture(scope="module")
def modules() -> str:
    folder = os.environ.get("NODE_MODULES", "")
    if not shutil.which("node") or not Path(folder, "gltf-validator").is_dir() or not Path(folder, "three").is_dir():
        pytest.skip("no node with gltf-validator and three (set NODE_MODULES)")
    return str(Path(folder).resolve())


def assert_there(found: list[dict[str, list[float]]], motion: Motion, rest_joints, frames=FRAMES):
    """The joints of every frame by name, within half a millimetre."""
    true = motion.joints(rest_joints)[list(frames)]
    assert len(found) == len(frames)
    seen = torch.tensor([[place[name] for name in JOINT_NAMES] for place in found])
    assert (seen - true).norm(dim=-1).max() < HALF_MILLIMETRE


def test_the_validator_has_nothing_to_say(modules, written, motions, tmp_path):
    """Not even a hint: about takes, odd labels and rates, one frame, and the full body."""
    odd = replace(motions[0], label='</script>"\x1b\u00e9', fps=23.976, betas=torch.ones(10))
    still = replace(motions[0], rotations=motions[0].rotations[:1], root=motions[0].root[:1], label="")
    write_glb(tmp_path / "odd.glb", [odd, still], Body.free("full"))
    for path in (written, tmp_path / "odd.glb"):
        issues = json.loads(said("node", JUDGES / "validate.cjs", modules, path))
        assert [issues[kind] for kind in ("numErrors", "numWarnings", "numInfos", "numHints")] == [0, 0, 0, 0], issues
        assert issues["messages"] == []


def test_the_validator_sees_what_is_wrong(modules, written, tmp_path):
    """It would have said so."""
    raw = bytearray(written.read_bytes())
    raw[-200:] = bytes([255] * 200)
    (tmp_path / "a.glb").write_bytes(raw)
    assert json.loads(said("node", JUDGES / "validate.cjs", modules, tmp_path / "a.glb"))["numErrors"] > 0


def test_three_js_has_the_joints_where_they_are(modules, written, motions, rest_joints):
    for clip, motion in enumerate(motions):
        seconds = [repr(frame / 30) for frame in FRAMES]
        found = json.loads(said("node", JUDGES / "three_joints.mjs", modules, written, str(clip), *seconds))
        assert_there(found["joints"], motion, rest_joints)
        assert [name for name, _ in found["clips"]] == ["walk", "wave-left-hand"]
        assert found["clips"][clip][1] == pytest.approx(59 / 30, abs=1e-6)


def test_trimesh_loads_the_mesh(written, free_body):
    code = """
import sys, json, trimesh
scene = trimesh.load(sys.argv[1])
mesh = scene.to_geometry()
mesh.merge_vertices(merge_norm=True)
print(json.dumps([mesh.bounds.tolist(), len(mesh.faces), bool(mesh.is_watertight), mesh.volume, len(scene.geometry)]))
"""
    bounds, faces, closed, volume, parts = json.loads(said(python("JUDGES_PYTHON", "trimesh"), "-c", code, written))
    low, high = free_body.rest_vertices.amin(dim=0), free_body.rest_vertices.amax(dim=0)
    np.testing.assert_allclose(bounds, torch.stack([low, high]), atol=1e-6)
    assert (faces, parts) == (len(free_body.faces), len(DRAWN_PART_NAMES))
    assert closed and 0.03 < volume < 0.12  # cubic metres: a person, and its faces look outwards


def blender(path: Path, fps: float, frames=FRAMES) -> dict:
    out = said(python("BPY_PYTHON", "bpy"), JUDGES / "blender_joints.py", path, repr(fps), *map(str, frames))
    return json.loads(out.partition("FOUND ")[2].splitlines()[0])


def test_blender_imports_glb(written, motions, free_body, rest_joints):
    found = blender(written, 30.0)
    assert_there(found["joints"], motions[0], rest_joints)
    assert found["actions"] == {"walk": [0, 59], "wave-left-hand": [0, 59]}
    assert sorted(set(found["materials"])) == sorted(DRAWN_PART_NAMES)
    posed = free_body(motions[0].rotations[list(FRAMES)], motions[0].root[list(FRAMES)]).vertices
    np.testing.assert_allclose(found["low"], posed.amin(dim=1), atol=1e-3)
    np.testing.assert_allclose(found["high"], posed.amax(dim=1), atol=1e-3)


@pytest.mark.parametrize("fps", [30.0, 59.94])
def test_blender_imports_the_fbx_that_it_wrote(motions, free_body, rest_joints, tmp_path, fps):
    python("BPY_PYTHON", "bpy")
    motion = replace(motions[0], fps=fps)
    write_fbx(tmp_path / "a.fbx", motion, free_body)
    assert [path.name for path in tmp_path.iterdir()] == ["a.fbx"]
    found = blender(tmp_path / "a.fbx", fps)
    assert_there(found["joints"], motion, rest_joints)
    assert found["rate"] == pytest.approx(fps, rel=1e-5)
    ((name, (start, end)),) = found["actions"].items()
    assert name.endswith("walk") and (end - start) / round(fps) == pytest.approx(59 / fps, abs=1e-4)
    pelvis = np.array([place["pelvis"] for place in found["joints"]])
    assert pelvis[-1, 2] - pelvis[0, 2] > 1 and (np.array([p["head"][1] for p in found["joints"]]) > 1.2).all()


def test_what_blender_writes_is_read(written, motions, rest_joints, tmp_path):
    """Its exporter gives bones axes of their own and drops keys that say nothing new."""
    code = """
import sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 30
bpy.ops.import_scene.gltf(filepath=sys.argv[1], bone_heuristic="TEMPERANCE")
bpy.ops.export_scene.gltf(filepath=sys.argv[2])
"""
    said(python("BPY_PYTHON", "bpy"), "-c", code, written, tmp_path / "a.glb")
    takes = {take.label: take.bvh for take in read_takes(tmp_path / "a.glb")}
    assert sorted(takes) == ["walk", "wave-left-hand"]
    for motion in motions:
        joints, _ = world(takes[motion.label])
        assert (takes[motion.label].fps, len(joints)) == (30.0, 60)
        order = [takes[motion.label].names.index(name) for name in JOINT_NAMES]
        assert (joints[:, order] - motion.joints(rest_joints)).norm(dim=-1).max() < HALF_MILLIMETRE
