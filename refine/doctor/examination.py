"""Every part that Refine leans on is tried, and what does not work says what to do."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from refine.doctor import installed, machine, trials
from refine.doctor.findings import REINSTALL, Finding
from renderers.checks import UserError


def examine(bodies: Sequence[Path] = (), progress: Callable[..., None] = lambda *_: None) -> Iterator[Finding]:
    """Try everything; some seconds. What fails in a way of its own is a finding as well.

    Args:
        bodies: body files to tell apart.
        progress: called after each of the ``steps(bodies)`` steps.
    """
    for about, name, check in _checks(bodies):
        try:
            yield from check(about)
        except UserError as error:
            yield Finding(about, name, "broken", f"{error.where}: {error.problem}", error.remedy or REINSTALL)
        except Exception as error:  # whatever it is, the other findings are still wanted
            yield Finding(about, name, "broken", f"{type(error).__name__}: {error}", REINSTALL)
        progress()


def steps(bodies: Sequence[Path] = ()) -> int:
    return len(_checks(bodies))


def _checks(bodies: Sequence[Path]) -> list[tuple[str, str, Callable[[str], Iterator[Finding]]]]:
    return [
        ("versions", "Python", installed.find_python),
        ("versions", "packages", installed.find_packages),
        ("machine", "processor", machine.find_processor),
        ("machine", "memory", machine.find_memory),
        ("machine", "disk", machine.find_disk),
        ("machine", "network", machine.find_network),
        ("machine", "graphics card", machine.find_graphics_card),
        ("rendering", "Mitsuba", trials.try_mitsuba),
        ("rendering", "LLVM", trials.try_llvm),
        ("files", "pictures and films", trials.try_encoders),
        ("files", "Blender", trials.try_blender),
        ("files", "assets", installed.find_assets),
        ("files", "caches", installed.find_caches),
        *(("bodies", str(path or "free"), partial(trials.try_body, path=path)) for path in (None, *bodies)),
        ("self-test", "silhouette", trials.try_silhouette),
        ("self-test", "loop", trials.try_loop),
    ]
