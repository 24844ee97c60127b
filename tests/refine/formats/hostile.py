"""Files that were made to do harm, and what the readers answer.

python tests/refine/formats/hostile.py          prints docs/hostile.md
python tests/refine/formats/hostile.py --json   what became of each, for the tests
"""

import contextlib
import faulthandler
import gc
import importlib
import json
import os
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hostile_cases import Case

os.environ["OMP_NUM_THREADS"] = "1"  # the threads of a process do not live on in its children
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).resolve().parents[3])]
CASES: "dict[str, Case]" = importlib.import_module("hostile_cases").CASES
for subject in ("files", "bvh", "arrays", "pickles", "meshes", "others"):
    importlib.import_module(f"hostile_{subject}")

INTRODUCTION = """# Hostile files

A motion, a body, weights or a table may come from anyone. Whatever is in such a file, the answer is a motion or one
line that says what is wrong with it: nothing in it is executed, nothing is written, nothing is fetched, no link is
followed, and memory is taken only for what the file has shown. Limits are constants at the top of
`refine/formats/untrusted.py` and of each reader.

`python tests/refine/formats/hostile.py` makes the {count} files below, has them read in a process apart, and
prints this page. The tests hold every one of them to a refusal in one line, in less than a second of the processor and
less than 200 MB of memory. A file that is honest but large takes as long as it takes to read what is before the fault.

Files that nobody thought of are looked for by `python tools/fuzz.py`, which mutates the files of
`tests/refine/formats/seeds` and keeps what reaches new code. Ten minutes for each of BVH, AMC, .npz, pickles and GLB on
one core are 140,000 to 440,000 files each; what they found is among those below.
"""
READERS = ("motion", "body", "weights", "labels", "mapping", "json")
SECONDS = 10  # at which a reader is stopped


def readers() -> dict[str, Callable[[Path], object]]:
    """What reads each kind; they are imported here, so that what they take is not counted."""
    from refine.formats.files import load_motions
    from refine.formats.labels import read_labels
    from refine.formats.smpl import load_body
    from refine.formats.untrusted import read_json
    from refine.mae import load_mae
    from refine.skeletons.mapping import read_mapping
    from renderers.body import Body

    rest = Body.free("light").rest_joints
    given = (lambda path: load_motions(path, rest), load_body, load_mae, read_labels, read_mapping, read_json)
    return dict(zip(READERS, given, strict=True))


def outcomes(cases: "Iterable[Case]", read: Callable[["Case", Path], object]) -> dict[str, dict]:
    """What becomes of files that are read in a process of their own; if it dies, another goes on with the next.

    Returns by name:
        error: the kind of what was raised, "" if nothing was, or "died".
        answer: its message, without the folder. file: the name of the file.
        seconds: of the processor. megabytes: beyond those of before.
        written: the names of files that were not there before; the process was in an empty folder. warnings: what else
        was said.
    """
    left, found = list(cases), {}
    while left:
        with tempfile.TemporaryDirectory() as folder:
            found |= in_a_child(left, read, Path(folder))
        left = [case for case in left if case.name not in found]
    return found


def in_a_child(cases: "list[Case]", read: Callable[["Case", Path], object], folder: Path) -> dict[str, dict]:
    """As `outcomes`, up to and with the first file that ends the process."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with os.fdopen(writing, "w") as pipe:
            for case in cases:
                print(json.dumps(outcome(case, read, folder / case.name)), file=pipe, flush=True)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        told = [json.loads(line) for line in pipe]
    _, status = os.waitpid(child, 0)
    found = {case.name: one for case, one in zip(cases, told, strict=False)}
    if len(found) < len(cases):
        died = {
            "error": "died",
            "answer": f"status {status}",
            "seconds": 0,
            "megabytes": 0,
            "written": [],
            "warnings": [],
        }
        found[cases[len(found)].name] = died
    return found


def outcome(case: "Case", read: Callable[["Case", Path], object], folder: Path) -> dict:
    """Make a file, read it, and look at what that took."""
    (folder / "files").mkdir(parents=True)
    (folder / "empty").mkdir()
    path = case.make(folder / "files")
    os.chdir(folder / "empty")
    before = listing(folder)
    error, answer, start = "", "is read", time.process_time()
    stop = int(time.process_time()) + SECONDS
    resource.setrlimit(resource.RLIMIT_CPU, (stop, resource.RLIM_INFINITY))
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak
    memory = used("VmRSS")
    with warnings.catch_warnings(record=True) as warned, contextlib.redirect_stdout(sys.stderr):
        warnings.simplefilter("always")
        try:
            read(case, path)
        except BaseException as raised:
            error, answer = type(raised).__name__, str(raised)
    told = {"error": error, "answer": answer.replace(f"{folder / 'files'}/", ""), "file": path.name}
    told |= {"seconds": time.process_time() - start, "megabytes": used("VmHWM") - memory}
    return told | {"written": sorted(listing(folder) - before), "warnings": [str(one.message) for one in warned]}


def used(what: str) -> float:
    """Megabytes of memory, now ("VmRSS") or at most ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{what}:")) / 1024


def listing(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def by_our_readers(names: list[str] | None = None) -> dict[str, dict]:
    import torch

    torch.set_num_threads(1)
    ways = readers()
    gc.collect()
    gc.freeze()  # else a child copies what it shares with its parent, when it looks for garbage
    return outcomes([CASES[name] for name in names or CASES], lambda case, path: ways[case.reader](path))


def page(found: dict[str, dict]) -> str:
    """docs/hostile.md, with a row for each file."""
    lines = [INTRODUCTION.format(count=len(found)), "| file | read as | what it is | answer |", "|---|---|---|---|"]
    for name, told in found.items():
        answer = told["answer"].partition("; ")[0].removeprefix(told["file"]).lstrip(":, ")
        cells = (f"`{told['file']}`", CASES[name].reader, CASES[name].tries, answer)
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("<", "&lt;") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    wanted = [word for word in sys.argv[1:] if not word.startswith("-")]
    found = by_our_readers(wanted)
    print(json.dumps(found) if "--json" in sys.argv else page(found), end="")
