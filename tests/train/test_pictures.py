"""Pictures for the MAE: drawn where the decoupling loss draws, masked as asked."""

from dataclasses import replace

import pytest
import torch

from refine.decoupling import PAPER, Decoupler, DecouplingConfig
from refine.mae import MAE, MAEConfig
from refine.motion import Motion
from refine.seeing import Clips, mesh_to_draw
from renderers.body import Body
from renderers.checks import UserError
from renderers.rotations import axis_angle_to_matrix
from train.pictures import PictureConfig, Poses, draw_pictures, poses_of, show_parts

PARTS = MAEConfig()
STILL = PictureConfig(yaw=0.0, shift=0.0, zoom=0.0, parts_hidden=0.0)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.free("light")


@pytest.fixture(scope="module")
def waving() -> Motion:
    """Only the left elbow moves, and the body walks away turned by a right angle."""
    turns = torch.zeros(6, 24, 3)
    turns[:, 18, 2] = torch.linspace(0, 1, 6)
    turns[:, 0, 1] = torch.pi / 2
    root = torch.stack([torch.linspace(3, 4, 6), torch.full((6,), 0.9), torch.zeros(6)], dim=1)
    return Motion(axis_angle_to_matrix(turns), root, 30.0, "wave")


def draw(body, poses, count, config, seed=0, network=PARTS):
    mesh = mesh_to_draw(body, config.pinned, network.channels)
    return draw_pictures(poses, count, body, mesh, network, config, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("pinned", ["frame", "body", "trunk"])
def test_without_jitter_pictures_are_those_of_the_decoupling_loss(body, waving, pinned):
    poses = poses_of([waving], body.rest_joints, pinned)
    last = Poses(*(value[-1:] for value in poses))
    mae = MAE(MAEConfig(width=32, depth=1, heads=2))
    decoupler = Decoupler(body, mae, DecouplingConfig(pinned=pinned, views=(0.0,)))
    clip = Clips(waving.rotations[None], waving.root[None])
    expected = decoupler.see(clip, torch.tensor([[5]]), decoupler.cameras(clip, clip)).pictures
    drawn = draw(body, last, 1, replace(STILL, pinned=pinned)).images
    torch.testing.assert_close(drawn, expected, atol=1e-4, rtol=0)
    assert 100 < drawn.sum() < 2000


@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_without_parts_are_those_of_the_decoupling_loss_too(body, waving, channels):
    last = Poses(*(value[-1:] for value in poses_of([waving], body.rest_joints, "body")))
    network = MAEConfig(width=32, depth=1, heads=2, channels=channels)
    decoupler = Decoupler(body, MAE(network), replace(PAPER, pinned="body"))
    clip = Clips(waving.rotations[None], waving.root[None])
    expected = decoupler.see(clip, torch.tensor([[5]]), decoupler.cameras(clip, clip)).pictures
    drawn = draw(body, last, 9, replace(STILL, pinned="body", parts_hidden=1.0), network=network)
    assert drawn.images.shape == (9, channels, 64, 64) and drawn.shown.all()
    torch.testing.assert_close(drawn.images, expected.expand(9, -1, -1, -1), atol=1e-4, rtol=0)


def test_jitter_turns_moves_and_zooms(body, waving):
    one = Poses(*(value[:1] for value in poses_of([waving], body.rest_joints, "frame")))
    still = replace(STILL, pinned="frame")
    pictures = {
        name: draw(body, one, 2, replace(still, **change)).images
        for name, change in {"none": {}, "yaw": {"yaw": 90.0}, "shift": {"shift": 0.1}, "zoom": {"zoom": 0.2}}.items()
    }
    torch.testing.assert_close(pictures["none"][0], pictures["none"][1])
    assert not torch.allclose(pictures["yaw"][0], pictures["yaw"][1], atol=0.1)
    assert not torch.allclose(pictures["shift"][0], pictures["shift"][1], atol=0.1)
    assert pictures["zoom"].sum() < 0.99 * pictures["none"].sum()


def test_pose_noise_turns_joints_but_not_the_body(body, waving):
    poses = poses_of([waving], body.rest_joints, "body")
    still, noisy = (
        draw(body, poses, 6, replace(STILL, pinned="body", pose_noise=noise)).images for noise in (0.0, 0.2)
    )
    assert (still - noisy).abs().max() > 0.5
    torso = [images[:, 0].mean((1, 2)) for images in (still, noisy)]
    assert torch.allclose(torso[0], torso[1], rtol=0.15)


def test_a_third_of_the_patches_is_kept(body, waving):
    poses = poses_of([waving], body.rest_joints, "frame")
    pictures = draw(body, poses, 20, PictureConfig())
    assert (pictures.kept.sum(1) == 21).all()


def test_attention_masks_keep_the_moving_part_and_random_ones_do_not(body, waving):
    poses = poses_of([waving], body.rest_joints, "frame")

    def seen_share(attention_share):
        config = replace(STILL, pinned="frame", attention_share=attention_share)
        pictures = draw(body, poses, 40, config)
        arm = pictures.images[:, 2].unflatten(1, (8, 8)).unflatten(3, (8, 8)).sum((2, 4)).flatten(1)
        return float((arm * pictures.kept).sum() / arm.sum())

    assert seen_share(1.0) > 0.9
    assert seen_share(0.0) == pytest.approx(1 / 3, abs=0.1)
    assert 0.4 < seen_share(0.5) < 0.85


def test_energies_are_those_of_the_clip(body, waving):
    energies = poses_of([waving], body.rest_joints, "frame").energies
    assert energies.shape == (6, 24)
    assert energies[0].argmax() in (13, 16, 18, 20, 22)
    assert (energies == energies[:1]).all()


def test_single_frames_have_no_energy_and_are_left_out(body, waving):
    single = Motion(waving.rotations[:1], waving.root[:1], 30.0)
    assert len(poses_of([single, waving], body.rest_joints, "frame").root) == 6


def test_clips_of_single_frames_alone_are_refused(body, waving):
    single = Motion(waving.rotations[:1], waving.root[:1], 30.0)
    with pytest.raises(UserError, match="every clip is a single frame"):
        poses_of([single, single], body.rest_joints, "frame")


def test_some_pictures_lack_parts_but_never_all():
    shown = show_parts(4000, 6, 0.5, torch.Generator().manual_seed(0))
    assert shown.any(1).all()
    assert (~shown).any(1).float().mean().item() == pytest.approx(0.5 * (1 - 2 * 0.5**6), abs=0.03)
    assert show_parts(50, 6, 0.0, torch.Generator()).all()
    assert show_parts(50, 1, 1.0, torch.Generator()).all()
