"""The renderer: time, memory and error, how they grow, and its peers in the same run.

    python benchmarks/renderer.py           (a quarter of an hour; writes results/renderer.json and .md)
    python benchmarks/renderer.py --quick   (a minute or two; writes to --out alone)

The subject: sixteen poses, each framed alone by a pinhole camera, of three closed bodies (`subjects.py`). One channel,
float32, 4 subscanlines unless it says otherwise. Needs the extra ``bench``.

Time is wall time from world vertices to the picture ("forward"), or on to the gradient at the vertices of the sum of
squared differences to another pose's picture ("both"), in ms a frame: the median of several runs after one that does
not count. Memory is the most that tensors hold at once during a call, beyond what was held before it, by PyTorch's own
account of every allocation; vertices, mesh and target are there before, and the caller's loss is left out.

Errors are explained in `accuracy.py`. Peers (`peers.py`) run where they are installed: Mitsuba where
DRJIT_LIBLLVM_PATH names an LLVM that it can use, nvdiffrast on a GPU. They draw fewer frames a call where a frame takes
seconds, which is stated.
"""

import argparse
import json
import os
import shlex
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from accuracy import errors, find_truth
from machine import hardware, keep, versions
from peers import Peer, peers
from renderer_tables import markdown
from stages import decoupling_steps
from subjects import BODIES, FRAMES, motions, subject
from tqdm import tqdm

from renderers.mesh import Mesh
from renderers.silhouette import silhouette
from train.checkpoints import commit

RESULTS = Path(__file__).parent / "results" / "renderer.json"
PACKAGES = ("torch", "pytorch3d", "mitsuba", "drjit", "nvdiffrast", "shapely", "fast-simplification")


@dataclass(frozen=True)
class Setting:
    """What a cost depends on; the base point about which each is varied."""

    side: int = 112
    batch: int = 16
    body: str = "6890"
    parts: int = 1
    threads: int = 2
    subscanlines: int = 4


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    sweeps: dict[str, tuple]
    grid: tuple[int, ...]  # sides
    peer_sides: tuple[int, ...]
    poses: int  # that errors are taken over
    fields: int  # smooth motions
    repeats: int
    seconds: float  # after which no run but the third is begun


FULL = Plan(
    sweeps={
        "side": (32, 64, 112, 224, 448),
        "batch": (1, 2, 4, 8, 16, 32, 64, 128, 256),
        "body": BODIES,
        "parts": (1, 6),
        "subscanlines": (2, 4, 8),
        "threads": (1, 2),
    },
    grid=(32, 64, 112, 224, 448),
    peer_sides=(64, 112, 224),
    poses=FRAMES,
    fields=4,
    repeats=15,
    seconds=4.0,
)
QUICK = Plan(
    sweeps={"side": (32, 112), "batch": (4, 16), "body": BODIES, "parts": (1, 6), "threads": (1, 2)},
    grid=(64,),
    peer_sides=(64,),
    poses=2,
    fields=1,
    repeats=3,
    seconds=1.0,
)


# ------------------------------------------------------------------------------------------- the measures


def clock(run: Callable[[], object], frames: int, plan: Plan, device: str) -> dict[str, float]:
    """Milliseconds of a frame: the median of so many repeats, and the least."""

    def once() -> float:
        start = time.perf_counter()
        run()
        if device != "cpu":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start) / frames

    once()
    times, end = [], time.perf_counter() + plan.seconds
    while len(times) < plan.repeats and (len(times) < 3 or time.perf_counter() < end):
        times.append(once())
    return {"ms": statistics.median(times), "least": min(times), "repeats": len(times)}


def peak_bytes(run: Callable[[], object], device: str = "cpu") -> int:
    """The most bytes that tensors hold at once because of ``run``."""
    if device != "cpu":
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        run()
        return torch.cuda.max_memory_allocated() - before
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU], profile_memory=True) as profile:
        run()
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace.json"
        profile.export_chrome_trace(str(trace))
        events = json.loads(trace.read_text())["traceEvents"]
    events = sorted((event for event in events if event["name"] == "[memory]"), key=lambda event: event["ts"])
    return int(torch.tensor([0] + [event["args"]["Bytes"] for event in events]).cumsum(0).max())


def exponent(sizes: list[float], costs: list[float]) -> float:
    """The slope of the straight line through the logarithms."""
    x, y = (torch.tensor(values, dtype=torch.float64).log() for values in (sizes, costs))
    x = x - x.mean()
    return float((x * y).sum() / x.square().sum())


def use_threads(count: int):
    torch.set_num_threads(count)
    if "drjit" in sys.modules:
        sys.modules["drjit"].set_thread_count(count)


# ------------------------------------------------------------------------------------------- ours


