"""How near are rotations that are fitted to joint positions, how smooth, and how fast?

    python benchmarks/inverse_kinematics.py --real DIR_WITH_BVH --out benchmarks/results/inverse_kinematics.json

Positions are taken from motions whose rotations are known, on several bodies, as files of positions hold them: the body
that is fitted, others with every kind of bone 0.7 to 1.3 times as long, one with SMPL's T-pose, one with KIT's joints,
and positions that are unsteady. Truth is the same rotations on the body that is fitted. SMPL's and KIT's T-poses are
other postures than ours, so there only the directions of limbs have a truth, which is that of the positions.
"""

import argparse
import math
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from machine import hardware, keep, versions
from torch import Tensor
from tqdm import tqdm

from refine import synthetic
from refine.formats.files import load_motion
from refine.intervals import mean_interval
from refine.motion import Motion
from refine.positions.inverse_kinematics import fit_joints
from refine.positions.joint_layouts import KIT_LAYOUT, SMPL_LAYOUT
from renderers.body import Body
from renderers.rotations import rotation_angle
from renderers.skeleton import JOINT_NAMES, JOINTS, PARENTS, forward_kinematics
from train.checkpoints import commit

SEEN = 22  # joints that are compared; hands are not in most files
LIMBS = ((1, 4), (4, 7), (2, 5), (5, 8), (16, 18), (18, 20), (17, 19), (19, 21))
SPEED_FRAMES, SPEED_REPEATS = 1000, 7


class Case(NamedTuple):
    """Positions [T J 3] as a file holds them, of a body with the joints [T 24 3], and whether rotations mean the same
    posture on it as on ours."""

    name: str
    comparable: bool
    joints: Tensor
    positions: Tensor


def others_bones(rest: Tensor, random: torch.Generator) -> Tensor:
    """[24 3] T-pose with every kind of bone 0.7 to 1.3 times as long, left as right."""
    kinds = [name.removeprefix("left_").removeprefix("right_") for name in JOINT_NAMES]
    factors = {kind: 0.7 + 0.6 * float(torch.rand((), generator=random)) for kind in dict.fromkeys(kinds)}
    pose = rest.clone()
    for joint in range(1, len(PARENTS)):
        pose[joint] = pose[PARENTS[joint]] + factors[kinds[joint]] * (rest[joint] - rest[PARENTS[joint]])
    return pose


def kit(joints: Tensor) -> Tensor:
    """KIT's 21 joints, in the unit of that data set, from SMPL's 24 on a body of its make."""
    positions = joints.new_zeros(len(joints), len(KIT_LAYOUT.joints), 3)
    for index, joint in enumerate(KIT_LAYOUT.joints):
        if joint >= 0:
            positions[:, index] = joints[:, joint]
    for index, side in ((14, "right"), (19, "left")):
        positions[:, index] = (joints[:, JOINTS[f"{side}_ankle"]] + joints[:, JOINTS[f"{side}_foot"]]) / 2
    return 640 * positions


def as_files_hold_it(motion: Motion, rest: Tensor, random: torch.Generator) -> Iterator[Case]:

    def on(pose: Tensor) -> Tensor:
        return forward_kinematics(motion.rotations.double(), motion.root.double(), pose)[0]

    own, other, smpl, of_kit = map(on, (rest, others_bones(rest, random), SMPL_LAYOUT.rest, KIT_LAYOUT.rest))
    yield Case("own body, 24", True, own, own)
    yield Case("own body, 22", True, own, own[:, :SEEN])
    yield Case("other bones, 22", True, other, other[:, :SEEN])
    yield Case("SMPL's T-pose, 22", False, smpl, smpl[:, :SEEN])
    yield Case("KIT, 21", False, of_kit, kit(of_kit))
    for millimetres in (2, 5, 10):
        shaken = other + millimetres / 1000 * torch.randn(other.shape, generator=random, dtype=other.dtype)
        yield Case(f"other bones, 22, unsteady by {millimetres} mm", True, other, shaken[:, :SEEN])


def measure(motion: Motion, rest: Tensor, random: torch.Generator) -> dict[str, dict[str, float]]:
    """For each case what is reported of one clip: centimetres and degrees."""
    rows = {}
    for name, comparable, joints, positions in as_files_hold_it(motion, rest.double(), random):
        fit = fit_joints(positions, rest, motion.fps)
        ours, truth = (one.joints(rest)[:, :SEEN] for one in (fit.motion, motion))
        row = {"error": 100 * fit.error, "worst_frame": 100 * float(fit.errors.max())}
        row["limbs"] = math.degrees(float(_between(ours.double(), joints).mean()))
        if comparable:
            apart = (ours - ours[:, :1]) - (truth - truth[:, :1])
            row["to_truth"] = 100 * float(apart.norm(dim=-1).mean())
        row["turn"], row["true_turn"] = (_largest_turn(one) for one in (fit.motion, motion))
        rows[name] = row
    return rows


