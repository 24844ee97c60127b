"""Benchmarks: what is on disk, that it is frozen, that it can be recomputed from its manifest."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from refine.coupling import couple_features
from refine.motion import Motion, canonicalise, crop, to_features
from renderers.checks import UserError
from renderers.rotations import heading, rotation_about
from train.benchmarks import Benchmark, load_benchmark, seal
from train.building import Material, build_benchmark
from train.recipes import product, synth_c


@pytest.fixture(scope="module")
def small(rest_joints) -> Material:
    """synth-c with two test clips of each action, of 75 frames."""
    return synth_c(rest_joints, seed=3, train=2, test=2, extra=1, seconds=2.5)


@pytest.fixture(scope="module")
def built(small, rest_joints, tmp_path_factory) -> Benchmark:
    return build_benchmark(tmp_path_factory.mktemp("benchmarks") / "synth-c", small, rest_joints, 3, "refine data ...")


@pytest.fixture
def copied(built, tmp_path) -> Path:
    folder = tmp_path / "copy"
    folder.mkdir()
    for path in built.folder.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def clip(label: str, name: str, frames: int, turn: float = 0.0) -> Motion:
    """Someone who raises a leg (for "walk") or an arm while gliding along a line that is turned from z."""
    rotations = torch.eye(3).repeat(frames, 24, 1, 1)
    rotations[:, 0] = rotation_about("y", torch.tensor(turn))
    rotations[:, 1 if label == "walk" else 16] = rotation_about("z", torch.linspace(0, 1, frames))
    along = torch.linspace(0, 1, frames)
    root = torch.stack([np.sin(turn) * along, torch.full_like(along, 0.9), np.cos(turn) * along], dim=1)
    return Motion(rotations, root, 30.0, label, name)


def material(test: list[Motion], **changes) -> Material:
    labels = ("walk", "wave")
    train = [clip(label, f"train/{label}", 70) for label in labels]
    fields = {"name": "mine", "version": 1, "fps": 30.0, "frames": 60, "lower": labels[:1], "upper": labels[1:]}
    fields |= {"pairs": product(labels[:1], labels[1:]), "train": train, "test": test, "extra": [], "rule": "by hand"}
    return Material(**fields | changes)


# --- what is there ---------------------------------------------------------------------------------------------------


def test_counts_labels_and_order(built, small):
    assert [len(built.clips(split)) for split in ("train", "test", "extra")] == [20, 20, 10]
    assert (built.name, built.fps, built.frames, len(built.pairs)) == ("synth-c", 30.0, 60, 25)
    assert built.pairs == product(built.lower, built.upper) and len(built.lower) == len(built.upper) == 5
    expected = [f"{i}+{j}" for i, j in built.pairs for _ in range(4)]
    for kind in ("mask", "true"):
        compositions = built.compositions(kind)
        assert [motion.label for motion in compositions] == expected
        assert {len(motion) for motion in compositions} == {60}
    sources = [motion.source for motion in built.compositions("mask")[:4]]
    i, j = (f"test/{label}" for label in built.pairs[0])
    assert sources == [f"{i}_{a:03d} + {j}_{b:03d}" for a in (0, 1) for b in (0, 1)]
    assert sources == [motion.source for motion in built.compositions("true")[:4]]


def test_what_is_read_is_what_was_performed(built, small):
    for split in ("train", "test", "extra"):
        for read, performed in zip(built.clips(split), getattr(small, split), strict=True):
            assert (read.label, read.source, read.fps) == (performed.label, performed.source, performed.fps)
            assert torch.equal(read.six, performed.six) and torch.equal(read.root, performed.root)


def test_no_clip_is_in_two_splits(built):
    seen = {}
    for split in ("train", "test", "extra"):
        for entry in built.manifest["clips"][split]:
            assert entry["sha256"] not in seen, f"{entry['source']} is {seen[entry['sha256']]}"
            seen[entry["sha256"]] = entry["source"]
    assert len(seen) == 50


def test_the_manifest_says_what_the_files_hold(built):
    manifest = json.loads((built.folder / "manifest.json").read_text())
    assert set(manifest["files"]) == {"train.npz", "test.npz", "extra.npz", "mask.npz", "true.npz"}
    for name, file in manifest["files"].items():
        assert file["sha256"] == sha(built.folder / name)
    for split in ("train", "test", "extra"):
        for entry, motion in zip(manifest["clips"][split], built.clips(split), strict=True):
            arrays = motion.six.numpy().tobytes() + motion.root.numpy().tobytes()
            assert entry == {
                "source": motion.source,
                "label": motion.label,
                "frames": len(motion),
                "sha256": hashlib.sha256(arrays).hexdigest(),
            }
    assert (manifest["lambda"], manifest["seed"], manifest["command"]) == (0.5, 3, "refine data ...")
    assert manifest["coupling"]["mask"] and manifest["coupling"]["energy_space"] == "joints_rel"
    assert manifest["rejected"] == {"not finite": 0} and manifest["padded_compositions"] == 0


# --- compositions ----------------------------------------------------------------------------------------------------


def windows_of(built: Benchmark, side: str) -> torch.Tensor:
    """[N 60 25 6] as the manifest tells them, cut and turned here."""
    clips = {motion.source: motion for motion in built.clips("test")}
    cut = [
        canonicalise(crop(clips[one[side]["clip"]], one[side]["start"], one[side]["start"] + 60))
        for one in built.manifest["compositions"]
    ]
    return torch.stack([to_features(motion.six, motion.root) for motion in cut])


def test_compositions_are_lfcas_of_the_named_windows(built, rest_joints):
    x_i, x_j = (windows_of(built, side) for side in "ij")
    expected = couple_features(x_i, x_j, torch.full((len(x_i),), 0.5), rest_joints)
    found = built.compositions("mask")
    features = torch.stack([to_features(motion.six, motion.root) for motion in found])
    torch.testing.assert_close(features, expected, atol=2e-5, rtol=0)


def test_true_compositions_show_the_same_moments(built):
    """The legs' owner is i: its legs and path are the same in both, frame by frame, where j leaves the legs alone."""
    for mask, true in zip(built.compositions("mask"), built.compositions("true"), strict=True):
        assert (mask.label, mask.source) == (true.label, true.source)
        assert heading(true.rotations[0, 0]).abs() < 1e-5 and true.root[0, [0, 2]].abs().max() < 1e-6
    label = "forward-lunging+shoulder-abduction"
    pairs = [
        (mask, true)
        for mask, true in zip(built.compositions("mask"), built.compositions("true"), strict=True)
        if mask.label == label
    ]
    for mask, true in pairs:
        moves = (mask.root - mask.root.mean(0))[:, 2], (true.root - true.root.mean(0))[:, 2]
        assert torch.nn.functional.cosine_similarity(*moves, dim=0) > 0.99
    starts = [[one[side]["start"] for side in "ij"] for one in built.manifest["compositions"]]
    assert all(i == j for i, j in starts) and len({i for i, _ in starts}) == 16


