"""The topology of a triangle mesh, worked out once: which faces meet at which edge.

Nothing is asked of the mesh: it may be open, non-manifold, self-intersecting, of several pieces, or oriented anyhow.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from renderers.checks import UserError, check_shapes

LIMITS = {"faces": 2**26, "parts": 2**10}  # vertex and part numbers: an edge is named by two and one in 62 bits


@dataclass(frozen=True)
class Mesh:
    """Faces with their edges; build it with `Mesh.build` and keep it for as long as the faces stay the same.

    Every face goes round its three edges once, and passes each of them upwards (from the lower vertex number to the
    higher) or downwards. An edge belongs to one channel: where two parts meet, each has an edge of its own.
    """

    faces: Tensor  # [F 3] vertex numbers
    face_channels: Tensor  # [F] the channel that a face is drawn in
    edges: Tensor  # [E 2] vertex numbers, the lower one first
    edge_channels: Tensor  # [E]
    edge_faces: Tensor  # [E K] passages along the edge: f passes upwards, F + f downwards, 2 F fills up to K
    channels: int
    vertices: int  # the least number of vertices that the faces need

    @classmethod
    def build(cls, faces: Tensor, parts: Tensor | None = None, channels: int = 1) -> "Mesh":
        """The mesh of ``faces`` [F 3]; with ``parts`` [F] (0, 1, ...) every part becomes a channel of its own.

        There are at least ``channels`` of them, also where faces are missing.

        Raises:
            UserError: for numbers of vertices or parts that are not whole, negative, or beyond `LIMITS`.
        """
        parts = faces.new_zeros(len(faces)) if parts is None else parts
        check_shapes("Mesh.build", faces=(faces, "F 3"), parts=(parts, "F"))
        for name, numbers in (("faces", faces), ("parts", parts)):
            if numbers.is_floating_point() or (numbers < 0).any() or (numbers.long() >= LIMITS[name]).any():
                raise UserError(
                    f"Mesh.build({name})", f"expected whole numbers, 0 to below {LIMITS[name]}", "check them"
                )
        faces, parts = faces.long(), parts.long()
        vertices = int(faces.max()) + 1 if len(faces) else 0

        start, end = faces.flatten(), faces.roll(-1, dims=1).flatten()
        low, high = torch.minimum(start, end), torch.maximum(start, end)
        stride = max(vertices, 1)
        keys = (parts.repeat_interleave(3) * stride + low) * stride + high
        keys, edge, passages = torch.unique(keys, return_inverse=True, return_counts=True)

        by_edge = edge.argsort(stable=True)
        rank = torch.arange(len(edge), device=faces.device) - (passages.cumsum(0) - passages)[edge[by_edge]]
        passing = torch.arange(len(edge), device=faces.device) // 3 + len(faces) * (start > end)
        fan = int(passages.max()) if len(faces) else 1
        edge_faces = faces.new_full((len(keys), fan), 2 * len(faces))
        edge_faces[edge[by_edge], rank] = passing[by_edge]
        return cls(
            faces=faces,
            face_channels=parts,
            edges=torch.stack([keys // stride % stride, keys % stride], dim=1),
            edge_channels=keys // stride**2,
            edge_faces=edge_faces,
            channels=max(channels, int(parts.max()) + 1 if len(faces) else 0),
            vertices=vertices,
        )

    def to(self, device: torch.device | str) -> "Mesh":
        moved = {field.name: getattr(self, field.name) for field in fields(self)}
        return Mesh(**{name: value.to(device) if isinstance(value, Tensor) else value for name, value in moved.items()})
