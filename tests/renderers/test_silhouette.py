"""The public entry on the body itself: accuracy, gradients to the pose, both backends, errors."""

from dataclasses import replace
from functools import cache

import pytest
import torch
from meshes import sphere
from pictures import assert_images_close
from torch import Tensor

from renderers.body import Body
from renderers.camera import cat, frame
from renderers.checks import ShapeError, UserError
from renderers.mesh import Mesh
from renderers.rotations import axis_angle_to_matrix
from renderers.silhouette import blur, silhouette
from renderers.skeleton import DRAWN_PART_NAMES, JOINTS


@cache
def posed(frames: int) -> tuple[Tensor, Mesh, Mesh]:
    """World vertices [N V 3] of the light body with lowered arms, bent elbows and jitter; plain and parts."""
    body, generator = Body.free("light"), torch.Generator().manual_seed(0)
    turns = 0.3 * torch.randn(frames, 24, 3, generator=generator)
    down = torch.rand(frames, 2, generator=generator)
    turns[:, JOINTS["left_shoulder"], 2] -= 1.3 * down[:, 0]
    turns[:, JOINTS["right_shoulder"], 2] += 1.3 * down[:, 1]
    turns[:, JOINTS["left_elbow"], 1] -= 1.5 * down[:, 1]
    vertices = body(axis_angle_to_matrix(turns), torch.zeros(frames, 3)).vertices
    return vertices, Mesh.build(body.faces), Mesh.build(body.faces, body.face_parts)


@pytest.mark.parametrize(("size", "allowed"), [(64, 2e-4), (112, 1e-4), (224, 5e-5)])
def test_the_body_s_area_is_exact_to_a_few_parts_in_ten_thousand(size, allowed):
    vertices, plain, _ = posed(3)
    camera = frame(vertices, (size, size), yaw=0.4, kind="pinhole")
    actual = silhouette(vertices, plain, camera)
    expected = silhouette(vertices, plain, camera, subscanlines=64)
    assert_images_close(f"body at {size}", actual, expected, largest=0.2, mean=allowed)
    ours, theirs = actual > 0.5, expected > 0.5
    assert (ours & theirs).sum() > 0.997 * (ours | theirs).sum()


def test_backends_agree_on_the_body_in_value_and_gradient(generator):
    vertices, _, parts = posed(1)
    vertices = vertices.double().requires_grad_()
    camera = frame(vertices, (32, 24), yaw=-0.6, elevation=0.2, kind="pinhole")
    cotangent = torch.randn(1, len(DRAWN_PART_NAMES), 32, 24, dtype=torch.float64, generator=generator)
    fold, reference = (silhouette(vertices, parts, camera, 8, backend) for backend in ("fold", "reference"))
    assert (fold.amax((0, 2, 3)) > 0.9).all()
    assert_images_close("backends on the body", fold, reference, largest=0.05, mean=3e-4)
    pulls, expected = (torch.autograd.grad(image, vertices, cotangent)[0] for image in (fold, reference))
    assert expected.abs().max() > 1
    torch.testing.assert_close(pulls, expected, atol=1e-6 * expected.abs().max().item(), rtol=0)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_the_gradient_to_a_joint_is_the_slope_of_the_loss(kind):
    body, generator = Body.free("light").double(), torch.Generator().manual_seed(1)
    mesh = Mesh.build(body.faces, body.face_parts)
    turns = 0.2 * torch.randn(1, 24, 3, dtype=torch.float64, generator=generator)
    root = torch.zeros(1, 3, dtype=torch.float64)

    def vertices(turns: Tensor) -> Tensor:
        return body(axis_angle_to_matrix(turns), root).vertices

    camera = frame(vertices(turns).detach(), (64, 64), yaw=0.3, kind=kind)
    target = blur(silhouette(vertices(0.5 * turns), mesh, camera), 2.0).detach()

    def loss(turns: Tensor, subscanlines: int) -> Tensor:
        return (blur(silhouette(vertices(turns), mesh, camera, subscanlines), 2.0) - target).square().sum()

    turned = turns.clone().requires_grad_()
    slope = torch.autograd.grad(loss(turned, 4), turned)[0][0]
    moved = [
        (JOINTS[name], axis) for name in ("left_shoulder", "right_elbow", "left_knee", "spine1") for axis in (0, 2)
    ]
    expected = []
    for joint, axis in moved:
        step = torch.zeros_like(turns)
        step[0, joint, axis] = 1e-3
        expected.append((loss(turns + step, 32) - loss(turns - step, 32)) / 2e-3)
    actual, expected = torch.stack([slope[place] for place in moved]), torch.stack(expected)
    assert (actual - expected).norm() < 0.05 * expected.norm()


def test_an_arm_before_the_trunk_is_hidden_in_the_whole_and_seen_in_its_part():
    ball, faces = sphere(10, 12)
    vertices = torch.cat([ball, 0.2 * ball + torch.tensor([0.1, 0.2, 1.0])])[None].requires_grad_()
    faces, part = torch.cat([faces, faces + len(ball)]), torch.arange(2).repeat_interleave(len(faces))
    camera = frame(vertices, (32, 32))
    for mesh, seen in ((Mesh.build(faces), False), (Mesh.build(faces, part), True)):
        image = silhouette(vertices, mesh, camera)
        weights = torch.linspace(0, 1, 32, dtype=torch.float64).expand_as(image)
        pull = torch.autograd.grad(image, vertices, weights)[0][0, len(ball) :]
        assert bool(pull.abs().max() > 0.01) is seen


