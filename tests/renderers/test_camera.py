"""The conventions of renderers/camera.py with their wrong readings; projection against kornia, OpenCV and by hand."""

from math import pi

import pytest
import torch

from renderers.camera import Camera, cat, frame, frame_each
from renderers.checks import UserError

FRONT = torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], dtype=torch.float64)


def camera(kind="weak", rotation=FRONT, translation=(0.0, 0.0, 4.0), focal=(10.0, 10.0), centre=(24.0, 16.0)) -> Camera:
    vectors = (torch.tensor([vector], dtype=torch.float64) for vector in (translation, focal, centre))
    return Camera(rotation[None], *vectors, size=(32, 48), kind=kind)


def random_camera(kind: str, generator: torch.Generator) -> tuple[Camera, torch.Tensor]:
    points = torch.randn(3, 50, 3, dtype=torch.float64, generator=generator)
    rotation = torch.linalg.qr(torch.randn(3, 3, 3, dtype=torch.float64, generator=generator)).Q
    rotation = rotation * torch.linalg.det(rotation)[:, None, None]
    near = (points @ rotation.mT)[..., 2].amin(1)
    shift = torch.randn(3, 3, dtype=torch.float64, generator=generator)
    shift[:, 2] = 1 - near
    focal, centre = (100 * torch.rand(3, 2, dtype=torch.float64, generator=generator) + 50 for _ in range(2))
    return Camera(rotation, shift, focal, centre, (32, 48), kind), points


def project(at: tuple[float, float, float], view: Camera) -> list[float]:
    return view.project(torch.tensor([[at]], dtype=torch.float64)).flatten().tolist()


def test_y_grows_up_in_the_world_and_down_in_the_image():
    assert project((0, 1, 0), camera()) == [24, 6]
    assert project((0, 1, 0), camera()) != [24, 26]


def test_pixels_are_x_then_y_and_sizes_height_then_width():
    view = camera()
    assert project((2, 0, 0), view) == [44, 16]
    assert project((2, 0, 0), view) != [16, 44]
    x, y = project((2, 0, 0), view)
    assert x < view.size[1] and not x < view.size[0] and y < view.size[0]


def test_depth_shrinks_in_a_pinhole_and_not_in_weak_perspective():
    for kind, expected in (("pinhole", 24 + 10 * 2 / 5), ("weak", 24 + 10 * 2)):
        assert project((2, 0, -1), camera(kind)) == pytest.approx([expected, 16])


def test_a_pinhole_agrees_with_kornia_and_opencv(generator):
    import cv2
    from kornia.geometry.camera import PinholeCamera

    view, points = random_camera("pinhole", generator)
    intrinsics, extrinsics = (torch.eye(4, dtype=torch.float64).repeat(3, 1, 1) for _ in range(2))
    intrinsics[:, [0, 1], [0, 1]], intrinsics[:, :2, 2] = view.focal, view.centre
    extrinsics[:, :3, :3], extrinsics[:, :3, 3] = view.rotation, view.translation
    sides = (torch.full((3,), side) for side in view.size)
    kornia = PinholeCamera(intrinsics, extrinsics, *sides).project(points)
    opencv = [
        cv2.projectPoints(p.numpy(), cv2.Rodrigues(r.numpy())[0], t.numpy(), k.numpy(), None)[0][:, 0]
        for p, r, t, k in zip(points, view.rotation, view.translation, intrinsics[:, :3, :3], strict=True)
    ]
    for expected in (kornia, torch.stack([torch.from_numpy(pixels) for pixels in opencv])):
        torch.testing.assert_close(view.project(points), expected, atol=1e-4, rtol=0)


