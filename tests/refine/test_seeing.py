"""What pictures of motions show, and what pinning and straightening take out of them."""

import math

import pytest
import torch

from refine.seeing import COLOURS, Clips, coloured, draw, mesh_to_draw, pin, reach, straighten
from renderers.body import Body
from renderers.camera import frame
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import DRAWN_PART_NAMES, JOINTS

LIMBS = [n for n, name in enumerate(DRAWN_PART_NAMES) if name not in ("torso", "head")]


@pytest.fixture(scope="module")
def body():
    return Body.free("light")


def clip(spine_twist=0.0, elbow=0.4, frames=3):
    pose = torch.zeros(1, frames, 24, 3)
    pose[..., JOINTS["spine2"], 1] = spine_twist
    pose[..., JOINTS["left_elbow"], 1] = elbow * torch.arange(frames)
    pelvis = rotation_about("y", torch.linspace(0.2, 1.0, frames)) @ rotation_about("x", torch.tensor(0.4))
    rotations = axis_angle_to_matrix(pose)
    rotations[0, :, 0] = pelvis
    return Clips(rotations, torch.randn(1, frames, 3, generator=torch.Generator().manual_seed(0)))


def pictures(body, clips, mode, yaw=0.0):
    rotations, root = (value[0] for value in pin(clips, mode))
    camera = frame(reach(body.rest_joints, mode), (64, 64), yaw=yaw, margin=0.0)
    return draw(body, mesh_to_draw(body, mode, len(DRAWN_PART_NAMES)), rotations, root, [camera], mode)


@pytest.mark.parametrize("mode", ["sequence", "frame", "body", "trunk"])
def test_pinning_removes_a_common_turn_and_place(mode):
    turn = rotation_about("y", torch.tensor(1.1))
    here = clip()
    rotations = here.rotations.clone()
    rotations[:, :, 0] = turn @ rotations[:, :, 0]
    there = Clips(rotations, here.root @ turn.mT + torch.tensor([3.0, 0.0, -2.0]))
    one, two = pin(here, mode), pin(there, mode)
    assert torch.allclose(one.rotations, two.rotations, atol=1e-5) and torch.allclose(one.root, two.root, atol=1e-5)


def test_each_pinning_takes_out_more():
    sequence, each, whole = (pin(clip(), mode) for mode in ("sequence", "frame", "body"))
    assert torch.allclose(sequence.root[0, 0, [0, 2]], torch.zeros(2), atol=1e-6) and sequence.root[0, 1, 0] != 0
    assert not torch.allclose(sequence.rotations[0, 0, 0], sequence.rotations[0, 2, 0], atol=0.1)
    assert each.root[..., [0, 2]].abs().max() < 1e-6 and torch.allclose(each.root[..., 1], clip().root[..., 1])
    assert torch.allclose(each.rotations[0, :, 0], rotation_about("x", torch.tensor(0.4)).expand(3, 3, 3), atol=1e-5)
    assert whole.root.abs().max() == 0 and torch.equal(whole.rotations[0, 2, 0], torch.eye(3))
    assert torch.equal(pin(clip(0.5), "trunk").rotations[:, :, 1:], clip(0.5).rotations[:, :, 1:])


def test_straightening_touches_the_spine_alone():
    before = axis_angle_to_matrix(torch.randn(2, 24, 3, generator=torch.Generator().manual_seed(0)))
    after = straighten(before)
    changed = [joint for joint in range(24) if not torch.equal(before[:, joint], after[:, joint])]
    assert changed == [JOINTS[name] for name in ("spine1", "spine2", "spine3")]
    assert torch.equal(after[0, changed[0]], torch.eye(3))


