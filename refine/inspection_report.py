"""What an inspection found, in lines, as a sheet of pictures, and as one page."""

import html
import json
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from refine.drawing import strip
from refine.formats.describing import Clip
from refine.formats.files import Reading, load_motions
from refine.inspection import Inspection
from refine.motion import Motion, crop
from refine.oddities import Oddity
from refine.report import in_base64, table
from refine.viewer.page import MOST, page
from renderers.body import Body
from renderers.checks import UserError
from renderers.images import contact_sheet, save_png

SHOWN = 12  # clips on a sheet
LISTED = 30  # clips and odd clips that are listed one by one
NAMED = 20  # labels, and files that cannot be read
WIDEST = 1500  # pixels
POSES, HEIGHT = 10, 150  # of a row of a sheet
PLAYED = 10.0  # seconds of a clip that the page plays
SHEET, PAGE, VALUES = "clips.png", "report.html", "report.json"


# --- lines -----------------------------------------------------------------------------------------------------------


def lines(inspection: Inspection) -> list[str]:
    """What there is to know, for people: a summary, the labels, and the clips, or of many those that are odd."""
    rows = [*summary(inspection), ("", "")]
    found = [f"{name:<11} {value}".rstrip() for name, value in rows]
    labels = list(inspection.labels().items())
    if len(labels) > 1:
        found += [f"{count:5d}  {label}" for label, count in labels[:NAMED]]
        found += [f"       and {len(labels) - NAMED} more labels"] if len(labels) > NAMED else []
        found.append("")
    found += _in_columns([HEAD, *clip_rows(inspection)])
    if len(inspection.files) == 1 and (mapping := inspection.files[0].mapping):
        found += ["", *mapping.report()]
    return found


def summary(inspection: Inspection) -> list[tuple[str, str]]:
    """Pairs of a heading and what to say under it."""
    clips = inspection.clips
    seconds = sorted(clip.seconds for clip in clips)
    lengths = f"{seconds[0]:.1f} to {seconds[-1]:.1f} s each, {statistics.median(seconds):.1f} in the middle"
    frames = sum(clip.frames for clip in clips)
    total = f"{len(clips):,} with {frames:,} frames in {_duration(sum(seconds))}"
    read = [file for file in inspection.files if not file.problem]
    units = dict(Counter(f"{file.unit} ({file.unit_by})" for file in read).most_common())
    odd = [f"{count:,} with {name}" for name, count in inspection.oddities().items()]
    rates = dict(Counter(f"{clip.fps:g}" for clip in clips).most_common())
    ahead = sum(abs(clip.facing) <= 45 for clip in clips)
    facing = f"{ahead:,} of {len(clips):,} clips begin facing +z"
    if len(clips) == 1:
        side = "left" if clips[0].facing >= 0 else "right"
        facing = f"begins facing {abs(clips[0].facing):.0f} degrees to the {side} of +z"
    rows = [
        ("what", f"{inspection.source}: {_counted(inspection.count('kind'))}"),
        ("clips", f"{total}; {lengths}" if len(clips) > 1 else total),
        ("rate", f"{_counted(rates)} frames a second"),
        ("frame", f"{_counted(inspection.count('up'))} up; {facing}"),
        ("unit", _counted(units)),
        ("skeleton", _counted(inspection.count("skeleton"))),
        ("odd", ", ".join(odd) or "nothing found"),
    ]
    notes = dict.fromkeys(note for file in inspection.files for note in file.notes)
    rows += [("note", note) for note in list(notes)[:NAMED]]
    unread = inspection.unread
    rows += [("not read", problem) for problem in unread[:NAMED]]
    return rows + ([("", f"and {len(unread) - NAMED} more, {len(unread)} in all")] if len(unread) > NAMED else [])


HEAD = ("clip", "label", "frames", "fps", "seconds", "facing", "travel m", "odd")


def clip_rows(inspection: Inspection) -> list[tuple[str, ...]]:
    """The clips, one a row under `HEAD`; of many the odd ones, as far as there is room."""
    clips = inspection.clips
    if len(clips) > LISTED:
        clips = [clip for clip in clips if clip.oddities][:LISTED]
    return [_row(clip) for clip in clips]


def _row(clip: Clip) -> tuple[str, ...]:
    odd = "; ".join(said(oddity) for oddity in clip.oddities)
    numbers = f"{clip.frames}", f"{clip.fps:g}", f"{clip.seconds:.2f}", f"{round(clip.facing)}", f"{clip.travel:.2f}"
    return clip.source, clip.label, *numbers, odd or "-"


def said(oddity: Oddity) -> str:
    return f"{oddity.name}: {oddity.text}" + ("" if oddity.frame is None else f", from frame {oddity.frame}")


def _in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    if len(rows) < 2:
        return []
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = (0, 1, len(widths) - 1)  # the others are numbers
    pads = [f"<{width}" if place in texts else f">{width}" for place, width in enumerate(widths)]
    return ["  ".join(f"{cell:{pad}}" for cell, pad in zip(row, pads, strict=True)).rstrip() for row in rows]


