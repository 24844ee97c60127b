"""``refine doctor``: what works on this machine."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from refine.cli.results import AS_LINES, Printed, Result

if TYPE_CHECKING:
    from refine.doctor.findings import Finding

COLOURS = {"ok": "green", "missing": "yellow", "broken": "red"}


@dataclass(frozen=True)
class Doctor:
    """Try everything that Refine leans on, and say of what does not work what to do.

    Versions, processor and memory, graphics card, Mitsuba and LLVM, pictures and films, Blender, body files, assets,
    caches, and a second of the loop itself. Exit code 1 says that something which is needed does not work.

    Example: refine doctor
    Example: refine doctor --body models/SMPL_NEUTRAL.npz --json
    """

    body: tuple[Path, ...] = ()
    """Body files to tell apart; quoted patterns are understood."""
    seed: int = 0
    """Taken by every verb; nothing is drawn that depends on it."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from refine.cli.inputs import bar, expand
        from refine.doctor.examination import examine, steps
        from refine.doctor.findings import healthy

        bodies = expand(self.body)
        with bar(steps(bodies), "examine") as progress:
            findings = list(examine(bodies, progress))
        well = healthy(findings)
        values = {"healthy": well, "findings": [asdict(each) for each in findings]}
        return Result(page(findings, well), values=values, code=0 if well else 1, colours=COLOURS)


def page(findings: "list[Finding]", well: bool) -> str:
    """A line a finding, under headings; what is not ok has a line below it that says what to do."""
    width = max(len(each.name) for each in findings if each.about != "bodies")
    lines, heading = [], ""
    for each in findings:
        if each.about != heading:
            heading = each.about
            lines += ["", heading]
        lines.append(f"  {each.state:8s}{each.name:{width}s}  {each.found}")
        if each.state != "ok":
            lines.append(" " * (width + 12) + (each.remedy if each.needed else f"optional: {each.remedy}"))
    bad = sum(each.needed and each.state != "ok" for each in findings)
    wanting = "1 thing that is needed does" if bad == 1 else f"{bad} things that are needed do"
    lines += ["", "all that is needed works" if well else f"{wanting} not work"]
    return "\n".join(lines[1:])
