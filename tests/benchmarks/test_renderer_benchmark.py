"""What the renderer's benchmark measures with: exponents, peak memory, stages of a step, subjects, peers' cameras."""

import importlib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import torch

from renderers.camera import frame

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
MIB = 2**20


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))

    def load(name: str) -> ModuleType:
        return importlib.import_module(name)

    return load


def test_the_exponent_of_a_power_law_is_its_power(load):
    sizes = [1, 10, 40, 70]
    assert load("renderer").exponent(sizes, [3 * size**1.5 for size in sizes]) == pytest.approx(1.5)


def test_the_peak_is_what_is_held_at_once_and_counts_nothing_from_before(load):
    before = torch.zeros(8 * MIB, dtype=torch.uint8)

    def one_after_the_other():
        first = torch.zeros(3 * MIB, dtype=torch.uint8)
        del first
        torch.zeros(2 * MIB, dtype=torch.uint8)

    def together():
        first = torch.zeros(3 * MIB, dtype=torch.uint8)
        return first, torch.zeros(2 * MIB, dtype=torch.uint8)

    peak_bytes = load("renderer").peak_bytes
    assert peak_bytes(one_after_the_other) == pytest.approx(3 * MIB, rel=0.01)
    assert peak_bytes(together) == pytest.approx(5 * MIB, rel=0.01)
    assert len(before) == 8 * MIB


class Work(torch.autograd.Function):
    """Lets a clock run on, forward and again backward."""

    @staticmethod
    def forward(ctx, values, clock, seconds, seconds_back):
        ctx.clock, ctx.seconds = clock, seconds_back
        clock.now += seconds
        return values.clone()

    @staticmethod
    def backward(ctx, gradient):
        ctx.clock.now += ctx.seconds
        return gradient, None, None, None


def test_a_stage_has_its_own_forward_and_backward_and_not_those_of_stages_inside_or_outside(load, monkeypatch):
    clock = SimpleNamespace(now=0.0, perf_counter=lambda: clock.now)
    monkeypatch.setattr(load("stages"), "time", clock)
    stages = load("stages").Stages()
    inner = stages.wrap("inner", lambda values: Work.apply(values, clock, 2.0, 50.0))
    outer = stages.wrap("outer", lambda values: inner(Work.apply(values, clock, 4.0, 10.0)))
    values = torch.ones(2, requires_grad=True)
    result = outer(Work.apply(values, clock, 3.0, 20.0)).sum()
    forward = clock.now
    result.backward()
    found = stages.seconds(forward, clock.now - forward)
    assert found == {"inner": (2.0, 50.0), "outer": (4.0, 10.0), "rest": (3.0, 20.0)}


def test_a_point_of_a_triangle_is_found_again_by_its_shares(load, generator):
    triangles = torch.rand(40, 3, 3, generator=generator)
    shares = torch.rand(40, 3, generator=generator)
    shares = shares / shares.sum(1, keepdim=True)
    points = (shares[..., None] * triangles).sum(1)
    near, found = load("subjects").nearest(points, triangles, candidates=40)
    assert torch.allclose((found[..., None] * triangles[near]).sum(1), points, atol=1e-5)
    assert (found >= 0).all()


def test_motions_move_one_vertex_of_each_frame_by_a_pixel_at_64_px_and_none_by_more(load):
    subjects = load("subjects")
    subject = subjects.subject("light")
    camera = subject.cameras(64).to(dtype=torch.float64)
    for kind, fields in subjects.motions(subject, fields=1).items():
        there, here = (camera.project(subject.vertices + step * fields[0]) for step in (1e-4, 0.0))
        moved = (there - here).norm(dim=-1) / 1e-4
        assert torch.allclose(moved.amax(1), torch.ones(16).double(), atol=1e-2), kind


def test_shifts_go_right_and_down_in_the_picture(load):
    subjects = load("subjects")
    subject = subjects.subject("light")
    camera, vertices = subject.cameras(64).to(dtype=torch.float64), subject.vertices.double()
    motions = subjects.motions(subject, fields=1)
    for axis, kind in enumerate(("shift x", "shift y")):
        moved = camera.project(vertices + motions[kind][0]) - camera.project(vertices)
        assert (moved[..., axis] > 0.4).all() and moved[..., 1 - axis].abs().max() < 1e-4


def test_clip_coordinates_are_the_camera_s_pixels_with_nearer_points_before_others(load, generator):
    points = torch.randn(1, 50, 3, generator=generator)
    camera = frame(points, (48, 80), yaw=0.4, kind="pinhole")
    clip = load("peers").clip_coordinates(points, camera)
    plane = clip[..., :3] / clip[..., 3:]
    pixels = (plane[..., :2] + 1) / 2 * torch.tensor([80.0, 48.0])
    assert torch.allclose(pixels, camera.project(points), atol=1e-3)
    assert (plane[..., 2].abs() < 1).all()
    assert torch.equal(plane[..., 2].argsort(), camera.view(points)[..., 2].argsort())


def test_a_picture_half_as_bright_has_the_errors_that_one_can_say_in_advance(load):
    accuracy, peers = load("accuracy"), load("peers")

    class Faint(peers.Renderer):
        def draw(self, vertices):
            return vertices[:, 0, :1, None].expand(-1, 4, 4) / 2

    vertices = torch.ones(2, 1, 3)
    exact = {4: torch.ones(2, 4, 4, dtype=torch.float64)}
    motion = torch.ones(2, 1, 3, dtype=torch.float64)
    # The gradient of 16 (x / 2 - 1)² at x = 1 is -8; the truth is said to be -10.
    truth = accuracy.Truth(vertices, {"grow": [motion]}, exact, {4: {"grow": torch.full((2, 1), -10.0).double()}})
    found = accuracy.errors(Faint(None, None), truth, 4, "cpu")
    assert found["mean error"] == pytest.approx(0.5)
    assert found["soft IoU"] == pytest.approx(0.5)
    assert found["IoU"] == 0
    assert found["gradient"]["grow"] == {"error": pytest.approx(0.2), "sign": 1.0}
