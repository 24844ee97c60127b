"""Differentiable silhouettes of posed meshes: the public entry to the rasterisers."""

from collections.abc import Callable
from math import ceil, inf
from typing import Literal

import torch
from torch import Tensor

from renderers import raster_fold, raster_reference
from renderers.camera import NEAR, Camera
from renderers.checks import UserError, check_finite, check_known, check_shapes
from renderers.mesh import Mesh
from renderers.near import clip

FAR = 1e15  # metres, and pixels: beyond, the areas of faces would overflow
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

    The same input gives the same bits, for image and gradient: areas are sums of whole numbers, and the gradient's sums
    are left to ``index_put_``, which keeps their order. On CUDA that ends where other operations begin, as `blur`,
    whose gradient cuDNN may sum in any order: ``torch.use_deterministic_algorithms(True)`` is the switch, and refuses
    nothing here.

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
        UserError: shapes, dtypes, vertex numbers, cameras or backends that do not fit, values that are not finite or
            farther than `FAR`, fewer than one scan; in the backward pass, if a second derivative is asked for.
    """
    check_shapes("silhouette", vertices=(vertices, "N V 3"))
    if vertices.dtype not in (torch.float32, torch.float64):
        raise UserError("silhouette(vertices)", f"expected float32 or float64, got {vertices.dtype}")
    if vertices.shape[1] < mesh.vertices:
        raise UserError("silhouette", f"the faces name {mesh.vertices} vertices, got {vertices.shape[1]}")
    if not isinstance(subscanlines, int) or subscanlines < 1:
        raise UserError("silhouette(subscanlines)", f"expected a whole number of at least 1, got {subscanlines}")
    check_known("silhouette(backend)", backend, BACKENDS)
    check_finite("silhouette(vertices)", vertices, "frame vertex coordinate")
    camera = camera.to(vertices.device, vertices.dtype)
    with torch.autocast(vertices.device.type, enabled=False):  # bfloat16 projects to a tenth of a pixel
        return _draw(vertices, mesh, camera, lambda *given: BACKENDS[backend](*given, camera.size, subscanlines))


def _draw(vertices: Tensor, mesh: Mesh, camera: Camera, coverage: Callable[[Tensor, Mesh], Tensor]) -> Tensor:
    seen = camera.view(vertices)
    _check_far("axes of the camera", seen)
    if camera.kind == "weak" or (seen[..., 2] >= NEAR).all():
        return coverage(_check_far("image", camera.pixels(seen)), mesh)
    images = []
    for frame, points in enumerate(seen):
        points, clipped = clip(points, mesh, NEAR)
        own = camera if len(camera) == 1 else camera[frame : frame + 1]
        images.append(coverage(_check_far("image", own.pixels(points[None])), clipped))
    return torch.cat(images)


def _check_far(where: str, points: Tensor) -> Tensor:
    if not (points.abs() < FAR).all():
        raise UserError("silhouette", f"in the {where}, a vertex is not finite or beyond {FAR:g}", "check the camera")
    return points


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
