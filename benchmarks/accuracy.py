"""How wrong pictures and gradients are, against the exact area of the covered polygons.

The truth is independent of every renderer that is measured: `tests/renderers/exact.py` unites the projected triangles
and cuts the union with each pixel, by GEOS in float64. Derivatives of its loss are central differences.
"""

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import torch
from peers import Renderer
from subjects import Subject
from torch import Tensor
from tqdm import tqdm

from renderers.mesh import Mesh

EXACT = Path(__file__).resolve().parents[1] / "tests" / "renderers" / "exact.py"
STEP = 1e-3  # pixels at 64 px
CLEAR = 0.02  # of the largest slope: a smaller one need not have the right sign


@dataclass(frozen=True)
class Truth:
    """Exact pictures of N poses, and slopes of the loss against the next pose's, for each side."""

    vertices: Tensor  # [N V 3]
    motions: dict[str, list[Tensor]]  # K displacements [N V 3] of each kind, see `subjects.motions`
    images: dict[int, Tensor]  # [N H W]
    slopes: dict[int, dict[str, Tensor]]  # [N K]

    def target(self, side: int) -> Tensor:
        return self.images[side].roll(1, 0)


def find_truth(subject: Subject, poses: Tensor, sides: tuple[int, ...], motions: dict[str, list[Tensor]]) -> Truth:
    """The truth about some poses [N] of a subject; half a second for each pose, and for each of its motions twice."""
    spec = importlib.util.spec_from_file_location("exact", EXACT)
    exact = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(exact)
    camera, mesh = subject.cameras(64)[poses].to(dtype=torch.float64), Mesh.build(subject.faces)
    vertices = subject.vertices[poses]
    motions = {kind: [field[poses] for field in fields] for kind, fields in motions.items()}

    def draw(moved: Tensor) -> dict[int, Tensor]:
        shapes = exact.unions(camera.project(moved), mesh)[:, 0]
        return {side: torch.stack([exact.areas(shape, (side, side), side / 64) for shape in shapes]) for side in sides}

    images = draw(vertices.double())

    def slope(field: Tensor) -> dict[int, Tensor]:
        there, back = (draw(vertices.double() + way * STEP * field) for way in (1, -1))
        return {side: (loss(there[side], side) - loss(back[side], side)) / (2 * STEP) for side in sides}

    def loss(image: Tensor, side: int) -> Tensor:
        return (image - images[side].roll(1, 0)).square().sum((1, 2))

    progress = tqdm(motions.items(), desc="exact loss", disable=None)
    found = {kind: [slope(field) for field in fields] for kind, fields in progress}
    slopes = {
        side: {kind: torch.stack([one[side] for one in each], 1) for kind, each in found.items()} for side in sides
    }
    return Truth(vertices, motions, images, slopes)


def errors(renderer: Renderer, truth: Truth, side: int, device: str) -> dict:
    """Of a renderer's pictures, and of its gradients along each kind of motion."""
    vertices, exact = truth.vertices.to(device), truth.images[side]
    image = renderer.draw(vertices).double().cpu()
    gradient = renderer.descend(vertices, truth.target(side).to(vertices)).double().cpu()
    masks = image > 0.5, exact > 0.5
    found = {
        "mean error": (image - exact).abs().mean().item(),
        "IoU": ((masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum()).item(),
        "soft IoU": (torch.minimum(image, exact).sum() / torch.maximum(image, exact).sum()).item(),
        "gradient": {},
    }
    for kind, fields in truth.motions.items():
        slopes = torch.stack([(gradient * field).sum((1, 2)) for field in fields], dim=1)
        true = truth.slopes[side][kind]
        clear = true.abs() > CLEAR * true.abs().max()
        found["gradient"][kind] = {
            "error": ((slopes - true).norm() / true.norm()).item(),
            "sign": (slopes.sign() == true.sign())[clear].double().mean().item(),
        }
    return found
