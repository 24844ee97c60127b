"""Ctrl-C in the middle of long work: one line, 130, nothing half-written, nothing left running."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

PROGRAM = [sys.executable, "-m", "refine.cli.main"]
PATIENCE = 120.0  # seconds; imports take long on a busy machine
TRAIN = ["train", "mae", "tiny", "--data.actions", "walk", "--data.synthetic-clips", "2", "--measured", "4"]


def interrupted(words: list[str], folder: Path, bar: str) -> tuple[int, str, str]:
    """Run a command on a terminal, press Ctrl-C when its bar has moved; exit code, what was on the screen before, and
    after."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (40, 120))
    with subprocess.Popen(
        [*PROGRAM, *words], stdout=theirs, stderr=theirs, cwd=folder, env=os.environ | {"OMP_NUM_THREADS": "1"}
    ) as process:
        os.close(theirs)
        screens, pressed, start = ["", ""], False, time.monotonic()
        while process.poll() is None or select.select([ours], [], [], 0)[0]:
            if select.select([ours], [], [], 1.0)[0]:
                try:
                    screens[pressed] += os.read(ours, 65536).decode(errors="replace")
                except OSError:  # the program has closed it
                    break
            if not pressed and re.search(rf"{bar}: +[1-9]\d?%\|", screens[0]):
                process.send_signal(signal.SIGINT)
                pressed = True
            if time.monotonic() - start > PATIENCE:
                process.kill()
                break
    os.close(ours)
    return process.returncode, *screens


@pytest.mark.parametrize(
    ("words", "bar"),
    [
        (["compose", "walk", "wave-both-hands", "-o", "both.bvh", "--report", "report", "--steps", "500"], "refine"),
        (["demo", "--out", "demo", "--seconds", "1", "--steps", "500"], "refine"),
        ([*TRAIN, "--out", "run", "--loop.steps", "5000"], "mae"),
    ],
)
def test_ctrl_c_stops_cleanly(tmp_path, words, bar):
    code, before, after = interrupted(words, tmp_path, bar)
    assert code == 130
    assert re.search(r"\[\d\d:\d\d<\d\d:\d\d", before), "the bar shows an estimate"
    assert "refine: stopped; nothing half-written is left" in after
    assert "Traceback" not in after
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*"))
    if words[0] == "train":
        assert not [name for name in left if "part" in name]
    else:
        assert left == []


def test_ctrl_c_while_the_program_is_still_being_read():
    code = """
import sys
class Pressed:
    def find_spec(self, name, *_):
        if name == "refine.cli.words":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Pressed())
from refine.cli.main import main
sys.exit(main(["demo"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "refine: stopped; nothing half-written is left\n")
