"""The fold scan against the reference, against counting faces, and against finite differences of the exact area."""

from math import cos, sin

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import figure, sphere, swing
from pictures import assert_images_close
from torch import Tensor

from renderers import raster_fold, raster_reference
from renderers.camera import frame
from renderers.checks import UserError
from renderers.mesh import Mesh

SIZE = (20, 26)


def scene(name: str) -> tuple[Tensor, Mesh]:
    """Points [1 V 2] in pixels and the mesh, of one kind of mesh that a scan might get wrong."""
    generator = torch.Generator().manual_seed(3)
    ball, faces = sphere(8, 11)
    parts = None
    if name == "open":
        faces = faces[ball[faces].mean(1)[:, 1] < 0.4]
    elif name == "full of holes":
        faces = faces[len(faces) // 3 :]
    elif name == "flipped":
        faces = faces.flip(1)
    elif name == "inconsistent":
        faces = torch.where(torch.rand(len(faces), 1, generator=generator) < 0.5, faces.flip(1), faces)
    elif name == "self-intersecting":
        ball = ball + 0.7 * torch.sin(5 * ball.roll(1, dims=1))
    elif name == "two bodies":
        ball, faces = torch.cat([0.7 * ball + 0.3, 0.6 * ball - 0.3]), torch.cat([faces, faces + len(ball)])
    elif name == "parts":
        parts = (ball[faces].mean(1)[:, 0] > 0.2).long() + (ball[faces].mean(1)[:, 1] > 0.4).long()
    elif name == "book":
        ball = torch.randn(9, 3, dtype=torch.float64, generator=generator).clamp(-1, 1)
        faces = torch.tensor([[0, 1, page] for page in range(2, 9)])
    elif name == "crumpled":
        ball = torch.rand(20, 3, dtype=torch.float64, generator=generator) * 2 - 1
        faces = torch.randint(0, 20, (30, 3), generator=generator)
    pixels = frame(ball, SIZE, yaw=0.3, elevation=0.4, margin=0.06, kind="pinhole").project(ball[None])
    if name == "partly outside":
        pixels = (pixels - pixels.mean(1)) * 1.8 + torch.tensor([3.0, 15.0])
    return pixels, Mesh.build(faces, parts)


SCENES = (
    "closed", "open", "full of holes", "flipped", "inconsistent", "self-intersecting", "two bodies", "parts", "book",
    "crumpled", "partly outside",
)  # fmt: skip


def row_scans(points: Tensor, mesh: Mesh, size: tuple[int, int], subscanlines: int) -> tuple[Tensor, Tensor]:
    """Coverage from rows alone, by folds and by the reference."""
    height, width = size
    images = len(points) * mesh.channels
    outline = raster_fold.find_outline(raster_fold.find_folds(points, mesh), images, height, width, subscanlines)
    unit, whole = raster_fold.fixed_point(points.dtype, subscanlines)
    folds = raster_fold.fill(outline, images * height, width, unit, whole).to(points.dtype) / (unit * subscanlines)
    spans = [
        raster_reference.scan(frame[mesh.faces[mesh.face_channels == channel]], height, width, subscanlines)
        for frame in points
        for channel in range(mesh.channels)
    ]
    shape = (len(points), mesh.channels, height, width)
    return folds.view(shape), torch.stack(spans).view(shape)


def gradient(backend, points: Tensor, mesh: Mesh, cotangent: Tensor, subscanlines: int) -> Tensor:
    points = points.clone().requires_grad_()
    image = backend.coverage(points, mesh, tuple(cotangent.shape[-2:]), subscanlines)
    return torch.autograd.grad(image, points, cotangent)[0]


def smooth_fields(points: Tensor) -> list[Tensor]:
    """Ways to move all points: shifts, scales, shears, bends and waves in x, then in y."""
    x, y = ((points - points.mean(1, keepdim=True)) / 10).unbind(-1)
    zero = torch.zeros_like(x)
    shapes = [zero + 1, x, y, x**2, y**2, x * y, torch.sin(3 * x), torch.sin(3 * y)]
    return [torch.stack(pair, -1) for shape in shapes for pair in ((shape, zero), (zero, shape))]


@pytest.mark.parametrize("backend", [raster_fold, raster_reference])
def test_areas_by_hand(backend):
    square = torch.tensor([[[1.25, 1.0], [3.5, 1.0], [3.5, 2.5], [1.25, 2.5]]], dtype=torch.float64)
    mesh = Mesh.build(torch.tensor([[0, 1, 2], [0, 2, 3]]))
    expected = torch.zeros(1, 1, 4, 5, dtype=torch.float64)
    expected[0, 0, 1, 1:4] = torch.tensor([0.75, 1, 0.5])
    expected[0, 0, 2, 1:4] = torch.tensor([0.375, 0.5, 0.25])
    assert_images_close("square", backend.coverage(square, mesh, (4, 5)), expected, largest=1e-12)

    half = torch.tensor([[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]], dtype=torch.float64)
    triangle = backend.coverage(half, Mesh.build(torch.tensor([[0, 1, 2]])), (4, 4), 1)
    lower = torch.ones(4, 4, dtype=torch.float64).tril(-1).flip(1)
    expected = (1 - lower - 0.5 * torch.eye(4, dtype=torch.float64).flip(1))[None, None]
    assert_images_close("triangle", triangle, expected, largest=1e-12)


@pytest.mark.parametrize("backend", [raster_fold, raster_reference])
@pytest.mark.parametrize("angle", [0.3, 0.7, 1.2, 2.0, 2.6, -0.9, -2.2])
def test_a_straight_outline_is_measured_exactly(backend, angle):
    # A half-plane. Taken for points, the crossings of four scans would be wrong by up to .03 of a pixel.
    normal = torch.tensor([cos(angle), sin(angle)], dtype=torch.float64)
    along = torch.stack([-normal[1], normal[0]])
    middle = torch.tensor([3.3, 2.9], dtype=torch.float64)
    corners = torch.stack([middle - 40 * along, middle + 40 * along, middle + 40 * along - 40 * normal])
    points = torch.cat([corners, corners[:1] - 40 * normal])[None].requires_grad_()
    image = backend.coverage(points, Mesh.build(torch.tensor([[0, 1, 2], [0, 2, 3]])), (6, 7))
    fine = (torch.arange(700, dtype=torch.float64) + 0.5) / 100
    inside = (fine[:600, None] - middle[1]) * normal[1] + (fine - middle[0]) * normal[0] < 0
    expected = inside.double().view(6, 100, 7, 100).mean((1, 3))[None, None]
    assert_images_close(f"half-plane at {angle}", image, expected, largest=1e-3)
    # Moved by its normal, it sweeps the area of its length within the image.
    slope = torch.autograd.grad(image.sum(), points)[0].sum((0, 1)) @ normal
    reach = (torch.tensor([[0.0, 0.0], [7.0, 6.0]], dtype=torch.float64) - middle) / along
    low, high = reach.amin(0).amax(), reach.amax(0).amin()
    torch.testing.assert_close(slope, high - low, atol=0.02, rtol=0)


@pytest.mark.parametrize("name", SCENES)
def test_the_winding_of_the_folds_counts_the_faces_over_a_point(name, generator):
    points, mesh = scene(name)
    folds = raster_fold.find_folds(points, mesh)
    probes = torch.rand(300, 2, dtype=torch.float64, generator=generator) * torch.tensor([26.0, 20.0])

    def passed(start: Tensor, end: Tensor) -> Tensor:
        """+-1 where an edge crosses the ray from a probe to the right [probes edges]."""
        up = (start[:, 1] > probes[:, 1:]).long() - (end[:, 1] > probes[:, 1:]).long()
        weight = (probes[:, 1:] - start[:, 1]) / (end[:, 1] - start[:, 1])
        return up * (start[:, 0] + weight * (end[:, 0] - start[:, 0]) > probes[:, :1])

    for channel in range(mesh.channels):
        corners = points[0, mesh.faces[mesh.face_channels == channel]]
        over = sum(passed(corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)).abs().sum(1)
        start, end = folds.points.view(2, -1, 2)[:, folds.image == channel]
        winding = passed(start, end) @ folds.winding[folds.image == channel]
        assert over.max() > 0
        torch.testing.assert_close(winding.abs(), over)


@pytest.mark.parametrize("name", SCENES)
def test_rows_agree_with_the_union_of_spans(name):
    points, mesh = scene(name)
    assert_images_close(f"rows of {name}", *row_scans(points, mesh, SIZE, 3), largest=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_converges_to_the_reference(name):
    points, mesh = scene(name)
    actual, expected = (backend.coverage(points, mesh, SIZE, 16) for backend in (raster_fold, raster_reference))
    assert_images_close(name, actual, expected, largest=0.02, mean=4e-4)
    assert_images_close(
        f"{name} in float32", raster_fold.coverage(points.float(), mesh, SIZE, 16).double(), actual, 1e-4
    )


@pytest.mark.parametrize("name", SCENES)
def test_the_gradient_is_the_reference_s(name, generator):
    points, mesh = scene(name)
    cotangent = torch.randn(1, mesh.channels, *SIZE, dtype=torch.float64, generator=generator)
    folds, spans = (gradient(backend, points, mesh, cotangent, 4) for backend in (raster_fold, raster_reference))
    assert folds.abs().max() > 0.5
    torch.testing.assert_close(folds, spans, atol=1e-9, rtol=0)
    single = gradient(raster_fold, points.float(), mesh, cotangent.float(), 4)
    assert (single - folds).norm() < 2e-3 * folds.norm()


@pytest.mark.parametrize("name", SCENES)
def test_the_gradient_is_that_of_the_exact_area(name, generator):
    points, mesh = scene(name)
    cotangent = torch.randn(1, mesh.channels, *SIZE, dtype=torch.float64, generator=generator)
    step, fields = 0.01, smooth_fields(points)
    moved = torch.cat([points + sign * step * field for field in fields for sign in (1, -1)])
    weighed = (raster_fold.coverage(moved, mesh, SIZE, 128) * cotangent).sum((1, 2, 3))
    expected = (weighed[::2] - weighed[1::2]) / (2 * step)
    for subscanlines, allowed in ((4, 0.1), (64, 0.015)):
        pulls = gradient(raster_fold, points, mesh, cotangent, subscanlines)
        actual = torch.stack([(pulls * field).sum() for field in fields])
        assert (actual - expected).norm() < allowed * expected.norm(), subscanlines


corner = st.one_of(st.floats(-6, 14), st.integers(-24, 56).map(lambda eighths: eighths / 8))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(corner, corner), min_size=5, max_size=5), st.booleans())
def test_any_triangles_agree_with_the_union_of_spans(corners, apart):
    # Multiples of 1/8 lie on the scans themselves; equal corners make faces without area.
    points = torch.tensor([corners], dtype=torch.float64)
    mesh = Mesh.build(torch.tensor([[0, 1, 2], [2, 1, 3], [3, 4, 0]]), torch.tensor([0, 1, 1]) if apart else None)
    rows, spans = row_scans(points, mesh, (7, 8), 4)
    assert_images_close("rows of triangles", rows, spans, largest=1e-6)
    area = raster_fold.coverage(points, mesh, (7, 8))
    assert area.min() >= 0 and area.max() <= 1
    assert gradient(raster_fold, points, mesh, torch.ones_like(area), 4).isfinite().all()


