"""Eq. 7: what it sees, what it ignores, where its gradient goes (protocol G, last paragraph)."""

from dataclasses import replace

import pytest
import torch

from refine import decoupling
from refine.attention import attention_map
from refine.decoupling import PAPER, Decoupler, DecouplingConfig
from refine.mae import MAE, MAEConfig, load_mae
from refine.patches import patchify
from refine.seeing import Clips, coloured
from renderers.body import Body
from renderers.checks import ShapeError, UserError
from renderers.rotations import axis_angle_to_matrix, rotation_about
from renderers.silhouette import blur
from renderers.skeleton import DRAWN_PART_NAMES, JOINTS

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
    cameras = side_only.cameras(clip, clip)
    for number, frame in ((0, 3), (1, 2), (1, 5)):
        place = FRAMES[number].tolist().index(frame)
        one = side_only.see(Clips(*(value[number : number + 1] for value in clip)), torch.tensor([[frame]]), cameras)
        assert torch.allclose(every[(number * 2 + place) * 2 + 1], one.pictures[0], atol=1e-4)


def test_motions_drawn_together_are_those_drawn_apart(body, mae):
    """Each in its place, whatever its length."""
    decoupler = Decoupler(body, mae, replace(PLAIN, views=(0.0, 90.0)))
    motions = clips(0), clips(1, ["right_knee"], frames=9)
    cameras = decoupler.cameras(*motions)
    for together, motion in zip(decoupler.see_each(motions, FRAMES, cameras), motions, strict=True):
        apart = decoupler.see(motion, FRAMES, cameras)
        assert torch.allclose(together.pictures, apart.pictures, atol=1e-6)
        assert torch.allclose(together.joints_px, apart.joints_px)


def test_a_view_of_ninety_degrees_sees_the_left_side(body, mae):
    front, left = Decoupler(body, mae, replace(PLAIN, views=(0.0, 90.0))).cameras(clips(0), clips(1))
    ahead, to_the_left = torch.eye(3)[None, None, 2], torch.eye(3)[None, None, 0]
    ahead, to_the_left = (point.expand(2, 1, 3) for point in (ahead, to_the_left))  # a camera for each of two clips
    assert front.project(to_the_left)[0, 0, 0] > 40 and front.project(ahead)[0, 0, 0] == pytest.approx(32, abs=1e-3)
    assert left.project(ahead)[0, 0, 0] < 24 and left.project(to_the_left)[0, 0, 0] == pytest.approx(32, abs=1e-3)


@pytest.mark.parametrize("mode", ["sequence", "frame", "body", "trunk"])
def test_the_picture_holds_raised_and_stretched_arms(body, mae, mode):
    pose = torch.zeros(1, 2, 24, 3)
    pose[0, 1, JOINTS["left_shoulder"], 2], pose[0, 1, JOINTS["right_shoulder"], 2] = 1.0, -1.0
    clip = Clips(axis_angle_to_matrix(pose), body.rest_joints[0].expand(1, 2, 3))
    decoupler = Decoupler(body, mae, replace(PLAIN, pinned=mode, views=(0.0, 45.0, 90.0)))
    pictures = decoupler.see(clip, torch.tensor([[0, 1]]), decoupler.cameras(clip, clip)).pictures.sum(1)
    assert (pictures.sum((1, 2)) > 100).all()
    assert pictures[:, [0, -1]].max() == 0 and pictures[:, :, [0, -1]].max() == 0


@pytest.mark.parametrize("whose", ["sub_action", "composition", "both"])
def test_attention_lies_on_the_joints_that_are_named(body, mae, whose):
    trace = Decoupler(body, mae, replace(PLAIN, attention_joints=whose))(clips(0), clips(1), clips(2), FRAMES)
    for side, reference in zip(trace.sides, trace.references, strict=True):
        own, made = (
            attention_map(reference.energies, seen.joints_px, (64, 64)) for seen in (reference.seen, trace.composed)
        )
        expected = {"sub_action": own, "composition": made, "both": own + made}[whose]
        assert torch.allclose(side.attention, expected) and not torch.allclose(own, made)


