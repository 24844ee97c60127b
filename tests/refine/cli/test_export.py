"""refine export: every format, the flags that change a motion, and what is refused before any work."""

import io
import json
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from refine.cli.export import stems
from refine.cli.main import main
from refine.formats.files import load_motion, load_motions, save_motion
from refine.motion import Motion, mirror, resample
from refine.synthetic import draw, perform
from renderers.body import Body
from renderers.rotations import heading


@pytest.fixture(scope="module")
def walk(tmp_path_factory, free_body) -> Motion:
    """A walk of 2 s, as it is read from its file."""
    motion = perform(draw("walk", torch.Generator().manual_seed(3), 30.0), 60, free_body.rest_joints)
    path = tmp_path_factory.mktemp("clips") / "walk.bvh"
    save_motion(motion, path, free_body)
    return load_motion(path, free_body.rest_joints)


@pytest.fixture
def export(walk, tmp_path, capsys):
    """Runs ``refine export`` on the walk: its exit code and what it printed."""

    def run(*words: str, motions: tuple[str, ...] = (walk.source,)) -> tuple[int, str, str]:
        code = main(["export", *motions, *words])
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


@pytest.mark.parametrize(("suffix", "metres"), [("bvh", 1e-5), ("glb", 1e-5), ("npz", 1e-5), ("json", 1e-5)])
def test_formats_that_keep_rotations_keep_the_motion(export, walk, tmp_path, rest_joints, suffix, metres):
    out = tmp_path / f"new/both.{suffix}"
    code, printed, _ = export("-o", str(out))
    assert code == 0 and printed == f"{out}  1 motion, 60 frames at 30 fps\n"
    back = load_motion(out, rest_joints)
    assert (back.fps, len(back)) == (30.0, 60)
    assert (back.joints(rest_joints) - walk.joints(rest_joints)).norm(dim=-1).max() < metres


def test_a_walk_stays_upright_and_faces_where_it_goes(export, walk, tmp_path, rest_joints):
    for suffix in ("bvh", "glb", "npz", "json", "npy"):
        out = tmp_path / f"walk.{suffix}"
        assert export("-o", str(out))[0] == 0
        joints = load_motion(out, rest_joints, fps30(suffix)).joints(rest_joints)
        assert (joints[:, 15, 1] - joints[:, 0, 1]).min() > 0.4, suffix  # the head is above the pelvis
        assert joints[-1, 0, 2] - joints[0, 0, 2] > 1.0, suffix  # it went towards +z, and not sideways
        assert (joints[-1, 0, 0] - joints[0, 0, 0]).abs() < 0.2, suffix
        assert (joints[:, 16, 0] - joints[:, 17, 0]).min() > 0.2, suffix  # its left shoulder is at +x


def fps30(suffix: str):
    from refine.formats.files import Reading

    return Reading(fps=30.0) if suffix == "npy" else None


def test_joints_are_those_of_the_motion(export, walk, tmp_path, rest_joints):
    assert export("-o", str(tmp_path / "a.npy"))[0] == 0
    np.testing.assert_allclose(np.load(tmp_path / "a.npy"), walk.joints(rest_joints).numpy(), atol=1e-5)


def test_pictures_and_films(export, tmp_path):
    for suffix in ("png", "gif", "mp4"):
        assert export("-o", str(tmp_path / f"a.{suffix}"), "--seconds", "0.2")[0] == 0
    assert cv2.imread(str(tmp_path / "a.png")).std() > 5
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 6 and film.get(cv2.CAP_PROP_FPS) == pytest.approx(30)


def test_the_flags_cut_resample_mirror_and_hold(export, walk, tmp_path, rest_joints):
    out = tmp_path / "a.json"
    assert export("-o", str(out), "--start", "0.5", "--seconds", "1", "--fps", "15")[0] == 0
    back, wanted = load_motion(out, rest_joints), resample(walk, 15.0)
    assert back.fps == 15.0 and len(back) == 15
    torch.testing.assert_close(back.root[1], walk.root[17], atol=1e-5, rtol=0)
    assert len(wanted) > len(back)
    assert export("-o", str(out), "--mirror", "--force")[0] == 0
    torch.testing.assert_close(load_motion(out, rest_joints).root, mirror(walk).root, atol=1e-5, rtol=0)
    assert export("-o", str(out), "--in-place", "--force")[0] == 0
    back = load_motion(out, rest_joints)
    assert back.root[:, [0, 2]].std(dim=0).max() < 1e-6
    torch.testing.assert_close(back.root[:, 1], walk.root[:, 1], atol=1e-5, rtol=0)
    torch.testing.assert_close(heading(back.rotations[:, 0]), heading(walk.rotations[:, 0]), atol=1e-4, rtol=0)