def poses(frames: int = 3) -> tuple[Tensor, Mesh, Mesh]:
    """A figure in pixels [N V 2], as one mesh and in parts."""
    vertices, faces, parts = figure(8, 9)
    vertices = swing(vertices, torch.randn(frames, 6, generator=torch.Generator().manual_seed(0)).double())
    return frame(vertices, SIZE, kind="pinhole").project(vertices), Mesh.build(faces), Mesh.build(faces, parts)


def test_the_whole_is_the_union_of_its_parts():
    points, whole, parts = poses()
    plain, apart = (raster_fold.coverage(points, mesh, SIZE, 64) for mesh in (whole, parts))
    assert apart.shape == (3, 6, *SIZE) and (apart.amax((2, 3)) > 0.2).all()
    assert (apart <= plain + 5e-3).all()
    assert (plain <= apart.sum(1, keepdim=True) + 5e-3).all()
    overlapping = apart.sum(1, keepdim=True) - plain > 0.5
    assert overlapping.any()
    for part in range(6):
        alone = Mesh.build(parts.faces[parts.face_channels == part])
        assert_images_close("a part alone", apart[:, part : part + 1], raster_fold.coverage(points, alone, SIZE, 64), 0)


def test_a_batch_is_its_frames_and_a_run_repeats_bit_by_bit(generator, monkeypatch):
    points, _, mesh = poses()
    points = points.float()
    cotangent = torch.randn(3, 6, *SIZE, generator=generator)
    image, pulls = raster_fold.coverage(points, mesh, SIZE), gradient(raster_fold, points, mesh, cotangent, 4)
    assert torch.equal(image, raster_fold.coverage(points, mesh, SIZE))
    assert torch.equal(pulls, gradient(raster_fold, points, mesh, cotangent, 4))
    monkeypatch.setattr(raster_fold, "CHUNK", 2)
    assert torch.equal(image, raster_fold.coverage(points, mesh, SIZE))
    assert torch.equal(pulls, gradient(raster_fold, points, mesh, cotangent, 4))
    assert raster_fold.coverage(points[:0], mesh, SIZE).shape == (0, 6, *SIZE)
    for one in range(3):
        here = slice(one, one + 1)
        assert torch.equal(image[here], raster_fold.coverage(points[here], mesh, SIZE))
        assert torch.equal(pulls[here], gradient(raster_fold, points[here], mesh, cotangent[here], 4))


