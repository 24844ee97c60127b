"""Which files there are to read: in a folder, named by a labels file, or one alone."""

import os
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from refine.formats.clips import is_shards
from refine.formats.clips import shard_paths as shards_of
from refine.formats.files import READ_SUFFIXES
from refine.formats.labels import Row, read_labels
from refine.formats.motion_json import FORMAT
from refine.formats.motion_json import MAX_BYTES as MAX_JSON
from refine.formats.untrusted import START, opened
from refine.motion import Motion
from renderers.checks import UserError, printable


class Job(NamedTuple):
    """A file to read."""

    path: Path
    source: str  # what its clips are called
    rows: tuple[Row, ...] | None = None  # of the labels file
    whole: bool = False  # the file is what is imported, not one of a folder


class Plan(NamedTuple):
    jobs: list[Job]
    refused: list[UserError]
    unlabelled: int = 0


def motion_files(folder: str | Path) -> tuple[list[Path], list[UserError]]:
    """The motion files under a folder by name, in the order of their paths, hidden ones left out.

    Links are followed to files inside the folder; others are refused, one error each. Linked folders are not entered.

    Raises:
        UserError: there are none.
    """
    folder = Path(folder)
    inside, paths, refused = folder.resolve(), [], []
    for where, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            path = Path(where, name)
            if name.startswith(".") or path.suffix.lower() not in READ_SUFFIXES or _is_other_json(path):
                continue
            if path.is_symlink() and not real(path).is_relative_to(inside):
                refused.append(UserError(path, "is a link that leads out of the folder", "put the file itself there"))
            else:
                paths.append(path)
    if not paths:
        known = " or ".join(READ_SUFFIXES)
        raise UserError(folder, f"has no files that end in {known}", "give a folder of motion files")
    return sorted(paths), sorted(refused, key=str)


def _is_other_json(path: Path) -> bool:
    """Whether it is JSON of another sort than a motion, of which folders hold many: manifests, settings, mappings."""
    if path.suffix.lower() != ".json":
        return False
    try:
        with opened(path, MAX_JSON) as stream:
            return f'"{FORMAT}"'.encode() not in stream.read(START)
    except UserError:
        return False  # it is refused where it is read


def real(path: Path) -> Path:
    """Where links lead; a link that leads to itself leads to itself."""
    return Path(os.path.realpath(path))  # Path.resolve raises a RuntimeError there, before Python 3.13


def plan(source: Path, labels_file: Path | None = None) -> Plan:
    """What to read of a folder of motion files, a folder of packed clips, or a single file.

    Raises:
        UserError: there is no such thing, no motion file in it, or the labels file is none or names none of them.
    """
    if source.is_dir() and is_shards(source):
        found, refused = shards_of(source), []
        jobs = [Job(path, path.name, whole=True) for path in found]
    elif source.is_dir():
        found, refused = motion_files(source)
        jobs = [Job(real(path) if path.is_symlink() else path, _name(path, source)) for path in found]
    elif source.exists():
        refused, jobs = [], [Job(source, source.name, whole=True)]
    else:
        raise UserError(source, "does not exist", "check the path")
    if labels_file is None:
        return Plan(jobs, refused)
    rows, missing = _rows_of_files(labels_file, [job.source for job in jobs])
    labelled = [job._replace(rows=tuple(rows[job.source])) for job in jobs if job.source in rows]
    if not labelled:
        raise UserError(labels_file, f"names none of the {len(jobs)} motion files of {source}", str(missing[0].problem))
    return Plan(labelled, refused + missing, len(jobs) - len(labelled))


def _rows_of_files(labels_file: Path, sources: list[str]) -> tuple[dict[str, list[Row]], list[UserError]]:
    """The rows of each file, by path or, where that is not ambiguous, by name with or without its suffix; and one error
    for each row whose file is not there."""
    by_name: dict[str, set[str]] = defaultdict(set)
    for source in sources:
        path = Path(source)
        for name in (source, str(path.with_suffix("")), path.name, path.stem):
            by_name[name].add(source)
    known, rows, missing = set(sources), defaultdict(list), []
    for row in read_labels(labels_file):
        where = f"{labels_file}, line {row.line}"
        found = {row.file} if row.file in known else by_name.get(row.file, set())
        if len(found) == 1:
            rows[found.pop()].append(row)
        elif found:
            problem = f"{row.file} may be {' or '.join(sorted(found)[:3])}"
            raise UserError(where, problem, "write its path from the folder on")
        else:
            missing.append(UserError(where, f"there is no file {row.file}", "check its path from the folder on"))
    return rows, missing


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def sources_in(job: Job, motions: list[Motion]) -> list[str]:
    """What the clips of a file are called: as the file, where it holds one; else by their own names in it."""
    inner = [motion.source.removeprefix(f"{job.path.name}/") for motion in motions]
    if inner == [printable(str(job.path))]:  # as a motion has it
        return [job.source]
    if len(set(inner)) < len(inner):
        inner = [f"{index:04d}" for index in range(len(inner))]
    if job.whole:
        return [motion.source for motion in motions] if len({m.source for m in motions}) == len(motions) else inner
    return [f"{job.source}/{name}" for name in inner]
