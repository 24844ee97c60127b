"""The built-in actions in words: said as they are performed, and no tested pair is learned."""

from collections import Counter

import pytest
import torch

from refine.synthetic import ACTIONS, draw
from refine.text.builtin import PHRASINGS, builtin_corpus, builtin_pairs, parts_of, phrasings_of
from refine.text.labellers import labeller
from refine.text.phrases import PHRASES


@pytest.fixture(scope="module")
def corpus(rest_joints):
    return builtin_corpus(rest_joints, seed=2, clips=5, seconds=0.5)


def test_every_action_is_said_in_five_ways_that_no_other_has():
    assert set(PHRASINGS) == set(ACTIONS)
    every = [text for texts in PHRASINGS.values() for text in texts]
    assert len(set(every)) == len(every) and all(len(texts) >= 5 for texts in PHRASINGS.values())
    for name, phrase in PHRASES.items():
        assert PHRASINGS[name][0].startswith(phrase), name  # the usual way comes first


def test_the_hand_that_is_said_is_the_hand_that_acts():
    random = torch.Generator().manual_seed(0)
    hands = Counter()
    for _ in range(20):
        drawn = draw("drink", random)
        (arm,) = parts_of(drawn).names
        hands[arm] += 1
        assert all(f"{arm.split()[0]} hand" in text for text in phrasings_of(drawn))
    assert set(hands) == {"left arm", "right arm"}


def test_true_parts_are_those_of_the_performance():
    random = torch.Generator().manual_seed(0)
    parts = {name: parts_of(draw(name, random)).names for name in ACTIONS}
    assert parts["walk"] == parts["left-kicking"] == ("global", "left leg", "right leg")
    assert parts["stand"] == ("left leg", "right leg")
    assert parts["standing-rotation"] == ("torso", "left arm", "right arm")
    assert parts["wave-right-hand"] == ("right arm",)
    said = {name: labeller()([PHRASINGS[name][0].format(hand="right")])[0].parts.names for name in ACTIONS}
    assert {name for name in ACTIONS if said[name] != parts[name]} <= {"left-kicking", "drink"}  # one leg; either hand


def test_no_tested_pair_is_learned_and_none_stands_still():
    for seed in range(3):
        pairs = {split: {frozenset(pair) for pair in some} for split, some in builtin_pairs(seed).items()}
        assert not pairs["train"] & pairs["test"] and min(map(len, pairs.values())) >= 25
        assert not any("stand" in pair for some in pairs.values() for pair in some)
    assert builtin_pairs(0) == builtin_pairs(0) != builtin_pairs(1)


def alone(item) -> bool:
    return item.split == "train" and item.actions == 1


def together(item) -> bool:
    return item.split != "test" and item.actions == 2


def test_single_actions_and_true_pairs(corpus):
    assert len({item.key for item in corpus}) == len(corpus)
    counts = Counter((item.split, item.actions) for item in corpus)
    few, many = (len(pairs) for pairs in builtin_pairs(2).values())
    assert counts == {
        ("train", 1): 3 * len(ACTIONS), ("val", 1): len(ACTIONS), ("test", 1): len(ACTIONS),
        ("train", 2): few, ("val", 2): few, ("test", 2): 2 * many,
    }  # fmt: skip
    action = {text.format(hand=hand): name for name, texts in PHRASINGS.items() for text in texts
              for hand in ("left", "right")}  # fmt: skip
    learned = {
        use: {frozenset(map(action.get, said)) for item in corpus for said in item.phrasings if use(item)}
        for use in (alone, together)
    }
    for item in corpus:
        if item.split == "test":
            for said in item.phrasings:
                names = list(map(action.get, said))
                assert all(frozenset([name]) in learned[alone] for name in names)
                assert len(names) == 1 or frozenset(names) not in learned[together]
    clips = [item.motion.rotations for item in corpus]
    assert all(len(rotations) == 15 for rotations in clips)
    assert len({rotations.numpy().tobytes() for rotations in clips}) == len(clips)  # no two clips alike
    heads = {tuple(item.motion.rotations[0, 12].flatten().tolist()) for item in corpus if item.actions == 1}
    assert len(heads) > 0.9 * 5 * len(ACTIONS)  # nor held alike: each action draws styles of its own


def test_pairs_are_said_in_either_order(corpus):
    pair = next(item for item in corpus if item.actions == 2)
    assert {said[::-1] for said in pair.phrasings} == set(pair.phrasings)
    i, j = pair.motion.label.split("+")
    assert pair.key.split("-train")[0] in (f"{i}+{j}", f"{j}+{i}")