def test_torch_s_deterministic_mode_finds_nothing_to_refuse(generator):
    points, _, mesh = poses()
    cotangent = torch.randn(3, 6, *SIZE, dtype=torch.float64, generator=generator)
    usual = gradient(raster_fold, points, mesh, cotangent, 4)
    torch.use_deterministic_algorithms(True)
    try:
        assert torch.equal(gradient(raster_fold, points, mesh, cotangent, 4), usual)
    finally:
        torch.use_deterministic_algorithms(False)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_draws_the_same_and_repeats_bit_by_bit(generator):
    points, _, mesh = poses()
    cotangent = torch.randn(3, 6, *SIZE, dtype=torch.float64, generator=generator)
    there = (points.cuda(), mesh.to("cuda"), cotangent.cuda())
    image, pulls = raster_fold.coverage(*there[:2], SIZE).cpu(), gradient(raster_fold, *there, 4).cpu()
    assert_images_close("gpu", image, raster_fold.coverage(points, mesh, SIZE), largest=1e-9)
    torch.testing.assert_close(pulls, gradient(raster_fold, points, mesh, cotangent, 4), atol=1e-9, rtol=0)
    assert torch.equal(image, raster_fold.coverage(*there[:2], SIZE).cpu())
    assert torch.equal(pulls, gradient(raster_fold, *there, 4).cpu())


