"""Differentiable renderers side by side: how each makes silhouettes of the same vertices, and their gradient.

Those of others are imported where they are used and need not be installed. Cameras: ours has x to the right and y down;
PyTorch3D's x to the left and y up; nvdiffrast takes clip coordinates, whose y we let grow downwards.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec
from math import log

import torch
from torch import Tensor

from renderers import mitsuba_scene
from renderers.camera import Camera
from renderers.mesh import Mesh
from renderers.raster_mitsuba import find_llvm
from renderers.silhouette import silhouette

SIGMA = 1e-4  # PyTorch3D's tutorials, squared normalised device coordinates


@dataclass
class Renderer(ABC):
    """Faces [F 3] seen by N cameras; subclasses draw by autograd."""

    faces: Tensor
    camera: Camera

    @abstractmethod
    def draw(self, vertices: Tensor) -> Tensor:
        """Vertices [N V 3], world -> silhouettes [N H W]."""

    def descend(self, vertices: Tensor, target: Tensor) -> Tensor:
        """The gradient [N V 3] of the sum of squared differences to ``target`` [N H W]."""
        moving = vertices.clone().requires_grad_()
        (self.draw(moving) - target).square().sum().backward()
        return moving.grad


@dataclass
class Fold(Renderer):
    """Ours."""

    subscanlines: int = 4

    @cached_property
    def mesh(self) -> Mesh:
        return Mesh.build(self.faces)

    def draw(self, vertices: Tensor) -> Tensor:
        return silhouette(vertices, self.mesh, self.camera, self.subscanlines)[:, 0]


@dataclass
class PyTorch3D(Renderer):
    """The soft silhouette of PyTorch3D's documentation (Liu et al. 2019)."""

    faces_per_pixel: int = 50

    @cached_property
    def renderer(self) -> Callable:
        from pytorch3d.renderer import (
            BlendParams,
            MeshRasterizer,
            MeshRenderer,
            PerspectiveCameras,
            RasterizationSettings,
            SoftSilhouetteShader,
        )

        own, half_turn = self.camera, torch.tensor([-1.0, -1.0, 1.0], device=self.faces.device)
        cameras = PerspectiveCameras(
            R=(half_turn[:, None] * own.rotation).mT,
            T=half_turn * own.translation,
            focal_length=own.focal,
            principal_point=own.centre,
            image_size=torch.tensor([own.size]).expand(len(own), 2),
            in_ndc=False,
            device=self.faces.device,
        )
        settings = RasterizationSettings(
            image_size=own.size, blur_radius=log(1 / SIGMA - 1) * SIGMA, faces_per_pixel=self.faces_per_pixel
        )
        shader = SoftSilhouetteShader(blend_params=BlendParams(sigma=SIGMA, gamma=1e-4))
        return MeshRenderer(MeshRasterizer(cameras, settings), shader)

    def draw(self, vertices: Tensor) -> Tensor:
        from pytorch3d.structures import Meshes

        return self.renderer(Meshes(vertices, self.faces.expand(len(vertices), -1, 3)))[..., 3]


@dataclass
class Nvdiffrast(Renderer):
    """Rasterise and antialias (Laine et al. 2020), one sample a pixel; on a GPU alone."""

    @cached_property
    def context(self):
        from nvdiffrast.torch import RasterizeCudaContext

        return RasterizeCudaContext(device=self.faces.device)

    def draw(self, vertices: Tensor) -> Tensor:
        from nvdiffrast.torch import antialias, rasterize

        clip, faces = clip_coordinates(vertices, self.camera), self.faces.int()
        raster, _ = rasterize(self.context, clip, faces, self.camera.size)
        hit = (raster[..., 3:] > 0).to(clip)
        return antialias(hit, raster, clip, faces)[..., 0]


