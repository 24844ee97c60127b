"""The judge: the same silhouettes by sampling rays in Mitsuba 3, and their gradients by its projective integrator.

Nothing is shared with the rasterisers but the faces: world vertices and a camera go in, so that projection, clipping
and the conventions of the image are judged as well. To compare with, not to optimise with: a picture has the noise of
its samples, and takes a hundred times as long.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from glob import glob
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor

from renderers import mitsuba_scene
from renderers.camera import Camera
from renderers.checks import UserError, check_finite, check_shapes
from renderers.mesh import Mesh
from renderers.mitsuba_scene import LLVM, Crop, move, sensor, square, using

FEW = 4  # samples a pixel that find where in the picture a mesh is
MARGIN = 4  # pixels around what they find
AFAR = 1000.0  # metres from which a pinhole camera sees what a weak-perspective one sees
LIBRARIES = (
    f"{sys.prefix}/lib/libLLVM[.-]*",
    "/usr/lib/*/libLLVM[.-]*",
    "/usr/lib*/libLLVM[.-]*",
    "/usr/lib/llvm*/lib/libLLVM[.-]*",
    "/usr/local/lib/libLLVM[.-]*",
    "/usr/local/opt/llvm*/lib/libLLVM[.-]*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM[.-]*",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
)
REMEDY = "install LLVM 19, or name its library in DRJIT_LIBLLVM_PATH"


def silhouette(vertices: Tensor, mesh: Mesh, camera: Camera, samples: int = 256, seed: int = 0) -> Tensor:
    """How much of each pixel the mesh covers, as `renderers.silhouette.silhouette` has it; without gradients.

    The same arguments give the same bits. What lies nearer than `NEAR` to a pinhole camera is not seen.

    Args:
        vertices: [N V 3] world, metres; read in float32.
        camera: one for all N, or N.
        samples: rays a pixel, stratified; square numbers serve best. A pixel on the outline is off by .004 with 256.
        seed: of the rays; another seed gives other errors.

    Returns:
        [N C H W] in 0..1, whole multiples of one ray, of as many as Mitsuba rounds ``samples`` up to.

    Raises:
        UserError: shapes, vertex numbers, cameras, samples or seeds that do not fit, or values that are not finite.
    """
    if samples < 1 or not 0 <= seed < 2**32:
        raise UserError(
            "raster_mitsuba", f"expected samples of 1 or more and a seed below 2**32, got {samples}, {seed}"
        )
    frames, cameras = _frames(vertices, mesh, camera)
    images = torch.zeros(len(frames), mesh.channels, *camera.size)
    with using() as mi:
        for channel, faces in _channels(mesh):
            body = mitsuba_scene.mesh(frames[0], faces)
            scene = mi.load_dict({"type": "scene", "integrator": {"type": "depth"}, "body": body})
            parameters = mi.traverse(scene)
            for image, points, own in zip(images[:, channel], frames, cameras, strict=True):
                move(parameters, "body", points)
                top, left, height, width = crop = _where(_alpha(mi, scene, sensor(own, points, FEW), seed))
                seen = _alpha(mi, scene, sensor(own, points, samples, crop=crop), seed)
                image[top : top + height, left : left + width] = seen
    return images.to(vertices)


def gradient(
    vertices: Tensor,
    mesh: Mesh,
    camera: Camera,
    cotangent: Tensor,
    samples: int = 256,
    seed: int = 0,
    llvm: Path | None = None,
) -> Tensor:
    """The gradient [N V 3] of ``(silhouette * cotangent).sum()``, from samples of the outline.

    It is worked out in a process of its own: some LLVMs end the process that they run in. The faces of a body must be
    oriented alike, outwards or inwards, and in front of the camera, as the integrator knows no near plane. It knows
    pinhole cameras alone: one that stands a kilometre away takes the place of a weak-perspective one.

    Args:
        cotangent: [N C H W].
        samples: of the outline, for each pixel of the picture.
        seed: of the samples.
        llvm: the library, that of `find_llvm` when None.

    Raises:
        UserError: no LLVM that works was found, or the given one does not.
    """
    height, width = camera.size
    check_shapes("gradient", vertices=(vertices, "N V 3"), cotangent=(cotangent, f"N {mesh.channels} {height} {width}"))
    llvm = llvm or find_llvm()
    if llvm is None:
        raise UserError("gradient", "there is no LLVM that Mitsuba's projective integrator runs with", REMEDY)
    with torch.enable_grad():
        moved = vertices.detach().requires_grad_()
        frames, cameras = _frames(moved, mesh, camera)
    pinholes = [_from_afar(own, points) for own, points in zip(cameras, frames.detach(), strict=True)]
    asked = {
        "vertices": frames.detach(),
        "faces": mesh.faces.cpu(),
        "parts": mesh.face_channels.cpu(),
        "cotangent": cotangent.detach().cpu(),
        "samples": samples,
        "seed": seed,
        **{name: torch.cat([getattr(own, name) for own in pinholes]) for name in _PLACED},
    }
    with TemporaryDirectory() as folder:
        np.savez(Path(folder) / "asked.npz", **asked)
        path = os.pathsep.join(map(os.path.abspath, sys.path))
        done = subprocess.run(
            [sys.executable, "-m", "renderers.raster_mitsuba", folder],
            cwd=folder,  # takes the core that an abort may leave
            env={**os.environ, "DRJIT_LIBLLVM_PATH": str(llvm), "PYTHONPATH": path},
            capture_output=True,
        )
        if done.returncode:
            raise UserError(llvm, "Mitsuba's projective integrator does not run with this LLVM", REMEDY)
        found = torch.from_numpy(np.load(Path(folder) / "found.npy"))
    return torch.autograd.grad(frames, moved, found.to(frames))[0]


def find_llvm() -> Path | None:
    """The newest LLVM at the usual places that `gradient` works with; ``DRJIT_LIBLLVM_PATH`` comes before them."""
    named = [Path(name) for name in [os.environ.get("DRJIT_LIBLLVM_PATH")] if name]
    named = [path.absolute() if path.exists() else path for path in named]  # a bare name is for the system to find
    found = {Path(path).resolve() for pattern in LIBRARIES for path in glob(pattern)}
    newest = sorted(found, key=lambda path: [int(number) for number in re.findall(r"\d+", path.name)], reverse=True)
    return first_working((*named, *newest))


@cache
def first_working(libraries: tuple[Path, ...]) -> Path | None:
    """The first of the libraries with which the gradient of a triangle can be had; each is tried once a process."""
    vertices, mesh = (
        torch.tensor([[[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 1.0, 3.0]]]),
        Mesh.build(torch.arange(3)[None]),
    )
    middle = torch.full((1, 2), 4.0)
    camera = Camera(torch.eye(3)[None], torch.zeros(1, 3), 2 * middle, middle, (8, 8), "pinhole")
    for library in libraries:
        try:
            found = gradient(vertices, mesh, camera, torch.ones(1, 1, 8, 8), samples=4, llvm=library)
        except UserError:
            continue
        if found.isfinite().all() and found.any():
            return library
    return None


_PLACED = ("rotation", "translation", "focal", "centre")


def _frames(vertices: Tensor, mesh: Mesh, camera: Camera) -> tuple[Tensor, list[Camera]]:
    """Vertices [N V 3] for square pixels, and a camera for each frame; float64."""
    check_shapes("raster_mitsuba", vertices=(vertices, "N V 3"))
    check_finite("raster_mitsuba(vertices)", vertices, "frame vertex coordinate")
    if vertices.shape[1] < mesh.vertices:
        raise UserError("raster_mitsuba", f"the faces name {mesh.vertices} vertices, got {vertices.shape[1]}")
    if len(camera) not in (1, len(vertices)):
        raise UserError("raster_mitsuba", f"{len(camera)} cameras do not fit {len(vertices)} frames")
    camera = camera.to("cpu", torch.float64)[torch.arange(len(vertices)) % len(camera)]
    return square(vertices.to("cpu", torch.float64), camera), [camera[k : k + 1] for k in range(len(camera))]


def _channels(mesh: Mesh) -> Iterable[tuple[int, Tensor]]:
    """The channels that have faces, with their faces [F' 3]."""
    for channel in mesh.face_channels.unique().tolist():
        yield channel, mesh.faces[mesh.face_channels == channel]


def _alpha(mi: Any, scene: Any, sensor: Any, seed: int) -> Tensor:
    return torch.from_numpy(mi.render(scene, sensor=sensor, seed=seed).numpy())[..., 3]


def _where(rough: Tensor) -> Crop:
    """The part of a picture [H W] that holds all it shows, with a margin; all of it where nothing is seen."""
    spans = []
    for seen in (rough.any(1), rough.any(0)):
        places = seen.nonzero().flatten().tolist() or [0, len(seen)]
        first, last = max(places[0] - MARGIN, 0), min(places[-1] + 1 + MARGIN, len(seen))
        spans.append((first, last - first))
    (top, height), (left, width) = spans
    return top, left, height, width


def _from_afar(camera: Camera, vertices: Tensor) -> Camera:
    """A pinhole camera for a weak-perspective one; the same where the vertices [V 3] lie on average."""
    if camera.kind == "pinhole":
        return camera
    depth = vertices.mean(0) @ camera.rotation[0, 2] + camera.translation[0, 2]
    back = torch.stack([0 * depth, 0 * depth, AFAR - depth])
    return replace(camera, translation=camera.translation + back, focal=camera.focal * AFAR, kind="pinhole")


def _differentiate(folder: Path) -> None:
    """Answer what `gradient` asks, in the process that it starts.

    The body is black before a white sky, so that the picture is the sky less the silhouette, on whichever side of a
    face the ray falls.
    """
    with np.load(folder / "asked.npz") as stored:
        asked = {name: torch.from_numpy(values) for name, values in stored.items()}
    frames, cotangent, samples, seed = (asked[name] for name in ("vertices", "cotangent", "samples", "seed"))
    cameras = Camera(*(asked[name] for name in _PLACED), tuple(cotangent.shape[2:]), "pinhole")
    mesh = Mesh.build(asked["faces"], asked["parts"])
    found = torch.zeros_like(frames)
    with using(LLVM) as mi:
        import drjit as dr

        integrator = mi.load_dict({"type": "direct_projective", "sppc": 0, "sppp": int(samples), "sppi": 0})
        black = {"type": "twosided", "side": {"type": "diffuse", "reflectance": 0.0}}
        for channel, faces in _channels(mesh):
            body = mitsuba_scene.mesh(frames[0], faces, bsdf=black)
            scene = mi.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 1.0}, "body": body})
            parameters = mi.traverse(scene)
            parameters.keep(["body.vertex_positions"])
            for frame, points in enumerate(frames):
                move(parameters, "body", points)
                dr.enable_grad(parameters["body.vertex_positions"])
                parameters.update()
                pull = torch.zeros(*cameras.size, 4)
                pull[..., 0] = -cotangent[frame, channel]
                view = sensor(cameras[frame : frame + 1], points, int(samples))
                integrator.render_backward(scene, parameters, mi.TensorXf(pull.numpy()), view, int(seed), int(samples))
                found[frame] += torch.from_numpy(dr.grad(parameters["body.vertex_positions"]).numpy()).view(-1, 3)
    np.save(folder / "found.npy", found)


if __name__ == "__main__":
    _differentiate(Path(sys.argv[1]))
