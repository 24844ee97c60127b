"""What is drawn stands where projection says, and cameras hold all that they are to show."""

from functools import cache

import pytest
import torch
from meshes import sphere
from torch import Tensor

from refine.composition import aligned
from refine.coupling import couple
from refine.decoupling import SPARE, Decoupler, DecouplingConfig
from refine.formats.files import load_motion
from refine.mae import MAE, MAEConfig
from refine.motion import Motion, resample
from refine.seeing import Clips, pin, straighten
from renderers.body import Body, Posed
from renderers.camera import Camera, frame
from renderers.mesh import Mesh
from renderers.poses import sixteen_poses
from renderers.silhouette import silhouette

SIZE = (96, 128)
BALL = 0.04  # metres, about two pixels
EVERY = 8  # frames of the real clips: a body moves little in a quarter of a second


@cache
def light_body() -> Body:
    return Body.free("light")


@pytest.fixture(scope="module")
def posed() -> Posed:
    """Four of the sixteen poses, which stand, stride, kick and lie, away from the origin."""
    return light_body()(sixteen_poses()[[2, 3, 12, 14]], torch.tensor([[0.3, 1.2, -0.4]]).expand(4, 3))


def views(points: Tensor, kind: str, size: tuple[int, int] = SIZE) -> list[Camera]:
    return [frame(points, size, yaw, elevation, kind=kind) for yaw, elevation in ((0.0, 0.0), (2.2, 0.4))]


def centroids(images: Tensor) -> Tensor:
    """Images [N 1 H W] to the centres of what is covered, [N 2] pixels (x, y); a pixel's own centre is at its half."""
    y, x = (torch.arange(side) + 0.5 for side in images.shape[-2:])
    area = images.sum((1, 2, 3))
    return torch.stack([(images * x).sum((1, 2, 3)) / area, (images * y[:, None]).sum((1, 2, 3)) / area], dim=-1)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_the_joint_that_projects_to_a_pixel_is_drawn_there(kind, posed):
    ball, faces = sphere(12, 16)
    for joints in posed.joints:
        for camera in views(posed.vertices, kind):
            balls = (joints[:, None] + BALL * ball).float()
            drawn, projected = centroids(silhouette(balls, Mesh.build(faces), camera)), camera.project(joints[None])[0]
            torch.testing.assert_close(drawn, projected, atol=0.02, rtol=0)
            # The wrong readings: pixels counted from their corners or centres, and rows taken for columns.
            assert ((drawn - (projected + 0.5)).abs() > 0.45).all() and ((drawn - (projected - 0.5)).abs() > 0.45).all()
            assert (drawn - projected.flip(1)).norm(dim=1).mean() > 10


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_joints_lie_in_the_body_that_is_drawn(kind, posed):
    side = 4 * SIZE[0]
    for camera in views(posed.vertices, kind, (side, side)):
        images = silhouette(posed.vertices, Mesh.build(light_body().faces), camera)[:, 0]
        x, y = camera.project(posed.joints).long().unbind(-1)
        pose = torch.arange(4)[:, None]
        assert (images[pose, y, x] > 0.5).all()
        assert (images[pose, x, y] > 0.5).float().mean() < 0.5


@pytest.fixture(scope="module")
def pairs(real_clips) -> list[list[Motion]]:
    """Every real clip once, in whole: two actions and their composition, which ends with the shorter."""
    rest_joints = light_body().rest_joints
    motions = [resample(load_motion(path, rest_joints), 30 / EVERY) for path in real_clips]
    together = zip(motions[::2], motions[1::2], strict=True)
    return [[i, j, couple(*aligned(i, j), rest_joints).motion] for i, j in together]


def spare(points: Tensor, camera: Camera) -> float:
    """The least part of a side between points [N V 3] and a border; below zero, how far they stick out."""
    along = camera.project(points) / points.new_tensor([camera.size[1], camera.size[0]])
    return torch.minimum(along, 1 - along).min().item()


@torch.no_grad()
def test_a_frame_holds_two_real_actions_and_their_composition(pairs):
    for number, motions in enumerate(pairs):
        points = torch.cat([light_body()(motion.rotations, motion.root).vertices for motion in motions])
        kind = ("weak", "pinhole")[number % 2]
        camera = frame(points, SIZE, yaw=0.02 * number, elevation=0.2, margin=0.07, kind=kind)
        assert spare(points, camera) > 0.07 - 1e-5, motions[0].source


@torch.no_grad()
@pytest.mark.parametrize(("pinned", "every"), [("trunk", 1), ("body", 6), ("frame", 6), ("sequence", 6)])
def test_the_decoupler_s_cameras_hold_two_real_actions_and_their_composition(pinned, every, pairs):
    mae = MAE(MAEConfig(channels=6, width=12, depth=1, heads=3, decoder_width=12, decoder_depth=1, decoder_heads=3))
    decoupler = Decoupler(light_body(), mae, DecouplingConfig(pinned=pinned))
    drawn = decoupler.mesh.faces.unique()
    for motions in pairs[::every]:
        clips = [Clips(motion.rotations[None], motion.root[None]) for motion in motions]
        cameras = decoupler.cameras(*clips)
        for clip in clips:
            rotations, root = (value[0] for value in pin(clip, pinned))
            points = light_body()(rotations, root).vertices
            if pinned == "trunk":
                points = torch.cat([points, light_body()(straighten(rotations), root).vertices], dim=1)[:, drawn]
            for camera in cameras:
                # As a part of what the picture spans. Skin that bends reaches a little farther than at rest.
                margin = SPARE / 2 * camera.focal[0, 0].item() / camera.size[0]
                assert spare(points, camera) > margin, motions[0].source