def clip_coordinates(vertices: Tensor, camera: Camera) -> Tensor:
    """World vertices [N V 3] before a pinhole camera -> [N V 4] as OpenGL has them, but with y downwards."""
    seen = camera.view(vertices)
    depth, sides = seen[..., 2:], seen.new_tensor(camera.size[::-1])
    near, far = depth.min().item() / 2, depth.max().item() * 2
    along = (depth * (far + near) - 2 * far * near) / (far - near)
    return torch.cat([(2 * camera.pixels(seen) / sides - 1) * depth, along, depth], dim=-1)


@dataclass
class Mitsuba(Renderer):
    """Mitsuba 3's projective integrator (Zhang et al. 2023): the body glows, a pixel's radiance is its coverage.

    Only the outline carries a gradient here, so that none is sought inside (``sppc``). Frames follow each other; the
    first call sets up the scenes and compiles, and should not be timed.
    """

    samples: int = 16

    @cached_property
    def scenes(self) -> list[tuple]:
        import mitsuba as mi

        glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
        made = []
        for frame in range(len(self.camera)):
            somewhere = torch.eye(int(self.faces.max()) + 1, 3) + torch.tensor([0.0, 0.0, 1.0])
            mesh = mitsuba_scene.mesh(somewhere, self.faces, emitter=glow)
            sensor = mitsuba_scene.sensor(self.camera[frame : frame + 1], somewhere, self.samples)
            scene = mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {"type": "direct_projective", "sppc": 0, "sppi": 0},
                    "sensor": sensor,
                    "mesh": mesh,
                }
            )
            made.append((scene, mi.traverse(scene)))
        return made

    def draw(self, vertices: Tensor) -> Tensor:
        return self._render(vertices, None)[0]

    def descend(self, vertices: Tensor, target: Tensor) -> Tensor:
        return self._render(vertices, target)[1]

    def _render(self, vertices: Tensor, target: Tensor | None) -> tuple[Tensor, Tensor]:
        images, gradients = [], []
        with mitsuba_scene.using(mitsuba_scene.LLVM) as mi:
            import drjit as dr

            for frame, (points, (scene, parameters)) in enumerate(zip(vertices, self.scenes, strict=True)):
                positions = mi.Float(points.flatten().numpy())
                if target is not None:
                    dr.enable_grad(positions)
                parameters["mesh.vertex_positions"] = positions
                parameters.update()
                image = mi.render(scene, parameters, spp=self.samples, seed=frame)[:, :, 0]
                images.append(torch.from_numpy(image.numpy()))
                if target is not None:
                    dr.backward(dr.sum(dr.square(image - mi.TensorXf(target[frame].numpy())), axis=None))
                    gradients.append(torch.from_numpy(dr.grad(positions).numpy()).view_as(points))
        return torch.stack(images), torch.stack(gradients) if gradients else None


@dataclass(frozen=True)
class Peer:
    """A renderer in one setting, as tables have it."""

    name: str
    missing: str | None  # why it cannot run here
    frames: int  # that it draws in a call that is timed
    open: Callable[[Tensor, Camera], Renderer]


def peers(device: str) -> list[Peer]:
    """All that are compared, ours first."""
    pytorch3d = None if find_spec("pytorch3d") else "not installed"
    nvdiffrast = "no GPU" if device == "cpu" else None if find_spec("nvdiffrast") else "not installed"
    mitsuba = choose_llvm() if device == "cpu" else "on the CPU alone"
    return [
        *(Peer(f"fold scan, S={scans}", None, 16, partial(Fold, subscanlines=scans)) for scans in (4, 8)),
        *(Peer(f"PyTorch3D, K={k}", pytorch3d, 2, partial(PyTorch3D, faces_per_pixel=k)) for k in (50, 8)),
        *(Peer(f"Mitsuba, {samples} spp", mitsuba, 2, partial(Mitsuba, samples=samples)) for samples in (16, 64)),
        Peer("nvdiffrast", nvdiffrast, 16, Nvdiffrast),
    ]


def choose_llvm() -> str | None:
    """Let Mitsuba use an LLVM that works, or say why it cannot: others end the process."""
    library = find_llvm()
    if library is None:
        return "no LLVM that works"
    os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    return None
