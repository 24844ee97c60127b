"""What the loop saw of a composition, for the viewer: the loop's cameras, small pictures of a few moments, losses."""

import base64
import io
import math
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from refine.composition import Composition
from refine.decoupling import Trace
from refine.motion import Motion
from refine.stages import STAGES, answers_for, stage_pictures
from refine.viewer.packing import Packer
from renderers.checks import check_shapes

MOMENTS = 12
SHOWN = {  # of STAGES, and what they are called where they stand alone
    "sub-action": "its own picture",
    "composition": "composition",
    "attention": "attention",
    "kept patches": "kept patches",
    "inpainted": "inpainted",
    "what counts of it": "left to mend",
}
FACTOR = 2  # pixels of a picture to one of the loop's: patches are hatched and ruled in lines of one pixel
COLOURS = 96  # of the palette of a sheet


def pack_looking(packer: Packer, composition: Composition, motions: dict[str, Motion], rest_joints: Tensor) -> dict:
    """Plain JSON values; cameras and losses are arrays of ``packer``.

    Args:
        motions: ``composition.motions()`` as they are shown, perhaps moved and turned.
    """
    length = len(composition.motion)
    moments = torch.linspace(0, length - 1, min(MOMENTS, length)).round().long().tolist()
    return {
        "moments": moments,
        "stages": list(SHOWN.values()),
        "made": [
            {"name": made, **pack_trace(packer, trace, motions[made].joints(rest_joints), moments)}
            for made, trace in composition.traces().items()
        ],
    }


def pack_trace(packer: Packer, trace: Trace, joints: Tensor, moments: list[int]) -> dict[str, Any]:
    """One composition's pictures: a sheet for each sub-action and view, one row a stage, one column a moment.

    Args:
        joints: [T 24 3] metres, of the motion as it is shown.
    """
    pictures = trace.composed.pictures
    views = len(pictures) // len(joints)
    size = tuple(pictures.shape[-2:])
    corners = picture_corners(joints.repeat_interleave(views, 0), trace.composed.joints_px.detach(), size)
    loss = [side.loss.detach().cpu().reshape(-1, views).mean(1) for side in trace.sides]
    return {
        "views": views,
        "side": size[0] * FACTOR,
        "corners": packer.add(corners.reshape(-1, views, 4, 3).float().numpy()),
        "loss": [packer.add(values.float().numpy()) for values in loss],
        "answers": [answers_for(side.owned.answers[0].cpu()).removeprefix(", ") for side in trace.references],
        "sheets": sheets(trace, moments, views),
    }


def sheets(trace: Trace, moments: list[int], views: int) -> list[list[str]]:
    """For each sub-action, for each view, the pictures of the moments as one PNG in a data URL."""
    wanted = [STAGES.index(stage) for stage in SHOWN]
    of_sides = [[], []]
    for view in range(views):
        columns = [stage_pictures(trace, moment * views + view, FACTOR) for moment in moments]
        for side, made in enumerate(of_sides):
            column = [torch.cat([pictures[side][stage] for stage in wanted], dim=1) for pictures in columns]
            made.append(data_url(torch.cat(column, dim=2)))
    return of_sides


def data_url(picture: Tensor) -> str:
    """A picture [3 H W] in 0..1 as a PNG of few colours in a data URL."""
    levels = (picture.detach().cpu().float().clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()
    few = Image.fromarray(np.ascontiguousarray(levels)).quantize(COLOURS, dither=Image.Dither.NONE)
    stream = io.BytesIO()
    few.save(stream, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def picture_corners(joints: Tensor, pixels: Tensor, size: tuple[int, int]) -> Tensor:
    """Where pictures by weak perspective stand in the world, from where they put a body's joints.

    Whatever was taken out of a motion before it was drawn (place, heading, the pelvis's orientation) moved the body as
    a whole, so that the same picture is seen by a camera that moves instead.

    Args:
        joints: [N 24 3] metres, not all in one plane.
        pixels: [N 24 2] (x, y) of the joints in each picture.
        size: (height, width) of the pictures.

    Returns:
        [N 4 3] metres: corners of each picture (top left, top right, bottom right, bottom left), in the plane through
        the middle of the joints that faces the camera.
    """
    n = check_shapes("picture_corners", joints=(joints, "N 24 3"), pixels=(pixels, "N 24 2"))["N"]
    joints, pixels = joints.detach().cpu().double(), pixels.cpu().double()
    middle = joints.mean(1, keepdim=True)
    known = torch.cat([joints - middle, torch.ones(n, joints.shape[1], 1, dtype=torch.float64)], dim=2)
    fitted = torch.linalg.lstsq(known, pixels).solution  # [N 4 2]: pixels a metre along each axis, and of the middle
    axes, centre = fitted[:, :3].mT, fitted[:, 3]
    scale = axes.norm(dim=2).mean(1)[:, None, None]
    height, width = size
    corners = torch.tensor([[0, 0], [width, 0], [width, height], [0, height]], dtype=torch.float64)
    across = (corners - centre[:, None]) / scale
    return middle + across @ torch.nn.functional.normalize(axes, dim=2)


def history(composition: Composition) -> dict[str, list[float]]:
    """The loss terms of each step, of four figures; values that are not finite are left out of the page as null."""
    terms = composition.history or {}
    return {
        name: [float(f"{value:.4g}") if math.isfinite(value) else None for value in values]
        for name, values in terms.items()
        if values
    }
