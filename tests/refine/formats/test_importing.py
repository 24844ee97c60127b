"""Import at scale: labels files, shards, several processes, what is broken."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.formats import clips as packing
from refine.formats.amass import write_amass
from refine.formats.clips import is_shards, load_clips, save_clips
from refine.formats.finding import motion_files
from refine.formats.importing import ImportConfig, import_clips, import_folder
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from train.data import DataConfig, open_source
from train.recipes import read_source


def clip(frames: int, seed: int, fps: float = 30.0, label: str = "") -> Motion:
    random = torch.Generator().manual_seed(seed)
    rotations = axis_angle_to_matrix(0.3 * torch.randn(frames, 24, 3, generator=random))
    return Motion(rotations, torch.randn(frames, 3, generator=random), fps, label)


@pytest.fixture
def folder(tmp_path) -> Path:
    """Ten clips of 10 to 19 frames in two folders, one that is broken and one that holds NaN."""
    folder = tmp_path / "in"
    for index in range(10):
        name = f"{'walk' if index % 3 else 'wave'}_{index:02d}.npz"
        write_amass(folder / ("even" if index % 2 == 0 else "odd") / name, clip(10 + index, index))
    (folder / "broken.npz").write_bytes(b"PK\x03\x04 and no more")
    write_amass(folder / "nan.npz", clip(5, 0))
    with np.load(folder / "nan.npz") as arrays:
        np.savez(folder / "nan.npz", **{**arrays, "trans": np.full((5, 3), np.nan)})
    return folder


def contents(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in path.iterdir()}


def equal(ours: Motion, theirs: Motion) -> bool:
    same = torch.equal(ours.rotations, theirs.rotations) and torch.equal(ours.root, theirs.root)
    return same and (ours.fps, ours.label, ours.source) == (theirs.fps, theirs.label, theirs.source)


def labels_file(tmp_path: Path, text: str) -> ImportConfig:
    (tmp_path / "labels.csv").write_text(text)
    return ImportConfig(labels_file=tmp_path / "labels.csv")


# --- shards ----------------------------------------------------------------------------------------------------------


def test_shards_hold_to_the_bit_what_one_file_holds(folder, tmp_path, rest_joints, monkeypatch):
    monkeypatch.setattr(packing, "SHARD_FRAMES", 40)
    one = import_clips(folder, tmp_path / "one.npz", rest_joints)
    many = import_clips(folder, tmp_path / "many", rest_joints)
    assert replace(one, refused=str(one.refused)) == replace(many, refused=str(many.refused))
    assert one.clips == 10 and one.frames == sum(range(10, 20))
    names = sorted(path.name for path in (tmp_path / "many").iterdir())
    assert names == [*(f"clips-{k:05d}.npz" for k in range(len(names) - 1)), "manifest.json"] and len(names) > 3
    assert all(sum(map(len, load_clips(tmp_path / "many" / name))) <= 40 for name in names[:-1])
    alone, together = load_clips(tmp_path / "one.npz"), load_clips(tmp_path / "many")
    assert len(alone) == len(together) == 10 and all(map(equal, alone, together))


def test_the_manifest_says_what_there_is_and_what_is_not(folder, tmp_path, rest_joints):
    done = import_clips(folder, tmp_path / "out", rest_joints)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (manifest["clips"], manifest["frames"]) == (10, 145)
    assert manifest["labels"] == done.labels == {"walk": 6, "wave": 4}
    assert [entry["source"] for entry in manifest["left_out"]] == ["broken.npz", "nan.npz"]
    assert "not finite" in manifest["left_out"][1]["problem"]
    assert str(tmp_path) not in (tmp_path / "out" / "manifest.json").read_text()
    assert len(manifest["hash"]) == 64 and is_shards(tmp_path / "out") and not is_shards(folder)


def test_any_number_of_workers_writes_the_same_bytes(folder, tmp_path, rest_joints):
    lines = ["file,label,start_frame,end_frame", "broken.npz,part 0,,", "nan.npz,part 1,,"]
    for k in range(9, -1, -1):
        path = f"{'even' if k % 2 == 0 else 'odd'}/{'walk' if k % 3 else 'wave'}_{k:02d}.npz"
        lines += [f"{path},part {k % 2},{k % 4},9", f"{path},too long,0,99"]
    (tmp_path / "labels.csv").write_text("\n".join(lines))
    outs = []
    for workers in (1, 2):
        done = import_clips(
            folder, tmp_path / f"by{workers}", rest_joints, ImportConfig(None, tmp_path / "labels.csv", workers=workers)
        )
        outs.append((contents(tmp_path / f"by{workers}"), str(done)))
    assert outs[0] == outs[1]
    manifest = json.loads(outs[0][0]["manifest.json"])
    assert manifest["clips"] == 10 and len(manifest["left_out"]) == 12


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda out: (out / "clips-00001.npz").unlink(), "clips-00001.npz: is missing; import the clips again"),
        (lambda out: (out / "clips-00000.npz").write_bytes(b"x"), "clips-00000.npz: was changed since it was written"),
        (lambda out: (out / "manifest.json").write_text("{"), "manifest.json: is not JSON"),
        (lambda out: (out / "manifest.json").write_text("[1]"), "manifest.json: is not a manifest"),
        (lambda out: (out / "manifest.json").write_text("{}"), "is not a folder of packed clips"),
        (lambda out: (out / "manifest.json").unlink(), "out: is not a folder of packed clips"),
        (
            lambda out: (out / "manifest.json").write_text(
                (out / "manifest.json").read_text().replace("clips-00000.npz", "../../secret.npz")
            ),
            "manifest.json: names a file that is none of clips",
        ),
    ],
)
def test_a_folder_that_was_tampered_with_is_refused(folder, tmp_path, rest_joints, monkeypatch, harm, said):
    monkeypatch.setattr(packing, "SHARD_FRAMES", 40)
    import_clips(folder, tmp_path / "out", rest_joints)
    harm(tmp_path / "out")
    with pytest.raises(UserError) as caught:
        load_clips(tmp_path / "out")
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_training_and_benchmarks_read_both(folder, tmp_path, rest_joints):
    for out in ("one.npz", "many"):
        import_clips(folder, tmp_path / out, rest_joints)
    learned = [open_source(DataConfig(str(tmp_path / out), fps=30.0), rest_joints).clips for out in ("one.npz", "many")]
    assert all(map(equal, *learned))
    read = [read_source(tmp_path / out, rest_joints).motions for out in ("one.npz", "many")]
    assert all(map(equal, *read))


def test_packed_clips_are_imported_again_by_label(folder, tmp_path, rest_joints):
    import_clips(folder, tmp_path / "many", rest_joints)
    import_clips(tmp_path / "many", tmp_path / "waves.npz", rest_joints, ImportConfig(labels=("wave",)))
    before = [clip for clip in load_clips(tmp_path / "many") if clip.label == "wave"]
    assert len(before) == 4 and all(map(equal, before, load_clips(tmp_path / "waves.npz")))
    with pytest.raises(UserError, match="unknown name 'wve'; did you mean wave"):
        import_clips(tmp_path / "many", tmp_path / "x", rest_joints, ImportConfig(labels=("wave", "wve")))
    assert not (tmp_path / "x").exists()


def test_whose_body_it_was_is_kept(tmp_path, rest_joints):
    shaped = clip(4, 1, label="a")
    shaped = Motion(shaped.rotations, shaped.root, 30.0, "a", "a", torch.tensor([0.5, -2.0]), "female")
    save_clips(tmp_path / "both.npz", [clip(3, 0, label="b"), shaped])
    plain, back = load_clips(tmp_path / "both.npz")
    assert plain.betas is None and plain.gender == "neutral"
    assert back.gender == "female" and torch.equal(back.betas, shaped.betas)


def test_a_file_is_the_same_bytes_as_numpy_would_write(tmp_path):
    motions = [clip(3, 0, label="walk"), clip(5, 1, 60.0, "wave")]
    save_clips(tmp_path / "ours.npz", motions)
    np.savez(
        tmp_path / "theirs.npz",
        six=torch.cat([motion.six for motion in motions]).numpy(),
        root=torch.cat([motion.root for motion in motions]).numpy(),
        lengths=np.array([3, 5]),
        fps=np.array([30.0, 60.0]),
        labels=np.array(["walk", "wave"]),
        sources=np.array(["motion", "motion"]),
    )
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "theirs.npz").read_bytes()


# --- labels files ----------------------------------------------------------------------------------------------------


def test_a_labels_file_cuts_and_names_clips(folder, tmp_path, rest_joints):
    config = labels_file(
        tmp_path,
        "file,label,start,end\nodd/walk_01.npz,step,0,0.2\nodd/walk_01.npz,stand,0.2,\nwave_00,hello,,\nnan.npz,x,,\n"
        "gone.npz,y,,\nodd/walk_07.npz,late,9,10\n",
    )
    done = import_clips(folder, tmp_path / "out.npz", rest_joints, config)
    clips = load_clips(tmp_path / "out.npz")
    assert [(c.label, c.source, len(c)) for c in clips] == [
        ("hello", "even/wave_00.npz", 10),
        ("step", "odd/walk_01.npz#0-6", 6),
        ("stand", "odd/walk_01.npz#6-11", 5),
    ]
    whole = next(c for c in import_folder(folder, rest_joints).motions if c.source == "odd/walk_01.npz")
    torch.testing.assert_close(torch.cat([clips[1].root, clips[2].root]), whole.root, atol=0, rtol=0)
    assert done.unlabelled == 12 - 4  # broken.npz among them: nobody asked for it
    said = [str(error) for error in done.refused]
    assert len(said) == 3 and "labels.csv, line 6: there is no file gone.npz" in said[0]
    assert "nan.npz" in said[1] and "labels.csv, line 7: asks for frames 270 to 300" in said[2]


def test_a_name_that_may_be_two_files_is_refused(folder, tmp_path, rest_joints):
    shutil.copy(folder / "odd" / "walk_01.npz", folder / "even")
    config = labels_file(tmp_path, "file,label\nwave_00,a\nwalk_01.npz,b\n")
    with pytest.raises(UserError, match=r"labels.csv, line 3: walk_01.npz may be even/walk_01.npz or odd/walk_01.npz"):
        import_clips(folder, tmp_path / "out", rest_joints, config)
    config = labels_file(tmp_path, "file,label\nrun.bvh,a\n")
    with pytest.raises(UserError, match=r"labels.csv: names none of the 13 motion files of .*there is no file run.bvh"):
        import_clips(folder, tmp_path / "out", rest_joints, config)
    assert not (tmp_path / "out").exists()


def test_a_labels_file_and_a_pattern_exclude_each_other(folder, tmp_path, rest_joints):
    config = ImportConfig("(?P<label>.*)", tmp_path / "labels.csv")
    with pytest.raises(UserError, match="exclude each other"):
        import_clips(folder, tmp_path / "out", rest_joints, config)


# --- what is in the way ----------------------------------------------------------------------------------------------


def test_a_clip_that_is_there_twice_is_left_out_once(folder, tmp_path, rest_joints):
    for copy in ("walk_90.npz", "wave_91.npz"):
        shutil.copy(folder / "odd" / "walk_01.npz", folder / copy)
    done = import_clips(folder, tmp_path / "out.npz", rest_joints)
    assert done.clips == 11 and done.labels == {"walk": 6, "wave": 5}  # under another label it is another clip
    [twice] = [error for error in done.refused if "same motion" in str(error)]
    assert str(twice) == "walk_90.npz: is the same motion as odd/walk_01.npz, with the same label"


def test_a_reader_that_fails_in_any_way_costs_its_clip_alone(folder, tmp_path, rest_joints, monkeypatch):
    from refine.formats import files

    def reader(path, *rest):
        if path.name == "walk_01.npz":
            raise MemoryError("Unable to allocate 7 TiB")
        return ours(path, *rest)

    ours = files.READERS["npz"]
    monkeypatch.setitem(files.READERS, "npz", reader)
    done = import_clips(folder, tmp_path / "out.npz", rest_joints)
    assert done.clips == 9
    assert "walk_01.npz: cannot be read (MemoryError: Unable to allocate 7 TiB)" in str(done.refused[-1])


def test_links_lead_nowhere_else(folder, tmp_path, rest_joints):
    outside = tmp_path / "outside"
    write_amass(outside / "secret.npz", clip(5, 99))
    (folder / "link.npz").symlink_to(outside / "secret.npz")
    (folder / "linked").symlink_to(outside)
    (folder / "round").symlink_to(folder)
    (folder / "alias_00.npz").symlink_to(folder / "even" / "wave_00.npz")
    (folder / ".hidden.npz").write_bytes(b"x")
    paths, refused = motion_files(folder)
    names = {path.name for path in paths}
    assert "alias_00.npz" in names and not names & {"link.npz", "secret.npz", ".hidden.npz"} and len(paths) == 13
    assert [error.problem for error in refused] == ["is a link that leads out of the folder"]
    done = import_clips(folder, tmp_path / "out.npz", rest_joints)
    assert done.clips == 10 and "secret" not in str(done)
    assert "even/wave_00.npz: is the same motion as alias_00.npz" in " ".join(map(str, done.refused))


def test_nothing_is_left_of_an_import_that_fails(tmp_path, rest_joints):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.bvh").write_text("HIERARCHY")
    for out in ("out", "out.npz"):
        with pytest.raises(UserError, match=r"in: none of its 1 motion files can be read; the first: .*a.bvh"):
            import_clips(tmp_path / "in", tmp_path / out, rest_joints)
    with pytest.raises(UserError, match="nowhere: does not exist"):
        import_clips(tmp_path / "nowhere", tmp_path / "out", rest_joints)
    with pytest.raises(UserError, match="--workers: expected 1 to 256, got 0"):
        import_clips(tmp_path / "in", tmp_path / "out", rest_joints, ImportConfig(workers=0))
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_too_much_for_one_file_names_the_other_way(folder, tmp_path, rest_joints, monkeypatch):
    monkeypatch.setattr("refine.formats.importing.MAX_BYTES", 100 * 588)
    with pytest.raises(UserError, match=r"out.npz: would be too large for one file; name a folder"):
        import_clips(folder, tmp_path / "out.npz", rest_joints)
    assert import_clips(folder, tmp_path / "out", rest_joints).frames == 145


def test_a_single_file_is_a_source(folder, tmp_path, rest_joints):
    done = import_clips(folder / "odd" / "walk_01.npz", tmp_path / "out.npz", rest_joints)
    assert done.labels == {"walk": 1} and load_clips(tmp_path / "out.npz")[0].source == "walk_01.npz"
