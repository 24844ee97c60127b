"""Jobs on several processes."""

import os
import time
from contextlib import closing

import pytest

from refine.workers import AHEAD, Failure, in_order, suitable


def slow_if_even(job: int) -> tuple[int, int]:
    time.sleep(0.05 if job % 2 == 0 else 0)
    return job, os.getpid()


def fragile(job: int) -> int:
    if job == 2:
        raise ValueError("no\nsuch number")
    if job == 4:
        raise MemoryError
    if job == 5:
        os._exit(7)
    return job * job


def threads(_job: int) -> int:
    import torch

    return torch.get_num_threads()


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_results_come_in_the_order_of_the_jobs_from_several_processes():
    results = list(in_order(slow_if_even, range(20), workers=2))
    assert [job for job, _ in results] == list(range(20))
    processes = {process for _, process in results}
    assert len(processes) == 2 and os.getpid() not in processes
    assert not any(map(alive, processes))


def test_one_worker_is_this_process():
    assert {process for _, process in in_order(slow_if_even, [1, 3], workers=1)} == {os.getpid()}
    assert list(in_order(slow_if_even, [], workers=3)) == []


def test_a_job_that_raises_or_kills_its_process_is_a_failure_alone():
    results = list(in_order(fragile, range(9), workers=2))
    assert results == [
        0,
        1,
        Failure("ValueError: no such number"),
        9,
        Failure("MemoryError:"),
        Failure("its process ended with code 7"),
        36,
        49,
        64,
    ]
    assert list(in_order(fragile, range(5), workers=1)) == results[:5]


def test_closing_ends_the_processes():
    with closing(in_order(slow_if_even, range(1000), workers=2)) as results:
        processes = {next(results)[1] for _ in range(6)}
    assert not any(map(alive, processes))


def test_nobody_runs_far_ahead():
    """With the first job held up, the others are not all done meanwhile: their results would fill the memory."""
    done = {job: seconds for job, seconds in in_order(first_is_slow, range(40), workers=2)}
    assert max(job for job, seconds in done.items() if seconds < done[0]) <= 2 * AHEAD
    assert [job for job in done] == list(range(40))


def first_is_slow(job: int) -> tuple[int, float]:
    time.sleep(0.5 if job == 0 else 0)
    return job, time.monotonic()


def test_each_process_keeps_to_one_core():
    assert list(in_order(threads, [0], workers=2)) == [1]


@pytest.mark.parametrize(("jobs", "workers"), [(0, 1), (199, 1), (10**6, None)])
def test_few_jobs_are_not_worth_a_process(jobs, workers, monkeypatch):
    monkeypatch.setattr("refine.workers.cores", lambda: 4)
    assert suitable(jobs) == (workers or 4)
