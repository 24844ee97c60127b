"""Runs that are cut: in parts, over processes, by a kill. Real processes, on the built-in actions."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from refine.generator import TINY
from renderers.checks import UserError
from train.config import GeneratorTraining
from train.data import DataConfig
from train.generator import train_generator
from train.loop import LoopConfig
from train.processes import Processes
from train.shares import SharesConfig
from train.steps import GeneratorLoss

NETWORK = replace(TINY, latent=32, feedforward=32, layers=1, dropout=0.0)
STEPS = 10
FLAGS = (
    "--data.lower walk squat --data.upper wave-both-hands --data.frames 12 --data.synthetic-clips 2 "
    "--data.synthetic-seconds 1 --network.latent 32 --network.feedforward 32 --network.layers 1 --network.dropout 0 "
    "--loss.decoupling-clips 3 --loss.decoupling-frames 1 --loss.decoupling-every 2 --shares.looks 2 --batch 5 "
    "--measured 3 "
    f"--loop.steps {STEPS} --loop.warmup 0 --loop.save-every 5"
).split()


def config(folder: Path, **changes) -> GeneratorTraining:
    """What `FLAGS` says."""
    data = DataConfig(
        lower=("walk", "squat"), upper=("wave-both-hands",), frames=12, synthetic_clips=2, synthetic_seconds=1.0
    )
    whole = GeneratorTraining(
        out=folder,
        data=data,
        network=NETWORK,
        loss=GeneratorLoss(decoupling_clips=3, decoupling_frames=1, decoupling_every=2),
        shares=SharesConfig(looks=2),
        loop=LoopConfig(steps=STEPS, learning_rate=1e-3, clip_gradients=1.0, save_every=5),
        batch=5,
        measured=3,
    )
    return replace(whole, **changes)


def launch(folder: Path, *flags: str, processes: int = 1) -> subprocess.Popen:
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    command = [sys.executable, *(torchrun if processes > 1 else []), "-m", "refine.cli.main", "train", "generator"]
    return subprocess.Popen(
        [*command, "tiny", *FLAGS, "--out", str(folder), *flags],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )


def rows(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def without_time(row: dict) -> dict:
    return {name: value for name, value in row.items() if name != "seconds"}


def assert_same_losses(ours: Path, theirs: Path, tolerance: float):
    ours, theirs = rows(ours), rows(theirs)
    assert [row["step"] for row in ours] == [row["step"] for row in theirs] == list(range(STEPS))
    for a, b in zip(ours, theirs, strict=True):
        assert a.keys() == b.keys()
        assert ("dr" in a) == (a["step"] % 2 == 0)
        for name in a.keys() - {"seconds", "held_out", "step"}:
            assert a[name] == pytest.approx(b[name], rel=tolerance), (a["step"], name)
        for name, value in a.get("held_out", {}).items():
            assert value == pytest.approx(b["held_out"][name], rel=tolerance), (a["step"], name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """One process, whole batches."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    train_generator(config(folder))
    return folder


@pytest.mark.parametrize("parts", [2, 4])
def test_a_batch_in_parts_gives_the_losses_of_the_whole(whole, tmp_path, parts):
    """5 pairs of which 3 are drawn do not divide evenly; in 4 parts one of them draws nothing."""
    train_generator(config(tmp_path / "run", accumulate=parts))
    assert_same_losses(tmp_path / "run", whole, 2e-5)
    first, same = rows(tmp_path / "run")[0], rows(whole)[0]
    for name in ("rc", "rcxyz", "kl", "dr", "total"):
        assert first[name] == pytest.approx(same[name], rel=1e-6)


def test_two_processes_give_the_losses_of_one(whole, tmp_path):
    run = launch(tmp_path / "run", "--accumulate", "2", processes=2)
    said, complaints = run.communicate(timeout=120)
    assert run.returncode == 0, complaints
    assert said.split() == [str(tmp_path / "run" / "best.safetensors")]
    assert_same_losses(tmp_path / "run", whole, 2e-5)


REFUSING = """
import sys
import torch
from renderers.checks import UserError
from train.processes import together

with together("cpu") as (processes, device):
    values = torch.tensor([1.0, 10.0 * processes.rank])
    processes.sum([values])
    assert values.tolist() == [2.0, 10.0] and device == "cpu"
    with processes.agreeing():
        pass
    try:
        with processes.agreeing():
            if processes.first:
                raise UserError("first", "refuses")
    except UserError as error:
        print(error)
        raise UserError("both", "end") from error
"""


def test_the_first_process_refuses_for_all_and_has_its_say():
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    place = {"WORLD_SIZE": "2", "MASTER_ADDR": "localhost", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", REFUSING],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | place | {"RANK": str(rank)},
        )
        for rank in (0, 1)
    ]
    first, other = (process.communicate(timeout=100) for process in both)
    assert first[0] == "first: refuses\n" and "UserError: both: end" in first[1]
    assert other == ("process 0: refused the run\n", "")
    assert both[1].returncode == 2


def test_a_run_that_is_killed_goes_on_as_if_it_had_not_been(whole, tmp_path):
    folder = tmp_path / "run"
    run = launch(folder, "--loop.steps", "1000000")
    deadline = time.monotonic() + 100
    while not (folder / "last.safetensors").exists() or len(rows(folder)) < 7:
        assert run.poll() is None and time.monotonic() < deadline, run.communicate()
        time.sleep(0.002)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    assert len(rows(folder)) < STEPS, "killed too late to show anything"
    train_generator(config(folder, resume=True))
    assert [without_time(row) for row in rows(folder)] == [without_time(row) for row in rows(whole)]
    for name in ("best", "last", "state"):
        ours, theirs = ((of / f"{name}.safetensors").read_bytes() for of in (folder, whole))
        assert ours == theirs, name


def test_more_parts_than_pairs_are_refused(tmp_path):
    with pytest.raises(UserError, match="--batch: 5 pairs cannot be cut in 6; accumulate less"):
        train_generator(config(tmp_path / "run", accumulate=6))
    assert not (tmp_path / "run").exists()


def test_one_process_sums_nothing_and_agrees_with_itself():
    alone, values = Processes(), torch.ones(3)
    alone.sum([values])
    alone.wait()
    assert alone.first and values.tolist() == [1.0] * 3
    with pytest.raises(UserError, match="here: no"), alone.agreeing():
        raise UserError("here", "no")