def _counted(counts: dict[str, int]) -> str:
    """Values with how often each is there, or the one alone."""
    many = len(counts) > 1
    return ", ".join(f"{count:,} {value}" if many else value for value, count in list(counts.items())[:8])


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.1f} s"
        if seconds < 120
        else f"{seconds / 60:.0f} min"
        if seconds < 7200
        else f"{seconds / 3600:.1f} h"
    )


# --- pictures --------------------------------------------------------------------------------------------------------


def write_report(
    folder: Path, inspection: Inspection, body: Body, reading: Reading, progress: Callable[[], None] = lambda: None
) -> None:
    """Write ``clips.png``, ``report.html`` and ``report.json`` into a folder.

    Args:
        folder: exists; see ``renderers.outputs.replacing_folder``.
        reading: as the files were read for the inspection.
        progress: called after each clip that is drawn.
    """
    shown = motions_of(inspection, chosen(inspection.clips, SHOWN), body.rest_joints, reading)
    save_png(folder / SHEET, sheet(shown, body, progress))
    (folder / VALUES).write_text(json.dumps(inspection.values(), indent=1) + "\n")
    moving = [crop(motion, 0, min(len(motion), round(PLAYED * motion.fps) + 1)) for _, motion in shown[:MOST]]
    roles = [clip.oddities[0].name if clip.oddities else "" for clip, _ in shown[:MOST]]
    lead = f"{len(inspection.clips):,} clips. These are some of them, odd ones first; the tables are below."
    below = sections(inspection, folder / SHEET)
    (folder / PAGE).write_text(page(moving, body, roles, Path(inspection.source).name, lead, below=below))


def chosen(clips: Sequence[Clip], count: int) -> list[Clip]:
    """Some clips to look at: odd ones up to a half, one of each oddity first, then one of each label, then others."""
    picked: dict[int, Clip] = {}

    def pick(candidates: Sequence[Clip], key: Callable[[Clip], str], limit: int):
        met: set[str] = set()
        for clip in candidates:
            if len(picked) < limit and key(clip) not in met:
                met.add(key(clip))
                picked.setdefault(id(clip), clip)

    odd = [clip for clip in clips if clip.oddities]
    pick(odd, lambda clip: clip.oddities[0].name, count // 2)
    pick(odd, lambda clip: str(id(clip)), count // 2)
    pick(clips, lambda clip: clip.label, count)
    pick(clips, lambda clip: str(id(clip)), count)
    return list(picked.values())


def motions_of(
    inspection: Inspection, clips: Sequence[Clip], rest_joints: Tensor, reading: Reading
) -> list[tuple[Clip, Motion]]:
    """The motions of clips, read again; what has gone since is left out."""
    wanted = {id(clip) for clip in clips}
    found: dict[int, Motion] = {}
    for file in inspection.files:
        if file.path and any(id(clip) in wanted for clip in file.clips):
            try:
                motions = load_motions(file.path, rest_joints, reading)
            except UserError:
                continue
            found |= {id(clip): motion for clip, motion in zip(file.clips, motions, strict=False)}
    return [(clip, found[id(clip)]) for clip in clips if id(clip) in found]


def sheet(shown: Sequence[tuple[Clip, Motion]], body: Body, progress: Callable[[], None] = lambda: None) -> Tensor:
    """Clips as rows of poses [3 H W], each at a scale of its own, so that an odd one spoils no other."""
    rows, captions = [], []
    for clip, motion in shown:
        rows.append([_row_of_poses(motion, body)])
        odd = "; ".join(map(said, clip.oddities))
        captions.append(f"{clip.label}, {clip.seconds:.1f} s, {clip.source[-60:]}" + (f"  [{odd}]" if odd else ""))
        progress()
    return contact_sheet(rows, captions)


def _row_of_poses(motion: Motion, body: Body) -> Tensor:
    """One picture, not wider than `WIDEST`, of poses that stand on the floor."""
    lowest = motion.joints(body.rest_joints)[..., 1].min() - body.rest_joints[:, 1].min()
    motion = replace(motion, root=motion.root - torch.stack([lowest * 0, lowest, lowest * 0]))
    poses = POSES
    while True:
        [row] = strip([motion], body, poses, HEIGHT)
        if row.shape[2] <= WIDEST or poses == 1:
            return row[:, :, :WIDEST]
        poses = max(1, poses * WIDEST // row.shape[2])


def sections(inspection: Inspection, picture: Path) -> str:
    """HTML: the summary, the labels, the clips and the sheet."""
    escape = html.escape
    about = [(escape(name), escape(value)) for name, value in summary(inspection)]
    labels = [(escape(label), f"{count:,}") for label, count in inspection.labels().items()]
    rows = [tuple(map(escape, row)) for row in clip_rows(inspection)]
    listed = "Clips" if len(rows) == len(inspection.clips) else "Odd clips"
    return f"""<h2>What it is</h2>{table(("", ""), about)}
<h2>Labels</h2>{table(("label", "clips"), labels)}
{f"<h2>{listed}</h2>" + table(HEAD, rows) if rows else ""}
<h2>Some clips, from the first frame to the last</h2>
<figure><img alt="Rows of poses" src="data:image/png;base64,{in_base64(picture)}"></figure>
"""