def test_several_motions_go_into_a_folder_or_one_glb(export, walk, tmp_path, rest_joints):
    both = (walk.source, "wave-both-hands")
    code, printed, _ = export("-o", str(tmp_path / "f"), "--format", "npz", "--json", motions=both)
    names = ["walk.npz", "wave-both-hands.npz"]
    assert code == 0 and json.loads(printed)["files"] == [str(tmp_path / "f" / name) for name in names]
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == names
    assert export("-o", str(tmp_path / "a.glb"), motions=both)[0] == 0
    assert [motion.label for motion in load_motions(tmp_path / "a.glb", rest_joints)] == ["walk", "wave-both-hands"]
    # Out of one file, they go by their labels, which a .bvh keeps in its name alone.
    assert export("-o", str(tmp_path / "b"), "--format", "bvh", motions=(str(tmp_path / "a.glb"),))[0] == 0
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == ["walk.bvh", "wave-both-hands.bvh"]
    code, _, error = export("-o", str(tmp_path / "a.bvh"), motions=both)
    assert code == 2 and "2 motions do not go into one .bvh file; add --format bvh" in error


def test_mirrored_files_name_the_other_side(export, tmp_path, rest_joints):
    both = ("wave-left-hand", "left-kicking")
    out = tmp_path / "mirrored"
    assert export("-o", str(out), "--format", "glb", "--mirror", motions=both)[0] == 0
    names = ["wave-right-hand", "right-kicking"]
    assert sorted(path.stem for path in out.iterdir()) == sorted(names)
    assert [load_motion(out / f"{name}.glb", rest_joints).label for name in names] == names
    again = tmp_path / "again"  # now from files
    assert export("-o", str(again), "--format", "bvh", "--mirror", motions=(str(out / "*.glb"),))[0] == 0
    assert sorted(path.name for path in again.iterdir()) == ["left-kicking.bvh", "wave-left-hand.bvh"]


def test_meshes_of_one_motion_lie_in_the_folder_and_of_several_in_folders(export, walk, tmp_path):
    frames = [f"frame_{frame:05d}.obj" for frame in range(3)]
    words = ("--format", "obj", "--seconds", "0.1", "--json")
    code, printed, _ = export("-o", str(tmp_path / "one"), *words)
    assert code == 0 and json.loads(printed)["files"] == [str(tmp_path / "one")]
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == frames
    code, printed, _ = export("-o", str(tmp_path / "two"), *words, motions=(walk.source, "wave-both-hands"))
    folders = [tmp_path / "two" / name for name in ("walk", "wave-both-hands")]
    assert code == 0 and json.loads(printed)["files"] == [str(folder) for folder in folders]
    for folder in folders:
        assert sorted(path.name for path in folder.iterdir()) == frames


def test_one_mesh_is_that_of_the_moment(export, walk, tmp_path):
    code, printed, _ = export("-o", str(tmp_path / "a.obj"), "--start", "0.5")
    assert code == 0 and printed == f"{tmp_path / 'a.obj'}  1 motion, 1 frame at 30 fps\n"
    rows = [line.split() for line in (tmp_path / "a.obj").read_text().splitlines()]
    points = np.array([row[1:] for row in rows if row[0] == "v"], dtype=float)
    posed = Body.free("full")(walk.rotations[15:16], walk.root[15:16]).vertices[0]
    np.testing.assert_allclose(points, posed, atol=2e-6)


def test_names_that_are_alike_are_numbered():
    motions = [SimpleNamespace(source=source, label="") for source in ("a/x.bvh", "b/x.bvh", "x_002.bvh", "../..")]
    assert stems(motions) == ["x", "x_002", "x_002_002", "-"]
    assert stems([SimpleNamespace(source="built-in", label="../etc/passwd")]) == ["-etc-passwd"]


def test_standard_input_and_output(walk, monkeypatch, capsysbinary):
    with open(walk.source, "rb") as stream:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stream.read())))
    assert main(["export", "-", "-o", "-.json"]) == 0
    assert len(json.loads(capsysbinary.readouterr().out)["root"]) == 60


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-o", "a.xyz"), "no format has the suffix '.xyz'; known are .bvh"),
        (("-o", "a.obj", "--seconds", "1"), "is one mesh, and --seconds 1 asks for many; leave it out, or name a"),
        (("-o", "a.bvh", "--seconds", "3"), "has 2 s from 0 s on, 3 s were asked for; ask for at most 2"),
        (("-o", "a.bvh", "--start", "2"), "lasts 2 s, a start at 2 s was asked for"),
        (("-o", "a.bvh", "--start", "-1"), "a start at -1 s was asked for"),
        (("-o", "a.bvh", "--seconds", "nan"), "nan s were asked for"),
        (("-o", "a.bvh", "--fps", "0"), "--fps: expected a positive frame rate, got 0; give"),
        (("-o", "a.fbx"), "is written by Blender, and BPY_PYTHON does not say where that is"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(export, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BPY_PYTHON", raising=False)
    code, out, error = export(*words)
    assert code == 2 and out == "" and message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