def test_every_blur_counts_alike(body, mae):
    trace = Decoupler(body, mae, replace(PLAIN, blurs=(0.0, 3.0)))(clips(0), clips(1), clips(2), FRAMES)
    for side, reference in zip(trace.sides, trace.references, strict=True):
        difference = side.inpainted - reference.seen.pictures
        expected = (difference.square() + blur(difference, 3.0).square()).mean((1, 2, 3)) / 2
        assert torch.allclose(side.loss, expected)


def test_what_the_other_action_owns_does_not_count(body, mae):
    """i swings its left arm, j its right: where the composition's right arm is, is nothing to i."""
    decoupler = Decoupler(body, mae, replace(PLAIN, ownership="standing"))
    subs = clips(1, ["left_shoulder"]), clips(2, ["right_shoulder"])
    one, other = (decoupler(clips(0, moving), *subs, FRAMES).sides for moving in ([], ["right_elbow"]))
    assert torch.allclose(one[0].loss, other[0].loss, rtol=1e-4)
    assert not torch.allclose(one[1].loss, other[1].loss, rtol=1e-2)


def test_the_inpainter_sees_no_part_that_the_other_action_owns(body, mae):
    images = []
    hook = mae.register_forward_pre_hook(lambda _, inputs: images.append(inputs[0]))
    subs = clips(1, ["left_shoulder"]), clips(2, ["right_shoulder"])
    Decoupler(body, mae, replace(PLAIN, ownership="standing"))(clips(0), *subs, FRAMES)
    hook.remove()
    arms = [DRAWN_PART_NAMES.index(name) for name in ("left_arm", "right_arm")]
    sides = torch.cat(images).chunk(2)
    assert [(shown[:, arms].amax((0, 2, 3)) > 0).tolist() for shown in sides] == [[True, False], [False, True]]


def test_both_sides_in_chunks_are_each_side_alone(body, mae, monkeypatch):
    """Chunks may end anywhere, also across the two sides."""
    decoupler = Decoupler(body, mae, replace(PLAIN, views=(0.0, 90.0)))
    composed, i, j = clips(0), clips(1), clips(2, ["right_elbow"])
    cameras = decoupler.cameras(composed, i, j)
    seen, references = decoupler.see(composed, FRAMES, cameras), decoupler.references(i, j, FRAMES, cameras)
    monkeypatch.setattr(decoupling, "CHUNK", 3)
    trace = decoupler.compare(seen, references)
    for side, reference in zip(trace.sides, references, strict=True):
        alone = decoupler.complete(seen, reference)
        for name, value in side._asdict().items():
            torch.testing.assert_close(value, getattr(alone, name), rtol=1e-4, atol=1e-6)


def test_what_is_not_asked_about_is_inpainted_for_looking_alone(body, mae):
    """The second pair's sub-actions both swing the left arm, which is nobody's: its loss is 0, and so its gradient."""
    decoupler = Decoupler(body, mae, replace(PLAIN, ownership="standing"))
    i, j = clips(1, ["left_shoulder"]), clips(2, ["right_shoulder"])
    j = Clips(*(torch.stack([mine[0], others[1]]) for mine, others in zip(j, i, strict=True)))
    composed = clips(0)
    rotations = composed.rotations.requires_grad_()
    pictures = []
    hook = mae.register_forward_pre_hook(lambda _, inputs: pictures.append(len(inputs[0])))
    trace = decoupler(composed, i, j, FRAMES)
    with torch.no_grad():
        looked = decoupler(composed, i, j, FRAMES)
    hook.remove()
    assert pictures == [4, 8]
    for side, whole in zip(trace.sides, looked.sides, strict=True):
        torch.testing.assert_close(side.loss, whole.loss, rtol=1e-4, atol=1e-9)
        assert torch.allclose(side.inpainted[:2], whole.inpainted[:2], atol=1e-5)
        assert torch.equal(side.inpainted[2:], trace.composed.pictures[2:])
        assert not torch.equal(whole.inpainted[2:], trace.composed.pictures[2:])
    trace.loss.backward()
    assert rotations.grad[0].any() and not rotations.grad[1].any()


