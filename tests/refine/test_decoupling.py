"""Eq. 7: what it sees, what it ignores, where its gradient goes (protocol G, last paragraph)."""

from dataclasses import replace

import pytest
import torch

from refine.decoupling import PAPER, Clips, Decoupler, pin
from refine.mae import MAE, MAEConfig
from refine.patches import patchify
from renderers.body import Body
from renderers.checks import ShapeError, UserError
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.skeleton import JOINTS

PLAIN = replace(PAPER, pinned="frame")
FRAMES = torch.tensor([[0, 3], [2, 5]])


@pytest.fixture(scope="module")
def body():
    return Body.free("light")


@pytest.fixture(scope="module")
def mae():
    torch.manual_seed(0)
    return MAE(MAEConfig(width=48, depth=1, heads=3, decoder_width=32, decoder_depth=1, decoder_heads=2))


def clips(seed, moving=("left_elbow",), frames=6, batch=2):
    """Arms down, upright; the named joints swing."""
    generator = torch.Generator().manual_seed(seed)
    pose = torch.zeros(batch, frames, 24, 3)
    pose[..., JOINTS["left_shoulder"], 2] = -1.2
    pose[..., JOINTS["right_shoulder"], 2] = 1.2
    for name in moving:
        pose[..., JOINTS[name], :] += torch.randn(batch, frames, 3, generator=generator) * 0.5
    root = torch.tensor([0.0, 0.9, 0.0]).expand(batch, frames, 3)
    return Clips(axis_angle_to_matrix(pose), root.clone())


def turned(clip, yaw, shift):
    turn = rotation_about("y", torch.tensor(yaw))
    rotations = clip.rotations.clone()
    rotations[:, :, 0] = turn @ rotations[:, :, 0]
    return Clips(rotations, clip.root @ turn.mT + torch.tensor(shift))


@pytest.mark.parametrize("mode", ["sequence", "frame", "body"])
def test_pinning_removes_a_common_turn_and_place(mode):
    clip = clips(0)
    clip.root[:] += torch.arange(6)[:, None] * torch.tensor([0.1, 0.0, 0.2])
    one, two = pin(clip, mode), pin(turned(clip, 1.1, [3.0, 0.0, -2.0]), mode)
    assert torch.allclose(one.rotations, two.rotations, atol=1e-5) and torch.allclose(one.root, two.root, atol=1e-5)


def test_what_each_pinning_keeps():
    clip = clips(0)
    clip.root[:, :, 2] = torch.arange(6.0)
    clip.rotations[:, :, 0] = rotation_about("y", torch.linspace(0, 1, 6)) @ rotation_about("x", torch.tensor(0.4))
    sequence, frame, body = (pin(clip, mode) for mode in ("sequence", "frame", "body"))
    assert sequence.root[0, -1, 2] == pytest.approx(5.0) and not torch.allclose(
        sequence.rotations[:, 0, 0], sequence.rotations[:, -1, 0]
    )
    assert frame.root[..., [0, 2]].abs().max() < 1e-6 and frame.root[0, 0, 1] == pytest.approx(0.9)
    assert torch.allclose(frame.rotations[0, -1, 0], rotation_about("x", torch.tensor(0.4)), atol=1e-6)
    assert body.root.abs().max() == 0 and torch.allclose(body.rotations[0, -1, 0], torch.eye(3), atol=1e-6)


def test_loss_ignores_a_common_turn_and_place(body, mae):
    decoupler = Decoupler(body, mae, PLAIN)
    three = clips(0), clips(1, ["left_knee"]), clips(2, ["right_elbow"])
    here = decoupler(*three, FRAMES).loss
    there = decoupler(*(turned(clip, 0.7, [1.0, 0.0, 2.0]) for clip in three), FRAMES).loss
    assert float(there) == pytest.approx(float(here), rel=1e-3)


def test_trace_holds_every_stage(body, mae):
    views = (0.0, 90.0)
    trace = Decoupler(body, mae, replace(PLAIN, views=views))(clips(0), clips(1), clips(2), FRAMES)
    pictures = 2 * 2 * len(views)
    assert trace.composed.pictures.shape == (pictures, 6, 64, 64)
    for side, reference in zip(trace.sides, trace.references, strict=True):
        assert side.kept.shape == (pictures, 64) and side.kept.sum(1).unique().tolist() == [21]
        assert side.attention.shape == (pictures, 64, 64) and side.loss.shape == (pictures,)
        visible = patchify(trace.composed.pictures, 8)[side.kept]
        assert torch.equal(patchify(side.inpainted, 8)[side.kept], visible)
        assert reference.seen.joints_px.shape == (pictures, 24, 2)
    expected = sum(
        (side.inpainted - ref.seen.pictures).square().mean()
        for side, ref in zip(trace.sides, trace.references, strict=True)
    )
    assert float(trace.loss) == pytest.approx(float(expected), rel=1e-5)


