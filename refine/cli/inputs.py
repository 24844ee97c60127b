"""What several verbs read alike: clips, bodies, the judge; standard input and output, patterns. Light to import."""

import glob
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from refine.cli.results import STDOUT, is_stdout
from renderers.checks import UserError, check_known, printable

if TYPE_CHECKING:
    from torch import Tensor

    from refine.decoupling import Decoupler
    from refine.motion import Motion
    from refine.refinement import RefinementConfig
    from renderers.body import Body


STDIN = "-"  # in place of a motion file's name
MAX_STDIN = 1 << 30  # bytes
TEXT_SUFFIXES = (".bvh", ".json", ".obj", ".amc", ".csv", ".md", ".html")


def say(message: str) -> None:
    """A line for the person who waits; results go to stdout, this goes to stderr."""
    print(printable(message), file=sys.stderr)


@contextmanager
def input_path(name: str | Path) -> Iterator[Path]:
    """The file of that name; for "-" a private copy of standard input, which is gone after the block.

    Raises:
        UserError: standard input is a terminal, empty (as it is the second time), or larger than `MAX_STDIN`.
    """
    if str(name) != STDIN:
        yield Path(name)
        return
    stream = sys.stdin.buffer
    if stream.isatty():
        raise UserError("standard input", "is a terminal, not a file", "pipe a motion into it: refine ... - < walk.bvh")
    with TemporaryDirectory(prefix="refine-") as folder:  # readable by its owner alone
        path = Path(folder).resolve() / "stdin"
        with path.open("wb") as copy:
            size = 0
            while block := stream.read(1 << 20):
                size += copy.write(block)
                if size > MAX_STDIN:
                    raise UserError("standard input", f"has more than {MAX_STDIN} bytes", "give a file")
        if not size:
            raise UserError("standard input", "is empty", "pipe a motion into it; - can be read once")
        yield path


@contextmanager
def output_path(out: Path, suffix: str = ".bvh") -> Iterator[Path]:
    """The path to write an output to; for "-" a temporary one of that suffix, which goes to standard output then.

    "-.npz" is standard output in that format. `refuse_output` comes before any work is done.
    """
    if not is_stdout(out):
        yield out
        return
    with TemporaryDirectory(prefix="refine-") as folder:
        path = Path(folder).resolve() / f"stdout{output_suffix(out, suffix)}"
        yield path
        sys.stdout.flush()
        with path.open("rb") as made:
            shutil.copyfileobj(made, sys.stdout.buffer)
        sys.stdout.buffer.flush()


def output_suffix(out: Path, suffix: str = ".bvh") -> str:
    """The suffix that says an output's format, in small letters; ``suffix`` is that of plain standard output."""
    if not is_stdout(out):
        return out.suffix.lower()
    return str(out).removeprefix(STDOUT).lower() or suffix


def refuse_output(out: Path, force: bool, suffix: str = ".bvh") -> None:
    """`renderers.outputs.refuse_existing` for a file, or standard output, which takes no bytes if it is a terminal."""
    from renderers.outputs import refuse_existing

    if not is_stdout(out):
        refuse_existing(out, force)
    elif output_suffix(out, suffix) not in TEXT_SUFFIXES and sys.stdout.isatty():
        raise UserError(
            "standard output", "is a terminal, and this format is no text", "send it to a file or a program"
        )


def check_motion_output(out: Path, force: bool) -> None:
    """Refuse, before any work is done, where a motion cannot be written.

    Raises:
        UserError: no format has the suffix, or see `refuse_output`.
    """
    from refine.formats.files import check_suffix

    check_suffix(f"standard output{output_suffix(out)}" if is_stdout(out) else out)
    refuse_output(out, force)


def expand(names: Sequence[str | Path]) -> list[Path]:
    """Every name, with patterns (``*``, ``?``, ``[ab]``, ``**``) put in for what they match, in alphabetical order.

    A shell does so unless a pattern is quoted, and some never do. A name that is there as it stands is no pattern.

    Raises:
        UserError: nothing matches a pattern.
    """
    found: list[Path] = []
    for name in map(str, names):
        if os.path.lexists(name) or not glob.has_magic(name):
            found.append(Path(name))
            continue
        matches = sorted(glob.glob(os.path.expanduser(name), recursive=True))
        if not matches:
            raise UserError(name, "matches no file", "check the pattern")
        found += map(Path, matches)
    return found