def test_nothing_asked_is_no_loss(body, mae):
    same = clips(1, ["left_shoulder"])
    composed = clips(0)
    composed.rotations.requires_grad_()
    loss = Decoupler(body, mae, replace(PLAIN, ownership="standing"))(composed, same, same, FRAMES).loss
    loss.backward()
    assert float(loss.detach()) == 0 and not composed.rotations.grad.any()


def test_bfloat16_turns_the_gradient_a_little(body):
    """With the shipped network, whose gradient is what a motion follows."""
    gradients = []
    for precision in ("float32", "bfloat16"):
        composed = clips(0, ["left_shoulder", "right_knee"])
        composed.rotations.requires_grad_()
        subs = clips(1, ["left_shoulder", "left_elbow"]), clips(2, ["right_knee", "left_hip"])
        trace = Decoupler(body, load_mae(), DecouplingConfig(precision=precision))(composed, *subs, FRAMES)
        assert trace.sides[0].inpainted.dtype == torch.float32
        trace.loss.backward()
        gradients.append((composed.rotations.grad.flatten(), float(trace.loss.detach())))
    (exact, loss), (rounded, near) = gradients
    assert not torch.equal(exact, rounded) and near == pytest.approx(loss, rel=0.02)
    assert torch.cosine_similarity(exact, rounded, 0) > 0.999


def test_without_the_path_through_the_mae_the_gradient_is_that_of_the_visible_pixels(body, mae):
    """By hand: each visible pixel's difference, twice, over all pixels of the pictures; the loss itself stays."""
    composed, i, j = clips(0), clips(1), clips(2, ["right_elbow"])
    decoupler = Decoupler(body, mae, replace(PLAIN, through_mae=False))
    cameras = decoupler.cameras(composed, i, j)
    references = decoupler.references(i, j, FRAMES, cameras)
    seen = decoupler.see(composed, FRAMES, cameras)
    pictures = seen.pictures.requires_grad_()
    trace = decoupler.compare(seen._replace(pictures=pictures), references)
    trace.loss.backward()
    expected = torch.zeros_like(patchify(pictures, 8))
    for side, reference in zip(trace.sides, references, strict=True):
        difference = patchify((pictures - reference.seen.pictures).detach(), 8)
        expected += 2 * difference * side.kept[..., None]
    torch.testing.assert_close(patchify(pictures.grad * pictures.numel(), 8), expected, rtol=1e-4, atol=1e-4)
    whole = Decoupler(body, mae, PLAIN).compare(seen, references).loss
    torch.testing.assert_close(whole.detach(), trace.loss.detach())


def test_kept_patches_lie_where_the_action_moves(body, mae):
    trace = Decoupler(body, mae, PLAIN)(clips(0), clips(1, ["left_shoulder"]), clips(2, ["right_shoulder"]), FRAMES)
    columns = torch.arange(64) % 8
    left_of_body, right_of_body = (columns[side.kept[0]].float().mean() for side in trace.sides)
    assert left_of_body > 3.5 > right_of_body  # the left arm appears on the picture's right


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_our_configuration_is_what_the_pictures_allow(body, mae, channels):
    decoupler = Decoupler(body, MAE(replace(mae.config, channels=channels)))
    ours = DecouplingConfig()
    assert decoupler.config == (ours if channels == 6 else replace(ours, ownership="none", pinned="body"))
    trace = decoupler(clips(0), clips(1), clips(2), FRAMES)
    assert trace.sides[0].inpainted.shape[1] == trace.references[0].owned.answers.shape[1] == channels


