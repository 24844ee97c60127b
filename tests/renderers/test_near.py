"""Bodies that reach behind a pinhole camera: clipped as rays would see them, with gradients."""

from dataclasses import replace

import pytest
import torch
from meshes import figure, sphere
from pictures import assert_images_close
from torch import Tensor

from renderers.camera import NEAR, Camera
from renderers.mesh import Mesh
from renderers.near import clip
from renderers.silhouette import silhouette

SIZE = (26, 34)


def wide_camera(size: tuple[int, int] = SIZE) -> Camera:
    """At the origin, looking along the world's z axis, 90 degrees wide."""
    zero = torch.zeros(1, 3, dtype=torch.float64)
    focal = torch.full((1, 2), size[1] / 2, dtype=torch.float64)
    centre = torch.tensor([[size[1] / 2, size[0] / 2]], dtype=torch.float64)
    return Camera(torch.eye(3, dtype=torch.float64)[None], zero, focal, centre, size, "pinhole")


def cut_scene(name: str) -> tuple[Tensor, Mesh]:
    """Vertices [1 V 3] that reach behind `wide_camera`, and their mesh."""
    ball, faces = sphere(9, 12)
    parts = None
    if name == "beside the eye":
        ball = 0.5 * ball + torch.tensor([0.45, 0.2, 0.2])
    elif name == "around the eye":
        ball = ball * torch.tensor([0.7, 0.3, 1.0]) + torch.tensor([0.3, 0.2, 0.2])
        faces = faces[ball[faces].mean(1)[:, 2] < 0.7]  # a window in the far wall
    elif name == "open":
        faces = faces[ball[faces].mean(1)[:, 0] < 0.1]
        ball = ball * torch.tensor([0.3, 0.3, 2.0]) + torch.tensor([0.4, -0.2, 1.0])
    elif name == "flat":
        faces = torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
        ball = torch.randn(12, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    elif name == "figure":
        ball, faces, parts = figure(6, 7)
        turn = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
        ball = ball @ turn.T + torch.tensor([0.2, 0.25, -0.6])
    return ball[None], Mesh.build(faces, parts)


SCENES = ("beside the eye", "around the eye", "open", "flat", "figure")


def hit_by_rays(vertices: Tensor, mesh: Mesh, camera: Camera) -> Tensor:
    """Coverage [1 C H W] by 8 x 8 rays a pixel: some face lies on the ray, at depth NEAR or more."""
    (height, width), fine = camera.size, 8
    y, x = torch.meshgrid(*[(torch.arange(side * fine) + 0.5) / fine for side in (height, width)], indexing="ij")
    x, y = x.double(), y.double()
    rays = torch.stack([(x - camera.centre[0, 0]) / camera.focal[0, 0], (y - camera.centre[0, 1]) / camera.focal[0, 1]])
    rays = torch.cat([rays, torch.ones_like(x)[None]]).view(3, -1).T
    hits = torch.zeros(mesh.channels, len(rays), dtype=torch.bool)
    for face, channel in zip(vertices[0, mesh.faces], mesh.face_channels.tolist(), strict=True):
        normal = torch.linalg.cross(face[1] - face[0], face[2] - face[0])
        depth = (normal @ face[0]) / (rays @ normal)
        points = depth[:, None] * rays
        sides = [torch.linalg.cross((face[k - 2] - face[k])[None], points - face[k]) @ normal for k in range(3)]
        hits[channel] |= (torch.stack(sides) >= 0).all(0) & (depth >= NEAR)
    return hits.view(1, mesh.channels, height, fine, width, fine).double().mean((3, 5))


@pytest.mark.parametrize("backend", ["fold", "reference"])
@pytest.mark.parametrize("name", SCENES)
def test_rays_see_the_same(name, backend):
    vertices, mesh = cut_scene(name)
    assert (vertices[..., 2] < 0).any() and (vertices[..., 2] > NEAR).any()
    actual = silhouette(vertices, mesh, wide_camera(), 8, backend)
    expected = hit_by_rays(vertices, mesh, wide_camera())
    assert expected.mean() > 0.02
    assert_images_close(f"{name} near {backend}", actual, expected, largest=0.1, mean=3e-3)


@pytest.mark.parametrize("name", SCENES)
def test_the_gradient_is_the_slope_of_the_area(name, generator):
    vertices, mesh = cut_scene(name)
    weights = torch.rand(1, mesh.channels, *SIZE, dtype=torch.float64, generator=generator)
    x, y, z = vertices.unbind(-1)
    shapes = (torch.ones_like(x), torch.sin(3 * x), torch.cos(2 * y + 1), z)
    ways = [
        torch.nn.functional.one_hot(torch.tensor(axis), 3) * shape[..., None] for axis in (0, 1) for shape in shapes
    ]

    def area(vertices: Tensor, subscanlines: int) -> Tensor:
        return (silhouette(vertices, mesh, wide_camera(), subscanlines) * weights).sum()

    moving = vertices.clone().requires_grad_()
    slope = torch.autograd.grad(area(moving, 64), moving)[0]
    step = 1e-3
    expected = torch.stack([(area(vertices + step * w, 64) - area(vertices - step * w, 64)) / (2 * step) for w in ways])
    actual = torch.stack([(slope * way).sum() for way in ways])
    assert expected.norm() > 1
    assert (actual - expected).norm() < 0.03 * expected.norm()


@pytest.mark.parametrize("name", SCENES)
def test_a_cut_is_shared_by_neighbours_and_nothing_behind_is_left(name):
    vertices, mesh = cut_scene(name)
    points, clipped = clip(vertices[0], mesh, NEAR)
    assert points[:, 2].min() > NEAR - 1e-12
    assert clipped.channels == mesh.channels and clipped.vertices == len(points)

    def lone_edges(mesh: Mesh) -> int:
        return int(((mesh.edge_faces < 2 * len(mesh.faces)).sum(1) == 1).sum())

    cut = vertices[0, mesh.faces, 2] < NEAR
    halved = (cut.sum(1) % 3 != 0).sum()
    if lone_edges(mesh) == 0:
        assert lone_edges(clipped) == halved > 3


def test_whole_frames_and_cut_ones_go_together_and_each_by_its_own_camera():
    vertices, mesh = cut_scene("figure")
    batch = torch.cat([vertices, vertices + torch.tensor([0.0, 0.0, 5.0]), vertices - torch.tensor([0.0, 0.0, 50.0])])
    batch = batch.float().requires_grad_()
    images = silhouette(batch, mesh, wide_camera())
    assert images.shape == (3, 6, *SIZE) and images[2].count_nonzero() == 0
    for frame in range(3):
        assert torch.equal(images[frame : frame + 1], silhouette(batch[frame : frame + 1], mesh, wide_camera()))
    pull = torch.autograd.grad(images.square().sum(), batch)[0]
    assert pull.isfinite().all() and pull[0].any() and pull[1].any() and not pull[2].any()

    cameras = wide_camera()[torch.tensor([0, 0, 0])]
    cameras = replace(cameras, centre=cameras.centre + torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]))
    moved = silhouette(batch, mesh, cameras)
    assert_images_close("second camera", moved[1, :, :, 1:][None], images[1, :, :, :-1][None], largest=1e-5)
    assert torch.equal(moved[0], images[0])


def test_an_unused_vertex_in_the_eye_takes_no_part_in_the_gradient():
    corners = torch.tensor([[[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 1.0, 3.0], [0.0, 0.0, 0.0]]], dtype=torch.float64)
    size = torch.ones((), dtype=torch.float64, requires_grad=True)
    image = silhouette(size * corners, Mesh.build(torch.tensor([[0, 1, 2]])), wide_camera())
    assert image.sum() > 5
    image[..., :, :20].sum().backward()
    assert size.grad.isfinite()


def test_without_clipping_what_lies_behind_would_be_drawn_upside_down():
    behind = torch.tensor([[[0.2, 0.3, -1.0], [0.6, 0.3, -1.0], [0.4, 0.6, -1.0]]], dtype=torch.float64)
    mesh, camera = Mesh.build(torch.tensor([[0, 1, 2]])), wide_camera()
    assert silhouette(behind, mesh, camera).count_nonzero() == 0
    assert silhouette(-behind, mesh, camera).sum() > 1
    pixels = camera.pixels(behind)
    assert (pixels > 0).all() and (pixels[..., 0] < SIZE[1]).all()
