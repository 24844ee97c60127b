"""Windows, pairs and splits (protocol A.4, G.5, G.7)."""

from dataclasses import replace

import pytest
import torch

from refine.formats.clips import save_clips
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, heading, rotation_about
from train.data import (
    DataConfig,
    draw_pairs,
    draw_windows,
    group,
    load_clips_for,
    pair_labels,
    split,
    start_of_window,
    window,
)

REST = torch.zeros(24, 3)


def clip(frames: int, label: str = "walk", seed: int = 0, fps: float = 30.0) -> Motion:
    random = torch.Generator().manual_seed(seed)
    return Motion(
        axis_angle_to_matrix(0.3 * torch.randn(frames, 24, 3, generator=random)),
        torch.randn(frames, 3, generator=random),
        fps,
        label,
        f"{label}-{seed}",
    )


def starts(length: int, frames: int, legacy: bool) -> set[int]:
    random = torch.Generator().manual_seed(0)
    return {start_of_window(length, frames, legacy, random) for _ in range(300)}


def test_every_window_that_fits_is_drawn():
    assert starts(60, 60, False) == {0}
    assert starts(61, 60, False) == {0, 1}
    assert starts(65, 60, False) == {0, 1, 2, 3, 4, 5}
    assert starts(40, 60, False) == {0}


def test_the_legacy_rule_never_draws_the_last_window():
    assert starts(60, 60, True) == {0}
    assert starts(61, 60, True) == {0}
    assert starts(62, 60, True) == {0, 1}
    assert starts(40, 60, True) == {0}


def test_a_short_clip_stands_still_in_its_last_pose():
    motion = clip(40)
    padded, real = window(motion, 0, 60)
    assert (len(padded), real) == (60, 40)
    assert torch.equal(padded.rotations[39:], padded.rotations[39:40].expand(21, 24, 3, 3))
    assert torch.equal(padded.root[39:], padded.root[39:40].expand(21, 3))
    torch.testing.assert_close(padded.rotations[:40, 1:], motion.rotations[:, 1:])


def test_a_window_is_canonical_and_keeps_later_turns_and_heights():
    motion = clip(30, seed=3)
    taken, real = window(motion, 5, 20)
    assert real == 20
    assert heading(taken.rotations[0, 0]).abs() < 1e-5
    torch.testing.assert_close(taken.root[0], motion.root[5] * torch.tensor([0.0, 1.0, 0.0]), atol=1e-6, rtol=0)
    torch.testing.assert_close(taken.root[:, 1], motion.root[5:25, 1])
    turn = rotation_about("y", -heading(motion.rotations[5, 0]))
    torch.testing.assert_close(taken.rotations[:, 0], turn @ motion.rotations[5:25, 0])


def test_padding_is_masked_unless_legacy():
    clips = {"walk": [clip(7)]}
    config = DataConfig(frames=10)
    features, height, valid = draw_windows(clips, ["walk"], config, torch.Generator().manual_seed(0))
    assert valid.tolist() == [[True] * 7 + [False] * 3]
    assert features.shape == (1, 10, 25, 6)
    assert features[0, 0, 24].tolist() == [0.0] * 6
    assert (features[0, :, 24, 3:] == 0).all()
    torch.testing.assert_close(height, clips["walk"][0].root[:1, 1])
    _, _, legacy = draw_windows(clips, ["walk"], replace(config, legacy_windows=True), torch.Generator().manual_seed(0))
    assert legacy.all()


def test_pairs_carry_their_labels_and_lambda():
    clips = {name: [clip(12, name, seed)] for seed, name in enumerate(("squat", "walk", "wave"))}
    config = DataConfig(frames=12)
    batch = draw_pairs(clips, [("walk", "wave"), ("squat", "wave")], 40, config, torch.Generator().manual_seed(1))
    assert set(zip(batch.class_i.tolist(), batch.class_j.tolist(), strict=True)) == {(1, 2), (0, 2)}
    for name, index in (("squat", 0), ("walk", 1)):
        alone, height, _ = draw_windows(clips, [name], config, torch.Generator())
        of_name = batch.class_i == index
        torch.testing.assert_close(batch.features_i[of_name], alone.expand(int(of_name.sum()), -1, -1, -1))
        torch.testing.assert_close(batch.height_i[of_name], height.expand(int(of_name.sum())))
    assert abs(batch.lam.mean().item() - 0.5) < 0.05
    assert batch.lam.std().item() == pytest.approx(0.1, abs=0.03)
    wide = draw_pairs(
        clips, [("walk", "wave")], 40, replace(config, uniform_lambda=True), torch.Generator().manual_seed(1)
    )
    assert wide.lam.std().item() == pytest.approx(12**-0.5, abs=0.06)


