"""What is in motion files: kinds, frames of reference, skeletons, clips, and what is odd about them. Values out."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from refine.formats.actor import is_uestc, uestc_clips
from refine.formats.describing import UESTC, Clip, File, describe
from refine.formats.files import Reading
from refine.formats.finding import Job, plan, sources_in
from refine.motion import Motion
from refine.oddities import find
from refine.workers import Failure, in_order, suitable
from renderers.checks import UserError
from renderers.rotations import heading


@dataclass(frozen=True)
class Inspection:
    """All files of a source, in order."""

    source: str
    files: tuple[File, ...]
    refused: tuple[str, ...] = ()  # what was not even opened

    @property
    def clips(self) -> list[Clip]:
        return [clip for file in self.files for clip in file.clips]

    @property
    def unread(self) -> list[str]:
        return [*self.refused, *(file.problem for file in self.files if file.problem)]

    def count(self, name: str) -> dict[str, int]:
        """How many readable files share each value of a field, the most frequent first."""
        return dict(Counter(str(getattr(file, name)) for file in self.files if not file.problem).most_common())

    def labels(self) -> dict[str, int]:
        return dict(sorted(Counter(clip.label for clip in self.clips).items()))

    def oddities(self) -> dict[str, int]:
        """How many clips have each, the most frequent first."""
        return dict(Counter(oddity.name for clip in self.clips for oddity in clip.oddities).most_common())

    def values(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        files = []
        for file in self.files:
            about = {name: getattr(file, name) for name in ("source", "kind", "up", "unit", "unit_by", "skeleton")}
            mapping = file.mapping and {"joints": dict(file.mapping.joints), "confidence": file.mapping.confidence}
            clips = [asdict(clip) | {"oddities": [o._asdict() for o in clip.oddities]} for clip in file.clips]
            notes = list(file.notes)
            files.append(about | {"notes": notes, "mapping": mapping, "problem": file.problem, "clips": clips})
        return {
            "source": self.source,
            "clips": len(self.clips),
            "frames": sum(clip.frames for clip in self.clips),
            "seconds": sum(clip.seconds for clip in self.clips),
            "labels": self.labels(),
            "oddities": self.oddities(),
            "unread": self.unread,
            "inspected": files,
        }


@dataclass(frozen=True)
class InspectConfig:
    """How files are read."""

    reading: Reading = field(default_factory=Reading)
    workers: int | None = None
    """Processes; none means one a core for many files, and this one alone for few."""


def inspect(
    source: Path,
    rest_joints: Tensor,
    config: InspectConfig | None = None,
    progress: Callable[[Sequence[Any]], Iterable[Any]] = iter,
) -> Inspection:
    """Look at every motion file of a folder, at packed clips, at a package of ACTOR's, or at one file.

    Args:
        rest_joints: [24 3] T-pose joints in metres.
        progress: wraps the list of files, as ``tqdm`` does.

    Raises:
        UserError: there is nothing, or nothing of it can be read.
    """
    config = config or InspectConfig()
    if is_uestc(source):
        clips = tuple(clip_of(motion, motion.source, rest_joints) for motion in uestc_clips(source, rest_joints))
        return Inspection(str(source), (replace(UESTC, source=source.name, path=str(source), clips=clips),))
    planned = plan(source)
    look = partial(look_at, rest_joints=rest_joints.detach().cpu(), reading=config.reading)
    workers = suitable(len(planned.jobs)) if config.workers is None else config.workers
    files = []
    with closing(in_order(look, planned.jobs, workers)) as results:
        for job, result in zip(progress(planned.jobs), results, strict=True):
            if isinstance(result, Failure):
                result = File(job.source, problem=f"{job.path}: cannot be read ({result.reason})")
            files.append(result)
    inspection = Inspection(str(source), tuple(files), tuple(map(str, planned.refused)))
    if not inspection.clips:
        unread = inspection.unread
        if len(unread) == 1:
            raise UserError(source, "cannot be read", unread[0].removeprefix(f"{source}: "))
        raise UserError(source, f"none of its {len(files)} motion files can be read", f"the first: {unread[0]}")
    return inspection


def look_at(job: Job, rest_joints: Tensor, reading: Reading) -> File:
    """One file and its clips."""
    try:
        file, motions, bones = describe(job.path, rest_joints, reading)
    except UserError as error:
        return File(job.source, str(job.path), problem=str(error))
    sources = sources_in(job, motions)
    clips = [clip_of(motion, source, rest_joints, bones) for motion, source in zip(motions, sources, strict=True)]
    return replace(file, source=job.source, path=str(job.path), clips=tuple(clips))


def clip_of(motion: Motion, source: str, rest_joints: Tensor, bones: Mapping[str, float] | None = None) -> Clip:
    """What there is to say about a motion; ``bones`` as `refine.oddities.find` takes them."""
    return Clip(
        source=source,
        label=motion.label,
        frames=len(motion),
        fps=motion.fps,
        seconds=round(motion.seconds, 4),
        facing=round(math.degrees(float(heading(motion.rotations[0, 0].double()))), 1),
        travel=round(float((motion.root[-1] - motion.root[0])[[0, 2]].norm()), 3),
        oddities=tuple(find(motion, rest_joints, bones)),
    )