def test_true_compositions_differ_from_those_by_energies(built, rest_joints):
    distances = [
        float((mask.joints(rest_joints) - true.joints(rest_joints)).norm(dim=-1).mean())
        for mask, true in zip(built.compositions("mask"), built.compositions("true"), strict=True)
    ]
    assert min(distances) > 1e-3 and 0.01 < np.mean(distances) < 0.3


def test_sides_start_independently_where_nothing_is_performed_together(rest_joints, tmp_path):
    test = [clip(label, f"{label}{number}", 200) for label in ("walk", "wave") for number in range(3)]
    built = build_benchmark(tmp_path / "b", material(test), rest_joints)
    starts = [[one[side]["start"] for side in "ij"] for one in built.manifest["compositions"]]
    assert any(i != j for i, j in starts) and all(0 <= start <= 140 for pair in starts for start in pair)
    assert not built.has_true
    with pytest.raises(UserError, match="has no true compositions; only synth-c has"):
        built.compositions("true")
    assert built.clips("extra") == []


def test_every_window_that_fits_is_drawn(rest_joints, tmp_path):
    test = [clip("walk", f"w{n}", 61) for n in range(3)] + [clip("wave", f"a{n}", 62) for n in range(6)]
    built = build_benchmark(tmp_path / "b", material(test), rest_joints)
    drawn = built.manifest["compositions"]
    assert {one["i"]["start"] for one in drawn} == {0, 1} and {one["j"]["start"] for one in drawn} == {0, 1, 2}


def test_short_clips_stand_still_and_are_counted(rest_joints, tmp_path):
    test = [clip("walk", "short", 40), clip("walk", "long", 60), clip("wave", "a", 60), clip("wave", "b", 70)]
    built = build_benchmark(tmp_path / "b", material(test), rest_joints)
    assert built.manifest["shorter_than_window"] == {"train": 0, "test": 1, "extra": 0}
    assert built.manifest["padded_compositions"] == 2
    padded = [(one["i"]["clip"], one["i"]["padded"], one["j"]["padded"]) for one in built.manifest["compositions"]]
    assert padded == [("short", 20, 0), ("short", 20, 0), ("long", 0, 0), ("long", 0, 0)]
    root = built.compositions("mask")[0].root
    assert torch.equal(root[39:], root[39:40].expand(21, 3)) and (root[38] - root[39]).norm() > 0


def test_windows_are_canonical(rest_joints, tmp_path):
    test = [clip("walk", "turned", 100, turn=2.0), clip("wave", "a", 100, turn=-1.0)]
    built = build_benchmark(tmp_path / "b", material(test), rest_joints)
    motion = built.compositions("mask")[0]
    assert heading(motion.rotations[:, 0]).abs().max() < 1e-5
    assert motion.root[:, 0].abs().max() < 1e-5 and motion.root[-1, 2] > 0.3 and motion.root[0, 1] > 0.8


