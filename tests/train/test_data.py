"""Windows, pairs, splits and where clips come from."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from refine.formats.clips import save_clips
from refine.motion import Motion
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, heading, rotation_about
from train.data import (
    ClipStore,
    DataConfig,
    Draw,
    Source,
    draw_batch,
    draw_pairs,
    group,
    index_pairs,
    load_clips_for,
    open_source,
    pair_labels,
    settled,
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


def batch_of(motions: list[Motion], pairs: list[tuple[str, str]], count: int, config: DataConfig, seed: int = 1):
    store = ClipStore.build(motions)
    return draw_pairs(store, index_pairs(store, pairs), count, config, torch.Generator().manual_seed(seed))


def test_windows_of_a_batch_are_those_of_single_clips():
    """Clips shorter and longer than the window, from their first to their last possible start."""
    motions = [clip(frames, name, frames) for name in ("wave", "walk") for frames in (1, 7, 12, 30)]
    store = ClipStore.build(motions)
    assert store.classes == ("walk", "wave")
    assert store.labels.tolist() == [0] * 4 + [1] * 4
    sorted_motions = [motion for of_label in group(motions).values() for motion in of_label]
    for place, motion in enumerate(sorted_motions):
        assert store.sources[place] == motion.source
        starts = torch.tensor([0, max(0, len(motion) - 12), len(motion) - 1])
        rotations, root = store.windows(torch.full((3,), place), starts, 12)
        for row, start in enumerate(starts.tolist()):
            single, _ = window(motion, start, 12)
            torch.testing.assert_close(rotations[row], single.rotations, atol=1e-6, rtol=0)
            torch.testing.assert_close(root[row], single.root, atol=1e-6, rtol=0)


def test_taking_windows_leaves_the_store_as_it_is():
    store = ClipStore.build([clip(20)])
    before = store.rotations.clone(), store.root.clone()
    store.windows(torch.tensor([0]), torch.tensor([3]), 12)
    assert torch.equal(store.rotations, before[0]) and torch.equal(store.root, before[1])


def test_padding_is_masked_unless_it_counts_as_real():
    config = settled(DataConfig(frames=10))
    batch = batch_of([clip(7), clip(30, "wave")], [("walk", "wave")], 1, config)
    assert batch.valid.tolist() == [[True] * 7 + [False] * 3]
    assert batch.features_i.shape == (1, 10, 25, 6)
    assert batch.features_i[0, 0, 24].tolist() == [0.0] * 6
    assert (batch.features_i[0, :, 24, 3:] == 0).all()
    assert torch.equal(batch.features_i[0, 6:, :24], batch.features_i[0, 6:7, :24].expand(4, 24, 6))
    torch.testing.assert_close(batch.height_i, clip(7).root[:1, 1])
    learned = batch_of([clip(7), clip(30, "wave")], [("walk", "wave")], 1, replace(config, padding="real"))
    assert learned.valid.all()


def test_pairs_carry_their_labels_and_lambda():
    motions = [clip(12, name, seed) for seed, name in enumerate(("squat", "walk", "wave"))]
    config, pairs = settled(DataConfig(frames=12)), [("walk", "wave"), ("squat", "wave")]
    batch = batch_of(motions, pairs, 40, config)
    assert set(zip(batch.class_i.tolist(), batch.class_j.tolist(), strict=True)) == {(1, 2), (0, 2)}
    for motion, index in ((motions[0], 0), (motions[1], 1)):
        alone, _ = window(motion, 0, 12)
        of_name = batch.class_i == index
        six = batch.features_i[of_name][:, :, :24]
        torch.testing.assert_close(six, alone.six.expand_as(six), atol=1e-6, rtol=0)
        torch.testing.assert_close(batch.height_i[of_name], alone.root[0, 1].expand(int(of_name.sum())))
    assert abs(batch.lam.mean().item() - 0.5) < 0.05
    assert batch.lam.std().item() == pytest.approx(0.1, abs=0.03)
    wide = batch_of(motions, pairs, 40, replace(config, lam="uniform"))
    assert wide.lam.std().item() == pytest.approx(12**-0.5, abs=0.06)
    assert batch_of(motions, pairs, 4, replace(config, lam="half")).lam.tolist() == [0.5] * 4


def test_every_clip_and_start_of_an_action_is_drawn_alike():
    motions = [clip(12, "walk", 0), clip(14, "walk", 1), clip(13, "wave", 2), clip(9, "squat", 3)]
    store = ClipStore.build(motions)
    config, pairs = settled(DataConfig(frames=10)), index_pairs(store, [("walk", "wave")])
    drawn = draw_batch(store, pairs, 6000, config, torch.Generator().manual_seed(0))
    walk = list(zip(drawn.clips[:, 0].tolist(), drawn.starts[:, 0].tolist(), strict=True))
    expected = {(1, start): 1000 for start in range(3)} | {(2, start): 600 for start in range(5)}
    assert set(walk) == set(expected)
    for which, count in expected.items():
        assert walk.count(which) == pytest.approx(count, abs=130), which
    assert set(drawn.clips[:, 1].tolist()) == {3} and set(drawn.starts[:, 1].tolist()) == {0, 1, 2, 3}


def test_an_action_with_itself_is_one_window_twice():
    motions = [clip(30, "walk", seed) for seed in range(3)]
    batch = batch_of(motions, [("walk", "walk")], 8, settled(DataConfig(frames=10)))
    assert torch.equal(batch.features_i, batch.features_j)
    assert len(batch.features_i.flatten(1).unique(dim=0)) > 3


def test_a_pair_is_valid_where_both_are():
    config = settled(DataConfig(frames=12))
    batch = batch_of([clip(12, "walk"), clip(8, "wave")], [("walk", "wave")], 1, config)
    assert batch.valid.tolist() == [[True] * 8 + [False] * 4]


def test_the_same_generator_gives_the_same_batch():
    motions = [clip(30, name, seed) for seed, name in enumerate(("walk", "wave"))]
    first, again, other = (
        batch_of(motions, [("walk", "wave")], 4, settled(DataConfig(frames=10)), seed) for seed in (5, 5, 6)
    )
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.features_i, other.features_i)


def test_a_pair_is_named_and_short_clips_are_counted():
    store = ClipStore.build([clip(30, "walk", 4), clip(8, "wave", 5), clip(12, "wave", 6)])
    drawn = Draw(torch.tensor([[0, 0], [0, 2]]), torch.tensor([[0, 0], [7, 1]]), torch.ones(2))
    assert store.describe(drawn, 1) == "walk (walk-4 from frame 7) + wave (wave-6 from frame 1)"
    assert [store.short(frames) for frames in (8, 12, 13, 60)] == [0, 1, 2, 3]


def source(config: DataConfig, labels=("a", "b", "c"), **known) -> Source:
    return Source(settled(config), [clip(2, label) for label in labels], **known)


def test_pairs_of_labels():
    everything = [("a", "b"), ("a", "c"), ("b", "a"), ("b", "c"), ("c", "a"), ("c", "b")]
    assert pair_labels(source(DataConfig())) == everything
    named = DataConfig(lower=("a", "b"), upper=("c", "b"))
    assert pair_labels(source(named)) == [("a", "c"), ("a", "b"), ("b", "c")]
    assert pair_labels(source(replace(named, pairs="all"))) == everything
    assert pair_labels(source(replace(named, pairs="single"))) == [("a", "a"), ("b", "b"), ("c", "c")]
    with pytest.raises(UserError, match="lower and upper go together"):
        pair_labels(source(DataConfig(lower=("a",))))
    with pytest.raises(UserError, match="no pair of different actions among a; name at least two"):
        pair_labels(source(DataConfig(), ("a",)))


def test_a_benchmark_knows_its_pairs():
    known = {"lower": ("a", "b"), "upper": ("c",), "tested": (("b", "c"),)}
    for pairs, expected in (
        ("test", [("b", "c")]),
        ("product", [("a", "c"), ("b", "c")]),
        ("all", [("a", "b"), ("a", "c"), ("b", "a"), ("b", "c"), ("c", "a"), ("c", "b")]),
        ("single", [("a", "a"), ("b", "b"), ("c", "c")]),
    ):
        assert pair_labels(source(DataConfig(pairs=pairs), **known)) == expected
    assert pair_labels(source(DataConfig(lower=("a",), upper=("b",)), **known)) == [("a", "b")]


def test_split_holds_out_clips_of_every_action():
    motions = [clip(3, name, seed) for name in ("walk", "wave") for seed in range(10)] + [clip(3, "once")]
    train, test = split(motions, 0.2, 0)
    assert {name: len(clips) for name, clips in group(test).items()} == {"once": 1, "walk": 2, "wave": 2}
    assert {name: len(clips) for name, clips in group(train).items()} == {"once": 1, "walk": 8, "wave": 8}
    many = [motion.source for motion in train + test if motion.label != "once"]
    assert len(set(many)) == len(many) == 20
    assert [motion.source for motion in split(motions, 0.2, 0)[1]] == [motion.source for motion in test]
    assert [motion.source for motion in split(motions, 0.2, 1)[1]] != [motion.source for motion in test]


@pytest.mark.parametrize("held_out", [0.01, 0.9, 1.0])
def test_both_sides_of_a_split_know_every_action(held_out):
    """A label's number is its place among the labels, so the two sides must have the same ones."""
    motions = [clip(3, name, seed) for name in ("walk", "wave") for seed in range(3)]
    train, test = (group(side) for side in split(motions, held_out, 0))
    assert list(train) == list(test) == ["walk", "wave"]
    assert {len(train[name]) + len(test[name]) for name in train} == {3}


