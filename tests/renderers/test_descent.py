"""Places and poses found from silhouettes alone: the gradient leads there, also from where shapes do not overlap."""

from collections.abc import Callable
from functools import cache
from math import degrees, pi

import pytest
import torch
from torch import Tensor

from renderers.body import Body
from renderers.camera import Camera, frame
from renderers.mesh import Mesh
from renderers.poses import POSE_NAMES, sixteen_poses
from renderers.rotations import axis_angle_to_matrix, rotation_angle
from renderers.silhouette import blur, silhouette
from renderers.skeleton import JOINTS

SIZE = (64, 64)
YAWS = (0.0, pi / 2)  # what one view cannot see, such as depth or the sense of a turn, the other one does
ROOT = torch.tensor([[0.0, 0.95, 0.0]])


@cache
def light_body() -> Body:
    return Body.free("light")


@cache
def meshes() -> tuple[Mesh, Mesh]:
    """The body as one mesh, and in parts."""
    return Mesh.build(light_body().faces), Mesh.build(light_body().faces, light_body().face_parts)


def pose(name: str) -> Tensor:
    return sixteen_poses()[POSE_NAMES.index(name)][None]


def turned(rotations: Tensor, joint: str, turn: Tensor) -> Tensor:
    """Rotations [1 24 3 3] with ``turn`` [3] (axis-angle, in the parent's frame) put before a joint's own."""
    chosen = (torch.arange(24) == JOINTS[joint])[:, None, None]
    return torch.where(chosen, axis_angle_to_matrix(turn) @ rotations, rotations)


def cameras(yaws: tuple[float, ...]) -> list[Camera]:
    """Views of a cube of 3 metres about a standing body."""
    corners = ROOT + torch.cartesian_prod(*[torch.tensor([-1.5, 1.5])] * 3)
    return [frame(corners, SIZE, yaw=yaw, margin=0.0) for yaw in yaws]


def descend(
    vertices: Callable[[Tensor], Tensor], wanted: Tensor, mesh: Mesh, views: list[Camera], rate: float
) -> Tensor:
    """Parameters [3], begun at zero, at which ``vertices`` [1 V 3] have the silhouettes of the ``wanted`` ones."""
    steps = 80
    targets = [silhouette(wanted, mesh, view) for view in views]
    parameters = torch.zeros(3, requires_grad=True)
    optimiser = torch.optim.Adam([parameters], lr=rate)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.01 ** (1 / steps))
    for step in range(steps):
        sigma = 6 * 0.05 ** (step / steps)  # pixels: from more than a limb to less than a pixel
        images = [silhouette(vertices(parameters), mesh, view) for view in views]
        differences = [blur(image - target, sigma) for image, target in zip(images, targets, strict=True)]
        optimiser.zero_grad()
        sum(difference.square().sum() for difference in differences).backward()
        optimiser.step()
        schedule.step()
    return parameters.detach()


def recovered_turn(name: str, joint: str, turn: list[float], mesh: Mesh, yaws: tuple[float, ...], rate: float) -> float:
    """Degrees between the turn of a joint that is found from silhouettes and the true one."""

    def vertices(turn: Tensor) -> Tensor:
        return light_body()(turned(pose(name), joint, turn), ROOT).vertices

    wanted = torch.tensor(turn)
    found = descend(vertices, vertices(wanted), mesh, cameras(yaws), rate)
    missing = axis_angle_to_matrix(found).T @ axis_angle_to_matrix(wanted)
    return degrees(rotation_angle(missing))


@pytest.mark.parametrize("shift", [[0.6, -0.2, 0.7], [-0.7, 0.2, -0.6]])
def test_a_place_is_found_to_two_millimetres_from_where_nothing_overlaps(shift):
    def vertices(shift: Tensor) -> Tensor:
        return light_body()(pose("standing"), ROOT + shift).vertices

    wanted = torch.tensor(shift)
    for view in cameras(YAWS):
        here, there = (silhouette(vertices(at), meshes()[0], view) for at in (torch.zeros(3), wanted))
        assert torch.minimum(here, there).sum() < 0.02 * here.sum()
    found = descend(vertices, vertices(wanted), meshes()[0], cameras(YAWS), rate=0.1)
    assert (found - wanted).norm() < 0.002


@pytest.mark.parametrize("apart", [False, True], ids=["plain", "parts"])
@pytest.mark.parametrize("name", ["hands on hips", "waving"])
@pytest.mark.parametrize("turn", [[0.0, 0.5, 0.6], [-0.4, 0.2, -0.5]])
def test_an_arm_is_found_to_half_a_degree(name, turn, apart):
    # The elbows are bent: silhouettes do not tell how a straight arm is twisted about itself.
    assert degrees(torch.tensor(turn).norm().item()) > 35
    assert recovered_turn(name, "left_shoulder", turn, meshes()[apart], YAWS, rate=0.2) < 0.5


def test_an_arm_before_the_trunk_is_found_from_one_view_of_parts_and_lost_in_a_plain_one():
    plain, parts = (
        recovered_turn("arms crossed", "left_shoulder", [-0.4, 0.2, -0.5], mesh, (0.0,), rate=0.1) for mesh in meshes()
    )
    assert parts < 0.5 and plain > 5


@pytest.mark.parametrize("name", ["stride", "kicking"])
@pytest.mark.parametrize("turn", [[0.0, 0.9, 0.0], [0.3, -0.6, 0.2]])
def test_a_turn_of_the_whole_body_is_found_to_half_a_degree(name, turn):
    assert degrees(torch.tensor(turn).norm().item()) > 40
    assert recovered_turn(name, "pelvis", turn, meshes()[0], YAWS, rate=0.1) < 0.5


def test_depth_pulls_in_the_side_view_alone():
    root = ROOT.clone().requires_grad_()
    vertices, away = light_body()(pose("standing"), root).vertices, torch.tensor([0.0, 0.0, 0.3])
    pulls = []
    for view in cameras(YAWS):
        difference = silhouette(vertices, meshes()[0], view) - silhouette(vertices.detach() + away, meshes()[0], view)
        loss = blur(difference, 6.0).square().sum()
        pulls.append(torch.autograd.grad(loss, root, retain_graph=True)[0][0, 2].item())
    front, side = pulls
    assert side < -1 and abs(front) < 0.02 * abs(side)
