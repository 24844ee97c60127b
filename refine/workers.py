"""Many jobs on several processes, with results in the order of the jobs, whichever process did them."""

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

AHEAD = 4  # jobs a process may be done with before those in front of them, so that memory stays bounded
MANY = 8  # processes that are started unasked


@dataclass(frozen=True)
class Failure:
    """In place of a result: why there is none."""

    reason: str


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def suitable(jobs: int, each: int = 100) -> int:
    """How many processes are worth their start, which takes seconds: one for ``each`` jobs, no more than cores."""
    return max(1, min(cores(), MANY, jobs // each))


def in_order(function: Callable[[Any], Any], jobs: Sequence[Any], workers: int = 1) -> Iterator[Any]:
    """``map(function, jobs)`` on ``workers`` processes.

    What a job raises becomes a `Failure` in its place, and so does a job whose process dies; the others go on. Ctrl-C
    is this process's alone: close the generator (``contextlib.closing``), and the others end.

    Args:
        function: with ``workers`` above 1 it, the jobs and the results must pickle.
        workers: 1 does all of it in this process.
    """
    if workers <= 1:
        yield from (_attempt(function, job) for job in jobs)
        return
    with _team(function, min(workers, max(1, len(jobs)))) as team:
        waiting, done = deque(enumerate(jobs)), {}
        for place in range(len(jobs)):
            while place not in done:
                team.feed(waiting, limit=place + AHEAD * len(team.members))
                done.update(team.collect())
            yield done.pop(place)


def _attempt(function: Callable[[Any], Any], job: Any) -> Any:
    try:
        return function(job)
    except Exception as error:  # of thousands of jobs one may fail in any way
        return Failure(" ".join(f"{type(error).__name__}: {error}".split())[:200])


class _Member:
    """One process, and the place of the job that it is at."""

    def __init__(self, context: Any, function: Callable[[Any], Any]):
        self.busy: int | None = None
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, function), daemon=True)
        with _interrupts_held():
            self.process.start()
        theirs.close()

    def end(self):
        self.process.terminate()
        self.process.join()
        self.pipe.close()


class _Team:
    """Processes that all do the same; a dead one is replaced."""

    def __init__(self, function: Callable[[Any], Any]):
        self.context, self.function = get_context("spawn"), function
        self.members: list[_Member] = []

    def grow(self, size: int):
        while len(self.members) < size:
            self.members.append(_Member(self.context, self.function))

    def feed(self, waiting: deque[tuple[int, Any]], limit: int):
        """A job for each idle process, while the next one's place is below ``limit``."""
        for member in self.members:
            if member.busy is None and waiting and waiting[0][0] < limit:
                member.busy, job = waiting.popleft()
                with suppress(BrokenPipeError):  # it has died; collect() finds that out
                    member.pipe.send(job)

    def collect(self) -> list[tuple[int, Any]]:
        """The next results, at least one, with the places of their jobs."""
        ready = wait([member.pipe for member in self.members if member.busy is not None])
        results = []
        for index, member in enumerate(self.members):
            if member.pipe in ready:
                try:
                    result = member.pipe.recv()
                except (EOFError, ConnectionResetError):
                    member.end()
                    result = Failure(f"its process ended with code {member.process.exitcode}")
                    self.members[index] = _Member(self.context, self.function)
                results.append((member.busy, result))
                member.busy = None
        return results


@contextmanager
def _team(function: Callable[[Any], Any], size: int) -> Iterator[_Team]:
    team = _Team(function)
    try:
        team.grow(size)
        yield team
    finally:
        for member in team.members:
            member.end()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """A process that is started in this block never sees Ctrl-C; this one sees it after the block.

    To block the signal is for the child, which inherits that. It does not keep it from this process: another thread may
    take it, and Python then runs the handler here all the same.
    """
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # or the first process to start would start it, which unblocks the signal
    pressed: list[Any] = []
    handler = signal.signal(signal.SIGINT, lambda *event: pressed.append(event))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(signal.SIGINT, handler)
        if pressed and callable(handler):
            handler(*pressed[0])


def _serve(pipe: Connection, function: Callable[[Any], Any]):
    """What a process does until it is ended, or its parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"  # for what is loaded from here on
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(_attempt(function, job))
