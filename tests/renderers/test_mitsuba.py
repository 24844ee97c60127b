"""The judge: Mitsuba's silhouettes and gradients beside ours, the conventions between the two, and LLVM's whims."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from meshes import figure, sphere, swing
from pictures import assert_images_close
from torch import Tensor

from renderers import mitsuba_scene, raster_mitsuba
from renderers.body import Body
from renderers.camera import NEAR, Camera, cat, frame
from renderers.checks import UserError
from renderers.mesh import Mesh
from renderers.poses import sixteen_poses
from renderers.silhouette import blur, silhouette
from renderers.skeleton import DRAWN_PART_NAMES

# Mitsuba's noise is measured in each comparison; the rest is our own error: on pixels of the outline, and at most.
OWN_MEAN, OWN_LARGEST = 0.004, 0.1


def assert_agrees(name: str, vertices: Tensor, mesh: Mesh, camera: Camera, samples: int = 256) -> Tensor:
    """Compare ours with the mean of two renders, whose noise is half their difference; returns that mean."""
    first, second = (raster_mitsuba.silhouette(vertices, mesh, camera, samples, seed) for seed in (0, 1))
    judge, noise = (first + second) / 2, (first - second).abs() / 2
    outline = ((judge > 0) & (judge < 1)).to(judge.dtype).mean()
    largest, mean = noise.max().item() + OWN_LARGEST, (noise.mean() + OWN_MEAN * outline).item()
    assert outline > 0.005, "there is no outline to compare"
    assert_images_close(name, silhouette(vertices, mesh, camera), judge, largest, mean)
    return judge


ANGLES = torch.tensor([[0, 0.1, 0.4, -0.9, 0.2, -0.5], [0, -0.2, -1.2, 0.3, -0.6, 0.1]])


@cache
def figures() -> tuple[Tensor, Tensor, Tensor]:
    """Two poses [2 V 3] of the figure, its faces and their parts."""
    vertices, faces, parts = figure()
    return swing(vertices, ANGLES.double()), faces, parts


def needs_llvm() -> Path:
    llvm = raster_mitsuba.find_llvm()
    if llvm is None:
        pytest.skip("no LLVM that Mitsuba's projective integrator runs with (DRJIT_LIBLLVM_PATH, or the usual places)")
    return llvm


# --- images ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
@pytest.mark.parametrize(
    ("size", "focal", "centre"),
    [
        ((48, 48), (1.0, 1.0), (0.0, 0.0)),
        ((40, 72), (1.0, 1.0), (0.0, 0.0)),
        ((64, 40), (0.7, 1.0), (0.0, 0.0)),
        ((40, 40), (1.0, 0.6), (5.3, -3.8)),
        ((40, 40), (1.0, 1.0), (17.0, 21.0)),
    ],
    ids=["square", "wide", "tall with two focal lengths", "off-centre with two focal lengths", "partly outside"],
)
def test_figures_agree_before_any_camera(kind, size, focal, centre):
    vertices, faces, _ = figures()
    camera = frame(vertices, size, yaw=0.5, elevation=0.3, kind=kind)
    camera = replace(camera, focal=camera.focal * torch.tensor([focal]), centre=camera.centre + torch.tensor([centre]))
    assert_agrees(f"figures, {kind}", vertices, Mesh.build(faces), camera)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_the_body_and_its_six_parts_agree(kind):
    body = Body.free("light")
    vertices = body(sixteen_poses()[[4, 7]], torch.zeros(2, 3)).vertices
    camera = cat(
        [frame(points, (64, 56), yaw, 0.2, kind=kind) for points, yaw in zip(vertices, (0.6, -2.0), strict=True)]
    )
    assert_agrees(f"body, {kind}", vertices, Mesh.build(body.faces), camera)
    parts = assert_agrees(f"parts, {kind}", vertices, Mesh.build(body.faces, body.face_parts), camera, samples=144)
    assert parts.shape[1] == len(DRAWN_PART_NAMES)
    assert (parts.amax((2, 3)) > 0.99).all()


def test_several_bodies_agree_open_flipped_and_one_before_the_other():
    ball, faces = sphere(10, 12)
    balls = torch.cat([ball, 0.5 * ball + torch.tensor([0.9, 0.3, 2.0]), 0.4 * ball + torch.tensor([-1.5, -0.9, -1.0])])
    faces = torch.cat([faces, faces.flip(1) + len(ball), faces[20:] + 2 * len(ball)])
    camera = frame(balls, (40, 56), yaw=0.3, kind="pinhole")
    assert_agrees("several bodies", balls[None], Mesh.build(faces), camera)


def test_what_crosses_the_near_plane_is_cut_there():
    vertices, faces, parts = figures()
    camera = frame(vertices, (48, 48), yaw=0.4, kind="pinhole")
    nearer = camera.translation - torch.tensor([0.0, 0.0, 1.0]) * camera.translation[:, 2:]
    camera = replace(camera, translation=nearer + torch.tensor([0.3, -0.2, 0.1]), focal=camera.focal / 6)
    depth = camera.to(dtype=vertices.dtype).view(vertices)[..., 2]
    assert (depth < NEAR).any()
    assert (depth > NEAR).any()
    assert_agrees("near plane", vertices, Mesh.build(faces), camera)
    assert_agrees("near plane, parts", vertices, Mesh.build(faces, parts), camera, samples=144)


def test_neither_sees_what_is_nearer_than_the_near_plane():
    ball, faces = sphere()
    camera = Camera(
        torch.eye(3)[None], torch.zeros(1, 3), torch.full((1, 2), 16.0), torch.full((1, 2), 8.0), (16, 16), "pinhole"
    )
    for share, seen in ((0.7, False), (1.4, True)):
        vertices = 0.2 * NEAR * ball[None] + torch.tensor([0.0, 0.0, share * NEAR])
        for render in (silhouette, raster_mitsuba.silhouette):
            assert render(vertices, Mesh.build(faces), camera).any().item() is seen


def test_parts_out_of_the_picture_and_channels_without_faces_are_empty():
    ball, faces = sphere()
    vertices = torch.cat([ball, ball + torch.tensor([30.0, 0.0, 0.0])])[None]
    mesh = Mesh.build(torch.cat([faces, faces + len(ball)]), torch.tensor([0, 2]).repeat_interleave(len(faces)))
    images = raster_mitsuba.silhouette(vertices, mesh, frame(ball, (24, 24)), samples=16)
    assert images.shape == (1, 3, 24, 24)
    assert images[:, 0].max() == 1
    assert not images[:, 1:].any()


def test_a_body_that_the_first_few_rays_miss_is_found():
    ball, faces = sphere(10, 12)
    camera = frame(ball, (16, 16))
    camera = replace(camera, focal=camera.focal / 150, centre=torch.tensor([[9.3, 6.6]]))
    mesh = Mesh.build(faces)
    assert not raster_mitsuba.silhouette(ball[None], mesh, camera, samples=raster_mitsuba.FEW).any()
    seen = raster_mitsuba.silhouette(ball[None], mesh, camera, samples=4096)
    assert seen[0, 0, 6, 9] == pytest.approx(silhouette(ball[None], mesh, camera, 256).sum().item(), rel=0.1)
    assert seen.sum() == seen[0, 0, 6, 9]


# --- conventions, each with its wrong reading ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_the_body_s_left_is_right_in_a_picture_of_its_front_and_up_is_up(kind):
    ball, faces = sphere()
    mesh, frontal = Mesh.build(faces), frame(2 * ball, (32, 32), kind=kind)
    vertices = 0.5 * ball[None] + torch.tensor([1.0, 1.0, 0.0])
    image = raster_mitsuba.silhouette(vertices, mesh, frontal, samples=64)
    assert image[0, 0, 9, 22] == 1
    ours = silhouette(vertices, mesh, frontal)
    assert (ours - image).abs().mean() < 0.001
    for mirrored in (image.flip(-1), image.flip(-2)):
        assert (ours - mirrored).abs().mean() > 0.05


def test_a_camera_as_mitsuba_has_it_shows_the_mirror_image():
    ball, faces = sphere()
    vertices = 0.5 * ball + torch.tensor([1.0, 0.0, 0.0])
    with mitsuba_scene.using() as mi:
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "depth"},
                "body": mitsuba_scene.mesh(vertices, faces),
                "sensor": {
                    "type": "orthographic",
                    "to_world": mi.ScalarTransform4f().translate([0, 0, -5]).scale([2, 2, 1]),
                    "film": {"type": "hdrfilm", "width": 32, "height": 32, "pixel_format": "rgba"},
                },
            }
        )
        alpha = torch.from_numpy(mi.render(scene, spp=16).numpy())[..., 3]
    assert alpha[16, 8] > 0.99, "looking along z with y up, Mitsuba has x to the left"
    assert alpha[16, 24] == 0


def test_two_focal_lengths_are_given_by_the_vertices_and_one_leaves_them_alone():
    ball, _ = sphere()
    camera = cat([frame(ball, (32, 32), yaw, 0.4, kind="pinhole") for yaw in (0.3, 1.0)])
    vertices = ball.repeat(2, 1, 1)
    assert mitsuba_scene.square(vertices, camera) is vertices
    flat = replace(camera, focal=camera.focal * torch.tensor([1.0, 0.5]))
    square = mitsuba_scene.square(vertices, flat)
    expected = flat.project(vertices)
    torch.testing.assert_close(camera.project(square)[..., 0], expected[..., 0])
    torch.testing.assert_close(
        (camera.project(square) - camera.centre[:, None])[..., 1] + flat.centre[:, None, 1], expected[..., 1]
    )


# --- behaviour -------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bits_and_no_frame_leaks_into_the_next():
    vertices, faces, parts = figures()
    mesh, camera = Mesh.build(faces, parts), frame(vertices, (32, 32))
    images = raster_mitsuba.silhouette(vertices, mesh, camera, 64)
    assert torch.equal(raster_mitsuba.silhouette(vertices, mesh, camera, 64), images)
    assert not torch.equal(raster_mitsuba.silhouette(vertices, mesh, camera, 64, seed=1), images)
    there_and_back = raster_mitsuba.silhouette(vertices[[1, 0, 1]], mesh, camera, 64)
    assert torch.equal(there_and_back, images[[1, 0, 1]])
    assert not torch.equal(images[0], images[1])


def test_numbers_come_back_as_they_went_in():
    vertices, faces, _ = figures()
    for dtype in (torch.float32, torch.float64):
        image = raster_mitsuba.silhouette(vertices[:1].to(dtype), Mesh.build(faces), frame(vertices, (24, 24)), 16)
        assert image.dtype == dtype
        assert torch.equal(image * 16, (image * 16).round())


def test_the_variant_of_the_host_is_left_alone():
    import mitsuba as mi

    ball, faces = sphere()
    mi.set_variant("scalar_spectral")
    try:
        raster_mitsuba.silhouette(ball[None], Mesh.build(faces), frame(ball, (16, 16)), 16)
        assert mi.variant() == "scalar_spectral"
        with pytest.raises(UserError):
            raster_mitsuba.silhouette(ball[None] / 0, Mesh.build(faces), frame(ball, (16, 16)), 16)
        with pytest.raises(RuntimeError, match="stop"), mitsuba_scene.using():
            assert mi.variant() == mitsuba_scene.SCALAR
            raise RuntimeError("stop")
        assert mi.variant() == "scalar_spectral"
    finally:
        mi.set_variant(mitsuba_scene.SCALAR)


def test_a_mesh_takes_colours_a_surface_a_lamp_and_smooth_normals():
    ball, faces = sphere(12, 16)
    colours = torch.where(ball[:, :1] > 0, torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 0.0, 1.0]))
    painted = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [3.0, 3.0, 3.0]}}
    camera = frame(ball, (32, 32))
    with mitsuba_scene.using() as mi:
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "body": mitsuba_scene.mesh(ball, faces, bsdf=painted, colours=colours, smooth=True),
                "lamp": mitsuba_scene.mesh(ball + torch.tensor([0.0, 0.0, 6.0]), faces, emitter=lamp),
            }
        )
        sensor = mitsuba_scene.sensor(camera, ball, 64)
        image = torch.from_numpy(mi.render(scene, sensor=sensor).numpy())
        parameters = mi.traverse(scene)
        before = list(parameters["body.vertex_normals"])
        mitsuba_scene.move(parameters, "body", ball * torch.tensor([1.0, 0.3, 1.0]))
        assert list(parameters["body.vertex_normals"]) != before
    left, right = image[16, 8, :3], image[16, 24, :3]
    assert left[2] > 10 * left[0] and left[2] > 0.01, "the body's right side is at the left, and blue"
    assert right[0] > 10 * right[2] and right[0] > 0.01


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v[0], r"expected shape \[N V 3\]"),
        (lambda v: v[:, :-1], "the faces name 42 vertices, got 41"),
        (lambda v: v / 0, "at frame 0, vertex 0, coordinate 0"),
        (lambda v: v[:1].repeat(3, 1, 1), "2 cameras do not fit 3 frames"),
    ],
)
def test_errors_name_what_does_not_fit(change, words):
    ball, faces = sphere()
    camera = frame(ball, (16, 16))[torch.tensor([0, 0])]
    with pytest.raises(UserError, match=words):
        raster_mitsuba.silhouette(change(ball.repeat(2, 1, 1)), Mesh.build(faces), camera)
    for samples, seed in ((0, 0), (4, -1)):
        with pytest.raises(UserError, match=f"got {samples}, {seed}"):
            raster_mitsuba.silhouette(ball[None], Mesh.build(faces), camera[:1], samples, seed)
    with mitsuba_scene.using(), pytest.raises(UserError, match="faces name other than the 42 vertices"):
        mitsuba_scene.mesh(ball, faces + 1)
    with pytest.raises(UserError, match=r"gradient\(cotangent\): expected shape \[N 1 16 16\] with N=2"):
        raster_mitsuba.gradient(ball.repeat(2, 1, 1), Mesh.build(faces), camera, torch.ones(2, 1, 16, 8))


# --- gradients -------------------------------------------------------------------------------------------------------


def motions(camera: Camera) -> dict[str, Tensor]:
    """Ways [2 V 3] of moving the figures, by about a pixel each."""
    vertices, _, _ = figures()
    right, down = camera.rotation[0, :2].double()
    shifted = camera.to(dtype=torch.float64).project(vertices + 1e-3 * right)
    pixel = 1e-3 / (shifted - camera.to(dtype=torch.float64).project(vertices)).norm(dim=-1).mean()
    turn = torch.tensor([0, 0, 1e-3, 0, 0, 0]).double()
    arm = (swing(figure()[0], ANGLES + turn) - vertices) / 1e-3
    middle = vertices.mean(1, keepdim=True)
    ways = {"x": right.expand_as(vertices), "y": down.expand_as(vertices), "scale": vertices - middle, "arm": 2 * arm}
    return {name: pixel * way for name, way in ways.items()}


def smooth(channels: int, size: tuple[int, int]) -> Tensor:
    """Weights [2 C H W] of a loss, of about 1, that hardly change within a pixel."""
    weights = torch.randn(len(ANGLES), channels, *size, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    weights = blur(weights, 10.0)
    return weights / weights.std()


def pulls(mesh: Mesh, camera: Camera, weights: Tensor, subscanlines: int = 4) -> Tensor:
    vertices = figures()[0].clone().requires_grad_()
    return torch.autograd.grad(silhouette(vertices, mesh, camera, subscanlines), vertices, weights)[0]


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_our_gradient_is_the_slope_of_mitsuba_s_renders(kind):
    # Steps of half a pixel to either side: of the .03, .01 are their length, .01 the noise of 324 rays, .004 our own.
    vertices, faces, _ = figures()
    mesh, camera = Mesh.build(faces), frame(vertices, (64, 48), yaw=0.5, elevation=0.2, kind=kind)
    weights = smooth(1, camera.size)
    gradient = pulls(mesh, camera, weights)
    for name, way in motions(camera).items():
        ahead, behind = (
            raster_mitsuba.silhouette(vertices + step * way, mesh, camera, samples=324) for step in (0.5, -0.5)
        )
        expected = ((ahead - behind) * weights).sum((1, 2, 3))
        actual = (gradient * way).sum((1, 2))
        assert (actual - expected).norm() < 0.03 * expected.norm(), f"{name}: {actual}, by differences {expected}"


@pytest.mark.parametrize(
    ("kind", "split", "focal"), [("pinhole", False, (1.0, 1.0)), ("weak", True, (1.0, 0.7))], ids=["whole", "parts"]
)
def test_our_gradient_is_that_of_the_projective_integrator(kind, split, focal):
    llvm = needs_llvm()
    vertices, faces, parts = figures()
    mesh = Mesh.build(faces, parts if split else None)
    camera = frame(vertices, (48, 40), yaw=0.5, elevation=0.2, kind=kind)
    camera = replace(camera, focal=camera.focal * torch.tensor([focal]))
    weights = smooth(mesh.channels, camera.size)
    gradient = pulls(mesh, camera, weights, subscanlines=8)
    expected = raster_mitsuba.gradient(vertices, mesh, camera, weights, samples=144, llvm=llvm)
    assert expected.dtype == vertices.dtype
    assert (gradient - expected).norm() < 0.04 * expected.norm()
    for name, way in motions(camera).items():
        actual, judge = ((pull * way).sum((1, 2)) for pull in (gradient, expected))
        assert (actual - judge).norm() < 0.05 * judge.norm(), f"{name}: {actual}, by Mitsuba {judge}"


def test_libraries_that_do_not_work_are_passed_over(tmp_path, monkeypatch):
    ball, faces = sphere()
    asked = (ball[None], Mesh.build(faces), frame(ball, (8, 8)), torch.ones(1, 1, 8, 8))
    with pytest.raises(UserError, match="^/nowhere/libLLVM.so: Mitsuba's projective integrator does not run with this"):
        raster_mitsuba.gradient(*asked, llvm=Path("/nowhere/libLLVM.so"))
    text = tmp_path / "libLLVM.so.99"
    text.write_text("no library")
    monkeypatch.setattr(raster_mitsuba, "LIBRARIES", ())
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(text))
    assert raster_mitsuba.find_llvm() is None
    with pytest.raises(UserError, match="there is no LLVM that Mitsuba's projective integrator runs with; install"):
        raster_mitsuba.gradient(*asked)


def test_the_newest_library_is_tried_first_and_the_named_one_before_it(tmp_path, monkeypatch):
    for name in ("libLLVM-9.so", "libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVMCore.a"):
        (tmp_path / name).touch()
    tried = []
    monkeypatch.setattr(raster_mitsuba, "first_working", tried.extend)
    monkeypatch.setattr(raster_mitsuba, "LIBRARIES", (str(tmp_path / "libLLVM[.-]*"),))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/mine/libLLVM.so")
    raster_mitsuba.find_llvm()
    assert [path.name for path in tried] == ["libLLVM.so", "libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVM-9.so"]


def test_an_llvm_that_aborts_ends_its_own_process_alone():
    """LLVM 15 and 16 abort where the gradient is compiled, LLVM 14 is refused."""
    old = [
        Path(path)
        for path in ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", "/usr/lib/x86_64-linux-gnu/libLLVM-16.so.1")
    ]
    old = tuple(path for path in old if path.exists())
    if not old:
        pytest.skip("no LLVM 15 or 16 is here")
    assert raster_mitsuba.first_working(old) is None
