"""What a batch of described clips holds: singles, pairs, and what is made of two singles."""

from collections import Counter
from dataclasses import replace

import pytest
import torch

from refine.coupling import couple
from refine.motion import Motion, trimmed
from refine.synthetic import draw, perform
from refine.text.described import Described
from refine.text.features import from_text_features
from refine.text.parts import Labelled, Parts
from refine.text.sentences import TEMPLATES, combine
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import heading, rotation_about
from train.text_data import TextDataConfig, TextStore, batch_of, below

FPS = 20.0
LEGS, RIGHT, LEFT = (
    Parts.of(names) for names in (("global", "left leg", "right leg"), ("right arm",), ("left arm", "torso"))
)
ABOUT = {"walk": LEGS, "run": LEGS, "wave": RIGHT, "raise a hand": RIGHT, "lean": LEFT}


def labeller(phrases):
    return [Labelled(phrase, ABOUT[phrase], "test") for phrase in phrases]


def motion(name: str, frames: int, seed: int) -> Motion:
    rest_joints = Body.free("light").rest_joints
    return perform(draw(name, torch.Generator().manual_seed(seed), FPS), frames, rest_joints)


@pytest.fixture(scope="module")
def items() -> list[Described]:
    return [
        Described(motion("walk", 60, 0), (("walk",),), "a"),
        Described(motion("run", 50, 1), (("run",),), "b"),
        Described(motion("wave-right-hand", 40, 2), (("wave",), ("raise a hand",)), "c"),
        Described(motion("standing-rotation", 30, 3), (("lean",),), "d"),
        Described(motion("squat", 70, 4), (("squat", "wave"),), "e"),
    ]


def config(**given) -> TextDataConfig:
    return TextDataConfig(**{"fps": FPS, "frames": 32, **given})


def test_only_what_is_compatible_is_put_together(items):
    store = TextStore.build(items, config(probability=1.0), labeller)
    batch = store.draw(300, torch.Generator().manual_seed(0))
    pairs = Counter(frozenset(texts) for texts in batch.texts)
    wrong = {
        frozenset(pair) for pair in (("walk", "run"), ("wave", "raise a hand"), ("walk", "walk"), ("wave", "wave"))
    }
    assert not wrong & set(pairs)
    assert all(
        pairs[frozenset(pair)]
        for pair in (("walk", "wave"), ("run", "lean"), ("raise a hand", "lean"), ("squat", "wave"))
    )
    assert all(len(texts) == 2 for texts in batch.texts)  # at probability 1 nothing is learned alone


def test_how_often_singles_are_joined_and_how_they_are_said(items):
    store = TextStore.build(items, config(probability=0.25, pairs=False), labeller)
    batch = store.draw(1200, torch.Generator().manual_seed(1))
    joined = [texts for texts in batch.texts if len(texts) == 2]
    assert abs(len(joined) / 1200 - 0.25) < 0.04
    for texts, sentence in zip(batch.texts, batch.sentences, strict=True):
        assert sentence in {combine(texts, name) for name in TEMPLATES}
    said = Counter(texts[0] for texts in batch.texts if texts[0] in ("wave", "raise a hand"))
    assert abs(said["wave"] - said["raise a hand"]) < 70  # phrasings take turns


def test_a_joined_clip_is_both_from_their_first_frames(items):
    store = TextStore.build(items, config(probability=1.0, frames=1000), labeller)
    random = torch.Generator().manual_seed(3)
    walk, lean = items[0].motion, items[3].motion
    made = store.join(walk, lean, "walk", "lean", random)
    assert len(made) == 30
    legs = torch.tensor([joint in (0, 1, 2, 4, 5, 7, 8, 10, 11) for joint in range(24)])
    assert torch.equal(made.rotations[:, legs], walk.rotations[:30, legs])
    others = torch.tensor([13, 16, 18, 20, 22, 3, 6, 9, 12, 15])
    assert torch.equal(made.rotations[:, others], lean.rotations[:30, others])
    assert torch.equal(made.root, walk.root[:30])
    # lean has fewer parts (2 of 3), so its own; what nobody asks for is the walk's
    right = torch.tensor([14, 17, 19, 21, 23])
    assert torch.equal(made.rotations[:, right], walk.rotations[:30, right])


