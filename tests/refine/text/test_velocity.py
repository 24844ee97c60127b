"""Parts from how fast they move: both rules against numbers worked out by hand, and on motions that are known."""

import pytest
import torch

from refine.motion import Motion, crop
from refine.synthetic import draw, perform
from refine.text.parts import BODY_PARTS
from refine.text.velocity import RULES, parts_above, scores_of
from renderers.checks import ShapeError, UserError

SPEEDS = {"left arm": 3.0, "right arm": 1.0}
ARMS = {"left arm": (13, 16, 18, 20), "right arm": (14, 17, 19, 21)}


def joints(alternating: bool = False) -> torch.Tensor:
    """[5 24 3]: arms at constant speeds; with ``alternating``, neighbours in the left arm move against each other."""
    found = torch.zeros(5, 24, 3)
    for name, speed in SPEEDS.items():
        for number, joint in enumerate(ARMS[name]):
            sign = -1 if alternating and name == "left arm" and number % 2 else 1
            found[:, joint, 0] = sign * speed * torch.arange(5) / 10
    return found


def test_the_codes_rule_scales_the_speeds_of_a_motion() -> None:
    scores = RULES["code"].scores(joints(), 10.0)
    assert scores.tolist() == pytest.approx([0, 0, 1, 1 / 3, 0, 0], abs=1e-6)


def test_the_codes_rule_takes_the_mean_of_vectors() -> None:
    """Joints that move against each other leave their part at rest."""
    assert RULES["code"].scores(joints(alternating=True), 10.0).tolist() == pytest.approx([0, 0, 0, 1, 0, 0], abs=1e-6)


def test_the_papers_rule_standardises_the_speeds() -> None:
    speeds = torch.tensor([0.0, 0, 3, 1, 0, 0], dtype=torch.float64)
    by_hand = ((speeds - speeds.mean()) / ((speeds - speeds.mean()) ** 2).mean().sqrt()).tolist()
    assert RULES["paper"].scores(joints(), 10.0).tolist() == pytest.approx(by_hand, abs=1e-5)
    assert RULES["paper"].scores(joints(alternating=True), 10.0).tolist() == pytest.approx(by_hand, abs=1e-5)


def test_hands_do_not_count() -> None:
    moving = joints()
    moving[:, 22] = torch.rand(5, 3)
    for rule in RULES.values():
        assert torch.equal(rule.scores(moving, 10.0), rule.scores(joints(), 10.0))


@pytest.mark.parametrize("rule", RULES)
def test_a_wave_is_about_its_arm(rule: str, rest_joints, generator) -> None:
    motion = perform(draw("wave-right-hand", generator), 60, rest_joints)
    scores = scores_of(motion, rest_joints, rule)
    assert max(scores, key=scores.__getitem__) == "right arm"
    assert parts_above(scores, RULES[rule].threshold).names == ("right arm",)


@pytest.mark.parametrize("rule", RULES)
def test_what_stands_still_is_about_nothing(rule: str, rest_joints) -> None:
    still = Motion(torch.eye(3).repeat(9, 24, 1, 1), torch.zeros(9, 3), 30.0)
    assert parts_above(scores_of(still, rest_joints, rule), RULES[rule].threshold).names == ()


def test_a_threshold_is_passed_by_more(rest_joints) -> None:
    scores = dict(zip(BODY_PARTS, (0.1, 0.5, 0.6, 1.0, 0.0, 0.5), strict=True))
    assert parts_above(scores, 0.5).names == ("left arm", "right arm")


def test_one_frame_holds_no_motion(rest_joints, generator) -> None:
    motion = crop(perform(draw("walk", generator), 4, rest_joints), 0, 1)
    with pytest.raises(UserError, match="single frame"):
        scores_of(motion, rest_joints, "paper")
    with pytest.raises(ShapeError):
        RULES["paper"].scores(torch.zeros(3, 22, 3), 30.0)
