"""What is tried: renderers, encoders, Blender, bodies, and the loop itself."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from refine.doctor.asking import ask
from refine.doctor.findings import REINSTALL, Finding
from renderers.checks import UserError

USED = ("scalar_rgb", "llvm_ad_rgb")  # of Mitsuba's variants
MEND_MITSUBA = "render --quality and check-renderer draw with it: pip install --force-reinstall mitsuba"
PINNED_AREA = 435.2567  # pixels of the light body in its T-pose, in a picture of 64 px
SELF_TEST = ("walk", "wave-both-hands")
DRAW = """
import json, torch
from renderers.mesh import Mesh
from renderers.camera import frame
from renderers.mitsuba_scene import using
from renderers.raster_mitsuba import silhouette
triangle = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
mesh = Mesh.build(torch.arange(3)[None])
area = float(silhouette(triangle, mesh, frame(triangle[0], (20, 20)), 64).sum())
with using() as mi:
    print(json.dumps({"variants": list(mi.variants()), "version": mi.__version__, "area": area}))
"""
FIND = """
import json
from renderers.raster_mitsuba import find_llvm
found = find_llvm()
print(json.dumps(found and str(found)))
"""


def try_mitsuba(about: str) -> Iterator[Finding]:
    """A triangle over half of 16 x 16 pixels, in a process of its own."""
    try:
        found = ask(DRAW)
    except UserError as error:
        yield Finding(about, "Mitsuba", "broken", error.problem, MEND_MITSUBA, needed=False)
        return
    right = abs(found["area"] - 128) < 4
    used = [variant for variant in USED if variant in found["variants"]]
    said = f"{found['version']} draws; has {', '.join(used)} and {len(found['variants']) - len(used)} other variants"
    if not right:
        said = f"{found['version']} draws {found['area']:.1f} pixels where 128 are right"
    remedy = "" if right else MEND_MITSUBA
    yield Finding(about, "Mitsuba", "ok" if right else "broken", said, remedy, needed=False, values=found)


def try_llvm(about: str) -> Iterator[Finding]:
    try:
        found = ask(FIND)
    except UserError as error:
        found, said = None, error.problem
    else:
        said = found or "none was found with which Mitsuba's gradients work"
    remedy = "" if found else "check-renderer compares gradients with it: install LLVM 19, or set DRJIT_LIBLLVM_PATH"
    yield Finding(about, "LLVM", "ok" if found else "missing", said, remedy, needed=False, values={"library": found})


def try_encoders(about: str) -> Iterator[Finding]:
    """Pictures and films are written and read again."""
    import av
    import torch
    from PIL import Image

    from renderers.images import save_gif, save_mp4, save_png

    frames = torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(0))

    def stored(path: Path) -> int:
        with Image.open(path) as picture:
            return getattr(picture, "n_frames", 1)

    def filmed(path: Path) -> int:
        with av.open(str(path)) as film:
            return len(list(film.decode(video=0)))

    kinds = (
        ("PNG", "a.png", lambda path: save_png(path, frames[0]), stored, 1),
        ("GIF", "a.gif", lambda path: save_gif(path, frames, 10.0), stored, 4),
        ("MP4", "a.mp4", lambda path: save_mp4(path, frames, 10.0), filmed, 4),
    )
    with tempfile.TemporaryDirectory(prefix="refine-") as folder:
        for name, file, save, count, expected in kinds:
            path = Path(folder) / file
            try:
                save(path)
                found = count(path)
                said = f"{expected} of {expected} frames come back" if expected > 1 else "comes back"
                problem = "" if found == expected else f"{found} of {expected} frames come back"
            except Exception as error:  # encoders raise what they like
                problem = f"{type(error).__name__}: {error}"
            remedy = "pip install --force-reinstall av pillow" if problem else ""
            yield Finding(about, name, "broken" if problem else "ok", problem or said, remedy)
    encoders = {name: name in av.codecs_available for name in ("libx264", "libvpx-vp9")}
    names = {"libx264": "H.264", "libvpx-vp9": "VP9"}
    for codec, there in encoders.items():
        said = f"PyAV {av.__version__} has {codec}" if there else f"PyAV {av.__version__} has no {codec}"
        remedy = "" if there else "pip install --force-reinstall av"
        yield Finding(about, names[codec], "ok" if there else "missing", said, remedy, needed=codec == "libx264")


def try_blender(about: str) -> Iterator[Finding]:
    """Blender's module, in the Python that BPY_PYTHON names."""
    from refine.formats.fbx import REMEDY, VARIABLE

    python = os.environ.get(VARIABLE, "")
    if not python:
        yield Finding(about, "Blender", "missing", f"{VARIABLE} is not set, so that no .fbx is written", REMEDY, False)
        return
    try:
        code = "import bpy, json; print(json.dumps(bpy.app.version_string))"
        version = ask(code, python=shutil.which(python) or python, isolated=True)
    except UserError as error:
        yield Finding(about, "Blender", "broken", f"{VARIABLE}={python} {error.problem}", REMEDY, False)
        return
    yield Finding(about, "Blender", "ok", f"{version}, {python}", needed=False, values={"version": version})