def test_random_composition_takes_any_partner_and_any_parts(items):
    store = TextStore.build(items, config(probability=1.0, synthetic="random", pairs=False), labeller)
    assert not store.parts  # nobody is asked
    batch = store.draw(300, torch.Generator().manual_seed(4))
    assert {("walk", "run"), ("walk", "walk")} <= set(batch.texts)
    made = [
        store.join(items[0].motion, items[3].motion, "walk", "lean", torch.Generator().manual_seed(seed))
        for seed in range(40)
    ]
    heads = Counter(bool(torch.equal(each.rotations[:, 15], items[3].motion.rotations[:30, 15])) for each in made)
    assert min(heads.values()) > 5


def test_without_synthesis_recordings_stay_what_they_are(items):
    store = TextStore.build(items, config(synthetic="none"))
    batch = store.draw(200, torch.Generator().manual_seed(5))
    assert {len(texts) for texts in batch.texts} == {1, 2}
    assert {texts for texts in batch.texts if len(texts) == 2} == {("squat", "wave")}
    pairs = TextStore.build(items, config(singles=False))
    assert [item.key for item in pairs.items] == ["e"] and not pairs.config.composes


def test_stretches_are_canonical_and_cut(items):
    turned = []
    for item in items:
        turn = rotation_about("y", torch.tensor(1.1))
        rotations = item.motion.rotations.clone()
        rotations[:, 0] = turn @ rotations[:, 0]
        moved = replace(item.motion, rotations=rotations, root=item.motion.root @ turn.mT + torch.tensor([3.0, 0, 4]))
        turned.append(replace(item, motion=moved))
    plain, other = (
        TextStore.build(each, config(synthetic="none")).draw(12, torch.Generator().manual_seed(6))
        for each in (items, turned)
    )
    torch.testing.assert_close(plain.features, other.features, atol=1e-5, rtol=1e-5)
    assert plain.valid.sum(1).max() == 32 and plain.features.shape[1] == 32
    assert not plain.features[~plain.valid].any()
    for features, valid in zip(plain.features, plain.valid, strict=True):
        rotations, root = from_text_features(features[valid])
        assert abs(float(heading(rotations[0, 0]))) < 1e-4 and root[0, [0, 2]].abs().max() == 0


def test_draws_are_the_generators_alone(items):
    store = TextStore.build(items, config(), labeller)
    one, same, other = (store.draw(8, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1))
    assert torch.equal(one.features, same.features) and one.sentences == same.sentences
    assert one.sentences != other.sentences


def test_frame_rates_and_short_clips(items):
    store = TextStore.build(items, config(fps=10.0, synthetic="none"))
    assert [len(item.motion) for item in store.items] == [30, 25, 20, 15, 35]
    short = [replace(items[0], motion=motion("walk", 14, 9))]
    with pytest.raises(UserError, match="no clips of 15 frames"):
        TextStore.build(short, config())


def test_what_cannot_be_learned():
    with pytest.raises(UserError, match="nothing to learn"):
        TextDataConfig(singles=False, pairs=False)
    with pytest.raises(UserError, match="because"):
        TextDataConfig(conjunctions=("because",))
    with pytest.raises(UserError, match="probability"):
        TextDataConfig(probability=1.5)


def test_below_is_uniform_and_never_reaches_its_limit():
    random = torch.Generator().manual_seed(0)
    drawn = Counter(below(3, random) for _ in range(3000))
    assert set(drawn) == {0, 1, 2} and all(abs(count - 1000) < 120 for count in drawn.values())


def test_a_batch_is_padded_behind(items):
    batch = batch_of([items[0].motion, items[3].motion], [("walk",), ("lean",)], ["walk", "lean"])
    assert batch.features.shape == (2, 60, 135) and batch.valid.sum(1).tolist() == [60, 30]


def test_composition_by_energies_is_the_coupling(items):
    rest_joints = Body.free("light").rest_joints
    store = TextStore.build(items, config(probability=1.0, synthetic="energies", pairs=False), rest_joints=rest_joints)
    walk, lean = items[0].motion, items[3].motion
    made = store.join(walk, lean, "walk", "lean", torch.Generator())
    expected = couple(*trimmed((walk, lean)), rest_joints, 0.5).motion
    assert torch.equal(made.rotations, expected.rotations) and torch.equal(made.root, expected.root)
    assert {("walk", "run"), ("walk", "lean")} <= set(store.draw(300, torch.Generator().manual_seed(0)).texts)