def test_one_camera_serves_all_frames_and_each_may_have_its_own():
    vertices, plain, _ = posed(2)
    camera = frame(vertices, (24, 24))
    image = silhouette(vertices, plain, camera)
    assert torch.equal(silhouette(vertices, plain, camera[torch.tensor([0, 0])]), image)
    beside = cat([camera, replace(camera, centre=camera.centre + 1)])
    moved = silhouette(vertices, plain, beside)[1:, :, 1:, 1:]
    assert_images_close("own cameras", moved, image[1:, :, :-1, :-1], largest=1e-4)


def test_blur_spreads_over_the_pixels_asked_for_and_keeps_the_sum():
    dot = torch.zeros(1, 2, 41, 41)
    dot[0, 1, 20, 20] = 1
    spread = blur(dot, 3.0)
    assert spread[0, 0].count_nonzero() == 0
    assert spread.sum().item() == pytest.approx(1, abs=1e-5)
    across = (spread[0, 1].sum(0) * (torch.arange(41) - 20.0) ** 2).sum().sqrt()
    assert across.item() == pytest.approx(3, rel=0.03)


def test_the_gradient_of_a_blur_is_the_blurred_cotangent(generator):
    images, cotangent = torch.rand(2, 2, 3, 17, 23, dtype=torch.float64, generator=generator)
    images.requires_grad_()
    pull = torch.autograd.grad(blur(images, 2.3), images, cotangent)[0]
    torch.testing.assert_close(pull, blur(cotangent, 2.3))
    assert blur(images, 0.0) is images


@pytest.mark.parametrize("sigma", [-1.0, float("nan"), float("inf")])
def test_a_blur_without_meaning_is_refused(sigma):
    with pytest.raises(UserError, match="expected 0 or more pixels"):
        blur(torch.zeros(1, 1, 4, 4), sigma)


def test_a_blurred_pair_pulls_where_a_sharp_one_does_not():
    ball, faces = sphere()
    middle, mesh = 0.2 * ball[None], Mesh.build(faces)
    left, right = (middle + torch.tensor([x, 0.0, 0.0]) for x in (-0.6, 0.6))
    camera = frame(torch.cat([left, right]), (32, 64))

    def push_right(target: Tensor, sigma: float) -> float:
        vertices = middle.clone().requires_grad_()
        images = [blur(silhouette(at, mesh, camera), sigma) for at in (vertices, target)]
        return -torch.autograd.grad((images[0] - images[1]).square().sum(), vertices)[0][..., 0].sum().item()

    assert push_right(right, 0.1) == push_right(left, 0.1)
    assert push_right(left, 8.0) < -1 and push_right(right, 8.0) > 1


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda v: v[0], ShapeError, r"silhouette\(vertices\): expected shape \[N V 3\]"),
        (lambda v: v.half(), UserError, "expected float32 or float64, got torch.float16"),
        (lambda v: v[:, :-1], UserError, "the faces name 42 vertices, got 41"),
        (lambda v: v / 0, UserError, "at frame 0, vertex 0, coordinate 0"),
        (lambda v: v[:1].repeat(3, 1, 1), UserError, "2 cameras do not fit 3"),
    ],
)
def test_errors_name_what_does_not_fit(change, error, words):
    ball, faces = sphere()
    camera = frame(ball, (16, 16), kind="pinhole")[torch.tensor([0, 0])]
    with pytest.raises(error, match=words):
        silhouette(change(ball.repeat(2, 1, 1)), Mesh.build(faces), camera)
    for scans in (0, 4.0):
        with pytest.raises(UserError, match=f"at least 1, got {scans}"):
            silhouette(ball[None], Mesh.build(faces), camera, subscanlines=scans)
    with pytest.raises(UserError, match="unknown name 'folds'; did you mean fold?"):
        silhouette(ball[None], Mesh.build(faces), camera, backend="folds")


@pytest.mark.parametrize("kind", ["pinhole", "weak"])
def test_cameras_and_places_without_meaning_are_refused_rather_than_drawn_blank(kind):
    ball, faces = sphere()
    camera = frame(ball, (16, 16), kind=kind)
    for change in ({"translation": camera.translation / 0}, {"focal": camera.focal * float("nan")}):
        with pytest.raises(UserError, match="is not finite or beyond"):
            silhouette(ball[None], Mesh.build(faces), replace(camera, **change))
    with pytest.raises(UserError, match="is not finite or beyond 1e"):
        silhouette(1e16 * ball[None], Mesh.build(faces), camera)


def test_autocast_does_not_blur_the_projection():
    vertices, plain, _ = posed(1)
    camera = frame(vertices, (64, 64))
    with torch.autocast("cpu", torch.bfloat16):
        image = silhouette(vertices, plain, camera)
    assert torch.equal(image, silhouette(vertices, plain, camera))
    precise = silhouette(vertices.double(), plain, camera)
    assert_images_close("autocast", image.double(), precise, largest=1e-3)
