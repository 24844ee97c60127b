"""Labels files: which action is in which motion file, and from when to when.

A CSV table with a line of headings: ``file,label``, and if a file is cut into pieces ``start,end`` in seconds, or
``start_frame,end_frame``, the end not counted. An empty start is the beginning, an empty end the end. Semicolons and
tabs serve as well as commas, for spreadsheets write them.
"""

import csv
import io
import math
from pathlib import Path
from typing import NamedTuple

from refine.formats.untrusted import read_bytes
from renderers.checks import UserError

MAX_BYTES = 1 << 26
MAX_ROWS = 1_000_000
MAX_COLUMNS = 100
MAX_LETTERS = 200  # of a label
SECONDS, FRAMES = ("start", "end"), ("start_frame", "end_frame")


class Row(NamedTuple):
    """One line: a label for a file, or for a piece of it."""

    line: int
    file: str  # as written, with forward slashes
    label: str
    start: float | None = None  # seconds, or a whole number of frames
    end: float | None = None
    in_frames: bool = False

    def frames(self, length: int, fps: float, where: str) -> tuple[int, int]:
        """First frame, and the one behind the last, of a clip of so many frames.

        Raises:
            UserError: the piece lies outside the clip, or has no frame.
        """
        rate = 1.0 if self.in_frames else fps
        start = 0 if self.start is None else round(self.start * rate)
        end = length if self.end is None else round(self.end * rate)
        if end == length + 1 and not self.in_frames:  # seconds are counted to the end of the last frame, or rounded
            end = length
        if not start < end <= length:
            has = f"{length} frames at {fps:g} a second"
            raise UserError(where, f"asks for frames {start} to {end} of a clip of {has}", "mend its start and end")
        return start, end


def read_labels(path: str | Path) -> list[Row]:
    """Read a labels file, in the order of its lines.

    Raises:
        UserError: it is missing, too large or no such table; the message names the line.
    """
    path = Path(path)
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(path, f"is not UTF-8 text (byte {error.start})", "save it as CSV in UTF-8") from error
    if "\0" in text:
        raise UserError(path, "is no text (it holds zero bytes)", "save it as CSV in UTF-8")
    head = text.partition("\n")[0]
    delimiter = max(",;\t", key=head.count)
    table = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[Row] = []
    columns: list[str] | None = None
    try:
        for cells in table:
            where = f"{path}, line {table.line_num}"
            if not any(cell.strip() for cell in cells):
                continue
            if columns is None:
                columns = _columns(where, cells)
            elif len(rows) == MAX_ROWS:
                raise UserError(path, f"has more than {MAX_ROWS:,} rows", "split it")
            else:
                rows.append(_row(where, table.line_num, dict(zip(columns, cells, strict=False)), len(cells), columns))
    except csv.Error as error:
        raise UserError(f"{path}, line {table.line_num}", f"is not CSV ({error})", "mend its quotes") from error
    if not rows:
        raise UserError(path, "names no file", "write a line file,label, and one for each clip below it")
    return rows


def _columns(where: str, cells: list[str]) -> list[str]:
    if len(cells) > MAX_COLUMNS:
        raise UserError(where, f"has {len(cells)} headings, up to {MAX_COLUMNS} are read", "leave columns out")
    columns = [cell.strip().lower() for cell in cells]
    if not {"file", "label"} <= set(columns):
        named = ", ".join(columns)[:60]
        raise UserError(where, f"expected headings with file and label, got {named}", "begin with a line file,label")
    twice = {name for name in columns if name and columns.count(name) > 1}
    if twice:
        raise UserError(where, f"has two columns called {min(twice)}", "name every column once")
    if set(SECONDS) & set(columns) and set(FRAMES) & set(columns):
        raise UserError(where, "counts pieces in seconds and in frames", "keep start,end or start_frame,end_frame")
    return columns


def _row(where: str, line: int, cells: dict[str, str], count: int, columns: list[str]) -> Row:
    if count != len(columns):
        raise UserError(where, f"has {count} cells, the headings are {len(columns)}", "quote what holds a comma")
    file, label = cells["file"].strip().replace("\\", "/"), cells["label"].strip()
    for name, value in (("file", file), ("label", label)):
        if not value:
            raise UserError(where, f"names no {name}", "fill it in, or take the line out")
    if len(label) > MAX_LETTERS or not label.isprintable():
        raise UserError(where, f"has a label that is no name ({label[:20]!r})", f"use at most {MAX_LETTERS} letters")
    in_frames = FRAMES[0] in columns or FRAMES[1] in columns
    bounds = [
        _bound(where, name, cells.get(name, "").strip(), in_frames) for name in (FRAMES if in_frames else SECONDS)
    ]
    start, end = bounds
    if end is not None and end <= (start or 0):
        raise UserError(where, f"ends at {end:g}, where it starts or before", "mend its start and end")
    return Row(line, file.removeprefix("./"), label, start, end, in_frames)


def _bound(where: str, name: str, text: str, in_frames: bool) -> float | None:
    if not text:
        return None
    try:
        value = float(int(text) if in_frames else float(text.replace(",", ".")))
    except ValueError:
        value = math.nan
    if not 0 <= value < 1e9:
        what = "a number of frames" if in_frames else "a time in seconds"
        raise UserError(where, f"has {text[:20]!r} for its {name}, which is not {what}", "mend it")
    return value