def test_pictures_in_colours_are_compared_in_them(body, mae):
    """Of an MAE of three channels, every stage is the six parts' coverage in their colours."""
    three = MAE(replace(mae.config, channels=3, normalisation="imagenet"))
    subs = clips(0), clips(1), clips(2, ["right_elbow"])
    trace, parts = (Decoupler(body, network, PLAIN)(*subs, FRAMES) for network in (three, mae))
    assert torch.allclose(trace.composed.pictures, coloured(parts.composed.pictures))
    assert torch.allclose(trace.references[1].seen.pictures, coloured(parts.references[1].seen.pictures))
    assert torch.equal(trace.sides[0].kept, parts.sides[0].kept)


@pytest.mark.parametrize("channels", [1, 3])
def test_gradients_through_other_channels_against_finite_differences(body, mae, channels):
    normalisation = "imagenet" if channels == 3 else "none"
    torch.manual_seed(0)
    whole = MAE(replace(mae.config, channels=channels, normalisation=normalisation))
    check_gradient(Decoupler(body, whole, PLAIN))


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


@pytest.mark.parametrize("mode", ["sequence", "trunk"])
def test_a_pair_is_judged_alike_beside_any_other(body, mae, mode):
    """The second pair's motions go far beyond where bodies usually are; the first one's camera must not follow."""
    decoupler = Decoupler(body, mae, replace(PLAIN, pinned=mode))
    sides = [clips(seed, ["left_elbow", "right_knee"]) for seed in range(3)]
    for side in sides:
        side.root[1] += torch.linspace(0, 6, side.root.shape[1])[:, None] * torch.tensor([1.0, 0.0, 0.5])
    together = decoupler(*sides, FRAMES)
    apart = [decoupler(*(Clips(*(v[n : n + 1] for v in side)) for side in sides), FRAMES[n : n + 1]) for n in range(2)]
    expected = torch.stack([trace.loss for trace in apart]).mean()
    torch.testing.assert_close(together.loss, expected, rtol=1e-6, atol=0)
    for which in (0, 1):
        pictures = torch.cat([trace.sides[which].inpainted for trace in apart])
        torch.testing.assert_close(together.sides[which].inpainted, pictures, rtol=0, atol=1e-5)
    if mode == "sequence":
        near, far = (trace.composed.joints_px.std(1).mean() for trace in apart)
        assert far < 0.8 * near  # each as large as its own path lets it


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
    check_gradient(Decoupler(body, mae, PLAIN))


def check_gradient(decoupler):
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


def test_refusals(body, mae):
    with pytest.raises(UserError, match=r"drawn in 1 \(plain\), 3 \(colours\) or 6 \(parts\) channels, not 4"):
        Decoupler(body, MAE(replace(mae.config, channels=4)))
    for channels in (1, 3):
        whole = MAE(replace(mae.config, channels=channels))
        for change in ({"ownership": "standing"}, {"pinned": "trunk"}):
            with pytest.raises(UserError, match=f"a picture of {channels} channels has no parts to own"):
                Decoupler(body, whole, replace(PLAIN, **change))
    with pytest.raises(ShapeError, match="frames"):
        Decoupler(body, mae, PLAIN)(clips(0), clips(1), clips(2), FRAMES[:1])


def test_sub_actions_may_differ_in_length(body, mae):
    """What is asked about a sub-action does not hang on the other's frames after those that are drawn."""
    decoupler, i, j = Decoupler(body, mae, PLAIN), clips(1), clips(2)
    cameras = decoupler.cameras(i, j)
    longer = Clips(*(torch.cat([value, value], dim=1) for value in j))
    same, other = (decoupler.references(i, each, FRAMES, cameras) for each in (j, longer))
    for one, two in zip(same, other, strict=True):
        assert torch.equal(one.seen.pictures, two.seen.pictures)
    assert torch.equal(same[0].energies, other[0].energies)
