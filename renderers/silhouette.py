"""Differentiable silhouettes of posed meshes: the public entry to the rasterisers."""

from math import ceil, inf
from typing import Literal

import torch
from torch import Tensor

from renderers import raster_fold, raster_reference
from renderers.camera import NEAR, Camera
from renderers.checks import UserError, check_finite, check_shapes
from renderers.mesh import Mesh
from renderers.near import clip

BACKENDS = {"fold": raster_fold.coverage, "reference": raster_reference.coverage}


def silhouette(
    vertices: Tensor,
    mesh: Mesh,
    camera: Camera,
    subscanlines: int = 4,
    backend: Literal["fold", "reference"] = "fold",
) -> Tensor:
    """How much of each pixel the mesh covers, with gradients to the vertices.

    A mesh with parts gives one image per part, and a part hides nothing of another: an arm before the trunk stays
    visible, and movable, in its own channel.

    The same input gives the same bits, for image and gradient: what is summed in no fixed order is summed in whole
    numbers. On CUDA that ends where other operations begin, as `blur`, whose gradient cuDNN may sum in any order:
    ``torch.use_deterministic_algorithms(True)`` is the switch, and refuses nothing here.

    Args:
        vertices: [N V 3] world, metres, float32 or float64. What lies behind `NEAR` of a pinhole camera is clipped,
            frame by frame: slow, where a batch has such frames.
        camera: one for all N, or N.
        subscanlines: scans per pixel in either direction. A body at 64 px is off by 8e-5 a pixel with 4, 2.4e-5 with 8.
        backend: "fold" is fast; "reference" is the plain specification it is compared with.

    Returns:
        [N C H W] in 0..1. Pixels that the outline does not touch are exactly 0 or 1 and carry no gradient; `blur` both
        images of a comparison to let them pull at each other from farther away.

    Raises:
        UserError: shapes, dtypes or vertex numbers that do not fit, or values that are not finite.
    """
    check_shapes("silhouette", vertices=(vertices, "N V 3"))
    if vertices.dtype not in (torch.float32, torch.float64):
        raise UserError("silhouette(vertices)", f"expected float32 or float64, got {vertices.dtype}")
    if vertices.shape[1] < mesh.vertices:
        raise UserError("silhouette", f"the faces name {mesh.vertices} vertices, got {vertices.shape[1]}")
    if subscanlines < 1:
        raise UserError("silhouette(subscanlines)", f"expected at least 1, got {subscanlines}")
    check_finite("silhouette(vertices)", vertices, "frame vertex coordinate")
    camera = camera.to(vertices.device, vertices.dtype)
    coverage, seen = BACKENDS[backend], camera.view(vertices)
    if camera.kind == "weak" or (seen[..., 2] >= NEAR).all():
        return coverage(camera.pixels(seen), mesh, camera.size, subscanlines)
    images = []
    for frame, points in enumerate(seen):
        points, clipped = clip(points, mesh, NEAR)
        own = camera if len(camera) == 1 else camera[frame : frame + 1]
        images.append(coverage(own.pixels(points[None]), clipped, camera.size, subscanlines))
    return torch.cat(images)


def blur(images: Tensor, sigma: float) -> Tensor:
    """Images [N C H W] blurred by a Gaussian of ``sigma`` pixels, 0 for none; beyond the border there is background.

    Blurred, both images of a comparison pull at each other from about 3 ``sigma`` away.

    Raises:
        UserError: for a sigma that is negative or not finite.
    """
    from kornia.filters import gaussian_blur2d

    check_shapes("blur", images=(images, "N C H W"))
    if not 0 <= sigma < inf:
        raise UserError("blur(sigma)", f"expected 0 or more pixels, got {sigma}")
    if sigma == 0:
        return images
    reach = 2 * ceil(3 * sigma) + 1
    return gaussian_blur2d(images, (reach, reach), (sigma, sigma), border_type="constant")
