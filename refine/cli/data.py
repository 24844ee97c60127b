"""``refine data import``: a folder of clips as one packed file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from renderers.checks import UserError


@dataclass(frozen=True)
class ImportData:
    """Read a folder of motion files, put them on SMPL's joints and pack them into one file.

    Labels come from the file names. A file that cannot be read is left out and named on stderr.

    Example: refine data import clips --out clips.npz
    """

    folder: Positional[Path]
    """Folder that is searched, with its subfolders, for .bvh and .npz files."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Packed file to write, .npz."""
    label_pattern: str | None = None
    """Regular expression for a whole file name without suffix, with a group (?P<label>...)."""
    force: bool = False
    """Replace the file if it is there."""
    seed: int = 0
    """Taken by every verb; importing draws nothing."""

    def run(self) -> None:
        from collections import Counter
        from functools import partial

        from tqdm import tqdm

        from refine.cli.inputs import body_of, say
        from refine.formats.clips import import_folder, save_clips
        from renderers.outputs import refuse_existing

        if not self.folder.is_dir():
            raise UserError(self.folder, "is not a folder", "give a folder of motion files")
        if self.out.suffix != ".npz":
            raise UserError(self.out, "packed clips are an .npz file", "end its name in .npz")
        refuse_existing(self.out, self.force)
        progress = partial(tqdm, desc="import", disable=None, leave=False)
        imported = import_folder(self.folder, body_of(None).rest_joints, self.label_pattern, progress)
        for error in imported.refused:
            say(f"refine: left out {error}")
        save_clips(self.out, imported.motions)
        counts = Counter(motion.label for motion in imported.motions)
        for label, count in sorted(counts.items()):
            print(f"{count:5d}  {label}")
        print(f"{self.out}  {len(imported.motions)} clips, {sum(map(len, imported.motions)):,} frames")
