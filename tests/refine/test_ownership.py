"""Who answers for which part: the rules on standings, and why they are of turning and not of travel."""

import pytest
import torch

from refine.energies import energy_signal, part_energies
from refine.ownership import Divided, as_divided, by_standing, everything
from refine.synthetic import draw, perform
from renderers.skeleton import DRAWN_PART_NAMES, PART_NAMES, PARTS

CHANNEL = {name: index for index, name in enumerate(DRAWN_PART_NAMES)}


def divide(of_i, of_j, contested=0.5, quiet=0.3):
    """Answers of i and of j by channel name, from energies given by part name."""
    rows = (torch.tensor([[part.get(name, 0.0) for name in PART_NAMES]]) for part in (of_i, of_j))
    sides = by_standing(*rows, contested, quiet)
    return [dict(zip(DRAWN_PART_NAMES, side.answers[0].tolist(), strict=True)) for side in sides], sides


def test_a_part_belongs_to_the_action_that_lives_in_it():
    (i, j), sides = divide({"left_leg": 1, "right_leg": 1}, {"left_arm": 3})
    assert i["left_leg"] == i["right_leg"] == 1 and j["left_arm"] == 1
    assert i["left_arm"] == j["left_leg"] == 0
    assert not sides[0].shown[0, CHANNEL["left_arm"]] and sides[1].shown[0, CHANNEL["left_arm"]]


def test_standings_count_and_not_energies():
    calm, wild = {"left_arm": 0.01}, {"left_leg": 90.0, "right_leg": 90.0, "left_arm": 10.0}
    (_, j), _ = divide(wild, calm)
    assert j["left_arm"] == 1
    scaled, _ = divide({name: 7 * value for name, value in wild.items()}, calm)
    assert scaled[1] == pytest.approx(j)


def test_what_nobody_or_both_live_in_is_left_to_coupling():
    (i, j), sides = divide({"left_leg": 10, "left_arm": 5}, {"left_arm": 10})
    assert i["left_arm"] == j["left_arm"] == 0  # .5 against 1: both
    assert i["right_arm"] == j["right_arm"] == i["torso"] == j["head"] == 0  # neither
    assert all(side.shown[0, CHANNEL[name]] for side in sides for name in ("left_arm", "right_arm", "torso"))


def test_certainty_fades_from_half_of_contested_to_contested():
    (_, clear), _ = divide({"left_leg": 8, "left_arm": 2}, {"left_arm": 1})
    (_, unsure), _ = divide({"left_leg": 8, "left_arm": 3}, {"left_arm": 1})
    assert clear["left_arm"] == pytest.approx(1.0) and unsure["left_arm"] == pytest.approx(0.5)


def test_a_resting_arm_goes_with_the_trunk_that_carries_it():
    (_, j), _ = divide({"left_leg": 1, "right_leg": 1}, {"torso": 1})
    assert j["torso"] == j["head"] == j["left_arm"] == j["right_arm"] == 1 and j["left_leg"] == 0


def test_exchanging_the_actions_exchanges_what_they_own(generator):
    energies = torch.rand(2, 50, 5, generator=generator) ** 4
    one, two = by_standing(*energies, 0.5, 0.3), by_standing(*energies.flip(0), 0.5, 0.3)
    for mine, its in ((one[0], two[1]), (one[1], two[0])):
        assert torch.equal(mine.answers, its.answers) and torch.equal(mine.shown, its.shown)
    assert (one[0].answers * one[1].answers).max() == 0
    assert (one[0].shown | one[1].shown).all()


def test_as_published_everybody_answers_for_everything():
    for side in everything(2, 6):
        assert side.answers.shape == (2, 6) and side.answers.min() == 1 and side.shown.all()


def test_a_runs_swinging_arms_are_not_its_own_but_a_punchers_are(rest_joints):
    def turning(name):
        clip = perform(draw(name, torch.Generator().manual_seed(3)), 60, rest_joints)
        return part_energies(energy_signal(clip.rotations, clip.root, rest_joints, "rot6d"))[None]

    wave = turning("wave-both-hands")
    arms = [CHANNEL["left_arm"], CHANNEL["right_arm"]]
    assert by_standing(turning("run"), wave, 0.5, 0.3)[1].answers[0, arms].min() > 0.8
    assert by_standing(turning("punching-and-knee-lifting"), wave, 0.5, 0.3)[1].answers[0, arms].max() == 0


def test_a_part_needs_standing_to_be_owned():
    for standing, sure in ((0.15, 0.0), (0.225, 0.5), (0.3, 1.0)):
        (i, _), _ = divide({"left_leg": 1.0, "right_leg": standing}, {"left_arm": 1.0})
        assert i["right_leg"] == pytest.approx(sure, abs=1e-6)


def test_as_divided_the_owner_answers_and_both_for_what_nobody_claims():
    def joints(*names):
        return torch.tensor([any(joint in PARTS[name] for name in names) for joint in range(24)])

    i, j = as_divided(Divided(joints("left_leg", "right_leg", "torso", "left_arm"), joints("torso", "left_arm")))
    of = {name: (i.answers[0, at].item(), j.answers[0, at].item()) for name, at in CHANNEL.items()}
    assert of == {
        "torso": (1, 1),
        "head": (1, 1),
        "left_arm": (1, 1),
        "right_arm": (0, 1),
        "left_leg": (1, 0),
        "right_leg": (1, 0),
    }
    assert all(torch.equal(side.shown, side.answers > 0) for side in (i, j))
