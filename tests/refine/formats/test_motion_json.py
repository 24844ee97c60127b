"""Motions as JSON: there and back, by hand too, and what is no motion."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from refine.formats.files import load_motion, save_motion
from refine.formats.motion_json import read_motion_json, write_motion_json
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from renderers.skeleton import PARENTS


def motion_of(seed: int, frames: int = 5, **about) -> Motion:
    random = torch.Generator().manual_seed(seed)
    rotations = axis_angle_to_matrix(torch.randn(frames, 24, 3, generator=random) * 2)
    return Motion(rotations, torch.randn(frames, 3, generator=random), 29.97, "walk", **about)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), frames=st.integers(1, 20))
def test_there_and_back(tmp_path_factory, free_body, seed, frames):
    motion = motion_of(seed, frames, betas=torch.linspace(-1, 1, 10), gender="female")
    path = tmp_path_factory.mktemp("json") / "a.json"
    save_motion(motion, path, free_body)
    back = load_motion(path, free_body.rest_joints)
    assert (back.fps, back.label, back.gender, back.source) == (29.97, "walk", "female", str(path))
    torch.testing.assert_close(back.betas, motion.betas)
    for made, wanted in zip(
        (back.joints(free_body.rest_joints), back.rotations),
        (motion.joints(free_body.rest_joints), motion.rotations),
        strict=True,
    ):
        torch.testing.assert_close(made, wanted, atol=2e-6, rtol=0)


def test_another_program_finds_the_joints(tmp_path, free_body):
    motion = motion_of(1)
    write_motion_json(tmp_path / "a.json", motion, free_body)
    found = json.loads((tmp_path / "a.json").read_text())
    rest, root = np.array(found["rest_joints"]), np.array(found["root"])
    local = np.array(found["rotations"])[..., [1, 2, 3, 0]]  # SciPy's order
    joints, turned = [], []
    for joint, parent in enumerate(found["parents"]):
        own = Rotation.from_quat(local[:, joint])
        turned.append(own if parent < 0 else turned[parent] * own)
        joints.append(root if parent < 0 else joints[parent] + turned[parent].apply(rest[joint] - rest[parent]))
    ours = motion.joints(free_body.rest_joints).numpy()
    np.testing.assert_allclose(np.stack(joints, 1), ours, atol=2e-6)
    assert tuple(found["parents"]) == PARENTS
    steps = np.abs(np.diff(np.array(found["rotations"]), axis=0)).max()
    flipped = np.einsum("tjq,tjq->tj", *(np.array(found["rotations"])[some] for some in (slice(1, None), slice(-1))))
    assert steps < 2 and flipped.min() >= -1e-6


def test_the_example_of_the_page_finds_the_joints(tmp_path, free_body, monkeypatch):
    page = (Path(__file__).parents[3] / "docs" / "json.md").read_text()
    code = page.partition("```python\n")[2].partition("```")[0]
    motion, found = motion_of(2), {}
    write_motion_json(tmp_path / "both.json", motion, free_body)
    monkeypatch.chdir(tmp_path)
    exec(code, found)  # our own page
    np.testing.assert_allclose(found["joints"], motion.joints(free_body.rest_joints), atol=2e-6)
    written = json.loads((tmp_path / "both.json").read_text())
    assert all(f"`{key}`" in page for key in (*written, "betas"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "is JSON, but no motion"),
        ({"version": 2}, "is of version 2, and 1 is read"),
        ({"joints": ["a"]}, "names other joints"),
        ({"fps": "30"}, "no fps, label or gender"),
        ({"fps": True}, "no fps, label or gender"),
        ({"fps": -1}, "frame rate -1"),
        ({"gender": "x"}, "no fps, label or gender"),
        ({"root": [[0, 0]] * 5}, "'root' is no list of finite numbers, frames by 3"),
        ({"root": [[0, 0, 0]] * 4}, "has 4 places and 5 poses"),
        ({"root": []}, "'root' is no list"),
        ({"root": [[0, 0, 1e300]] * 5}, "'root' is no list"),
        ({"rotations": [[[2, 0, 0, 0]] * 24] * 5}, "no unit quaternions"),
        ({"rotations": [[[True, 0, 0, 0]] * 24] * 5}, "'rotations' is no list"),
        ({"betas": [[1]]}, "'betas' is no list of finite numbers"),
    ],
)
def test_what_is_no_motion_is_refused(tmp_path, free_body, change, message):
    path = tmp_path / "a.json"
    write_motion_json(path, motion_of(1), free_body)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=message):
        read_motion_json(path)


def test_many_empty_lists_are_refused_before_they_are_made(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"format": "refine-motion", "root": [' + "[]," * 100_000 + "[]]}")
    with pytest.raises(UserError, match="is JSON, but no motion"):
        read_motion_json(path)


def test_what_could_not_be_read_again_is_not_written(tmp_path, free_body, monkeypatch):
    monkeypatch.setattr("refine.formats.motion_json.MAX_BYTES", 1000)
    with pytest.raises(UserError, match="more than the 1,000 that are read; cut it"):
        write_motion_json(tmp_path / "a.json", motion_of(1), free_body)
    assert not list(tmp_path.iterdir())