def test_pictures_run_clip_frame_view(body, mae):
    decoupler = Decoupler(body, mae, replace(PLAIN, views=(0.0, 90.0)))
    clip = clips(0, ["left_elbow", "right_knee"])
    every = decoupler.see(clip, FRAMES, decoupler.cameras(clip, clip)).pictures
    side_only = Decoupler(body, mae, replace(PLAIN, views=(90.0,)))
    alone = Clips(clip.rotations[1:], clip.root[1:])
    one = side_only.see(alone, torch.tensor([[5]]), side_only.cameras(clip, clip)).pictures
    assert torch.allclose(every[(1 * 2 + 1) * 2 + 1], one[0], atol=1e-4)


def test_kept_patches_lie_where_the_action_moves(body, mae):
    trace = Decoupler(body, mae, PLAIN)(clips(0), clips(1, ["left_shoulder"]), clips(2, ["right_shoulder"]), FRAMES)
    columns = torch.arange(64) % 8
    left_of_body, right_of_body = (columns[side.kept[0]].float().mean() for side in trace.sides)
    assert left_of_body > 3.5 > right_of_body  # the left arm appears on the picture's right


def test_no_gradient_into_masked_patches(body, mae):
    decoupler = Decoupler(body, mae, PLAIN)
    composed, i, j = clips(0), clips(1), clips(2)
    cameras = decoupler.cameras(i, j)
    seen = decoupler.see(composed, FRAMES, cameras)
    pictures = seen.pictures.detach().requires_grad_()
    trace = decoupler.compare(seen._replace(pictures=pictures), decoupler.references(i, j, FRAMES, cameras))
    trace.sides[0].loss.sum().backward()
    of_patches = patchify(pictures.grad, 8).abs().sum(-1)
    assert (of_patches[~trace.sides[0].kept] == 0).all() and (of_patches[trace.sides[0].kept] > 0).any()


def test_gradient_reaches_the_composition_alone(body, mae):
    decoupler = Decoupler(body, mae, PLAIN)
    composed, i, j = (Clips(*(value.requires_grad_() for value in clips(seed))) for seed in range(3))
    decoupler(composed, i, j, FRAMES).loss.backward()
    assert composed.rotations.grad.abs().sum() > 0 and i.rotations.grad is None and j.rotations.grad is None
    drawn = torch.zeros(2, 6, dtype=torch.bool)
    drawn[torch.arange(2)[:, None], FRAMES] = True
    of_frames = composed.rotations.grad.abs().sum((2, 3, 4))
    assert (of_frames[drawn] > 0).all() and (of_frames[~drawn] == 0).all()
    assert all(parameter.grad is None for parameter in mae.parameters())


def test_gradient_against_finite_differences(body, mae):
    decoupler = Decoupler(body, mae, PLAIN)
    composed, i, j = clips(0, ["left_shoulder"]), clips(1), clips(2)
    rotations = composed.rotations.clone().requires_grad_()
    decoupler(Clips(rotations, composed.root), i, j, FRAMES).loss.backward()
    direction = rotations.grad / rotations.grad.norm()
    with torch.no_grad():
        step = 2e-3  # beyond it an untrained inpainter is no longer linear
        ahead, behind = (
            decoupler(Clips(rotations + sign * step * direction, composed.root), i, j, FRAMES).loss for sign in (1, -1)
        )
    assert float((ahead - behind) / (2 * step)) == pytest.approx(float(rotations.grad.norm()), rel=0.1)


def test_each_part_is_answered_for_once(body, mae):
    decoupler = Decoupler(body, mae, replace(PLAIN, ownership="share"))
    of_i, of_j = decoupler.ownership(torch.tensor([[1.0, 0, 9, 0, 0]]), torch.tensor([[1.0, 9, 0, 0, 0]]))
    assert torch.allclose(of_i + of_j, torch.ones(1, 6))
    torso, head, left_arm, right_arm = of_i[0, :4].tolist()
    assert torso == head == pytest.approx(0.5) and left_arm < 1e-6 and right_arm == pytest.approx(1.0)


def test_refusals(body, mae):
    with pytest.raises(UserError, match="draws 1 or 6 channels, the MAE wants 3"):
        Decoupler(body, MAE(replace(mae.config, channels=3)))
    with pytest.raises(UserError, match="no parts to own"):
        Decoupler(body, MAE(replace(mae.config, channels=1)), replace(PLAIN, ownership="share"))
    with pytest.raises(ShapeError, match="frames"):
        Decoupler(body, mae, PLAIN)(clips(0), clips(1), clips(2), FRAMES[:1])
