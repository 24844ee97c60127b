from dataclasses import replace

import pytest
import torch

from refine.drawing import Painter, film, following, smoothed, strip
from refine.motion import Motion
from renderers.body import Body
from renderers.camera import frame
from renderers.palette import BACKGROUND, PARTS, rgb
from renderers.rotations import rotation_about
from renderers.skeleton import DRAWN_PART_NAMES, JOINTS


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.free("light")


def standing(body: Body, frames: int = 4, speed: float = 0.0) -> Motion:
    root = body.rest_joints[0].expand(frames, 3).clone()
    root[:, 2] += speed * torch.arange(frames) / 30
    return Motion(torch.eye(3).expand(frames, 24, 3, 3), root, 30.0, "stand")


def is_drawn(picture: torch.Tensor) -> torch.Tensor:
    """[H W] where a picture is coloured; floor, lines and shadow are nearly grey."""
    return picture.amax(0) - picture.amin(0) > 0.12


def test_strip_has_a_body_for_each_pose_at_one_scale(body):
    long, short = strip([standing(body, 8), standing(body, 2)], body, poses=4, height=120)
    assert long.shape == short.shape
    assert long.shape[1] == 120
    legs = is_drawn(long)[80:100].any(0).int()
    assert int((legs.diff() == 1).sum()) in (4, 8)
    assert is_drawn(long).sum() == pytest.approx(2 * float(is_drawn(short).sum()), rel=0.1)


def test_wide_poses_stand_clear_of_one_another(body):
    facing = rotation_about("y", torch.tensor(-0.49)).expand(4, 24, 3, 3).clone()
    facing[:, 1:] = torch.eye(3)
    [row] = strip([replace(standing(body, 4), rotations=facing)], body, poses=4, height=120, style="parts", yaw=0.0)
    columns = is_drawn(row).any(0).int()
    assert int((columns.diff() == 1).sum()) == 4


def test_left_is_warm_and_on_the_right_of_a_picture_from_the_front(body):
    [picture] = strip([standing(body, 1)], body, height=160, yaw=0.0, style="parts")
    for name, side in (("left_arm", 1), ("right_arm", -1)):
        colour = torch.tensor(rgb(PARTS[DRAWN_PART_NAMES.index(name)]))[:, None, None]
        columns = ((picture - colour).abs().amax(0) < 0.02).nonzero()[:, 1].double()
        assert side * (float(columns.mean()) - picture.shape[2] / 2) > 20


def test_film_runs_in_real_time_and_follows_the_body(body):
    motions = [standing(body, 31, speed=2.0), standing(body, 16)]
    moments = film(motions, body, (96, 80), fps=6.0)
    assert [len(moment) for moment in moments] == [2] * 6
    centres = [is_drawn(moment[0]).nonzero().double().mean(0) for moment in moments]
    assert torch.stack(centres).std(0).max() < 1.5
    assert torch.equal(moments[3][1], moments[5][1])


def test_film_shows_the_frame_of_each_moment(body):
    turning = rotation_about("x", -torch.linspace(0, 1.5, 31))
    rotations = torch.eye(3).repeat(31, 24, 1, 1)
    rotations[:, JOINTS["left_shoulder"]] = turning
    motion = Motion(rotations, body.rest_joints[0].expand(31, 3), 30.0)
    every_fifth = Motion(rotations[::5], motion.root[::5], 6.0)
    expected = torch.stack([moment[0] for moment in film([every_fifth], body, (96, 80), fps=6.0)][:6])
    found = torch.stack([moment[0] for moment in film([motion], body, (96, 80), fps=6.0)])
    assert torch.allclose(found, expected, atol=0.02)
    assert (expected[0] - expected[5]).abs().max() > 0.3


def test_a_camera_carried_along_sees_the_same(body):
    camera = frame(body.rest_vertices, (64, 64), yaw=0.4, elevation=0.2, kind="pinhole")
    step = torch.tensor([0.3, -0.2, 0.5])
    points = body.rest_joints[None]
    assert torch.allclose(following(camera, step).project(points + step), camera.project(points), atol=1e-3)


def test_smoothing_keeps_length_and_still_paths():
    path = torch.tensor([1.0, 2.0, 3.0]).expand(7, 3)
    assert torch.allclose(smoothed(path, 30.0), path)


def test_a_silhouette_is_dark_on_light(body):
    camera = frame(body.rest_vertices, (64, 64))
    picture = Painter.of(body, "silhouette")(body.rest_vertices[None], camera)[0]
    x, y = camera.project(body.rest_joints[None])[0, 3].long().tolist()
    assert picture[:, y, x].max() < 0.3
    assert torch.allclose(picture[:, 0, 0], torch.tensor(rgb(BACKGROUND)))
