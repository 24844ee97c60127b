"""The fold scan against exact coverage, in values and in gradients; and the exact coverage against plain geometry.

The benchmark: the sixteen poses of the light free body, each framed alone by a pinhole camera, in float32.
"""

from dataclasses import dataclass
from math import pi

import exact
import pytest
import torch
from pictures import assert_images_close
from test_raster import SCENES, SIZE, scene
from torch import Tensor

from renderers import raster_fold, raster_reference
from renderers.body import Body
from renderers.camera import Camera, cat, frame
from renderers.mesh import Mesh
from renderers.poses import sixteen_poses
from renderers.rotations import rotation_about
from renderers.silhouette import blur, silhouette
from renderers.skeleton import JOINTS

SIZES = (64, 112, 224)
DRAWN = 64  # pixels: polygons are made once, at this size
STEP = 1e-5  # of the central differences, metres, 3e-4 px: steps ten times larger change them by 2e-4 of their norm
ROOT = torch.zeros(16, 3, dtype=torch.float64)


@dataclass(frozen=True)
class Benchmark:
    body: Body
    mesh: Mesh
    poses: Tensor  # [16 24 3 3]
    vertices: Tensor  # [16 V 3]
    exact: dict[int, Tensor]  # for every size, [16 1 H W]

    def camera(self, size: int) -> Camera:
        return cat([frame(vertices, (size, size), yaw=0.4, kind="pinhole") for vertices in self.vertices])

    def draw(self, vertices: Tensor, size: int, subscanlines: int) -> Tensor:
        camera = self.camera(size).to(dtype=torch.float32)
        return silhouette(vertices.float(), self.mesh, camera, subscanlines).double()

    def draw_exactly(self, vertices: Tensor, sizes: tuple[int, ...]) -> dict[int, Tensor]:
        shapes = exact.unions(self.camera(DRAWN).project(vertices), self.mesh)[:, 0]
        return {
            size: torch.stack([exact.areas(shape, (size, size), size / DRAWN) for shape in shapes])[:, None]
            for size in sizes
        }


@pytest.fixture(scope="module")
def benchmark() -> Benchmark:
    body, poses = Body.free("light").double(), sixteen_poses().double()
    known = Benchmark(body, Mesh.build(body.faces), poses, body(poses, ROOT).vertices, {})
    known.exact.update(known.draw_exactly(known.vertices, SIZES))
    return known


def motion(benchmark: Benchmark, name: str) -> Tensor:
    """How all vertices begin to move, [16 V 3] in metres."""
    vertices, axes = benchmark.vertices, benchmark.camera(DRAWN).rotation[:, :, None]
    if name == "shift x":
        return axes[:, 0].expand_as(vertices)
    if name == "shift y":
        return axes[:, 1].expand_as(vertices)
    if name == "scale":
        return vertices - vertices.mean(1, keepdim=True)
    if name == "arm":
        return (raise_arm(benchmark, 1e-5) - raise_arm(benchmark, -1e-5)) / 2e-5
    generator = torch.Generator().manual_seed(int(name.removeprefix("random ")))
    waves, heights = torch.randn(2, 6, 3, dtype=torch.float64, generator=generator)
    phases = 2 * pi * torch.rand(6, dtype=torch.float64, generator=generator)
    return torch.sin(3 * vertices @ waves.T + phases) @ heights


def raise_arm(benchmark: Benchmark, angle: float) -> Tensor:
    poses, shoulder = benchmark.poses.clone(), JOINTS["left_shoulder"]
    poses[:, shoulder] = rotation_about("z", torch.tensor(angle, dtype=torch.float64)) @ poses[:, shoulder]
    return benchmark.body(poses, ROOT).vertices