def test_a_pair_is_valid_where_both_are():
    clips = {"walk": [clip(12, "walk")], "wave": [clip(8, "wave")]}
    batch = draw_pairs(clips, [("walk", "wave")], 1, DataConfig(frames=12), torch.Generator())
    assert batch.valid.tolist() == [[True] * 8 + [False] * 4]


def test_the_same_generator_gives_the_same_batch():
    clips = {name: [clip(30, name, seed)] for seed, name in enumerate(("walk", "wave"))}
    pairs, config = [("walk", "wave")], DataConfig(frames=10)
    first, again, other = (
        draw_pairs(clips, pairs, 4, config, torch.Generator().manual_seed(seed)) for seed in (5, 5, 6)
    )
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.features_i, other.features_i)


def test_pairs_of_labels():
    classes = ("a", "b", "c")
    assert pair_labels(DataConfig(), classes) == [
        ("a", "b"),
        ("a", "c"),
        ("b", "a"),
        ("b", "c"),
        ("c", "a"),
        ("c", "b"),
    ]
    assert pair_labels(DataConfig(lower=("a", "b"), upper=("c", "b")), classes) == [("a", "c"), ("a", "b"), ("b", "c")]
    with pytest.raises(UserError, match="lower and upper go together"):
        pair_labels(DataConfig(lower=("a",)), classes)
    with pytest.raises(UserError, match="no pair of different actions among a; name at least two"):
        pair_labels(DataConfig(), ("a",))


def test_split_holds_out_clips_of_every_action():
    motions = [clip(3, name, seed) for name in ("walk", "wave") for seed in range(10)] + [clip(3, "once")]
    train, test = split(motions, 0.2, 0)
    assert {name: len(clips) for name, clips in group(test).items()} == {"once": 1, "walk": 2, "wave": 2}
    assert {name: len(clips) for name, clips in group(train).items()} == {"once": 1, "walk": 8, "wave": 8}
    many = [motion.source for motion in train + test if motion.label != "once"]
    assert len(set(many)) == len(many) == 20
    assert [motion.source for motion in split(motions, 0.2, 0)[1]] == [motion.source for motion in test]
    assert [motion.source for motion in split(motions, 0.2, 1)[1]] != [motion.source for motion in test]


@pytest.mark.parametrize("held_out", [0.0, 0.9, 1.0])
def test_both_sides_of_a_split_know_every_action(held_out):
    """A label's number is its place among the labels, so the two sides must have the same ones."""
    motions = [clip(3, name, seed) for name in ("walk", "wave") for seed in range(3)]
    train, test = (group(side) for side in split(motions, held_out, 0))
    assert list(train) == list(test) == ["walk", "wave"]
    assert {len(train[name]) + len(test[name]) for name in train} == {3}


def test_clips_of_a_file_are_chosen_by_label_and_resampled(tmp_path):
    save_clips(tmp_path / "clips.npz", [clip(21, "walk", 0, 60.0), clip(9, "wave"), clip(9, "squat")])
    loaded = load_clips_for(DataConfig(source=str(tmp_path / "clips.npz"), actions=("walk", "wave")), REST)
    assert [(motion.label, motion.fps, len(motion)) for motion in loaded] == [("walk", 30.0, 11), ("wave", 30.0, 9)]


def test_an_unknown_label_offers_the_nearest(tmp_path):
    save_clips(tmp_path / "clips.npz", [clip(9, "walk"), clip(9, "wave-both-hands")])
    with pytest.raises(UserError, match=r"clips\.npz: unknown name 'wave-both-hand'; did you mean wave-both-hands"):
        load_clips_for(DataConfig(source=str(tmp_path / "clips.npz"), upper=("wave-both-hand",)), REST)
    with pytest.raises(UserError, match=r"unknown name 'wallk'; did you mean walk"):
        load_clips_for(DataConfig(actions=("wallk",)), REST)


def test_built_in_clips_are_repeatable_and_no_two_alike():
    from renderers.body import Body

    rest = Body.free("light").rest_joints
    config = DataConfig(actions=("walk", "drink"), synthetic_clips=3, synthetic_seconds=1.0)
    motions = load_clips_for(config, rest)
    assert [(motion.label, len(motion)) for motion in motions] == [("walk", 30)] * 3 + [("drink", 30)] * 3
    again = load_clips_for(config, rest)
    assert all(torch.equal(a.rotations, b.rotations) for a, b in zip(motions, again, strict=True))
    assert not torch.allclose(motions[0].rotations, motions[1].rotations, atol=1e-2)
    other = load_clips_for(replace(config, seed=1), rest)
    assert not torch.allclose(motions[0].rotations, other[0].rotations, atol=1e-2)
