"""Clipping at the near plane: what a pinhole camera sees of a mesh that reaches behind it."""

import torch
from torch import Tensor

from renderers.mesh import Mesh


def clip(points: Tensor, mesh: Mesh, near: float) -> tuple[Tensor, Mesh]:
    """The part of one posed mesh that lies at least ``near`` in front of the camera.

    Faces that the plane cuts are replaced by the triangles in front of it. Neighbours share their new vertices, so a
    closed mesh is open at the cut alone. The new mesh is as many channels deep, and may have no faces.

    Args:
        points: [V 3] in camera axes (z forward), metres.

    Returns:
        points [V' 3], differentiable in ``points``, and the mesh of their faces.
    """
    faces, before = mesh.faces, points[:, 2] >= near
    count = before[faces].sum(1)
    if before.all():
        return points, mesh
    one, two = _turned(faces, before, count == 1), _turned(faces, ~before, count == 2)

    # A cut edge is named by both its ends, whichever face asks.
    cuts = torch.cat([one[:, [0, 1]], one[:, [0, 2]], two[:, [0, 1]], two[:, [0, 2]]])
    ends, cut = torch.unique(cuts.sort(dim=1).values, dim=0, return_inverse=True)
    low, high = points[ends].unbind(1)
    weight = (near - low[:, 2:]) / (high[:, 2:] - low[:, 2:])
    one_next, one_last, two_next, two_last = (len(points) + cut).split([len(one)] * 2 + [len(two)] * 2)
    pieces = torch.cat(
        [
            faces[count == 3],
            torch.stack([one[:, 0], one_next, one_last], dim=1),
            torch.stack([two_next, two[:, 1], two[:, 2]], dim=1),
            torch.stack([two_next, two[:, 2], two_last], dim=1),
        ]
    )
    parts = mesh.face_channels
    parts = torch.cat([parts[count == 3], parts[count == 1], parts[count == 2], parts[count == 2]])

    # Vertices behind the camera have no place in the image: they are left out, not only unused.
    used, pieces = torch.unique(pieces, return_inverse=True)
    points = torch.cat([points, torch.lerp(low, high, weight)])[used]
    return points, Mesh.build(pieces, parts, mesh.channels)


def _turned(faces: Tensor, alone: Tensor, chosen: Tensor) -> Tensor:
    """The ``chosen`` faces [K 3], each turned so that the only corner that is ``alone`` [V] comes first."""
    faces = faces[chosen]
    first = alone[faces].long().argmax(1, keepdim=True)
    return faces.gather(1, (first + torch.arange(3, device=faces.device)) % 3)