def test_without_held_out_clips_all_are_trained_on_and_measured():
    motions = [clip(3, name, seed) for name in ("walk", "wave") for seed in range(3)]
    train, test = split(motions, 0.0, 0)
    assert {motion.source for motion in train} == {motion.source for motion in test}
    assert len(train) == len(test) == 6


def test_what_is_left_open_is_settled():
    config = settled(DataConfig())
    assert (config.fps, config.frames, config.held_out, config.padding) == (30.0, 60, 0.2, "masked")
    given = DataConfig(fps=25.0, frames=20, held_out=0.5, padding="real")
    assert settled(given) == given


class Benchmark:
    """What of a benchmark is read."""

    name, fps, frames, hash = "toy", 20.0, 45, "abc"
    lower, upper, pairs = ("walk",), ("wave", "drink"), (("walk", "wave"),)

    def clips(self, part: str) -> list[Motion]:
        assert part == "train"
        return [clip(50, label, seed, 20.0) for seed in range(2) for label in ("walk", "wave", "drink")]


@pytest.fixture
def benchmark(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "train.benchmarks", SimpleNamespace(load_benchmark=lambda folder: Benchmark()))
    return str(tmp_path)


def test_a_benchmark_brings_its_rate_length_and_pairs(benchmark):
    found = open_source(DataConfig(source=benchmark), REST)
    assert (found.config.fps, found.config.frames, found.config.held_out) == (20.0, 45, 0.0)
    assert found.config.padding == "real"
    assert [motion.label for motion in found.clips] == ["walk", "wave", "drink"] * 2
    assert pair_labels(found) == [("walk", "wave")]
    assert found.hash == "abc"
    agreeing = DataConfig(source=benchmark, fps=20.0, frames=45, held_out=0.5, padding="masked")
    assert open_source(agreeing, REST).config == agreeing


def test_what_contradicts_a_benchmark_is_refused(benchmark):
    for wrong, message in (
        ({"frames": 60}, "--data.frames: the benchmark toy has 45, not 60; leave it out"),
        ({"fps": 30.0}, "--data.fps: the benchmark toy has 20, not 30; leave it out"),
    ):
        with pytest.raises(UserError, match=message):
            open_source(DataConfig(source=benchmark, **wrong), REST)
    with pytest.raises(UserError, match="unknown name 'wavve'; did you mean wave"):
        open_source(DataConfig(source=benchmark, lower=("walk",), upper=("wavve",)), REST)


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