def test_the_order_of_faces_and_of_their_corners_does_not_matter(generator):
    points, whole, parts = poses()
    order = torch.randperm(len(whole.faces), generator=generator)
    shuffled = Mesh.build(parts.faces[order].roll(1, dims=1), parts.face_channels[order])
    expected = raster_fold.coverage(points, parts, SIZE)
    assert_images_close("shuffled", raster_fold.coverage(points, shuffled, SIZE), expected, largest=1e-12)


def test_a_shift_by_a_pixel_shifts_the_image():
    points, whole, _ = poses()
    image = raster_fold.coverage(points, whole, SIZE)
    right, down = (raster_fold.coverage(points + torch.tensor(by), whole, SIZE) for by in ([1.0, 0.0], [0.0, 1.0]))
    assert_images_close("right", right[..., 1:], image[..., :-1], largest=1e-9)
    assert_images_close("down", down[..., 1:, :], image[..., :-1, :], largest=1e-9)


def test_a_window_of_the_image_is_the_image_of_the_window():
    points, whole, _ = poses()
    image = raster_fold.coverage(points, whole, SIZE)
    window = raster_fold.coverage(points - torch.tensor([9.0, 5.0]), whole, (8, 7))
    assert 0.1 < window.mean() < 0.9
    assert_images_close("window", window, image[..., 5:13, 9:16], largest=1e-9)


@pytest.mark.parametrize("shift", [(100, 0), (-100, 0), (0, 100), (0, -100), (1e9, -1e9)])
def test_outside_the_image_there_is_nothing(shift):
    points, _, parts = poses()
    points = points + torch.tensor(shift)
    assert raster_fold.coverage(points, parts, SIZE).count_nonzero() == 0
    assert gradient(raster_fold, points, parts, torch.ones(3, 6, *SIZE).double(), 4).count_nonzero() == 0


def test_inside_a_large_body_the_image_is_full():
    ball, faces = sphere()
    assert (raster_fold.coverage(1e4 * ball[None, :, :2], Mesh.build(faces), SIZE) == 1).all()


def test_a_fan_of_any_number_of_faces_at_one_edge():
    points = torch.rand(1, 302, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 8
    mesh = Mesh.build(torch.tensor([[0, 1, page] for page in range(2, 302)]))
    assert_images_close("fan", *row_scans(points, mesh, (8, 8), 2), largest=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("subscanlines", [1, 4, 31, 32, 300])
def test_whole_numbers_hold_a_full_pixel(dtype, subscanlines):
    square = torch.tensor([[[0.3, -2.0], [5.0, -2.0], [5.0, 5.0], [0.3, 5.0]]], dtype=dtype)
    image = raster_fold.coverage(square, Mesh.build(torch.tensor([[0, 1, 2], [0, 2, 3]])), (3, 3), subscanlines)
    expected = torch.tensor([0.7, 1.0, 1.0], dtype=dtype).expand(1, 1, 3, 3)
    assert_images_close("full pixels", image, expected, largest=4 * torch.finfo(dtype).eps)
    assert torch.equal(image[..., 1:], expected[..., 1:])


@pytest.mark.parametrize("loss", [torch.sum, lambda image: image.square().sum()])
def test_there_is_no_second_derivative(loss):
    points, whole, _ = poses(1)
    points.requires_grad_()
    first = torch.autograd.grad(loss(raster_fold.coverage(points, whole, SIZE)), points, create_graph=True)[0]
    with pytest.raises(UserError, match="no second derivative; detach"):
        first.sum().backward()
