"""Python code that is tried in a process of its own, which may crash or hang."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from typing import Any

from renderers.checks import UserError

SECONDS = 120.0


def ask(code: str, seconds: float = SECONDS, python: str = sys.executable, isolated: bool = False) -> Any:
    """What Python code prints last, as JSON, in a process of its own, which may crash or hang.

    Args:
        python: the interpreter; ours unless given, which then finds what this one finds.
        isolated: with ``-I``, for another environment's interpreter.

    Raises:
        UserError: it fails, is ended by a signal, prints no JSON, or takes longer than ``seconds``; the reason in one
            line.
    """
    command = [python, *(["-I"] if isolated else []), "-c", code]
    environment = None if isolated else {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=environment,
            start_new_session=True,
        )
    except OSError as error:
        raise UserError(python, f"does not run ({error.strerror})") from error
    try:
        answer, complaint = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired as error:
        raise UserError(python, f"gave no answer within {seconds:g} s") from error
    finally:
        if process.poll() is None:
            _end(process)
    if process.returncode < 0:
        raise UserError(python, f"was ended by {signal.Signals(-process.returncode).name}")
    try:
        if process.returncode:
            raise ValueError
        return json.loads(answer.strip().splitlines()[-1])
    except (ValueError, IndexError) as error:
        last = ((complaint.strip() or answer.strip()).splitlines() or ["no message"])[-1]
        raise UserError(python, f"failed ({last[:200]})") from error


def _end(process: subprocess.Popen) -> None:
    """End a process, and those that it has started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
