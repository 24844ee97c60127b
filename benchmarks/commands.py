"""The command line, as benchmarks run it."""

import os
import subprocess
import sys


def refine(*arguments: object):
    """Run `refine` with these arguments on one thread.

    Raises:
        RuntimeError: it failed; with the command and the last line that it said.
    """
    command = [sys.executable, "-m", "refine.cli.main", *map(str, arguments)]
    done = subprocess.run(command, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True)
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise RuntimeError(f"{' '.join(command)}: {said[-1]}")
