"""Wavefront OBJ: a body's mesh, one file a frame, all with the same faces in the same order.

Metres, y up, faces counter-clockwise seen from outside.
"""

from collections.abc import Callable
from pathlib import Path

import torch

from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.outputs import replacing

MOST = 100_000  # files
CHUNK = 64  # frames that are posed at once; only memory depends on it


def write_obj(path: str | Path, motion: Motion, body: Body) -> None:
    """Write the mesh of the first frame."""
    with torch.no_grad():
        [vertices] = body(motion.rotations[:1], motion.root[:1]).vertices.tolist()
    with replacing(path) as partial:
        partial.write_text(points(vertices) + triangles(body))


def write_obj_sequence(
    folder: str | Path, motion: Motion, body: Body, progress: Callable[[], object] = lambda: None
) -> list[Path]:
    """Write ``frame_00000.obj`` and so on into a folder that is there.

    Args:
        progress: called after each file.

    Returns:
        the files, in the order of the frames.

    Raises:
        UserError: there would be more than ``MOST`` files.
    """
    if len(motion) > MOST:
        raise UserError(motion.source, f"has {len(motion)} frames, and at most {MOST} are written", "cut it shorter")
    faces, digits, written = triangles(body), max(5, len(str(len(motion) - 1))), []
    for start in range(0, len(motion), CHUNK):
        some = slice(start, start + CHUNK)
        with torch.no_grad():
            posed = body(motion.rotations[some], motion.root[some]).vertices
        for frame, vertices in enumerate(posed.tolist(), start):
            path = Path(folder) / f"frame_{frame:0{digits}d}.obj"
            head = f"# frame {frame} of {len(motion)} at {motion.fps:g} a second\n"
            path.write_text(head + points(vertices) + faces)
            written.append(path)
            progress()
    return written


def points(vertices: list[list[float]]) -> str:
    return "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in vertices)


def triangles(body: Body) -> str:
    return "".join(f"f {a} {b} {c}\n" for a, b, c in (body.faces + 1).tolist())