def test_exact_areas_by_hand():
    square = torch.tensor([[[1.25, 1.0], [3.5, 1.0], [3.5, 2.5], [1.25, 2.5]]], dtype=torch.float64)
    expected = torch.zeros(1, 1, 4, 5, dtype=torch.float64)
    expected[0, 0, 1, 1:4] = torch.tensor([0.75, 1, 0.5])
    expected[0, 0, 2, 1:4] = torch.tensor([0.375, 0.5, 0.25])
    drawn = exact.coverage(square, Mesh.build(torch.tensor([[0, 1, 2], [0, 2, 3]])), (4, 5))
    assert_images_close("exact square", drawn, expected, largest=1e-12)

    # Its long side falls by one pixel in three, from (0, 1) to (3, 2).
    wedge = torch.tensor([[[0.0, 1.0], [3.0, 2.0], [3.0, 1.0]]], dtype=torch.float64)
    expected = torch.tensor([[0.0, 0, 0], [1 / 6, 3 / 6, 5 / 6], [0, 0, 0]], dtype=torch.float64)[None, None]
    drawn = exact.coverage(wedge, Mesh.build(torch.tensor([[0, 1, 2]])), (3, 3))
    assert_images_close("exact wedge", drawn, expected, largest=1e-12)


def test_exact_areas_add_up_to_the_shoelace_formula(generator):
    angles = torch.rand(1, 9, dtype=torch.float64, generator=generator).sort().values * 2 * pi
    polygon = torch.stack([11 + 8.3 * angles.cos(), 9 + 6.1 * angles.sin()], dim=-1)
    x, y = polygon[0].unbind(1)
    shoelace = (x * y.roll(-1) - y * x.roll(-1)).sum() / 2
    fan = torch.tensor([[0, corner, corner + 1] for corner in range(1, 8)])
    drawn = exact.coverage(polygon, Mesh.build(fan), (18, 22))
    assert drawn.sum().item() == pytest.approx(shoelace.item(), rel=1e-12)
    (shape,) = exact.unions(polygon, Mesh.build(fan))[0]
    assert exact.areas(shape, (36, 44), zoom=2).sum().item() == pytest.approx(4 * shoelace.item(), rel=1e-12)


def test_exact_slopes_are_central_differences():
    points = torch.tensor([[[1.0, 2.0]], [[3.0, 4.0]]], dtype=torch.float64)
    motion = torch.tensor([[[1.0, 0.0]], [[0.0, -1.0]]], dtype=torch.float64)
    slopes = exact.slope(lambda at: (at**2).sum((1, 2)), points, motion, 1e-3)
    torch.testing.assert_close(slopes, torch.tensor([2.0, -8.0], dtype=torch.float64))


@pytest.mark.parametrize("name", ["closed", "self-intersecting", "parts"])
def test_the_reference_converges_to_exact_coverage(name):
    points, mesh = scene(name)
    expected = exact.coverage(points, mesh, SIZE)
    coarse, fine = (
        (raster_reference.coverage(points, mesh, SIZE, subscanlines) - expected).abs().mean()
        for subscanlines in (4, 64)
    )
    assert fine < 1e-4 < coarse


@pytest.mark.parametrize("name", SCENES)
def test_any_kind_of_mesh_converges_to_exact_coverage(name):
    points, mesh = scene(name)
    expected = exact.coverage(points, mesh, SIZE)
    for subscanlines, largest, mean in ((4, 0.08, 2e-3), (64, 5e-3, 3e-5), (256, 3e-4, 2e-6)):
        actual = raster_fold.coverage(points, mesh, SIZE, subscanlines)
        assert_images_close(f"{name} with {subscanlines}", actual, expected, largest, mean)


