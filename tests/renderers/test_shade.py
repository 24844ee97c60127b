import pytest
import torch

from renderers.camera import cat, frame
from renderers.palette import BACKGROUND, PARTS, rgb
from renderers.shade import Light, part_colours, shade

FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def wall(z: float, low: float = 0.5, high: float = 1.5) -> torch.Tensor:
    """[4 3] a square that faces +z."""
    return torch.tensor([[-0.5, low, z], [0.5, low, z], [0.5, high, z], [-0.5, high, z]])


def view(size=(40, 40), elevation=0.0, kind="weak"):
    return frame(torch.tensor([[-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]]), size, elevation=elevation, margin=0.0, kind=kind)


@pytest.mark.parametrize("kind", ["weak", "pinhole"])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_wall_hides_the_farther(kind, order):
    walls = [wall(-0.5), wall(0.5)]
    vertices = torch.cat([walls[k] for k in order])[None]
    faces = torch.cat([FACES, FACES + 4])
    colours = torch.tensor([[1.0, 0, 0], [0, 0, 1.0]])[list(order)].repeat_interleave(4, 0)
    picture = shade(vertices, faces, colours, view(kind=kind))[0]
    middle = picture[:, 18:22, 18:22]
    assert (middle[2] > middle[0] + 0.2).all()


def test_what_it_covers_is_what_projection_says():
    camera = view()
    picture = shade(wall(0.0)[None], FACES, torch.zeros(4, 3), camera, floor=False)[0]
    covered = (picture - torch.tensor(rgb(BACKGROUND))[:, None, None]).abs().amax(0) > 0.1
    (left, top), (right, bottom) = camera.project(wall(0.0)[None])[0][[3, 1]].round().long().tolist()
    expected = torch.zeros(40, 40, dtype=torch.bool)
    expected[top:bottom, left:right] = True
    assert torch.equal(covered, expected)


def test_colours_blend_over_a_face():
    colours = torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [0, 1.0, 0], [1.0, 0, 0]])
    row = shade(wall(0.0)[None], FACES, colours, view(), Light(rim=0.0), floor=False)[0][:, 20, 11:29]
    share = row[0] / (row[0] + row[1])
    assert torch.allclose(share, torch.linspace(17.5 / 20 + 0.05, 1.5 / 20, 18), atol=0.04)


def test_a_surface_that_faces_the_light_is_brighter():
    vertices, faces = roof(1.0, side=2)
    above, below = (
        shade(vertices[None], faces[:, order], torch.full((9, 3), 0.5), view(elevation=tilt), floor=False)[0]
        for order, tilt in (((0, 1, 2), 0.6), ((2, 1, 0), -0.6))
    )
    background = torch.tensor(rgb(BACKGROUND))[:, None, None]
    brightness = [p[:, (p - background).abs().amax(0) > 0.05].mean() for p in (above, below)]
    assert brightness[0] > brightness[1] + 0.1


def roof(height: float, side: int = 30) -> tuple[torch.Tensor, torch.Tensor]:
    """A square metre of small faces that look up: the shadow takes every face for a point."""
    steps = torch.linspace(-0.5, 0.5, side + 1)
    z, x = torch.meshgrid(steps, steps, indexing="ij")
    vertices = torch.stack([x, torch.full_like(x, height), z], dim=-1).reshape(-1, 3)
    corner = (torch.arange(side)[:, None] * (side + 1) + torch.arange(side)).reshape(-1, 1)
    quad = corner + torch.tensor([0, side + 1, side + 2, 1])
    return vertices, torch.cat([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


def test_the_shadow_falls_on_the_floor_and_fades_with_height():
    def darkest(height):
        vertices, faces = roof(height)
        camera = view((80, 80), elevation=0.3)
        picture = shade(vertices[None], faces, torch.full((len(vertices), 3), 0.9), camera, Light(grid=100.0))[0]
        below = camera.project(vertices[None])[0, :, 1].max().ceil().long() + 1
        return float(torch.tensor(rgb(BACKGROUND)).mean() - picture[:, below:].mean(0).amin())

    assert darkest(0.5) > darkest(1.0) + 0.02 > 0.04


def test_a_camera_along_the_floor_sees_no_floor():
    picture = shade(wall(0.0)[None], FACES, torch.zeros(4, 3), view(elevation=0.0))[0]
    assert torch.allclose(picture[:, -1, -1], torch.tensor(rgb(BACKGROUND)))


def test_above_the_horizon_is_plain_background():
    camera = view((60, 60), elevation=0.02, kind="pinhole")
    picture = shade(wall(0.0)[None], FACES, torch.zeros(4, 3), camera)[0]
    assert picture.isfinite().all()
    assert torch.allclose(picture[:, 0, 0], torch.tensor(rgb(BACKGROUND)), atol=1e-5)


def test_a_vertex_between_parts_has_their_mean():
    colours = part_colours(FACES, torch.tensor([0, 2]), 4)
    one, other = torch.tensor(rgb(PARTS[0])), torch.tensor(rgb(PARTS[2]))
    assert torch.allclose(colours, torch.stack([(one + other) / 2, one, (one + other) / 2, other]))


def test_every_frame_has_its_own_camera():
    points = torch.tensor([[-3.0, 0.0, -1.0], [1.0, 2.0, 1.0]])
    cameras = cat([view(elevation=0.2), frame(points, (40, 40), yaw=0.7, elevation=0.5)])
    both = shade(wall(0.0).expand(2, 4, 3), FACES, torch.full((4, 3), 0.5), cameras)
    for index in range(2):
        alone = shade(wall(0.0)[None], FACES, torch.full((4, 3), 0.5), cameras[index : index + 1])[0]
        assert torch.allclose(both[index], alone, atol=1e-6)
    assert (both[0] - both[1]).abs().max() > 0.3


def test_a_camera_and_a_body_of_double_precision_are_drawn_alike():
    colours, camera = torch.full((4, 3), 0.5), view(elevation=0.3)
    single = shade(wall(0.0)[None], FACES, colours, camera)
    double = shade(wall(0.0)[None].double(), FACES, colours.double(), camera.to(dtype=torch.float64))
    assert double.dtype == torch.float32 and torch.allclose(double, single, atol=1e-5)
