"""Other people's programs, asked where they are installed: their Python, and what they print."""

import os
import subprocess
from pathlib import Path

import pytest

JUDGES = Path(__file__).parent / "judges"  # what they are asked


def python(variable: str, module: str) -> str:
    """The Python that an environment variable names, if it has a module; else the test is skipped."""
    found = os.environ.get(variable, "")
    known = found and subprocess.run([found, "-c", f"import {module}"], capture_output=True).returncode == 0
    if not known:
        pytest.skip(f"no Python with {module} (set {variable})")
    return found


def said(*command: object) -> str:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
