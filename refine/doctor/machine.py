"""What this machine is: processor, memory, disk, graphics card."""

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from refine.doctor.findings import Finding, size
from refine.workers import cores

PROC = Path("/proc")
CGROUP = Path("/sys/fs/cgroup")
FREE_DISK = 1 << 30


def find_processor(about: str) -> Iterator[Finding]:
    import torch

    name, usable, there = processor(), cores(), os.cpu_count() or 1
    values = {"name": name, "system": platform.platform(), "cores": there, "usable_cores": usable}
    yield Finding(about, "processor", "ok", f"{name}, {platform.system()} {platform.machine()}", values=values)
    threads = torch.get_num_threads()
    said = f"{threads} of {usable} usable cores" + (f" ({there} in all)" if there != usable else "")
    if asked := os.environ.get("OMP_NUM_THREADS"):
        said += f", OMP_NUM_THREADS={asked}"
    yield Finding(about, "threads", "ok", said, values={"threads": threads})


def find_memory(about: str) -> Iterator[Finding]:
    found = memory()
    said = ", ".join(f"{size(value)} {name}" for name, value in found.items()) or "unknown"
    yield Finding(about, "memory", "ok", said, values=found)


def find_disk(about: str) -> Iterator[Finding]:
    folder = Path(tempfile.gettempdir())
    free = shutil.disk_usage(folder).free
    enough = free >= FREE_DISK
    remedy = "" if enough else "make room, or name another folder in TMPDIR"
    values = {"folder": str(folder), "free": free}
    said = f"{size(free)} free in {folder}"
    yield Finding(about, "temporary files", "ok" if enough else "broken", said, remedy, values=values)


def find_network(about: str) -> Iterator[Finding]:
    yield Finding(about, "network", "ok", "none is needed: nothing is fetched or sent")


def find_graphics_card(about: str) -> Iterator[Finding]:
    import torch

    name, driver = "graphics card", driver_version()
    if torch.cuda.is_available():
        for index in range(torch.cuda.device_count()):
            card = torch.cuda.get_device_properties(index)
            try:
                torch.ones(8, device=f"cuda:{index}").sum().item()
            except RuntimeError as error:
                said = f"{card.name} does not compute ({str(error).strip().partition(chr(10))[0][:200]})"
                remedy = "install a PyTorch that is built for it, or set CUDA_VISIBLE_DEVICES"
                yield Finding(about, name, "broken", said, remedy, False)
                continue
            said = f"{card.name}, {size(card.total_memory)}, CUDA {torch.version.cuda}, driver {driver or 'unknown'}"
            values = {"name": card.name, "memory": card.total_memory, "cuda": torch.version.cuda, "driver": driver}
            yield Finding(about, name, "ok", said, needed=False, values=values)
    elif torch.version.cuda is None and not driver:
        remedy = "with one, training is quicker (--device cuda)"
        yield Finding(about, name, "missing", "no NVIDIA driver, and PyTorch for processors alone", remedy, False)
    elif torch.version.cuda is None:
        remedy = "install PyTorch's build for CUDA to use it, see https://pytorch.org"
        yield Finding(about, name, "missing", f"driver {driver}, but PyTorch is for processors alone", remedy, False)
    elif not driver:
        remedy = "if there is one, install its driver; training is quicker then (--device cuda)"
        yield Finding(about, name, "missing", "no NVIDIA driver", remedy, False)
    else:
        remedy = f"update the driver {driver} to one that knows CUDA {torch.version.cuda}, or set CUDA_VISIBLE_DEVICES"
        yield Finding(about, name, "broken", "PyTorch cannot use it", remedy, False)


def processor() -> str:
    """The processor's name."""
    for line in _lines(PROC / "cpuinfo"):
        name, _, value = line.partition(":")
        if name.strip() in ("model name", "Model", "Hardware") and value.strip():
            return " ".join(value.split())
    return platform.processor() or platform.machine() or "unknown"


def memory() -> dict[str, int]:
    """Bytes of memory: "total" there is, "available", and "limit" that a container sets, as far as they are known."""
    found = {}
    for line in _lines(PROC / "meminfo"):
        if match := re.fullmatch(r"Mem(Total|Available):\s+(\d+) kB", line.strip()):
            found[match[1].lower()] = int(match[2]) * 1024
    if not found and hasattr(os, "sysconf"):
        with suppress(ValueError, OSError):
            found["total"] = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _lines(CGROUP / "memory.max"):
        if line.strip().isdigit():
            found["limit"] = int(line)
    return found


def driver_version() -> str:
    """The version of NVIDIA's driver; "" where there is none."""
    for line in _lines(PROC / "driver" / "nvidia" / "version"):
        if match := re.search(r"Module.*?\s(\d+\.\d+[\d.]*)\s", line):
            return match[1]
    return ""


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(errors="replace").splitlines()
    except OSError:
        return []
