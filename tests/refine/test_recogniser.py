"""The recogniser: its graph, its size, what it cannot see, and what its parts say of compositions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from refine.recogniser import (
    ARM_JOINTS,
    LEG_JOINTS,
    OTHER,
    Recogniser,
    RecogniserConfig,
    both_actions,
    features_of,
    partitions,
)
from renderers.checks import ShapeError, UserError
from renderers.skeleton import JOINT_NAMES, PARENTS

SMALL = RecogniserConfig(("a", "b", "c"), widths=(8, 12), depths=(2, 1))


def built(config=SMALL, seed=0) -> Recogniser:
    """With statistics and edges that are not those of the start, so that a fault in any of them would show."""
    torch.manual_seed(seed)
    recogniser = Recogniser(config)
    for module in recogniser.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, std=0.3)
            nn.init.uniform_(module.running_var, 0.5, 2)
    for name, value in recogniser.named_parameters():
        if name.endswith("edges"):
            nn.init.uniform_(value, 0.5, 1.5)
    return recogniser.eval()


def clips(count=5, frames=12, seed=0):
    return torch.randn(count, frames, 24, 6, generator=torch.Generator().manual_seed(seed))


def partitions_by_loops(truncated: bool) -> np.ndarray:
    """ST-GCN's spatial strategy as its authors write it: matrix powers for distances, a loop over pairs."""
    count = len(PARENTS)
    linked = np.eye(count)
    for joint in range(1, count):
        linked[joint, PARENTS[joint]] = linked[PARENTS[joint], joint] = 1
    distance = np.full((count, count), np.inf)
    for power in reversed(range(2 if truncated else count)):
        distance[np.linalg.matrix_power(linked, power) > 0] = power
    normalised = linked @ np.diag(1 / linked.sum(0))
    found = np.zeros((3, count, count))
    for i in range(count):
        for j in range(count):
            if linked[j, i] and i == j:
                found[0, j, i] = normalised[j, i]
            elif linked[j, i] and distance[j, 0] >= distance[i, 0]:
                found[1, j, i] = normalised[j, i]
            elif linked[j, i]:
                found[2, j, i] = normalised[j, i]
    return found


@pytest.mark.parametrize(
    ("graph", "entries", "sums"),
    [("actor", [24, 40, 6], [8.6167, 13.3833, 2.0]), ("centripetal", [24, 23, 23], [8.6167, 7.0167, 8.3667])],
)
def test_the_graph_is_that_of_the_released_code(graph, entries, sums):
    found = partitions(graph)
    np.testing.assert_allclose(found, partitions_by_loops(graph == "actor"), atol=1e-7)
    assert (found != 0).sum((1, 2)).tolist() == entries
    assert found.sum((1, 2)).tolist() == pytest.approx(sums, abs=1e-4)
    assert torch.allclose(found.sum((0, 1)), torch.ones(24))


def test_the_graph_of_a_part_keeps_its_bones_and_directions():
    whole, part = partitions("centripetal"), partitions("centripetal", ARM_JOINTS)
    kept = torch.tensor(ARM_JOINTS)
    assert torch.equal(part != 0, whole[:, kept][:, :, kept] != 0)
    assert torch.allclose(part.sum((0, 1)), torch.ones(len(kept)))
    top = ARM_JOINTS.index(JOINT_NAMES.index("spine1"))  # without the pelvis one neighbour is left, and itself
    assert part[0, top, top] == pytest.approx(1 / 2)


@pytest.mark.parametrize(("classes", "count"), [(9, 3_084_969), (25, 3_089_081), (40, 3_092_936)])
def test_the_default_is_as_large_as_the_released_networks(classes, count):
    recogniser = Recogniser(RecogniserConfig(tuple(map(str, range(classes)))))
    assert sum(value.numel() for value in recogniser.parameters()) == count
    assert recogniser.blocks[0].past is None and isinstance(recogniser.blocks[1].past, nn.Identity)


@pytest.mark.parametrize(("frames", "left"), [(60, 15), (64, 16), (61, 16)])
def test_two_blocks_halve_the_frames(frames, left):
    recogniser = built(RecogniserConfig(("a",), widths=(4, 4, 6), depths=(1, 1, 1)))
    seen = recogniser.blocks(torch.zeros(1, 6, frames, 24))
    assert seen.shape == (1, 6, left, 24)
    assert recogniser.features(clips(2, frames)).shape == (2, 6)


def by_the_book(recogniser: Recogniser, six: torch.Tensor) -> torch.Tensor:
    """The network in the order of the paper and of ACTOR's code: convolve to all partitions, then mix the joints."""
    batch, frames, joints, _ = six.shape
    flat = six.permute(0, 2, 3, 1).reshape(batch, joints * 6, frames)
    x = nn.functional.batch_norm(
        flat, *(getattr(recogniser.norm, name) for name in ("running_mean", "running_var", "weight", "bias"))
    )
    x = x.reshape(batch, joints, 6, frames).permute(0, 2, 3, 1)
    for block in recogniser.blocks:
        linear, weighed = block.spatial.linear, block.spatial.graph * block.spatial.edges
        spread = nn.functional.conv2d(x, linear.weight[:, :, None, None], linear.bias)
        spread = spread.reshape(batch, 3, -1, *spread.shape[2:])
        y = block.temporal(torch.einsum("nkctv,kvw->nctw", spread, weighed))
        x = torch.relu(y + (block.past(x) if block.past else 0))
    return nn.functional.avg_pool2d(x, x.shape[2:])[:, :, 0, 0]


