"""Inspection: what files are, and the page that says so."""

import html
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.formats.amass import write_amass
from refine.formats.bvh import motion_to_bvh, write_bvh
from refine.formats.clips import save_clips
from refine.formats.describing import bones_of, describe
from refine.formats.files import Reading, save_motion
from refine.inspection import InspectConfig, inspect
from refine.inspection_report import PAGE, SHEET, VALUES, chosen, lines, write_report
from refine.motion import Motion
from refine.skeletons.mapping import mapping_of
from refine.synthetic import draw, perform
from renderers.checks import UserError


@pytest.fixture(scope="module")
def act(rest_joints):
    def perform_one(name: str, frames: int = 40) -> Motion:
        return perform(draw(name, torch.Generator().manual_seed(1), 30.0), frames, rest_joints)

    return perform_one


@pytest.fixture
def folder(tmp_path, act, rest_joints, free_body) -> Path:
    folder = tmp_path / "in"
    write_bvh(folder / "walk_01.bvh", act("walk"), rest_joints)
    write_amass(folder / "squat_01.npz", act("squat"))
    write_amass(folder / "squat_02.npz", replace(act("squat"), fps=37.0))
    save_motion(act("punching"), folder / "punch.glb", free_body)
    save_motion(act("punching"), folder / "punch.npy", free_body)
    save_motion(act("punching"), folder / "punch.json", free_body)
    (folder / "settings.json").write_text('{"format": "other"}')
    save_clips(folder / "packed.npz", [replace(act("walk"), source="one"), replace(act("squat"), source="other")])
    (folder / "broken.bvh").write_text("HIERARCHY\n")
    return folder


def test_a_folder_of_all_kinds(folder, rest_joints):
    found = inspect(folder, rest_joints)
    kinds = [(file.source, file.kind, file.up, file.unit, len(file.clips)) for file in found.files]
    assert kinds == [
        ("broken.bvh", "", "y", "m", 0),
        ("packed.npz", "packed clips", "y", "m", 2),
        ("punch.glb", "GLB", "y", "m", 1),
        ("punch.json", "motion as JSON", "y", "m", 1),
        ("punch.npy", "joints .npy", "y", "1 m", 1),
        ("squat_01.npz", "AMASS-style .npz", "z", "m", 1),
        ("squat_02.npz", "AMASS-style .npz", "z", "m", 1),
        ("walk_01.bvh", "BVH", "y", "cm", 1),
    ]
    assert found.files[-1].unit_by == "guessed from the size of the skeleton"
    assert found.labels() == {"punch": 1, "punching": 2, "squat": 3, "walk": 2}
    assert found.oddities() == {"odd frame rate": 1}
    [problem] = found.unread
    assert "broken.bvh" in problem
    by_source = {clip.source: clip for clip in found.clips}
    assert by_source["packed.npz/other"].label == "squat"
    walk = by_source["walk_01.bvh"]
    assert (walk.frames, walk.fps, round(walk.seconds, 3)) == (40, 30.0, 1.333) and abs(walk.facing) < 5
    assert walk.travel == pytest.approx(by_source["packed.npz/one"].travel, abs=2e-3) and walk.travel > 0.5


def test_workers_find_the_same(folder, rest_joints):
    assert inspect(folder, rest_joints, InspectConfig(workers=2)).values() == inspect(folder, rest_joints).values()


def test_what_is_said_of_a_file_is_believed(tmp_path, act, rest_joints):
    write_bvh(tmp_path / "walk.bvh", act("walk"), rest_joints)
    [file] = inspect(tmp_path / "walk.bvh", rest_joints, InspectConfig(Reading(unit="m"))).files
    assert (file.unit, file.unit_by) == ("m", "as said")
    [oddity] = [oddity for oddity in file.clips[0].oddities if oddity.name == "odd body"]
    assert "m high" in oddity.text and float(oddity.text.split()[3]) > 100


def test_a_file_with_another_axis_up_is_noted(tmp_path, act, rest_joints):
    write_amass(tmp_path / "y.npz", act("walk"))
    noted = inspect(tmp_path / "y.npz", rest_joints, InspectConfig(Reading(up="y"))).files[0]
    assert noted.notes == ("it lies: likely z is up in it; then read it with --up z",)
    assert "wrong up axis" in {o.name for o in noted.clips[0].oddities}
    from refine.formats.amass import read_amass

    fallen = read_amass(tmp_path / "y.npz", "y")  # what a file with y up looks like when it is read with z up
    write_amass(tmp_path / "fallen.npz", replace(fallen, rotations=upright(fallen)))
    assert inspect(tmp_path / "fallen.npz", rest_joints).files[0].notes[0].startswith("it lies: likely y is up")
    np.save(tmp_path / "z.npy", act("walk").joints(rest_joints)[..., [0, 2, 1]] * torch.tensor([1.0, -1.0, 1.0]))
    assert inspect(tmp_path / "z.npy", rest_joints).files[0].notes[-1].startswith("it lies: likely z is up")
    assert len(inspect(tmp_path / "z.npy", rest_joints, InspectConfig(Reading(up="z"))).files[0].notes) == 1


