"""Labels files."""

import pytest

from refine.formats.labels import Row, read_labels
from renderers.checks import UserError


def written(tmp_path, text: str | bytes):
    path = tmp_path / "labels.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_files_and_labels(tmp_path):
    rows = read_labels(written(tmp_path, "file,label\na/walk_01.bvh,walk\nb.npz, wave both \n"))
    assert rows == [Row(2, "a/walk_01.bvh", "walk"), Row(3, "b.npz", "wave both")]


@pytest.mark.parametrize(
    "text",
    [
        "file,label,start,end\nwalk.bvh,walk,0.5,2\n",
        "\ufefffile,label,start,end\r\nwalk.bvh,walk,0.5,2\r\n",
        "file;label;start;end\nwalk.bvh;walk;0,5;2\n",
        "file\tlabel\tstart\tend\nwalk.bvh\twalk\t0.5\t2\n",
        "Label,END,note,File,start\nwalk,2,by hand,./walk.bvh,0.5\n",
        '"file","label","start","end"\n"walk.bvh","walk","0.5","2"',
    ],
)
def test_the_same_table_as_programs_write_it(tmp_path, text):
    assert [row._replace(line=2) for row in read_labels(written(tmp_path, text))] == [
        Row(2, "walk.bvh", "walk", 0.5, 2.0)
    ]


def test_quotes_blank_lines_other_scripts_and_backslashes(tmp_path):
    text = 'file,label\n\n"a, b.bvh","say ""hi"""\n,\n"two\nlines.bvh",x\na\\b.bvh,行走 🚶\n'
    rows = read_labels(written(tmp_path, text))
    assert [(row.file, row.label) for row in rows] == [
        ("a, b.bvh", 'say "hi"'),
        ("two\nlines.bvh", "x"),
        ("a/b.bvh", "行走 🚶"),
    ]
    assert [row.line for row in rows] == [3, 6, 7]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "labels.csv: is empty"),
        ("file,label\n", "labels.csv: names no file"),
        ("name,label\na,b\n", "line 1: expected headings with file and label, got name, label"),
        ("walk.bvh,walk\n", "line 1: expected headings with file and label"),
        ("file,label,label\na,b,c\n", "line 1: has two columns called label"),
        ("file,label,start,end_frame\na,b,0,1\n", "line 1: counts pieces in seconds and in frames"),
        ("file,label\na.bvh\n", "line 2: has 1 cells, the headings are 2"),
        ("file,label\na.bvh,walk,fast\n", "line 2: has 3 cells, the headings are 2"),
        ("file,label\na.bvh,walk\nb.bvh, \n", "line 3: names no label"),
        ("file,label\n,walk\n", "line 2: names no file"),
        ("file,label\na.bvh,\x1b[31mred\n", r"line 2: has a label that is no name ('\x1b[31mred')"),
        ("file,label\na.bvh," + "x" * 201 + "\n", "line 2: has a label that is no name"),
        ("file,label,start,end\na,b,one,2\n", "line 2: has 'one' for its start, which is not a time in seconds"),
        ("file,label,start,end\na,b,nan,2\n", "line 2: has 'nan' for its start"),
        ("file,label,start,end\na,b,-1,2\n", "line 2: has '-1' for its start"),
        ("file,label,start,end\na,b,0,inf\n", "line 2: has 'inf' for its end"),
        ("file,label,start,end\na,b,2,2\n", "line 2: ends at 2, where it starts or before"),
        ("file,label,start,end\na,b,,0\n", "line 2: ends at 0, where it starts or before"),
        ("file,label,start_frame\na,b,1.5\n", "line 2: has '1.5' for its start_frame, which is not a number of frames"),
        ('file,label\n"a,b\n', "is not CSV"),
        ("file,label\na," + "x" * 140_000 + "\n", "line 2: is not CSV (field larger than field limit"),
        (b"file,label\na,\xff\xfe\n", "labels.csv: is not UTF-8 text (byte 13)"),
        (b"file,label\na,b\0c\n", "labels.csv: is no text"),
    ],
)
def test_what_is_wrong_is_one_line_that_names_the_row(tmp_path, text, said):
    with pytest.raises(UserError) as caught:
        read_labels(written(tmp_path, text))
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert str(tmp_path / "labels.csv") in str(caught.value)


def test_a_table_too_large_or_missing_is_refused(tmp_path, monkeypatch):
    with pytest.raises(UserError, match="nowhere.csv"):
        read_labels(tmp_path / "nowhere.csv")
    path = written(tmp_path, "file,label\na,b\nc,d\ne,f\n")
    monkeypatch.setattr("refine.formats.labels.MAX_ROWS", 2)
    with pytest.raises(UserError, match="has more than 2 rows"):
        read_labels(path)
    monkeypatch.setattr("refine.formats.labels.MAX_BYTES", 5)
    with pytest.raises(UserError, match="labels.csv: has 23 bytes"):
        read_labels(path)


@pytest.mark.parametrize(
    ("start", "end", "in_frames", "frames"),
    [
        (None, None, False, (0, 60)),
        (0.5, None, False, (15, 60)),
        (None, 1.0, False, (0, 30)),
        (0.5, 2.0, False, (15, 60)),
        (0.0, 61 / 30, False, (0, 60)),  # a second of 30 frames may be counted as 31 moments
        (10.0, 20.0, True, (10, 20)),
        (59.0, None, True, (59, 60)),
    ],
)
def test_pieces_in_frames(start, end, in_frames, frames):
    assert Row(2, "a", "b", start, end, in_frames).frames(60, 30.0, "line 2") == frames


@pytest.mark.parametrize(
    ("start", "end", "in_frames"), [(2.0, None, False), (0.0, 2.1, False), (0.0, 61.0, True), (0.51, 0.511, False)]
)
def test_pieces_outside_or_without_a_frame_are_refused(start, end, in_frames):
    with pytest.raises(UserError, match="line 2: asks for frames .* of a clip of 60 frames at 30 a second"):
        Row(2, "a", "b", start, end, in_frames).frames(60, 30.0, "line 2")
