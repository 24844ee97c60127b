"""Silhouettes of the free body: accuracy against the exact area, and time for a picture with its gradient.

    OMP_NUM_THREADS=1 python benchmarks/silhouettes.py

Time is the median processor time per frame of a batch of 16, with the gradient of a sum of squared differences. "Exact"
is the fold scan in float64 with 64 subscanlines, which the tests hold against the reference.
"""

import statistics
import time

import torch
from torch import Tensor

from renderers.body import Body
from renderers.camera import frame
from renderers.mesh import Mesh
from renderers.rotations import axis_angle_to_matrix
from renderers.silhouette import silhouette
from renderers.skeleton import JOINTS

FRAMES, REPEATS = 16, 15


def pose(body: Body) -> Tensor:
    """Vertices [16 V 3] with the arms anywhere between the T-pose and hanging down, and all else jittered."""
    generator = torch.Generator().manual_seed(0)
    turns = 0.3 * torch.randn(FRAMES, 24, 3, generator=generator)
    turns[:, JOINTS["left_shoulder"], 2] -= 1.3 * torch.rand(FRAMES, generator=generator)
    turns[:, JOINTS["right_shoulder"], 2] += 1.3 * torch.rand(FRAMES, generator=generator)
    with torch.no_grad():
        return body(axis_angle_to_matrix(turns), torch.zeros(FRAMES, 3)).vertices


def measure(vertices: Tensor, mesh: Mesh, side: int) -> dict[str, float]:
    """Mean error, intersection over union at 1/2, and milliseconds a frame."""
    camera = frame(vertices, (side, side), yaw=0.4, kind="pinhole")
    image = silhouette(vertices, mesh, camera).double()
    exact = torch.cat([silhouette(one[None].double(), mesh, camera, subscanlines=64) for one in vertices])
    union = ((image > 0.5) | (exact > 0.5)).sum()

    def step():
        moving = vertices.clone().requires_grad_()
        (silhouette(moving, mesh, camera) - target).square().sum().backward()

    target, times = image.float().flip(0), []
    for _ in range(REPEATS):
        start = time.process_time()
        step()
        times.append(time.process_time() - start)
    return {
        "error": (image - exact).abs().mean().item(),
        "iou": (((image > 0.5) & (exact > 0.5)).sum() / union).item(),
        "ms": 1e3 * statistics.median(times) / FRAMES,
    }


def main():
    print("| body | picture | pixels | mean error | IoU | ms/frame |\n|---|---|---|---|---|---|")
    for level in ("light", "full"):
        body = Body.free(level)
        vertices = pose(body)
        for name, parts in (("plain", None), ("six parts", body.face_parts)):
            mesh = Mesh.build(body.faces, parts)
            for side in (64, 112, 224):
                found = measure(vertices, mesh, side)
                print(f"| {level} | {name} | {side} | {found['error']:.1e} | {found['iou']:.4f} | {found['ms']:.2f} |")


if __name__ == "__main__":
    main()