def test_a_composition_that_is_not_finite_is_rejected_and_counted(rest_joints, tmp_path):
    test = [clip(label, f"{label}{number}", 60) for label in ("walk", "wave") for number in range(2)]

    def together(i: Motion, j: Motion) -> Motion:
        bad = i.source == "walk1" and j.source == "wave0"
        return replace(i, root=i.root / 0 if bad else i.root)

    built = build_benchmark(tmp_path / "b", material(test, together=together), rest_joints)
    assert built.manifest["rejected"] == {"not finite": 1}
    assert len(built.compositions("mask")) == len(built.compositions("true")) == 3
    named = [(one["i"]["clip"], one["j"]["clip"]) for one in built.manifest["compositions"]]
    assert named == [("walk0", "wave0"), ("walk0", "wave1"), ("walk1", "wave1")]


# --- frozen ----------------------------------------------------------------------------------------------------------


def test_building_twice_gives_the_same_bytes(built, rest_joints, tmp_path):
    again = synth_c(rest_joints, seed=3, train=2, test=2, extra=1, seconds=2.5)
    build_benchmark(tmp_path / "again", again, rest_joints, 3, "refine data ...")
    for path in built.folder.iterdir():
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name


def test_another_seed_gives_other_clips_and_other_windows(small, rest_joints, tmp_path):
    other = synth_c(rest_joints, seed=4, train=2, test=2, extra=1, seconds=2.5)
    assert not any(torch.equal(a.rotations, b.rotations) for a, b in zip(small.test, other.test, strict=True))
    test = [clip(label, f"{label}{number}", 200) for label in ("walk", "wave") for number in range(2)]
    hashes = {build_benchmark(tmp_path / str(seed), material(test), rest_joints, seed).hash for seed in (0, 0, 1)}
    assert len(hashes) == 2


def test_more_extra_clips_leave_the_others_as_they_are(small, rest_joints):
    more = synth_c(rest_joints, seed=3, train=2, test=2, extra=2, seconds=2.5)
    for one, other in zip(small.test, more.test, strict=True):
        assert torch.equal(one.rotations, other.rotations)


def test_the_hash_is_that_of_all_files(built, copied):
    lines = "".join(f"{sha(path)} {path.name}\n" for path in sorted(copied.glob("*.npz")))
    assert load_benchmark(copied).hash == built.hash == hashlib.sha256(lines.encode()).hexdigest()


def test_other_files_in_the_folder_do_not_matter(built, copied):
    (copied / "recognisers").mkdir()
    (copied / "recognisers" / "mask.json").write_text("{}")
    assert load_benchmark(copied).hash == built.hash


@pytest.mark.parametrize("name", ["train.npz", "test.npz", "extra.npz", "mask.npz", "true.npz"])
def test_a_changed_file_is_named(copied, name):
    content = bytearray((copied / name).read_bytes())
    content[len(content) // 2] ^= 1
    (copied / name).write_bytes(content)
    with pytest.raises(UserError, match=rf"{name}: was changed since the benchmark was built; build it again"):
        load_benchmark(copied)
    (copied / name).unlink()
    with pytest.raises(UserError, match=rf"{name}: is missing"):
        load_benchmark(copied)


def test_a_changed_manifest_is_named(copied):
    path = copied / "manifest.json"
    path.write_text(path.read_text().replace('"frames": 60', '"frames": 61'))
    with pytest.raises(UserError, match=r"manifest.json: was changed since it was built"):
        load_benchmark(copied)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("[]", "is not a benchmark's manifest"),
        ("{}", "is not a benchmark's manifest"),
        ('{"schema": 99}', "has schema 99, not 1"),
        ('{"schema": 1, "files": [], "sha256": ""}', "was changed since it was built"),
        ("[" * 100_000, "is nested too deeply"),
    ],
)
def test_another_manifest_is_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(UserError, match=said) as caught:
        load_benchmark(tmp_path)
    assert "\n" not in str(caught.value)


def test_files_of_other_folders_are_not_read(copied):
    path = copied / "manifest.json"
    manifest = json.loads(path.read_text())
    del manifest["sha256"]
    manifest["files"]["../private.npz"] = next(iter(manifest["files"].values()))
    path.write_text(json.dumps(manifest | {"sha256": seal(manifest)}))
    with pytest.raises(UserError, match=r"names a file outside of its folder \('../private.npz'\)"):
        load_benchmark(copied)


def test_a_folder_without_a_benchmark_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(UserError, match="holds no benchmark"):
            load_benchmark(folder)


def test_unknown_splits_and_kinds_are_refused(built):
    with pytest.raises(UserError, match="unknown name 'tset'; did you mean test"):
        built.clips("tset")
    with pytest.raises(UserError, match="unknown name 'masks'; did you mean mask"):
        built.compositions("masks")


# --- material that does not fit --------------------------------------------------------------------------------------


def test_a_class_without_clips_and_names_that_repeat_are_refused(rest_joints, tmp_path):
    test = [clip("walk", "a", 60), clip("wave", "b", 60)]
    for bad, said in (
        (material(test[:1]), "mine: has no test clips of wave"),
        (material(test, train=[clip("wave", "c", 60)]), "mine: has no train clips of walk"),
        (material([test[0], replace(test[1], source="a")]), "mine: has 2 clips called a"),
    ):
        with pytest.raises(UserError, match=said):
            build_benchmark(tmp_path / "b", bad, rest_joints)
    assert not list(tmp_path.iterdir())
