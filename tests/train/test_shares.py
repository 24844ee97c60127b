"""Shares of pseudo-compositions, refined by decoupling."""

from dataclasses import replace

import pytest
import torch

from refine.coupling import CouplingConfig
from refine.decoupling import Decoupler, DecouplingConfig
from refine.mae import load_mae
from refine.synthetic import draw, perform
from renderers.body import Body
from renderers.skeleton import PART_NAMES
from train.data import ClipStore, DataConfig, draw_windows, settled
from train.shares import SharesConfig, refine_shares

ARMS = [PART_NAMES.index(name) for name in ("left_arm", "right_arm")]
LEGS = [PART_NAMES.index(name) for name in ("left_leg", "right_leg")]
CONFIG = SharesConfig(looks=10)


@pytest.fixture(scope="module")
def decoupler() -> Decoupler:
    return Decoupler(Body.free("light"), load_mae(), DecouplingConfig(precision="bfloat16"))


@pytest.fixture(scope="module")
def store(decoupler) -> ClipStore:
    """A walk, whose arms swing, and two actions of the arms."""
    clips = []
    for index, name in enumerate(("punching", "walk", "wave-both-hands")):
        random = torch.Generator().manual_seed(index)
        clips += [perform(draw(name, random), 40, decoupler.body.rest_joints) for _ in range(2)]
    return ClipStore.build(clips)


PUNCHING, WALK, WAVE = range(3)


def found(store, decoupler, pairs, config=CONFIG, seed=0):
    data = settled(DataConfig(frames=20))
    return refine_shares(
        lambda classes, random: store.pairs(draw_windows(store, classes, data, random), data),
        torch.tensor(pairs),
        3,
        decoupler,
        CouplingConfig(),
        config,
        torch.Generator().manual_seed(seed),
    )


def test_arms_lean_to_the_action_that_lives_in_them_and_legs_to_the_other(store, decoupler):
    leans = found(store, decoupler, [(WALK, PUNCHING), (WALK, WAVE)])
    assert leans.shape == (3, 3, 5)
    for other in (PUNCHING, WAVE):
        assert (leans[WALK, other, ARMS] < -0.3).all()
        assert (leans[WALK, other, LEGS] > -0.05).all()
    assert torch.equal(leans, -leans.transpose(0, 1))
    assert (leans[PUNCHING, WAVE] == 0).all()  # nobody asked


def test_a_pair_is_refined_by_itself_and_in_either_order(store, decoupler):
    alone = found(store, decoupler, [(WALK, WAVE)])
    torch.testing.assert_close(found(store, decoupler, [(WAVE, WALK)]), alone, rtol=0, atol=0)
    torch.testing.assert_close(found(store, decoupler, [(WAVE, WALK), (WALK, WAVE)]), alone, rtol=0, atol=0)
    apart = found(store, decoupler, [(WALK, PUNCHING), (WALK, WAVE)], replace(CONFIG, pairs=1))
    assert (apart[WALK, WAVE, ARMS] < -0.3).all()


def test_nothing_leans_that_is_alone_or_held_or_not_looked_at(store, decoupler):
    assert (found(store, decoupler, [(WALK, WALK)]) == 0).all()
    assert (found(store, decoupler, [(WALK, WAVE)], SharesConfig(looks=0)) == 0).all()
    held = found(store, decoupler, [(WALK, WAVE)], replace(CONFIG, looks=20, stay=1.0))
    assert held.abs().max() < 0.2


def test_frames_are_drawn_at_random_and_anew(store, decoupler, monkeypatch):
    drawn = []

    def look(made, batch, decoupler, count, chances):
        drawn.append(chances.argmax(1))
        return made.square().mean()

    monkeypatch.setattr("train.shares.decoupling_term", look)
    found(store, decoupler, [(WALK, WAVE)], replace(CONFIG, looks=30))
    assert len({int(frame) for frame in torch.cat(drawn)}) > 8  # of 20
