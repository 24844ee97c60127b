"""How fast and in how much memory a large folder is imported: a million frames in two thousand files.

    python benchmarks/importing.py --out benchmarks/results/importing.json

The files are made first: built-in actions under random headings, most as AMASS's .npz, some as BVH, one broken. Then
`refine data import` runs as a process of its own with two workers, while the resident memory of it and its children is
read ten times a second from /proc. Memory that processes share counts for each of them.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import torch
from machine import hardware, keep, versions

from refine.formats.amass import write_amass
from refine.formats.bvh import write_bvh
from refine.motion import Motion
from refine.synthetic import ACTIONS, draw, perform
from renderers.body import Body
from renderers.rotations import rotation_about

SECONDS_BETWEEN = 0.1
PAGE = os.sysconf("SC_PAGE_SIZE")


def make_folder(folder: Path, files: int, bvh: int, frames: int) -> None:
    """Labelled clips in folders of a hundred, no two alike; the last file is cut short."""
    rest = Body.free("light").rest_joints
    random = torch.Generator().manual_seed(0)
    names = list(ACTIONS)
    performed = [perform(draw(name, random, 30.0), frames, rest) for name in names]
    for number in range(files):
        motion = turned(performed[number % len(names)], random)
        path = folder / f"{number // 100:03d}" / f"{names[number % len(names)]}_{number:05d}"
        if number < bvh:
            write_bvh(path.with_suffix(".bvh"), motion, rest)
        else:
            write_amass(path.with_suffix(".npz"), motion)
    content = path.with_suffix(".npz").read_bytes()
    (folder / "broken.npz").write_bytes(content[: len(content) // 2])


def turned(motion: Motion, random: torch.Generator) -> Motion:
    """The motion under a random heading and somewhere else."""
    turn = rotation_about("y", 2 * math.pi * torch.rand((), generator=random))
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    away = torch.tensor([1.0, 0.0, 1.0]) * torch.randn(3, generator=random)
    return replace(motion, rotations=rotations, root=motion.root @ turn.mT + away)


def measure(folder: Path, out: Path, workers: int) -> dict[str, float]:
    """Seconds, and the greatest memory of all processes together, in bytes."""
    command = [sys.executable, "-m", "refine.cli.main", "data", "import", str(folder), "-o", str(out), "--force"]
    start = time.perf_counter()
    process = subprocess.Popen([*command, "--workers", str(workers)], stdout=subprocess.PIPE, text=True)
    resident, proportional, most = 0, 0, 0
    while process.poll() is None:
        family = descendants(process.pid)
        resident = max(resident, sum(map(resident_bytes, family)))
        proportional = max(proportional, sum(map(proportional_bytes, family)))
        most = max(most, len(family))
        time.sleep(SECONDS_BETWEEN)
    if process.returncode:
        raise SystemExit(f"the import ended with code {process.returncode}")
    manifest = json.loads((out / "manifest.json").read_text())
    return {
        "seconds": time.perf_counter() - start,
        "resident_bytes": resident,
        "proportional_bytes": proportional,
        "processes": most,
        "clips": manifest["clips"],
        "frames": manifest["frames"],
        "files_written": len(manifest["files"]),
        "left_out": len(manifest["left_out"]),
        "hash": manifest["hash"],
    }


def descendants(process: int) -> list[int]:
    """A process and all below it."""
    found = [process]
    for parent in found:
        try:
            for task in Path(f"/proc/{parent}/task").iterdir():
                found += map(int, (task / "children").read_text().split())
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def resident_bytes(process: int) -> int:
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * PAGE
    except (FileNotFoundError, ProcessLookupError):
        return 0


def proportional_bytes(process: int) -> int:
    """Resident memory in which what is shared counts once."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))
    except (OSError, StopIteration):
        return 0


def table(report: dict) -> str:
    run = report["import"]
    rows = [
        ("frames", f"{run['frames']:,} in {run['clips']:,} clips"),
        ("files read", f"{report['files']:,} ({report['bvh']} BVH, the others .npz), {run['left_out']} left out"),
        ("workers", f"{report['workers']}, {run['processes']} processes in all"),
        ("time", f"{run['seconds']:.0f} s"),
        ("frames a second", f"{run['frames'] / run['seconds']:,.0f}"),
        ("most resident memory, all processes", f"{run['resident_bytes'] / 2**30:.2f} GiB"),
        ("the same, shared memory counted once", f"{run['proportional_bytes'] / 2**30:.2f} GiB"),
        ("files written", f"{run['files_written']} and a manifest"),
    ]
    lines = ["| import | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)]
    return "\n".join([*lines, "", f"{report['hardware']}; load average {report['load']:.1f} at the start.", ""])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--bvh", type=int, default=40, help="how many of them are BVH")
    parser.add_argument("--frames", type=int, default=500, help="of each")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="where the files are made, and kept for another run")
    parser.add_argument("--out", type=Path, help="JSON to write; a table is written beside it")
    args = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.folder or Path(scratch) / "in"
        if not folder.exists():
            make_folder(folder, args.files, args.bvh, args.frames)
        load = os.getloadavg()[0]
        report = {
            "files": args.files + 1,
            "bvh": args.bvh,
            "bytes_read": sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
            "workers": args.workers,
            "load": load,
            "hardware": hardware("cpu"),
            "versions": versions(("torch", "numpy")),
            "import": measure(folder, Path(scratch) / "out", args.workers),
        }
    keep(args.out, report, table(report))


if __name__ == "__main__":
    main()
