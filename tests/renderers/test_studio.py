from dataclasses import replace
from math import inf

import pytest
import torch
from torch import Tensor

from renderers import studio as module
from renderers.camera import Camera, cat, frame
from renderers.checks import UserError
from renderers.mesh import Mesh
from renderers.palette import BACKGROUND, rgb
from renderers.rotations import rotation_about
from renderers.silhouette import silhouette
from renderers.studio import STRIPES, Studio, studio
from tests.renderers.meshes import LIMBS, figure, sphere
from tests.renderers.pictures import assert_images_close

QUICK = Studio(samples=16)
PAPER = torch.tensor(rgb(BACKGROUND))[:, None, None]
RED, GREEN = torch.tensor([0.9, 0.1, 0.1]), torch.tensor([0.1, 0.7, 0.1])


def person(**limbs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices [1 V 3], faces and colours of the figure with its feet on the floor, green but for the named limbs."""
    vertices, faces, _ = figure(8, 10)
    colours = torch.stack([limbs.get(name, GREEN) for name in LIMBS]).repeat_interleave(len(vertices) // len(LIMBS), 0)
    return (vertices - vertices.new_tensor([0, vertices[:, 1].min(), 0])).float()[None], faces, colours


def ball(height: float, radius: float = 0.25) -> tuple[Tensor, Tensor, Tensor]:
    vertices, faces = sphere(8, 12)
    vertices = (radius * vertices + vertices.new_tensor([0.0, height, 0.0])).float()
    return vertices[None], faces, RED.expand(len(vertices), 3)


def view(size=(72, 96), yaw=0.0, elevation=0.5, kind="weak", reach=1.2, margin=0.0) -> Camera:
    points = torch.tensor([[-reach, 0.0, -reach], [reach, 1.7, reach]])
    corners = torch.cartesian_prod(*points.T)
    return frame(corners, size, yaw=yaw, elevation=elevation, kind=kind, margin=margin)


def light_at(picture: Tensor, camera: Camera, x: float, z: float) -> float:
    """How bright the 3 x 3 pixels about a spot of the floor are, of the background's brightness."""
    column, row = camera.project(torch.tensor([[[x, 0.0, z]]]))[0, 0].long().tolist()
    return float((picture / PAPER)[:, row - 1 : row + 2, column - 1 : column + 2].mean())


@pytest.mark.parametrize(("kind", "elevation"), [("weak", 0.25), ("pinhole", 0.25), ("weak", 0.9), ("pinhole", 0.05)])
def test_a_floor_that_nothing_shades_is_the_background_and_has_no_horizon(kind, elevation):
    vertices, faces, colours = ball(0.1, radius=0.004)
    picture = studio(vertices, faces, colours, view((48, 64), elevation=elevation, kind=kind), replace(QUICK, fade=1e4))
    rest = (picture[0] - PAPER)[:, (picture[0] - PAPER).abs().amax(0) < 0.05]
    assert rest.shape[1] > 0.99 * 48 * 64
    assert rest.mean().abs() < 0.002 and rest.abs().max() < 0.02


def test_what_lies_flat_in_the_light_shows_its_own_colour():
    plate = torch.tensor([[-0.6, 0.5, -0.6], [-0.6, 0.5, 0.6], [0.6, 0.5, 0.6], [0.6, 0.5, -0.6]])
    faces, colour = torch.tensor([[0, 1, 2], [0, 2, 3]]), torch.tensor([0.8, 0.4, 0.2])
    camera = view(elevation=1.2)
    picture = studio(plate[None], faces, colour.expand(4, 3), camera, QUICK)[0]
    column, row = camera.project(plate[None]).mean(1)[0].long().tolist()
    middle = picture[:, row - 5 : row + 6, column - 5 : column + 6].mean((1, 2))
    assert torch.allclose(middle, colour, atol=0.01)


def test_a_ball_of_few_faces_looks_round():
    vertices, faces = sphere(6, 8)
    vertices = (0.7 * vertices + vertices.new_tensor([0.0, 0.7, 0.0])).float()
    camera = view((48, 64), elevation=0.2)
    picture = studio(vertices[None], faces, GREEN.expand(len(vertices), 3), camera, replace(QUICK, samples=64))[0]
    column, row = camera.project(torch.tensor([[[0.0, 0.7, 0.0]]]))[0, 0].long().tolist()
    across = picture[1, row - 3 : row + 4, column - 8 : column + 9].mean(0).diff().abs()
    assert across.max() < 0.03  # flat faces step by 0.1


def test_the_border_of_a_picture_is_exactly_the_background():
    picture = studio(*person(), view(reach=2.5), QUICK)[0]
    border = torch.cat([picture[:, :2].flatten(1), picture[:, -2:].flatten(1), picture[:, :, :2].flatten(1)], 1)
    assert (border - PAPER[:, 0]).abs().max() < 0.5 / 255


@pytest.mark.parametrize("azimuth", [90.0, -90.0])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_shadow_falls_away_from_the_light(azimuth, yaw):
    camera = view(yaw=yaw)
    picture = studio(*ball(0.25), camera, replace(QUICK, azimuth=azimuth, altitude=45.0))[0]
    right = camera.rotation[0, 0, [0, 2]] * (1 if azimuth > 0 else -1)
    away, towards = (light_at(picture, camera, *(side * 0.4 * right).tolist()) for side in (1.0, -1.0))
    assert away < 0.75 < 0.96 < towards


def test_the_shadow_of_a_lifted_body_leaves_it_and_is_paler():
    camera, lamp = view(), replace(QUICK, altitude=45.0, azimuth=90.0)
    standing, lifted = (studio(*ball(height), camera, lamp)[0] for height in (0.25, 1.0))
    assert light_at(standing, camera, 0.35, 0.0) < 0.7 < 0.96 < light_at(lifted, camera, 0.35, 0.0)
    assert 0.85 < light_at(lifted, camera, 0.75, 0.0) < 0.94 < 0.98 < light_at(standing, camera, 0.75, 0.0)


def test_the_left_arm_of_a_body_that_faces_the_camera_is_on_the_right():
    picture = studio(*person(left_arm=RED), view(), QUICK)[0]
    red = (picture[0] - picture[1] > 0.3).nonzero()[:, 1].double()
    assert len(red) > 20
    assert float(red.mean()) > 96 / 2 + 10  # mirrored, as Mitsuba's own x runs, it would be as far on the left


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
def test_the_outline_is_the_silhouette_s(kind):
    vertices, faces, colours = person()
    vertices = vertices @ rotation_about("z", torch.tensor(0.3)).T.float() + torch.tensor([0.2, 0.3, 0.0])
    camera = frame(vertices, (144, 160), yaw=0.5, elevation=0.3, kind=kind)
    camera = replace(camera, centre=camera.centre + torch.tensor([7.0, -4.0]))
    picture = studio(vertices, faces, colours, camera, QUICK)[0]
    drawn = picture[1] - picture[[0, 2]].amax(0) > 0.08
    covered = silhouette(vertices, Mesh.build(faces), camera)[0, 0] > 0.5

    def overlap(other: Tensor) -> float:
        return float((drawn & other).sum() / (drawn | other).sum())

    assert overlap(covered) > 0.95
    assert max(overlap(covered.flip(1)), overlap(covered.flip(0)), overlap(covered.roll(2, 1))) < 0.9


def test_a_body_far_below_stands_on_a_floor_as_well():
    vertices, faces, colours = person()
    camera, down = view(), torch.tensor([0.0, -3.0, 0.0])
    below = replace(camera, translation=camera.translation - camera.rotation[0] @ down)
    standing = studio(vertices, faces, colours, camera, QUICK)
    assert_images_close("floor-below", studio(vertices + down, faces, colours, below, QUICK), standing, 0.1, 0.001)


@pytest.mark.parametrize("elevation", [0.0, -0.4])
def test_a_camera_that_does_not_look_down_sees_the_body_and_no_floor(elevation):
    camera = view(elevation=elevation)
    picture = studio(*person(), camera, QUICK)[0]
    assert picture.isfinite().all()
    is_body = picture[1] - picture[[0, 2]].amax(0) > 0.05
    assert is_body.sum() > 200
    clear = torch.nn.functional.max_pool2d(is_body[None].float(), 7, 1, 3)[0] == 0
    assert (picture - PAPER)[:, clear].abs().max() < 1e-4


def test_the_light_turns_with_the_camera():
    vertices, faces, colours = person()
    turn = rotation_about("y", torch.tensor(1.1)).float()
    still = studio(vertices, faces, colours, view(yaw=0.3), QUICK)
    camera = view(yaw=0.3)
    camera = replace(camera, rotation=camera.rotation @ turn.T)
    assert_images_close("light-turns", studio(vertices @ turn.T, faces, colours, camera, QUICK), still, 0.2, 0.004)


def test_every_picture_has_its_own_body_and_camera():
    first, faces, colours = person()
    bodies = torch.cat([first, first + torch.tensor([0.4, 0.0, 0.0])])
    cameras = cat([view(), view(yaw=0.7, elevation=0.2)])
    both = studio(bodies, faces, colours, cameras, QUICK)
    for index in range(2):
        alone = studio(bodies[index : index + 1], faces, colours, cameras[index : index + 1], QUICK)
        assert_images_close("alone", both[index : index + 1], alone, 1e-4)
    assert (both[0] - both[1]).abs().max() > 0.3


def test_the_same_seed_gives_the_same_picture_and_another_other_noise():
    first, again, other = (studio(*person(), view(), replace(QUICK, seed=seed)) for seed in (3, 3, 4))
    assert_images_close("same-seed", first, again, 1e-5)
    assert 1e-4 < (first - other).abs().mean() < 0.01


def test_the_stripes_leave_no_seams(monkeypatch):
    striped = studio(*person(), view(), replace(QUICK, samples=64))
    monkeypatch.setattr(module, "STRIPES", 1)
    whole = studio(*person(), view(), replace(QUICK, samples=64))
    assert_images_close("stripes", striped, whole, 0.2, 0.003)
    by_row = (striped - whole).mean((0, 1, 3)).abs()
    assert by_row.max() < 0.005


def test_progress_is_told_of_every_stripe():
    told = []
    studio(*ball(0.25), view((10, 12)), Studio(samples=1), lambda: told.append(1))
    assert len(told) == STRIPES


def test_noise_falls_with_samples():
    def noise(samples: int) -> float:
        one, other = (studio(*person(), view((36, 48)), Studio(samples=samples, seed=seed)) for seed in (0, 1))
        return float((one - other).square().mean().sqrt())

    assert noise(64) < 0.6 * noise(9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"vertices": torch.zeros(1, 5, 2)}, "expected shape [N V 3]"),
        ({"vertices": torch.full((1, 86, 3), inf)}, "not finite"),
        ({"colours": torch.zeros(97, 3)}, "expected shape [V 3] with V=86"),
        ({"camera": cat([view(), view(), view()])}, "3 cameras do not fit 1 pictures"),
        ({"camera": replace(view(), focal=torch.tensor([[40.0, 41.0]]))}, "one focal length for both axes"),
    ],
)
def test_what_does_not_fit_is_refused(change, said):
    vertices, faces, colours = ball(0.25)
    given = {"vertices": vertices, "faces": faces, "colours": colours, "camera": view(), **change}
    with pytest.raises(UserError, match="studio") as refused:
        studio(**given)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    "wrong", [{"samples": 0}, {"altitude": 0}, {"sky": 1.0}, {"fade": 0}, {"spread": float("nan")}, {"seed": -1}]
)
def test_impossible_light_is_refused(wrong):
    with pytest.raises(UserError, match=rf"Studio\({next(iter(wrong))}\)"):
        Studio(**wrong)
