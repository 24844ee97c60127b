"""``refine data inspect``: what motion files are, and what is odd about them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError


@dataclass(frozen=True)
class InspectData:
    """Say what motion files are: kind, axes, unit, skeleton, clips, labels, rates, lengths, and what is odd.

    Odd are jumps, sliding feet, a wrong up axis, exchanged sides, frozen tails, copied frames, impossible bodies,
    floors far off, odd frame rates and clips too short. A file that cannot be read is named and does no harm.

    Example: refine data inspect clips -o look
    """

    source: Positional[str]
    """A motion file, - for standard input, a folder, packed clips, or one of ACTOR's packages."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for a page with moving clips, a sheet of poses and all values as JSON."""
    mapping: Path | None = None
    """JSON file to write: which joint of the file is which of ours, for you to edit and give to `refine data import
    --mapping`."""
    use_mapping: Path | None = None
    """JSON file that says which joint is which, as --mapping writes it."""
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of length; none guesses it from the size of the skeleton."""
    up: Literal["y", "z"] | None = None
    """Axis that points up in the files; none finds it, or takes the format's."""
    fps: float | None = None
    """Frame rate, for files that have none."""
    workers: int | None = None
    """Processes that read; none means one a core for many files."""
    force: bool = False
    """Replace what is there."""
    seed: int = 0
    """Taken by every verb; nothing is drawn."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from functools import partial

        from tqdm import tqdm

        from refine.cli.inputs import STDIN, bar, body_of, input_path
        from refine.formats.files import Reading
        from refine.inspection import InspectConfig, inspect
        from refine.inspection_report import PAGE, SHOWN, lines, write_report
        from renderers.outputs import refuse_existing, replacing, replacing_folder

        if self.out:
            refuse_existing(self.out, self.force, folder=True)
        if self.mapping:
            refuse_existing(self.mapping, self.force)
        reading = Reading(self.unit, self.fps, self.use_mapping, self.up)
        body = body_of(None)
        progress = partial(tqdm, desc="inspect", unit="file", disable=None, leave=False)
        written = []
        with input_path(self.source) as path:
            found = inspect(path, body.rest_joints, InspectConfig(reading, self.workers), progress)
            if self.source == STDIN:
                found = replace(found, source="standard input")
            if self.mapping:
                mapped = next((file.mapping for file in found.files if file.mapping), None)
                if mapped is None:
                    raise UserError(self.source, "brings no skeleton to map", "leave --mapping out")
                with replacing(self.mapping) as partial_path:
                    partial_path.write_text(mapped.to_json())
                written.append(self.mapping)
            if self.out:
                with replacing_folder(self.out) as folder, bar(min(SHOWN, len(found.clips)), "draw") as drawn:
                    write_report(folder, found, body, reading, drawn)
                written.append(self.out / PAGE)
        text = "\n".join([*lines(found), *map(str, written)])
        return Result(text, tuple(written), found.values())
