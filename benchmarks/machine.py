"""What a figure was measured on, and where it is kept."""

import json
import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch


def hardware(device: str) -> str:
    cpu = Path("/proc/cpuinfo")
    names = [line.split(":")[1].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")]
    gpu = "" if device == "cpu" else f", {torch.cuda.get_device_name()}"
    return f"{platform.machine()}, {os.cpu_count()} cores of {names[0] if names else platform.processor()}{gpu}"


def versions(packages: Iterable[str]) -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def keep(out: Path | None, report: dict, tables: str):
    """Print the tables; write the report as JSON to ``out``, if that is asked for, and the tables beside it."""
    print(tables)
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(report, indent=1) + "\n")
        out.with_suffix(".md").write_text(tables)