def _between(ours: Tensor, truth: Tensor) -> Tensor:
    """Angles [T 8] between the bones of limbs."""
    ours, truth = (torch.stack([joints[:, b] - joints[:, a] for a, b in LIMBS], dim=1) for joints in (ours, truth))
    return torch.atan2(torch.linalg.cross(ours, truth).norm(dim=-1), (ours * truth).sum(dim=-1))


def _largest_turn(motion: Motion) -> float:
    """Degrees that any joint turns from one frame to the next."""
    return math.degrees(float(rotation_angle(motion.rotations[:-1].mT @ motion.rotations[1:]).max()))


def speed(motion: Motion, rest: Tensor) -> dict:
    """Frames a second of one thread's own time, everything counted, the best of several."""
    found = {}
    for name, _, _, positions in as_files_hold_it(motion, rest.double(), torch.Generator().manual_seed(0)):
        times = (-(-SPEED_FRAMES // len(positions)), 1, 1)
        positions = positions.repeat(times)[:SPEED_FRAMES]
        seconds = []
        for _ in range(SPEED_REPEATS):
            start = time.process_time()
            fit_joints(positions, rest, motion.fps)
            seconds.append(time.process_time() - start)
        found[name] = {"frames_per_second": SPEED_FRAMES / min(seconds), "seconds": seconds}
    return found


def built_in(rest: Tensor, draws: int, seed: int) -> list[Motion]:
    random = torch.Generator().manual_seed(seed)
    names = [name for name in synthetic.ACTIONS for _ in range(draws)]
    return [synthetic.perform(synthetic.draw(name, random), 90, rest) for name in names]


def summarise(rows: list[dict[str, dict[str, float]]]) -> dict:
    """Means over clips with 95 % intervals, and the worst clip."""
    return {
        case: {
            value: mean_interval([row[case][value] for row in rows]) | {"worst": max(row[case][value] for row in rows)}
            for value in rows[0][case]
        }
        for case in rows[0]
    }


def table(report: dict) -> str:
    lines = [
        "# Rotations from joint positions",
        "",
        f"`{report['command']}`, commit {report['commit']}, {report['hardware']}, one thread",
        "",
        "Error: mean distance of the joints of the fitted rotations to the positions, on a skeleton with their bone "
        "lengths, at the size of the body. To truth: to the true rotations on the body that is fitted, pelvis on "
        "pelvis. Limbs: angle between fitted and true bones. Turn: the most that any joint turns in one frame, mean "
        "over clips, beside the true one. Brackets: 95 % intervals over clips. Frames a second of the thread's own "
        "time.",
    ]
    for kind in ("built-in", "real"):
        if kind not in report:
            continue
        summary, clips, frames = (report[kind][key] for key in ("summary", "clips", "frames"))
        lines += ["", f"## {clips} {kind} clips, {frames:,} frames", ""]
        lines += ["| positions | error, cm | worst clip | to truth, cm | limbs, degrees | turn (true) | frames/s |"]
        lines += ["|---|---|---|---|---|---|---|"]
        for case, values in summary.items():
            truth = _cell(values["to_truth"]) if "to_truth" in values else "-"
            turns = f"{values['turn']['mean']:.0f} ({values['true_turn']['mean']:.0f})"
            rate = report["speed"][case]["frames_per_second"]
            lines.append(
                f"| {case} | {_cell(values['error'])} | {values['error']['worst']:.2f} | {truth} | "
                f"{_cell(values['limbs'])} | {turns} | {rate:,.0f} |"
            )
    return "\n".join(lines) + "\n"


def _cell(value: dict) -> str:
    low, high = value["ci95"]
    return f"{value['mean']:.2f} [{low:.2f}, {high:.2f}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, help="folder of Bandai-Namco BVH clips; without it only built-in motions")
    parser.add_argument("--draws", type=int, default=3, help="of each built-in action")
    parser.add_argument("--every", type=int, default=1, help="take every so manyeth real clip")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    rest = Body.free("light").rest_joints
    random = torch.Generator().manual_seed(args.seed)
    clips = {"built-in": built_in(rest, args.draws, args.seed)}
    if args.real:
        paths = sorted(args.real.rglob("*.bvh"))[:: args.every]
        clips["real"] = [load_motion(path, rest) for path in tqdm(paths, desc="read")]
    report = {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "hardware": hardware("cpu"),
        "versions": versions(("torch", "numpy")),
        "speed": speed(clips["built-in"][0], rest),
    }
    for kind, motions in clips.items():
        rows = [measure(motion, rest, random) for motion in tqdm(motions, desc=kind)]
        report[kind] = {"clips": len(motions), "frames": sum(map(len, motions)), "summary": summarise(rows)}
    keep(args.out, report, table(report))


if __name__ == "__main__":
    main()
