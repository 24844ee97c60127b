"""What is installed: Python, packages and their versions, the files that ship, the cache."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from importlib import metadata
from pathlib import Path

from refine.doctor.findings import DISTRIBUTION, REINSTALL, Finding, size

PYTHON = (3, 11)
ROOM = Path(__file__).resolve().parents[2]
ASSETS = (
    "renderers/assets/body_light.npz",
    "renderers/assets/body_full.npz",
    "refine/assets/mae.safetensors",
    "refine/assets/mae.json",
)


def find_python(about: str) -> Iterator[Finding]:
    old = sys.version_info < PYTHON
    remedy = f"install Python {'.'.join(map(str, PYTHON))} or newer" if old else ""
    version = platform.python_version()
    yield Finding(about, "Python", "broken" if old else "ok", version, remedy, values={"version": version})


def find_packages(about: str) -> Iterator[Finding]:
    """Refine and what it requires, by what its own metadata says."""
    try:
        asked = metadata.requires(DISTRIBUTION) or []
        version = metadata.version(DISTRIBUTION)
        yield Finding(about, DISTRIBUTION, "ok", version, values={"version": version})
    except metadata.PackageNotFoundError:
        yield Finding(about, DISTRIBUTION, "missing", "not installed", "run pip install . in its folder")
        return
    for requirement in sorted(asked, key=str.lower):
        name, bounds, extra = re.fullmatch(r"([\w.-]+)\s*([^;]*)(;.*)?", requirement).groups()
        if extra:
            continue
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Finding(about, name, "missing", "not installed", f"pip install '{name}{bounds}'")
            continue
        fits = all(_within(version, bound.strip()) for bound in bounds.split(",") if bound.strip())
        found = version if fits else f"{version}, and {bounds} is needed"
        remedy = "" if fits else f"pip install '{name}{bounds}'"
        yield Finding(about, name, "ok" if fits else "broken", found, remedy, values={"version": version})


def _within(version: str, bound: str) -> bool:
    """Whether a version is within one bound, such as ">=2.11"; of other relations nothing is said."""
    match = re.fullmatch(r"(>=|<)\s*([\d.]+)", bound)
    if not match:
        return True
    ours, theirs = (
        [int(number) for number in re.findall(r"\d+", re.match(r"[\d.]*", each)[0])] for each in (version, match[2])
    )
    length = max(len(ours), len(theirs))
    ours, theirs = (each + [0] * (length - len(each)) for each in (ours, theirs))
    return ours >= theirs if match[1] == ">=" else ours < theirs


def find_assets(about: str) -> Iterator[Finding]:
    for name in ASSETS:
        path = ROOM / name
        if not path.is_file():
            yield Finding(about, path.name, "missing", f"is not at {path}", REINSTALL)
            continue
        content = path.read_bytes()
        values = {"path": str(path), "bytes": len(content), "sha256": sha256(content).hexdigest()}
        yield Finding(about, path.name, "ok", f"{size(len(content))}, sha256 {values['sha256'][:12]}", values=values)


def find_caches(about: str) -> Iterator[Finding]:
    """The one cache there is: kernels that Mitsuba's compiler keeps, of LLVM alone."""
    folder = Path.home() / ".drjit"
    files, taken = folder_size(folder)
    said = f"{folder}: {files} files, {size(taken)}; may be removed" if files else f"{folder}: nothing"
    yield Finding(about, "cache of drjit", "ok", said, values={"folder": str(folder), "files": files, "bytes": taken})


def folder_size(folder: Path) -> tuple[int, int]:
    """Files in a folder and all below it, and their bytes; links are not followed."""
    files = size = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += os.lstat(os.path.join(root, name)).st_size
                files += 1
    return files, size
