"""FBX out, by Blender's own module in a process of its own.

FBX has no public specification, so the file is written as GLB and converted by Blender, in the Python that the
environment variable ``BPY_PYTHON`` names. Blender is under the GPL; it is run, not imported.
"""

import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

from refine.formats.glb import write_glb
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.outputs import replacing

VARIABLE = "BPY_PYTHON"
SCRIPT = Path(__file__).with_name("fbx_blender.py")
SECONDS = 600.0  # for Blender to convert one file
REMEDY = (
    "install bpy in its own environment: python3.11 -m venv bpy && bpy/bin/pip install bpy, "
    "then BPY_PYTHON=bpy/bin/python; or write .glb, which Blender opens"
)


def write_fbx(path: str | Path, motion: Motion, body: Body) -> None:
    """Write a motion of a body with its mesh, skin and skeleton: one take, named by its label.

    Raises:
        UserError: there is no Blender, see :func:`blender_python`, it fails or takes longer than ``SECONDS``, or the
            file cannot be written.
    """
    python = blender_python()
    with tempfile.TemporaryDirectory(prefix="refine-fbx-") as folder:
        source, target = Path(folder, "motion.glb"), Path(folder, "motion.fbx")
        write_glb(source, replace(motion, fps=max(round(motion.fps), 1)), body)
        done = _run([python, "-I", str(SCRIPT), str(source), str(target), repr(motion.fps)], SECONDS, folder)
        if done.returncode != 0 or not target.is_file():
            last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1][:200]
            raise UserError(path, f"Blender did not write it ({last})", "write .glb instead and convert that")
        with replacing(path) as partial:
            shutil.copyfile(target, partial)


def blender_python() -> str:
    """The Python that has Blender's module.

    Raises:
        UserError: ``BPY_PYTHON`` is not set, or what it names is no such Python.
    """
    python = os.environ.get(VARIABLE, "")
    if not python:
        raise UserError(".fbx", f"is written by Blender, and {VARIABLE} does not say where that is", REMEDY)
    found = shutil.which(python)
    if found is None:
        raise UserError(VARIABLE, f"{python} is no program", REMEDY)
    code = "import importlib.util; print(importlib.util.find_spec('bpy') is not None)"
    if _run([found, "-I", "-c", code], 30.0).stdout.strip() != "True":
        raise UserError(VARIABLE, f"{python} is no Python that has the module bpy", REMEDY)
    return found


def _run(command: list[str], seconds: float, folder: str | None = None) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
        )
    except subprocess.TimeoutExpired as error:
        raise UserError(VARIABLE, f"{command[0]} did not end within {seconds:g} seconds", REMEDY) from error
    except OSError as error:
        raise UserError(VARIABLE, f"{command[0]} does not run ({error.strerror})", REMEDY) from error
