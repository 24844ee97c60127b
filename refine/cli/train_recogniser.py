"""``refine train recogniser``: the recognisers that a benchmark is evaluated with."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from refine.cli.results import AS_LINES, Printed, Result
from refine.cli.train import Presets, choice_of
from renderers.checks import UserError

if TYPE_CHECKING:
    from train.recogniser import RecogniserTraining


def recogniser_presets() -> Presets:
    from train.recogniser import RECOGNISER_PRESETS

    return RECOGNISER_PRESETS


@dataclass(frozen=True)
class TrainRecogniser:
    """Train the recognisers that a benchmark is evaluated with, into its folder.

    Three learn test compositions: all made by energies (mask), half of those (half), the true ones (true). Two learn
    single actions and see one part of the body each (legs, arms): together they say whether both actions are there.

    Example: refine train recogniser small --benchmark benchmarks/synth-c
    """

    presets = staticmethod(recogniser_presets)
    config: choice_of(recogniser_presets)
    benchmark: Path
    """Folder that `refine data benchmark` built."""
    force: bool = False
    """Replace recognisers that are there."""
    output: Printed = AS_LINES

    @property
    def seed(self) -> int:
        return self.config.seed

    def run(self) -> Result:
        from train.processes import launched
        from train.recogniser import train_recognisers

        if launched().count > 1:
            raise UserError("refine train recogniser", "trains on one process", "start it without torchrun")
        config: RecogniserTraining = self.config
        records = train_recognisers(self.benchmark, config, self.force)
        folder = self.benchmark / "recognisers"
        return Result(f"{table(records)}\n{folder}", (folder,), {"recognisers": records})


def table(records: dict[str, dict[str, Any]]) -> str:
    """A line a recogniser: passes, seconds, and its accuracy on what it learned and on what it did not."""
    lines = [f"{'':10s}{'classes':>8s}{'passes':>8s}{'seconds':>9s}{'learned':>9s}  unseen"]
    for kind, record in records.items():
        learned, *unseen = (f"{share:.1%}" for share in record["accuracy"].values())
        names = list(record["accuracy"])[1:]
        asked = ", ".join(f"{share} {name}" for name, share in zip(names, unseen, strict=True)) or "-"
        counts = f"{record['classes']:8d}{record['epochs']:8d}{record['seconds']:9.1f}"
        lines.append(f"{kind:10s}{counts}{learned:>9s}  {asked}")
    return "\n".join(lines)
