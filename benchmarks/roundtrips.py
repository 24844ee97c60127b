"""Through every format and back: how far do the joints of real clips move?

    python benchmarks/roundtrips.py --real DIR_WITH_BVH

Each clip is read, written in each format, and read again. Formats that keep rotations must keep joints within half a
millimetre, and length and frame rate exactly; a .npy holds positions alone, so its rotations are fitted, and its frame
rate is said. Beside it: whether bodies stay upright and face the same way. The table goes beside the JSON, as Markdown.
"""

import argparse
import shlex
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import torch
from machine import hardware, keep, versions
from tqdm import tqdm

from refine.formats.files import Reading, load_motion, save_motion
from refine.motion import Motion, cut
from renderers.body import Body
from renderers.rotations import heading
from renderers.skeleton import JOINTS
from train.checkpoints import commit

RESULTS = Path(__file__).parent / "results"
EXACT, FITTED = (".bvh", ".npz", ".glb", ".json"), (".npy",)
LIMIT = 0.0005  # metres, for formats that keep rotations
LONGEST = 400.0  # seconds, for JSON is read up to a size


def measure(path: Path, suffixes: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """One clip through each format: errors in metres and radians, times in seconds."""
    torch.set_num_threads(1)
    body = Body.free("light")
    clip = load_motion(path, body.rest_joints)
    clip = cut(clip, 0.0, min(clip.seconds, LONGEST))
    joints, found = clip.joints(body.rest_joints), {}
    with tempfile.TemporaryDirectory() as folder:
        for suffix in suffixes:
            out = Path(folder) / f"clip{suffix}"
            started = time.process_time()
            save_motion(clip, out, body)
            written = time.process_time()
            back = load_motion(out, body.rest_joints, Reading(fps=clip.fps) if suffix in FITTED else None)
            found[suffix] = {
                "write": written - started,
                "read": time.process_time() - written,
                "bytes": out.stat().st_size,
                "same_length": float(len(back) == len(clip)),
                "same_fps": float(back.fps == clip.fps),
                **(compared(back, clip, joints, body) if len(back) == len(clip) else {}),
            }
    return found | {"frames": {"count": float(len(clip))}}


def compared(back: Motion, clip: Motion, joints: torch.Tensor, body: Body) -> dict[str, float]:
    """The largest and the mean joint error of a clip, how far its heading turned, and whether heads stay up."""
    again = back.joints(body.rest_joints)
    errors = (again - joints).norm(dim=-1)
    turned = heading(back.rotations[:, 0]) - heading(clip.rotations[:, 0])
    turned = torch.atan2(turned.sin(), turned.cos()).abs()
    upright = clip.rotations[:, 0, 1, 1] > 0.5  # a body that lies has no heading to keep
    height = (each[:, JOINTS["head"], 1] - each[:, 0, 1] for each in (again, joints))
    now, before = height
    return {
        "largest": float(errors.max()),
        "mean": float(errors.double().mean()),
        "turned": float(turned[upright].max()) if upright.any() else 0.0,
        "upside_down": float(((now > 0) != (before > 0))[before.abs() > 0.1].any()),
    }


def summary(clips: list[dict[str, dict[str, float]]], suffix: str) -> dict[str, float]:
    """Over clips."""
    values: dict[str, list[float]] = defaultdict(list)
    for clip in clips:
        for name, value in clip[suffix].items():
            values[name].append(value)
    largest = torch.tensor(values["largest"], dtype=torch.float64)
    frames = sum(clip["frames"]["count"] for clip in clips)
    return {
        "clips": len(clips),
        "largest_mm": 1e3 * float(largest.max()),
        "p99_of_clips_mm": 1e3 * float(largest.quantile(0.99)),
        "mean_mm": 1e3 * sum(values["mean"]) / len(values["mean"]),
        "turned_degrees": float(torch.rad2deg(torch.tensor(max(values["turned"])))),
        "lengths_kept": sum(values["same_length"]) / len(clips),
        "rates_kept": sum(values["same_fps"]) / len(clips),
        "upside_down": sum(values["upside_down"]) / len(clips),
        "written_a_second": frames / sum(values["write"]),
        "read_a_second": frames / sum(values["read"]),
        "bytes_a_frame": sum(values["bytes"]) / frames,
    }


def table(found: dict) -> str:
    """A row a format."""
    lines = [
        f"{found['clips']} clips, {found['frames']:,.0f} frames. Reproduce: `{found['command']}` "
        f"(commit {found['commit'][:8]}, {found['hardware']}, one thread).",
        "",
        "| format | largest joint error, mm | of 99 % of clips | mean | heading, degrees | length and rate kept | "
        "frames/s written | read | bytes a frame |",
        "|---" * 9 + "|",
    ]
    for suffix, row in found["formats"].items():
        kept = f"{100 * min(row['lengths_kept'], row['rates_kept']):.0f} %"
        kept += " (rate is said)" if suffix in FITTED else ""
        lines.append(
            f"| {suffix} | {row['largest_mm']:.4f} | {row['p99_of_clips_mm']:.4f} | {row['mean_mm']:.5f} | "
            f"{row['turned_degrees']:.4f} | {kept} | {row['written_a_second']:,.0f} | {row['read_a_second']:,.0f} | "
            f"{row['bytes_a_frame']:,.0f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, required=True, help="folder of .bvh clips")
    parser.add_argument("--every", type=int, default=1, help="take every so-manieth clip")
    parser.add_argument("--formats", nargs="+", default=[*EXACT, *FITTED])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS / "roundtrips.json")
    args = parser.parse_args()
    paths = sorted(args.real.rglob("*.bvh"))[:: args.every]
    with ProcessPoolExecutor(args.workers, get_context("spawn")) as pool:
        waiting = pool.map(partial(measure, suffixes=tuple(args.formats)), paths)
        clips = list(tqdm(waiting, total=len(paths), desc="clips", disable=None))
    found = {
        "command": shlex.join(["python", "benchmarks/roundtrips.py", *sys.argv[1:]]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "versions": versions(("refine-motion", "torch", "numpy")),
        "clips": len(clips),
        "frames": sum(clip["frames"]["count"] for clip in clips),
        "limit_mm": 1e3 * LIMIT,
        "formats": {suffix: summary(clips, suffix) for suffix in args.formats},
    }
    keep(args.out, found, table(found))
    exact = [row for suffix, row in found["formats"].items() if suffix in EXACT]
    broken = any(r["largest_mm"] > 1e3 * LIMIT or min(r["lengths_kept"], r["rates_kept"]) < 1 for r in exact)
    return int(broken or any(row["upside_down"] for row in found["formats"].values()))


if __name__ == "__main__":
    sys.exit(main())
