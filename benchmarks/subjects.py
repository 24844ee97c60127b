"""What renderers are measured on: sixteen poses of three closed bodies, and small motions to differentiate along."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from renderers.body import Body
from renderers.camera import Camera, cat, frame
from renderers.poses import sixteen_poses
from renderers.rotations import rotation_about
from renderers.skeleton import JOINTS

BODIES = ("light", "6890", "full")
FRAMES = 16
SMPL_FACES = 13_776
ANGLE = 1e-3  # radians either way, for the arm's derivative


@dataclass(frozen=True)
class Subject:
    """A body in sixteen poses."""

    vertices: Tensor  # [16 V 3] world, metres
    faces: Tensor  # [F 3]
    parts: Tensor  # [F] 0..5
    arm: Tensor  # [16 V 3] how the vertices move when the left arm turns about its shoulder, metres per radian

    def cameras(self, side: int) -> Camera:
        """A pinhole camera for each pose, which fills 80 % of a square picture with it."""
        return cat([frame(vertices, (side, side), yaw=0.4, kind="pinhole") for vertices in self.vertices])


@cache
def subject(name: str) -> Subject:
    """The free bodies, and "6890": the full one decimated to the size of SMPL's mesh, of which no file is needed."""
    body = Body.free("light" if name == "light" else "full")
    vertices, arm = posed(body)
    faces, parts = body.faces, body.face_parts
    if name == "6890":
        corners, shares, near, faces = decimate(body.rest_vertices, faces, SMPL_FACES)
        vertices, arm = ((values[:, corners] * shares[:, :, None]).sum(2) for values in (vertices, arm))
        parts = parts[near[faces]].mode(1).values
    return Subject(vertices, faces, parts, arm)


@torch.no_grad()
def posed(body: Body) -> tuple[Tensor, Tensor]:
    """Vertices [16 V 3], and their derivatives by the angle of the left shoulder about z."""
    rotations, root = sixteen_poses(), torch.zeros(FRAMES, 3)
    turned = []
    for angle in (ANGLE, -ANGLE):
        moved, shoulder = rotations.clone(), JOINTS["left_shoulder"]
        moved[:, shoulder] = rotation_about("z", torch.tensor(angle)) @ moved[:, shoulder]
        turned.append(body.double()(moved.double(), root.double()).vertices)
    return body.float()(rotations, root).vertices, ((turned[0] - turned[1]) / (2 * ANGLE)).float()


def decimate(rest: Tensor, faces: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Quadric decimation to ``count`` faces, whose vertices follow the surface that they came from.

    Returns:
        corners [P 3] and shares [P 3] of the triangles that the new vertices lie on, those triangles [P], and the new
        faces [count 3].
    """
    import fast_simplification

    points, fewer = fast_simplification.simplify(
        rest.numpy(), faces.numpy().astype(np.int32), target_count=count, agg=3
    )
    near, shares = zip(
        *(nearest(some, rest[faces]) for some in torch.from_numpy(points).float().split(1000)), strict=True
    )
    near = torch.cat(near)
    return faces[near], torch.cat(shares), near, torch.from_numpy(fewer).long()


def nearest(points: Tensor, triangles: Tensor, candidates: int = 16) -> tuple[Tensor, Tensor]:
    """Which of triangles [F 3 3] each of points [P 3] is nearest to [P], and barycentric shares of its corners [P 3].

    Sought among the triangles with the nearest centres; a share below 0 becomes 0, which is nearly the nearest point.
    """
    near = torch.cdist(points, triangles.mean(1)).topk(candidates, largest=False).indices
    a, b, c = triangles[near].unbind(2)
    frame = torch.stack([b - a, c - a], dim=-1).double()
    second, third = (torch.linalg.pinv(frame) @ (points[:, None] - a)[..., None].double())[..., 0].unbind(-1)
    shares = torch.stack([1 - second - third, second, third], dim=-1).clamp(min=0).float()
    shares = shares / shares.sum(-1, keepdim=True)
    distance = ((shares[..., None] * triangles[near]).sum(2) - points[:, None]).norm(dim=-1)
    rows, best = torch.arange(len(points)), distance.argmin(1)
    return near[rows, best], shares[rows, best]


def motions(subject: Subject, fields: int = 4) -> dict[str, list[Tensor]]:
    """World displacements [16 V 3] of each kind; the largest in a frame would move by one pixel at 64 px."""
    vertices, camera = subject.vertices.double(), subject.cameras(64).to(dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    smooth = []
    for _ in range(fields):
        waves, amplitude = torch.randn(2, 6, 3, generator=generator, dtype=torch.float64)
        phase = 6.2832 * torch.rand(6, generator=generator, dtype=torch.float64)
        smooth.append((vertices @ (3 * waves).T + phase).sin() @ amplitude)
    kinds = {
        "shift x": [camera.rotation[:, :1].expand_as(vertices)],
        "shift y": [camera.rotation[:, 1:2].expand_as(vertices)],
        "scale": [vertices - vertices.mean(1, keepdim=True)],
        "arm": [subject.arm.double()],
        "smooth": smooth,
    }

    def per_pixel(field: Tensor) -> Tensor:
        there, back = (camera.project(vertices + way * 1e-5 * field) for way in (1, -1))
        pixels = (there - back).norm(dim=-1).amax(1) / 2e-5
        return field / pixels[:, None, None]

    return {kind: [per_pixel(field) for field in chosen] for kind, chosen in kinds.items()}