def test_weak_perspective_agrees_with_kornia(generator):
    from kornia.geometry.camera import project_points_orthographic

    view, points = random_camera("weak", generator)
    seen = torch.einsum("nij,npj->npi", view.rotation, points) + view.translation[:, None]
    expected = project_points_orthographic(seen) * view.focal[:, None] + view.centre[:, None]
    torch.testing.assert_close(view.project(points), expected, atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
@pytest.mark.parametrize("size", [(64, 64), (30, 80), (80, 30)])
@pytest.mark.parametrize(("yaw", "elevation"), [(0.0, 0.0), (2.5, 0.6), (-0.7, -0.4)])
def test_a_frame_holds_all_points_as_large_as_the_margin_lets(kind, size, yaw, elevation, generator):
    points = torch.randn(4, 3, 20, 3, dtype=torch.float64, generator=generator) * torch.tensor([0.3, 1.0, 0.4])
    view = frame(points, size, yaw, elevation, margin=0.15, kind=kind)
    pixels = view.project(points.reshape(1, -1, 3))[0]
    sides = torch.tensor([size[1], size[0]], dtype=torch.float64)
    low, high = pixels.amin(0) / sides, pixels.amax(0) / sides
    torch.testing.assert_close(low + high, torch.ones(2, dtype=torch.float64))
    assert low.min().item() == pytest.approx(0.15) and high.max().item() == pytest.approx(0.85)
    torch.testing.assert_close(view.rotation[0] @ view.rotation[0].T, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(view.rotation[0]).item() == pytest.approx(1)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_framing_each_is_framing_one_by_one(kind, generator):
    points = torch.randn(3, 20, 3, generator=generator) * torch.tensor([0.3, 1.0, 4.0])[:, None, None]
    each = frame_each(points, (48, 64), 0.4, 0.2, 0.1, kind)
    assert len(each) == 3
    for one, own in zip(points, each.project(points), strict=True):
        camera = frame(one, (48, 64), 0.4, 0.2, 0.1, kind)
        torch.testing.assert_close(own, camera.project(one[None])[0], atol=1e-3, rtol=1e-6)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_yaw_moves_the_camera_to_the_left_side_of_the_body_and_elevation_up(kind):
    box = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * 3)
    front, left, above = (frame(box, (64, 64), *angles, kind=kind) for angles in ((0, 0), (pi / 2, 0), (0, pi / 3)))

    def position(view: Camera) -> torch.Tensor:
        return (-view.rotation[0].T @ view.translation[0]).round(decimals=6)

    assert position(front)[2] > 1 and position(front)[:2].tolist() == [0, 0]
    assert position(left)[0] > 1 and position(left)[1:].tolist() == [0, 0]
    assert position(above)[1] > 1 and position(above)[2] > 0
    # A body facing +z has its left side at +x: on the right of its picture from the front, and its nose on the left
    # of the picture from its left side.
    assert project((1, 0, 0), front)[0] > 32 > project((1, 0, 0), frame(box, (64, 64), pi, kind=kind))[0]
    assert project((0, 0, 1), left)[0] < 32


def test_cameras_are_taken_and_joined_along_the_batch(generator):
    view, points = random_camera("pinhole", generator)
    frames = torch.tensor([0, 0, 1, 2, 2])
    torch.testing.assert_close(view[frames].project(points[frames]), view.project(points)[frames])
    torch.testing.assert_close(cat([view[:1], view[1:]]).project(points), view.project(points))


def test_errors_say_what_does_not_fit(generator):
    view, points = random_camera("pinhole", generator)
    behind = points.clone()
    behind[1, 7] -= 2 * (points[1, 7] + view.rotation[1].T @ view.translation[1])
    with pytest.raises(UserError, match="point 7 of frame 1 has depth -.* move the camera back"):
        view.project(behind)
    with pytest.raises(UserError, match="3 cameras do not fit 2 sets"):
        view.project(points[:2])
    with pytest.raises(UserError, match=r"expected shape \[N 2\] with N=3, got \[1, 2\]"):
        Camera(view.rotation, view.translation, view.focal[:1], view.centre, view.size)
    with pytest.raises(UserError, match="expected pinhole or weak, got 'fisheye'"):
        camera("fisheye")
    with pytest.raises(UserError, match="margin"):
        frame(points, (64, 64), margin=0.5)
    with pytest.raises(UserError, match="no points"):
        frame(points[:0], (64, 64))
    with pytest.raises(UserError, match="does not go with"):
        cat([view, camera("weak")])