@pytest.mark.parametrize("graph", ["actor", "centripetal"])
def test_mixing_joints_first_changes_nothing(graph):
    recogniser = built(replace(SMALL, graph=graph)).double()
    six = clips().double()
    assert torch.allclose(recogniser.features(six), by_the_book(recogniser, six), atol=1e-10)
    logits = by_the_book(recogniser, six) @ recogniser.classify.weight.T + recogniser.classify.bias
    assert torch.allclose(recogniser(six), logits, atol=1e-10)


def test_only_rotations_enter():
    with pytest.raises(ShapeError, match="Recogniser"):  # ACTOR's layout with the translation in row 24
        built()(torch.zeros(2, 12, 25, 6))


@pytest.mark.parametrize("joints", [LEG_JOINTS, ARM_JOINTS, (5,)])
def test_a_part_sees_its_joints_and_no_other(joints):
    recogniser = built(replace(SMALL, joints=joints))
    six, hidden = clips(), [joint for joint in range(24) if joint not in joints]
    others, own = six.clone(), six.clone()
    others[:, :, hidden] = 7.0
    own[:, :, joints[0]] += 1.0
    assert torch.equal(recogniser(others), recogniser(six))
    assert not torch.allclose(recogniser(own), recogniser(six))


def test_legs_and_arms_share_the_body():
    assert sorted(LEG_JOINTS + ARM_JOINTS) == list(range(24))
    assert 0 in LEG_JOINTS


def test_clips_do_not_see_each_other():
    recogniser, six = built(), clips(7)
    order = torch.tensor([3, 6, 0, 5, 1, 2, 4])
    whole, shuffled = features_of(recogniser, six), features_of(recogniser, six[order], batch=2)
    assert whole.features.dtype == whole.logits.dtype == torch.float64
    assert torch.allclose(shuffled.features, whole.features[order], atol=1e-6)
    assert torch.allclose(shuffled.logits, recogniser(six)[order].double(), atol=1e-6)


def test_a_recogniser_in_training_has_no_features_to_compare():
    with pytest.raises(UserError, match="training mode"):
        features_of(built().train(), clips())


class Says(nn.Module):
    """Names whatever class is written into one number of the clip."""

    def __init__(self, place: int, *classes: str, alike=()):
        super().__init__()
        self.config, self.place = RecogniserConfig((*classes, OTHER), alike=alike), place
        self.classify = nn.Identity()
        self.classify.weight = torch.zeros(1)

    def features(self, six):
        return torch.eye(len(self.config.classes))[six[:, 0, self.place, 0].long()]

    names = Recogniser.names


def said(*pairs):
    six = torch.zeros(len(pairs), 2, 24, 6)
    six[:, :, 0, 0] = torch.tensor([legs for legs, _ in pairs])[:, None].float()
    six[:, :, 1, 0] = torch.tensor([arms for _, arms in pairs])[:, None].float()
    return six


def test_both_actions_are_there_when_each_part_names_its_own():
    legs, arms = Says(0, "walk", "run").eval(), Says(1, "wave", "bow").eval()
    found = both_actions(
        legs, arms, said((0, 0), (0, 1), (1, 1), (2, 0)), ["walk+wave", "walk+wave", "walk+bow", "run+wave"]
    )
    assert found.legs.tolist() == [True, True, False, False]
    assert found.arms.tolist() == [True, False, True, True]
    assert found.both.tolist() == [True, False, False, False]


def test_actions_that_are_alike_pass_for_each_other_and_no_other_does():
    legs = Says(0, "march", "walk", "march-and-punch", alike=(("march", "march-and-punch"),)).eval()
    arms = Says(1, "wave").eval()
    found = both_actions(legs, arms, said((2, 0), (0, 0), (1, 0), (3, 0)), ["march+wave"] * 4)
    assert found.legs.tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (["walk"], "'walk' is no pair"),
        (["walk+wave+bow"], "is no pair"),
        (["wak+wave"], "unknown name 'wak'; did you mean walk"),
        (["walk+other"], "unknown name 'other'"),
        (["walk+wave"] * 2, "2 labels for 1 clips"),
    ],
)
def test_labels_that_cannot_be_judged_are_refused(labels, message):
    with pytest.raises(UserError, match=message.replace("+", "[+]")):
        both_actions(Says(0, "walk").eval(), Says(1, "wave").eval(), said((0, 0)), labels)


@pytest.mark.parametrize(
    "change",
    [
        {"classes": ()},
        {"joints": ()},
        {"joints": (3, 1)},
        {"joints": (24,)},
        {"joints": (1, 1)},
        {"graph": "uniform"},
        {"widths": ()},
        {"widths": (8,)},
        {"depths": (1, 0)},
        {"kernel": 4},
        {"alike": (("a", "z"),)},
    ],
)
def test_networks_that_cannot_be_are_refused(change):
    with pytest.raises(UserError, match="RecogniserConfig"):
        replace(SMALL, **change)