def try_body(about: str, path: Path | None) -> Iterator[Finding]:
    """The free body at both levels, or what a file is, by what it holds."""
    from refine.formats.smpl import load_body
    from renderers.body import Body

    if path is None:
        for level in ("light", "full"):
            vertices = len(Body.free(level).rest_vertices)
            yield Finding(about, f"free, {level}", "ok", f"{vertices:,} vertices", values={"vertices": vertices})
        return
    try:
        body = load_body(path)
    except UserError as error:
        yield Finding(about, str(path), "broken", error.problem, error.remedy)
        return
    low, high = body.rest_vertices[:, 1].aminmax()
    values = {"vertices": len(body.rest_vertices), "metres": round(float(high - low), 3)}
    said = f"SMPL, {values['vertices']:,} vertices, {values['metres']:.2f} m tall"
    yield Finding(about, str(path), "ok", said, values=values)


def try_silhouette(about: str) -> Iterator[Finding]:
    """The area of a picture that is known."""
    import torch

    from renderers.body import Body
    from renderers.camera import frame
    from renderers.mesh import Mesh
    from renderers.silhouette import silhouette

    body = Body.free("light")
    vertices = body(torch.eye(3).expand(1, 24, 3, 3), torch.zeros(1, 3)).vertices
    area = float(silhouette(vertices, Mesh.build(body.faces), frame(vertices[0], (64, 64))).sum())
    right = abs(area - PINNED_AREA) < 0.05
    said = f"{area:.2f} pixels" + ("" if right else f", and {PINNED_AREA:.2f} are right")
    remedy = "" if right else REINSTALL
    yield Finding(about, "silhouette", "ok" if right else "broken", said, remedy, values={"area": area})


def try_loop(about: str) -> Iterator[Finding]:
    """Two built-in actions are composed and refined a little, which makes the loss smaller."""
    import torch

    from refine.composition import compose
    from refine.decoupling import Decoupler
    from refine.mae import load_mae
    from refine.refinement import RefinementConfig
    from refine.report import losses
    from refine.synthetic import draw, perform
    from renderers.body import Body

    started = time.monotonic()
    body, random = Body.free("light"), torch.Generator().manual_seed(0)
    i, j = (perform(draw(name, random, 10.0), 10, body.rest_joints) for name in SELF_TEST)
    config = RefinementConfig(steps=8, frames=4)
    made = compose(i, j, Decoupler(body, load_mae()), refinement=config)
    before, after = losses(made.before)["total"], losses(made.after)["total"]
    falls = 0 < after < before
    said = f"{' + '.join(SELF_TEST)}: loss {before:.6f}, after {config.steps} steps {after:.6f}"
    values = {"before": before, "after": after, "seconds": round(time.monotonic() - started, 2)}
    remedy = "" if falls else REINSTALL
    yield Finding(about, "refinement", "ok" if falls else "broken", said, remedy, values=values)