@pytest.mark.parametrize("subscanlines", [4, 8])
@pytest.mark.parametrize(("size", "allowed"), [(64, 2e-4), (112, 1e-4), (224, 5e-5)])
def test_bodies_are_drawn_almost_exactly(size, allowed, subscanlines, benchmark):
    actual, expected = benchmark.draw(benchmark.vertices, size, subscanlines), benchmark.exact[size]
    share = 4 / subscanlines
    assert_images_close(f"poses at {size}", actual, expected, largest=0.1 * share, mean=share * allowed)
    # Intersection over union of areas; that of masks would be decided by the few pixels that are close to one half.
    assert torch.minimum(actual, expected).sum() > (1 - 1e-3 * share) * torch.maximum(actual, expected).sum()


LIMITS = {"shift x": 0.015, "shift y": 0.04, "scale": 0.04, "arm": 0.1, "random 0": 0.05, "random 1": 0.05}


@pytest.mark.parametrize("name", LIMITS)
def test_the_gradient_is_the_slope_of_the_exact_loss(name, benchmark):
    # Every pose is drawn towards the next one's exact image.
    target, direction = benchmark.exact[DRAWN].roll(-1, 0), motion(benchmark, name)

    def exact_loss(vertices: Tensor) -> Tensor:
        return (benchmark.draw_exactly(vertices, (DRAWN,))[DRAWN] - target).square().sum((1, 2, 3))

    vertices = benchmark.vertices.clone().requires_grad_()
    (pull,) = torch.autograd.grad((benchmark.draw(vertices, DRAWN, 4) - target).square().sum(), vertices)
    actual = (pull * direction).sum((1, 2))
    expected = exact.slope(exact_loss, benchmark.vertices, direction, STEP)
    assert (actual - expected).norm() < LIMITS[name] * expected.norm()
    clear = expected.abs() > 0.02 * expected.abs().max()
    assert clear.sum() >= 12 and (actual.sign() == expected.sign())[clear].all()


def test_a_body_smaller_than_a_pixel_keeps_its_area_and_is_pulled(benchmark, generator):
    pixels = frame(benchmark.vertices[0], (1, 1), margin=0.1).project(benchmark.vertices[:1])
    points = pixels + 6 + torch.rand(60, 1, 2, dtype=torch.float64, generator=generator)
    mesh, size = benchmark.mesh, (13, 13)
    area = exact.coverage(points[:1], mesh, size).sum()
    assert 0.05 < area < 0.2
    for subscanlines, each, together in ((32, 0.06, 0.01), (4, 1.5, 0.1)):
        error = raster_fold.coverage(points, mesh, size, subscanlines).sum((1, 2, 3)) / area - 1
        assert error.abs().max() < each and error.mean().abs() < together

    points, away = points[:12], torch.tensor([2.0, 1.0], dtype=torch.float64)
    target = blur(exact.coverage(points + away, mesh, size), 2.0)
    moved = points.clone().requires_grad_()
    loss = (blur(raster_fold.coverage(moved, mesh, size, 32), 2.0) - target).square().sum()
    actual = (torch.autograd.grad(loss, moved)[0] * away).sum((1, 2))
    expected = exact.slope(
        lambda points: (blur(exact.coverage(points, mesh, size), 2.0) - target).square().sum((1, 2, 3)),
        points,
        away.expand_as(points),
        1e-3,
    )
    assert expected.min() < -1e-4
    assert (actual - expected).norm() < 0.1 * expected.norm()


def test_bodies_partly_and_wholly_off_the_picture(benchmark):
    points = benchmark.camera(DRAWN).project(benchmark.vertices)[4:5]
    for shift in ((40.0, -20.0), (-30.0, 45.0), (0.0, 33.3), (64.0, 0.0), (0.0, -64.0)):
        moved = points + torch.tensor(shift, dtype=torch.float64)
        expected = exact.coverage(moved, benchmark.mesh, (DRAWN, DRAWN))
        actual = raster_fold.coverage(moved, benchmark.mesh, (DRAWN, DRAWN), 16)
        assert_images_close(f"shifted by {shift}", actual, expected, largest=0.01, mean=1e-5)
        assert bool(expected.any()) is (64.0 not in shift and -64.0 not in shift)