def test_on_a_straight_trunk_limbs_compare_though_the_spine_differs(body):
    straight, twisted = (pictures(body, clip(twist), "trunk").pictures for twist in (0.0, 0.6))
    assert torch.equal(straight[:, LIMBS], twisted[:, LIMBS])
    assert (straight[:, 0] - twisted[:, 0]).abs().max() > 0.3  # the torso is still drawn as it bends
    carried = [pictures(body, clip(twist), "body").pictures for twist in (0.0, 0.6)]
    assert (carried[0][:, LIMBS] - carried[1][:, LIMBS]).abs().max() > 0.9


def test_a_straight_clip_looks_the_same_either_way(body):
    one, two = (pictures(body, clip(), mode) for mode in ("body", "trunk"))
    assert torch.equal(one.pictures, two.pictures) and torch.equal(one.joints_px, two.joints_px)


def test_joints_lie_on_the_parts_that_are_drawn(body):
    seen = pictures(body, clip(0.6), "trunk")
    wrist = seen.joints_px[0, JOINTS["left_wrist"]]
    arm = seen.pictures[0, DRAWN_PART_NAMES.index("left_arm")]
    assert arm[int(wrist[1]), int(wrist[0])] > 0.5


def test_gradients_reach_the_spine_through_the_torso_alone(body):
    for channels, reached in ((LIMBS, False), ([0], True)):
        here = clip(0.6)
        here.rotations.requires_grad_()
        pictures(body, here, "trunk").pictures[:, channels].square().sum().backward()
        assert bool(here.rotations.grad[:, :, JOINTS["spine2"]].any()) is reached


@pytest.mark.parametrize("yaw", [0.0, 0.8, 1.57])
def test_every_view_shows_the_body_equally_large(body, yaw):
    focal = [
        frame(reach(body.rest_joints, "body"), (64, 64), yaw=angle, margin=0.0).focal[0, 0] for angle in (0.0, yaw)
    ]
    assert float(focal[0]) == pytest.approx(float(focal[1]), rel=0.02)


def test_colours_add_up_and_stay_in_range():
    """Whatever covers a pixel, it stays in 0..1, and what people would confuse can be told apart."""
    colours = torch.tensor(COLOURS)
    assert torch.equal(colours.sum(0), torch.ones(3)) and (colours >= 0).all()
    assert torch.nn.functional.pdist(torch.cat([torch.zeros(1, 3), colours])).min() > 0.35
    parts = torch.rand(2, 6, 4, 5, generator=torch.Generator().manual_seed(0))
    here = [sum(parts[1, p, 2, 3] * COLOURS[p][c] for p in range(6)) for c in range(3)]
    assert torch.allclose(coloured(parts)[1, :, 2, 3], torch.stack(here))


def test_an_arm_before_the_trunk_is_seen_in_colours(body):
    """From the left, an arm that hangs adds its red to the torso's colour."""
    pose = torch.zeros(1, 24, 3)
    pose[:, JOINTS["left_shoulder"], 2] = -1.3
    rotations = axis_angle_to_matrix(pose)
    camera = frame(reach(body.rest_joints, "body"), (64, 64), yaw=math.pi / 2, margin=0.0)
    seen = {}
    for channels in (3, 6):
        mesh = mesh_to_draw(body, "body", channels)
        seen[channels] = draw(body, mesh, rotations, torch.zeros(1, 3), [camera], "body", channels).pictures[0]
    torso, arm = (seen[6][DRAWN_PART_NAMES.index(name)] for name in ("torso", "left_arm"))
    both = (torso > 0.99) & (arm > 0.99)
    assert both.sum() > 5
    mixed = torch.tensor(COLOURS)[DRAWN_PART_NAMES.index("torso")] + torch.tensor([0.5, 0.0, 0.0])
    assert torch.allclose(seen[3][:, both], mixed[:, None].expand(-1, int(both.sum())), atol=0.02)


def test_refuses_pictures_that_are_not_drawn(body):
    with pytest.raises(UserError, match="not 2"):
        mesh_to_draw(body, "body", 2)
    for channels in (1, 3):
        with pytest.raises(UserError, match="need a channel for each part"):
            mesh_to_draw(body, "trunk", channels)
