"""Two real clips, composed, exported, and read by programs that know nothing of this one: are the joints the same?

    python benchmarks/independent.py --real DIR_WITH_BVH

The commands that a person would type are run; then bvhio reads the BVH, trimesh the GLB, and Blender the GLB, the BVH
and the FBX that it wrote. A Python that has bvhio and trimesh is named by JUDGES_PYTHON, one that has Blender's module
by BPY_PYTHON. The table goes beside the JSON, as Markdown.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import torch
from machine import hardware, keep, versions

from refine.formats.files import load_motion
from refine.motion import Motion
from renderers.body import Body
from renderers.skeleton import JOINT_NAMES
from train.checkpoints import commit

RESULTS = Path(__file__).parent / "results"
JUDGES = Path(__file__).resolve().parents[1] / "tests" / "refine" / "formats" / "judges"
CLIPS = ("dataset-2_walk_normal_004.bvh", "dataset-2_wave-both-hands_normal_001.bvh")
FRAMES = 8


def said(*command: str | Path) -> str:
    """What a command prints.

    Raises:
        RuntimeError: it failed.
    """
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600)
    if done.returncode:
        raise RuntimeError(f"{shlex.join(map(str, command[:4]))}: {(done.stderr or done.stdout)[-500:]}")
    return done.stdout


def refine(*words: str | Path) -> str:
    """Run a command of ours; how a person would type it."""
    said(sys.executable, "-m", "refine.cli.main", *words)
    return shlex.join(["refine", *(Path(word).name if isinstance(word, Path) else word for word in words)])


@dataclass(frozen=True)
class Reader:
    """A program that says where the joints are: ``python script FILE [rate] TIMES``."""

    suffix: str
    python: str
    script: str
    unit: float = 1.0  # metres a unit
    rate: bool = False  # it wants to be told
    seconds: bool = False  # times are seconds, and not frames


def readers(blender: str, judges: str) -> dict[str, Reader]:
    """By what they are called; those that are there."""
    found = {
        "bvhio": Reader(".bvh", judges, "bvhio_joints.py", unit=0.01),
        "trimesh": Reader(".glb", judges, "trimesh_joints.py", seconds=True),
        "Blender, BVH": Reader(".bvh", blender, "blender_bvh_joints.py"),
        "Blender, GLB": Reader(".glb", blender, "blender_joints.py", rate=True),
        "Blender, FBX": Reader(".fbx", blender, "blender_joints.py", rate=True),
    }
    return {name: reader for name, reader in found.items() if reader.python}


def largest_error(printed: str, motion: Motion, body: Body, frames: list[int], unit: float) -> float:
    """Metres between a joint where another program has it and where it is."""
    text = printed.partition("FOUND ")[2] or printed
    seen = json.loads(text.strip().splitlines()[0])["joints"]
    there = torch.tensor([[place[name] for name in JOINT_NAMES] for place in seen], dtype=torch.float64) * unit
    return float((there - motion.joints(body.rest_joints)[frames]).norm(dim=-1).max())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, required=True, help="folder with the Bandai-Namco clips")
    parser.add_argument("--out", type=Path, default=RESULTS / "independent.json")
    args = parser.parse_args()
    blender, judges = (os.environ.get(name, "") for name in ("BPY_PYTHON", "JUDGES_PYTHON"))
    clips = [next(args.real.rglob(name)) for name in CLIPS]
    body, rows = Body.free("full"), {}
    with tempfile.TemporaryDirectory() as folder:
        both = Path(folder) / "both.bvh"
        typed = [refine("compose", *clips, "-o", both)]
        motion = load_motion(both, body.rest_joints)
        suffixes = (".glb", ".fbx") if blender else (".glb",)
        typed += [refine("export", both, "-o", both.with_suffix(suffix)) for suffix in suffixes]
        frames = torch.linspace(0, len(motion) - 1, FRAMES).round().long().tolist()
        for name, reader in readers(blender, judges).items():
            times = [frame / motion.fps for frame in frames] if reader.seconds else frames
            words = map(repr, [motion.fps, *times] if reader.rate else times)
            printed = said(reader.python, JUDGES / reader.script, both.with_suffix(reader.suffix), *words)
            largest = largest_error(printed, motion, body, frames, reader.unit)
            rows[name] = {"file": reader.suffix, "largest_mm": 1e3 * largest}
    found = {
        "command": shlex.join(["python", "benchmarks/independent.py", *sys.argv[1:]]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "versions": versions(("refine-motion", "torch", "numpy")),
        "typed": typed,
        "frames": len(motion),
        "compared": frames,
        "readers": rows,
    }
    keep(args.out, found, table(found))
    return int(not rows or max(row["largest_mm"] for row in rows.values()) > 0.5)


def table(found: dict) -> str:
    lines = [
        f"{' and '.join(CLIPS)}: {found['frames']} frames, {len(found['compared'])} compared. Reproduce: "
        f"`{found['command']}` (commit {found['commit'][:8]}).",
        "",
        *(f"    {line}" for line in found["typed"]),
        "",
        "| reader | file | largest joint error, mm |",
        "|---|---|---|",
        *(f"| {name} | {row['file']} | {row['largest_mm']:.4f} |" for name, row in found["readers"].items()),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