def cost(setting: Setting, plan: Plan, device: str) -> dict:
    """Time of a frame and memory of a call in one setting."""
    use_threads(setting.threads)
    chosen, rows = subject(setting.body), torch.arange(setting.batch) % FRAMES
    mesh = Mesh.build(chosen.faces, chosen.parts if setting.parts > 1 else None).to(device)
    camera, vertices = chosen.cameras(setting.side)[rows].to(device), chosen.vertices[rows].to(device)
    moving = vertices.clone().requires_grad_()

    def draw(vertices: torch.Tensor) -> torch.Tensor:
        return silhouette(vertices, mesh, camera, setting.subscanlines)

    target = draw(vertices.roll(1, 0))
    ways = {
        "forward": (lambda: draw(vertices), lambda: draw(vertices)),
        "both": (
            lambda: torch.autograd.grad((draw(moving) - target).square().sum(), moving),
            lambda: torch.autograd.grad(draw(moving), moving, target),
        ),
    }
    return {**asdict(setting), "faces": len(chosen.faces)} | {
        way: clock(timed, setting.batch, plan, device) | {"peak": peak_bytes(weighed, device)}
        for way, (timed, weighed) in ways.items()
    }


def sweep(name: str, base: Setting, plan: Plan, device: str) -> dict:
    """The cost as one variable goes from the base point, with the exponents of a call's time and memory."""
    settings = [replace(base, **{name: value}) for value in plan.sweeps[name]]
    rows = [cost(setting, plan, device) for setting in tqdm(settings, desc=name, disable=None)]
    if name == "threads":
        return {"rows": rows}
    sizes = [row["faces" if name == "body" else name] for row in rows]
    costs = {way: [row[way]["ms"] * row["batch"] for row in rows] for way in ("forward", "both")}
    costs["memory"] = [row["both"]["peak"] for row in rows]
    return {
        "rows": rows,
        "exponents": {
            what: {"all": exponent(sizes, values), "largest two": exponent(sizes[-2:], values[-2:])}
            for what, values in costs.items()
        },
    }


# ------------------------------------------------------------------------------------------- beside others


def compare(plan: Plan, threads: int, device: str) -> list[dict]:
    """All renderers at all sides: times; and errors, of slow ones at the smallest side alone."""
    chosen, poses = subject("6890"), torch.arange(plan.poses) * FRAMES // plan.poses
    truth = find_truth(chosen, poses, plan.peer_sides, motions(chosen, plan.fields))
    rows = []
    for peer in peers(device):
        if peer.missing:
            rows.append({"renderer": peer.name, "missing": peer.missing})
            continue
        for side in tqdm(plan.peer_sides, desc=peer.name, disable=None):
            use_threads(threads)
            row = {"renderer": peer.name, "side": side, "frames": peer.frames, "threads": threads}
            row |= speed(peer, side, plan, device)
            if peer.frames == FRAMES or side == plan.peer_sides[0]:
                camera = chosen.cameras(side)[poses].to(device)
                row |= errors(peer.open(chosen.faces.to(device), camera), truth, side, device)
            rows.append(row)
    return rows


def speed(peer: Peer, side: int, plan: Plan, device: str) -> dict:
    """Times of a renderer on poses spread over the sixteen."""
    chosen, some = subject("6890"), torch.arange(peer.frames) * FRAMES // peer.frames
    renderer = peer.open(chosen.faces.to(device), chosen.cameras(side)[some].to(device))
    vertices = chosen.vertices[some].to(device)
    target = renderer.draw(vertices.roll(1, 0))
    return {
        "forward": clock(lambda: renderer.draw(vertices), peer.frames, plan, device),
        "both": clock(lambda: renderer.descend(vertices, target), peer.frames, plan, device),
    }


# ------------------------------------------------------------------------------------------- the report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few settings and poses; figures are rough")
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count()))
    parser.add_argument("--device", default="cpu", help="cuda draws with ours, PyTorch3D and nvdiffrast on a GPU")
    parser.add_argument("--out", type=Path, help="a .json, beside which a .md is written")
    args = parser.parse_args()
    plan, out = (QUICK, args.out) if args.quick else (FULL, args.out or RESULTS)
    base, start = Setting(threads=args.threads), time.perf_counter()
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": hardware(args.device),
        "versions": versions(PACKAGES),
        "threads": args.threads,
        "plan": asdict(plan),
        "base": asdict(base),
        "compared": compare(plan, args.threads, args.device),
        "steps": decoupling_steps(plan.repeats, args.threads),
        "sweeps": {name: sweep(name, base, plan, args.device) for name in plan.sweeps},
        "grid": [
            cost(replace(base, side=side, body=body), plan, args.device)
            for side in tqdm(plan.grid, desc="grid", disable=None)
            for body in BODIES
        ],
    }
    report["minutes"] = (time.perf_counter() - start) / 60
    keep(out, report, markdown(report))


if __name__ == "__main__":
    main()
