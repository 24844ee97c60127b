"""FBX out without Blender: what is said when it is not there, or fails. With Blender: test_gltf_judges.py."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

import refine.formats.fbx as fbx
from refine.formats.files import check_suffix, save_motion
from refine.synthetic import draw, perform
from renderers.checks import UserError


@pytest.fixture
def walk(rest_joints):
    return perform(draw("walk", torch.Generator().manual_seed(1)), 5, rest_joints)


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """Makes a program that says it is a Python with bpy, and then does what it is told; arguments are kept."""

    def make(then: str) -> Path:
        path = tmp_path / "blender" / "python"
        path.parent.mkdir()
        path.write_text(f'#!/bin/sh\n[ "$2" = -c ] && echo True && exit\necho "$@" > {path.parent}/called\n{then}\n')
        path.chmod(0o755)
        monkeypatch.setenv("BPY_PYTHON", str(path))
        return path.parent / "called"

    return make


def test_without_blender_the_way_to_it_is_said(walk, free_body, tmp_path, monkeypatch):
    """Before any work is done, in one line that can be followed."""
    monkeypatch.delenv("BPY_PYTHON", raising=False)
    for refuse in (lambda: check_suffix("a.fbx"), lambda: save_motion(walk, tmp_path / "a.fbx", free_body)):
        with pytest.raises(UserError) as caught:
            refuse()
        message = str(caught.value)
        assert message.startswith(".fbx: is written by Blender, and BPY_PYTHON does not say where that is; install bpy")
        assert "bpy/bin/pip install bpy" in message and "\n" not in message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("python", "said"),
    [
        ("/nowhere/python", "is no program"),
        (sys.executable, "is no Python that has the module bpy"),
        ("true", "is no Python"),
    ],
)
def test_a_python_without_blender_is_said(python, said, monkeypatch):
    monkeypatch.setenv("BPY_PYTHON", python)
    with pytest.raises(UserError, match=f"^BPY_PYTHON: {python} {said}"):
        fbx.blender_python()


def test_blender_gets_a_glb_and_the_rate_and_its_file_is_taken(walk, free_body, tmp_path, blender):
    called = blender('cp "$3" "$4"')
    save_motion(walk, tmp_path / "out" / "a.fbx", free_body)
    assert (tmp_path / "out" / "a.fbx").read_bytes().startswith(b"glTF")
    isolated, script, source, _, fps = called.read_text().split()
    assert (isolated, Path(script).name, fps) == ("-I", "fbx_blender.py", "30.0")
    assert not Path(source).parent.exists()


@pytest.mark.parametrize("before", ["echo working", 'cp "$3" "$4"'])
def test_blender_that_fails_is_said(walk, free_body, tmp_path, blender, before):
    """Also where it left half a file."""
    blender(f'{before}; echo "no memory" >&2; exit 3')
    with pytest.raises(UserError, match=r"Blender did not write it \(no memory\)"):
        fbx.write_fbx(tmp_path / "out" / "a.fbx", walk, free_body)
    assert not (tmp_path / "out").exists()


def test_blender_that_writes_nothing_is_said(walk, free_body, tmp_path, blender):
    blender("echo done")
    with pytest.raises(UserError, match=r"Blender did not write it \(done\)"):
        fbx.write_fbx(tmp_path / "a.fbx", walk, free_body)


def test_blender_that_does_not_end_is_ended(walk, free_body, tmp_path, blender, monkeypatch):
    blender("exec sleep 60")
    monkeypatch.setattr(fbx, "SECONDS", 0.3)
    with pytest.raises(UserError, match="did not end within 0.3 seconds"):
        fbx.write_fbx(tmp_path / "a.fbx", walk, free_body)
    assert not (tmp_path / "a.fbx").exists()


def test_the_script_for_blender_is_not_imported():
    """It stands for itself: here it can only say that there is no bpy."""
    done = subprocess.run([sys.executable, "-I", str(fbx.SCRIPT), "a", "b", "30"], capture_output=True, text=True)
    assert "No module named 'bpy'" in done.stderr