def upright(motion: Motion) -> torch.Tensor:
    """Turned back by a quarter twice: as if y had been taken for z."""
    turn = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ turn @ rotations[:, 0]
    return rotations


def test_bones_are_those_of_the_file(act, rest_joints):
    bvh = motion_to_bvh(act("walk"), 1.1 * rest_joints)
    bones = bones_of(bvh, mapping_of(bvh))
    thigh = 1.1 * float((rest_joints[4] - rest_joints[1]).norm())
    assert bones["left_knee"] == pytest.approx(thigh, abs=1e-5)
    assert bones["height"] == pytest.approx(1.1 * 1.70, abs=0.05)


def test_nothing_to_read_is_an_error_in_one_line(tmp_path, rest_joints):
    for name in ("a.bvh", "b.bvh"):
        (tmp_path / name).write_text("HIERARCHY\n")
    said_of = {
        tmp_path: "none of its 2 motion files",
        tmp_path / "a.bvh": "line 1: the file ends",
        "nowhere": "not exist",
    }
    for path, said in said_of.items():
        with pytest.raises(UserError, match=said) as caught:
            inspect(Path(path), rest_joints)
        assert "\n" not in str(caught.value)


def test_lines_for_people(folder, rest_joints):
    said = "\n".join(lines(inspect(folder, rest_joints)))
    for part in (
        "8 with 320 frames in 10.4 s; 1.1 to 1.3 s each, 1.3 in the middle",
        "7 30, 1 37 frames a second",
        "2 AMASS-style .npz, 1 packed clips",
        "odd         1 with odd frame rate",
        "not read    ",
        "    3  squat",
        "odd frame rate: 37 frames a second",
    ):
        assert part in said, part
    assert "pelvis <- pelvis" not in said  # the mapping is shown for one file alone
    assert "pelvis <- pelvis" in "\n".join(lines(inspect(folder / "walk_01.bvh", rest_joints)))


def test_many_clips_are_not_listed_one_by_one(tmp_path, act, rest_joints):
    clips = [replace(act("walk", 12), source=f"walk-{number}") for number in range(40)]
    clips[7] = replace(clips[7], fps=37.0, label="<odd>")
    save_clips(tmp_path / "clips.npz", clips)
    found = inspect(tmp_path / "clips.npz", rest_joints)
    said = "\n".join(lines(found))
    assert "walk-7" in said and "walk-8" not in said
    picked = chosen(found.clips, 12)
    assert len(picked) == 12 and picked[0].source.endswith("walk-7")


def test_the_page_holds_everything_and_escapes_what_it_quotes(tmp_path, act, rest_joints, free_body):
    label = "<script>alert('a & b')</script>"
    save_clips(
        tmp_path / "clips.npz", [act("walk"), replace(act("squat"), label=label, fps=37.0, source="<b>bold</b>")]
    )
    found = inspect(tmp_path / "clips.npz", rest_joints)
    out = tmp_path / "out"
    out.mkdir()
    drawn = []
    write_report(out, found, free_body, Reading(), lambda: drawn.append(1))
    assert len(drawn) == 2 and {path.name for path in out.iterdir()} == {PAGE, SHEET, VALUES}
    text = (out / PAGE).read_text()
    assert label not in text and "<b>bold" not in text and html.escape(label) in text
    assert "odd frame rate: 37 frames a second" in text and "http" not in text.replace("http-equiv", "").replace(
        "http://www.w3.org", ""
    )
    values = json.loads((out / VALUES).read_text())
    assert values == json.loads(json.dumps(found.values())) and values["labels"] == found.labels()


def test_describing_reads_as_loading_does(folder, rest_joints):
    from refine.formats.files import load_motions

    for name in ("walk_01.bvh", "punch.glb", "punch.npy", "punch.json", "squat_01.npz", "packed.npz"):
        _, motions, _ = describe(folder / name, rest_joints, Reading())
        for ours, theirs in zip(motions, load_motions(folder / name, rest_joints), strict=True):
            assert torch.equal(ours.rotations, theirs.rotations) and torch.equal(ours.root, theirs.root), name
            assert (ours.label, ours.fps) == (theirs.label, theirs.fps), name
