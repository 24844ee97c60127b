"""Mitsuba 3's meshes and cameras out of ours: the one file that knows them (`mi.Mesh` is another one from 3.10 on).

Mitsuba looks along z with y up, so that its x runs to the left of the picture; its film knows square pixels only, and
its perspective camera refuses scales. What is missing is given by the vertices: `square` stretches them until a camera
with two focal lengths sees them as one with a single focal length would.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from math import atan, degrees
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from renderers.camera import NEAR, Camera
from renderers.checks import UserError, check_shapes

SCALAR, LLVM = "scalar_rgb", "llvm_ad_rgb"
Crop = tuple[int, int, int, int]
IN_FRONT = 1.0  # metres between a weak-perspective camera and the nearest vertex


@contextmanager
def using(variant: str = SCALAR) -> Iterator[ModuleType]:
    """``mitsuba`` in a variant; what is made in the block is used in the block.

    A variant that the host program had chosen is chosen again afterwards. If there was none, ours stays: Mitsuba knows
    no way back.
    """
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant(variant)
    try:
        yield mi
    finally:
        if before is not None:
            mi.set_variant(before)


def mesh(
    vertices: Tensor,
    faces: Tensor,
    bsdf: dict[str, Any] | None = None,
    emitter: dict[str, Any] | None = None,
    colours: Tensor | None = None,
    smooth: bool = False,
) -> Any:
    """A `mi.Mesh` of the current variant, to be given to ``mi.load_dict`` as a part of a scene.

    Args:
        vertices: [V 3] world, metres.
        faces: [F 3].
        bsdf: of its surface, as ``mi.load_dict`` takes it; grey and diffuse when None. A texture
            ``{"type": "mesh_attribute", "name": "vertex_color"}`` shows ``colours``.
        emitter: makes it a lamp, as ``mi.load_dict`` takes it.
        colours: [V 3] linear RGB.
        smooth: shade by normals averaged at the vertices, which follow the vertices when they move.

    Raises:
        UserError: shapes that do not fit, or faces that name vertices which are not there.
    """
    import mitsuba as mi

    check_shapes("mitsuba_scene.mesh", vertices=(vertices, "V 3"), faces=(faces, "F 3"))
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise UserError("mitsuba_scene.mesh", f"faces name other than the {len(vertices)} vertices", "check the mesh")
    properties = mi.Properties()
    for name, plugin in (("bsdf", bsdf), ("emitter", emitter)):
        if plugin is not None:
            properties[name] = mi.load_dict(plugin)
    made = mi.Mesh("mesh", len(vertices), len(faces), props=properties, has_vertex_normals=smooth)
    if colours is not None:
        check_shapes("mitsuba_scene.mesh", {"V": len(vertices)}, colours=(colours, "V 3"))
        made.add_attribute("vertex_color", 3, _flat(colours))
    parameters = mi.traverse(made)
    parameters["faces"] = _flat(faces, torch.int32)
    parameters["vertex_positions"] = _flat(vertices)
    parameters.update()
    return made


def move(parameters: Any, name: str, vertices: Tensor) -> None:
    """Give the mesh ``name`` of a scene other vertices [V 3]; ``parameters`` are ``mi.traverse(scene)``."""
    parameters[f"{name}.vertex_positions"] = _flat(vertices)
    parameters.update()


def square(vertices: Tensor, camera: Camera) -> Tensor:
    """World vertices [N V 3] stretched along the cameras' y, so that ``focal[:, 0]`` is right for it as well."""
    stretch = camera.focal[:, 1] / camera.focal[:, 0]
    if (stretch == 1).all():
        return vertices
    seen = vertices @ camera.rotation.mT + camera.translation[:, None]
    taller = torch.stack([seen[..., 0], seen[..., 1] * stretch[:, None], seen[..., 2]], dim=-1)
    return (taller - camera.translation[:, None]) @ camera.rotation


def sensor(camera: Camera, vertices: Tensor, samples: int, filter: str = "box", crop: Crop | None = None) -> Any:
    """The first of the cameras as a `mi.Sensor` of the current variant, for vertices that went through `square`.

    The film is float32 RGBA; under its box filter a pixel is the mean of the samples in it, which are stratified.

    Args:
        vertices: [V 3] world, metres: a weak-perspective camera stands before all of them.
        samples: a pixel, stratified; a number that has no two like factors is rounded up, which is said.
        filter: Mitsuba's name of the film's filter; "gaussian" looks better, and is no area.
        crop: (top, left, height, width) of the only pixels to render.
    """
    import mitsuba as mi

    height, width = camera.size
    top, left, rows, columns = crop or (0, 0, height, width)
    rotation, eye = camera.rotation[0].double().cpu(), camera.translation[0].double().cpu()
    (focal, _), (x, y) = camera.focal[0].tolist(), camera.centre[0].tolist()
    right, down = width / 2 - x, height / 2 - y  # from the optical axis to the middle of the picture, in pixels
    to_world = torch.eye(4, dtype=torch.float64)
    to_world[:3, :3] = rotation.T @ torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    if camera.kind == "pinhole":
        place = torch.zeros(3, dtype=torch.float64)
        kind = {
            "type": "perspective",
            "fov": degrees(2 * atan(width / (2 * focal))),
            "fov_axis": "x",
            "principal_point_offset_x": right / width,
            "principal_point_offset_y": down / height,
        }
    else:
        depth = (vertices.detach().double().cpu() @ rotation.T + eye)[:, 2].min().item()
        place = torch.tensor([right / focal, down / focal, depth - IN_FRONT - NEAR], dtype=torch.float64)
        to_world[:3, :2] *= width / (2 * focal)
        kind = {"type": "orthographic"}
    to_world[:3, 3] = rotation.T @ (place - eye)
    return mi.load_dict(
        {
            **kind,
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "near_clip": NEAR,
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "crop_offset_x": left,
                "crop_offset_y": top,
                "crop_width": columns,
                "crop_height": rows,
                "pixel_format": "rgba",
                "component_format": "float32",
                "rfilter": {"type": filter},
                "sample_border": True,
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )


def _flat(values: Tensor, dtype: torch.dtype = torch.float32) -> Any:
    return values.detach().to("cpu", dtype).reshape(-1).numpy()