def body_of(path: Path | None, level: str = "light") -> "Body":
    """The user's SMPL body, or the free one."""
    if path is None:
        from renderers.body import Body

        return Body.free(level)
    from refine.formats.smpl import load_body

    return load_body(path)


def clip_of(name: str, rest_joints: "Tensor", seed: int = 0, seconds: float = 4.0) -> "Motion":
    """A motion file (a pattern that matches one, or - for standard input), or a built-in action of that name.

    Raises:
        UserError: there is neither; the nearest names are offered. Or the pattern matches several.
    """
    from refine.formats.files import load_motion

    paths = expand([name])
    if len(paths) > 1:
        raise UserError(name, f"matches {len(paths)} files, and one is wanted", f"name one, such as {paths[0]}")
    if name == STDIN:
        with input_path(name) as path:
            return replace(load_motion(path, rest_joints), source="standard input")
    if os.path.lexists(paths[0]) or paths[0].suffix:
        return load_motion(paths[0], rest_joints)
    check_action("neither a file nor a built-in action", name)
    return built_in(name, rest_joints, seed, seconds)


def check_action(where: str, name: str) -> None:
    """Refuse what is no built-in action; those that hold the word are offered, such as wave-left-hand for wave."""
    from refine.synthetic import ACTIONS

    check_known(where, name, [action for action in ACTIONS if name in action] or ACTIONS)


def built_in(name: str, rest_joints: "Tensor", seed: int, seconds: float = 4.0, fps: float = 30.0) -> "Motion":
    import torch

    from refine.synthetic import draw, perform

    return perform(draw(name, torch.Generator().manual_seed(seed), fps), round(seconds * fps), rest_joints)


def check_lam(lam: float) -> None:
    if not 0 <= lam <= 1:
        raise UserError("--lam", f"expected a weight between 0 and 1, got {lam}")


def clips_of(names: Sequence[str], rest_joints: "Tensor", seed: int, centred: bool = False) -> list["Motion"]:
    """Clips, aligned as by ``refine.composition.aligned``; a change of frame rate is said."""
    from refine.composition import aligned

    clips = [clip_of(name, rest_joints, seed + number) for number, name in enumerate(names)]
    for name, clip in zip(names, clips, strict=True):
        if clip.fps != clips[0].fps:
            say(f"refine: {name} has {clip.fps:g} fps, resampled to the {clips[0].fps:g} fps of {names[0]}")
    for clip in clips:
        if len(clip) < 2:
            raise UserError(clip.source, "has a single frame, which holds no motion", "give at least two frames")
    return aligned(*clips, centred=centred)


def pair_of(first: str, second: str, rest_joints: "Tensor", seed: int) -> tuple["Motion", "Motion"]:
    """``clips_of`` two, from their first frames."""
    i, j = clips_of((first, second), rest_joints, seed)
    return i, j


def judge_of(body: "Body", mae: Path | None = None) -> "Decoupler":
    """The decoupling loss that refinement uses, with the shipped MAE unless another is given."""
    from refine.decoupling import Decoupler
    from refine.mae import load_mae

    return Decoupler(body, load_mae(mae))


def refinement_of(steps: int | None, seed: int) -> "RefinementConfig":
    """The engine's own configuration, with another number of steps if one is given."""
    from refine.refinement import RefinementConfig

    if steps is None:
        return RefinementConfig(seed=seed)
    if steps < 0:
        raise UserError("--steps", f"expected 0 or more, got {steps}")
    return RefinementConfig(steps=steps, seed=seed)


@contextmanager
def bar(total: int, label: str) -> Iterator[Callable[..., None]]:
    """A progress bar to call after every step; silent when stderr is no terminal."""
    from tqdm import tqdm

    with tqdm(total=total, desc=label, disable=None, leave=False) as progress:
        yield lambda *_: progress.update()
