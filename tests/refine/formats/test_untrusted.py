"""The one door: what may come in, what a file is, and that nobody goes round it."""

import ast
import json
import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from refine.formats.files import load_motions
from refine.formats.smpl import load_body
from refine.formats.untrusted import START, kind_of, kind_of_start, opened, parse_json, read_bytes, read_json
from renderers.checks import LONGEST, UserError, printable

SEEDS = Path(__file__).parent / "seeds"
ROOT = Path(__file__).resolve().parents[3]

KINDS = {
    "bvh": (b"HIERARCHY\nROOT", b"\xef\xbb\xbf\r\n  hierarchy\r\n"),
    "amc": (b"#!OML:ASF H:\n:FULLY-SPECIFIED\n:DEGREES\n1\n", b"\n\n# a\n:degrees\n"),
    "asf": (b"# AST/ASF file\n# made by hand\n:version 1.10\n", b":units\n"),
    "glb": (b"glTF\2\0\0\0",),
    "gltf": (b'{"asset":{"version":"2.0"}}', b' \n{ "scene" : 0, "asset" : {} }'),
    "json": (b'{"format": "refine-motion"}', b"[1, 2]"),
    "npz": (b"PK\3\4\x14\0", b"PK\5\6" + bytes(18)),
    "npy": (b"\x93NUMPY\1\0",),
    "pickle": (*(pickle.dumps({"poses": [np.zeros(3)]}, protocol) for protocol in range(6)), b"(dp1\nS'poses'\np2\n"),
    "safetensors": (struct.pack("<Q", 0x8B1F) + b'{"a":', struct.pack("<Q", 0xFEFF) + b'{"a":'),  # gzip's and UTF-16's
    "": (b"\x89PNG\r\n", b"HIERARCHYX", b"HIERARCHY\n\0", b"hello", b"\x80", b":nothing\n", b"MZ", b"#!/bin/sh\n"),
}


@pytest.mark.parametrize(("kind", "content"), [(kind, content) for kind, all_ in KINDS.items() for content in all_])
def test_content_decides_and_the_name_does_not(tmp_path, kind, content):
    for name in ("file", "file.bvh", "file.npz", "file.pkl"):
        (tmp_path / name).write_bytes(content)
        assert kind_of(tmp_path / name) == kind


@given(st.binary(max_size=200))
def test_whatever_a_file_begins_with_it_is_of_one_kind(start):
    assert kind_of_start(start) in KINDS


def test_bytes_come_as_they_are_up_to_the_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"\xef\xbb\xbf 12345")
    assert read_bytes(tmp_path / "file", 9) == b"\xef\xbb\xbf 12345"
    with pytest.raises(UserError, match="file: has 9 bytes, more than the 8 that are read"):
        read_bytes(tmp_path / "file", 8)


def test_a_link_says_where_it_leads_and_folders_on_the_way_may_be_links(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").write_bytes(b"1")
    (tmp_path / "way").symlink_to("folder")
    assert read_bytes(tmp_path / "way" / "file", 1) == b"1"
    (tmp_path / "link").symlink_to("folder/file")
    with pytest.raises(UserError, match=r"link: is a link to 'folder/file', and links are not followed; give the file"):
        read_bytes(tmp_path / "link", 1)


def test_a_link_put_there_after_the_first_look_is_not_followed(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"1")
    (tmp_path / "link").symlink_to("file")
    regular = os.lstat(tmp_path / "file")
    monkeypatch.setattr("refine.formats.untrusted.os.lstat", lambda _path: regular)
    with pytest.raises(UserError, match="cannot be read"):
        read_bytes(tmp_path / "link", 1)


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"12")
    before = os.stat(tmp_path / "file")

    class Growing:
        def __getattr__(self, name):
            return 1 if name == "st_size" else getattr(before, name)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("refine.formats.untrusted.os.fstat", lambda _number: Growing())
        with pytest.raises(UserError, match="grew while it was read"):
            read_bytes(tmp_path / "file", 10)


def test_a_file_without_permission_is_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"1")
    (tmp_path / "file").chmod(0)
    if os.access(tmp_path / "file", os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(UserError, match=r"cannot be read \(Permission denied\)"):
        read_bytes(tmp_path / "file", 1)


def test_nothing_stays_open(tmp_path):
    (tmp_path / "file").write_bytes(b"x" * 2 * START)
    with opened(tmp_path / "file", 1 << 20) as stream:
        assert stream.tell() == 0 and len(stream.read()) == 2 * START
    assert stream.closed


def test_json(tmp_path):
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": [1, 2.5, null, "\\u00e9"]}')
    assert read_json(tmp_path / "a.json") == {"a": [1, 2.5, None, "é"]}
    for content in (b"NaN", b"[-Infinity]", b"{", b"'a'", b"\xff", b"[" * 10_000, b"9" * 5000, b'{"a": 1} 2'):
        with pytest.raises(UserError, match="a.json: is ") as caught:
            parse_json("a.json", content)
        assert "\n" not in str(caught.value)


def test_objects_with_a_key_twice_are_refused_where_that_is_asked_for(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": {"walk": 1, "walk": 2}}')
    assert read_json(path) == {"a": {"walk": 2}}
    with pytest.raises(UserError, match="has 'walk' twice"):
        read_json(path, unique=True)
    path.write_text('[{"a": 1}, {"a": 2}]')
    assert read_json(path, unique=True) == [{"a": 1}, {"a": 2}]


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=10,
    )
)
def test_any_json_comes_back(value):
    assert parse_json("a", json.dumps(value).encode()) == value


@given(st.text())
def test_messages_are_one_printable_line(text):
    message = str(UserError(text, text, text))
    assert all(character.isprintable() or character == "\t" for character in message)
    assert len(message) <= LONGEST + 3
    assert printable("walk 1 é 走") == "walk 1 é 走"


# --- seeds ------------------------------------------------------------------------------------------------------------

READ = {"smpl.bvh", "walk.amc", "amass.npz", "clips.npz", "smpl.glb", "humanact.pickle"}


@pytest.mark.parametrize("seed", sorted(path.name for path in SEEDS.iterdir() if path.suffix != ".dict"))
def test_what_fuzzing_starts_from_is_read_or_refused(seed, rest_joints, tmp_path):
    (tmp_path / "walk.asf").write_bytes((SEEDS / "skeleton.asf").read_bytes())
    path = tmp_path / seed
    path.write_bytes((SEEDS / seed).read_bytes())
    try:
        motions = load_motions(path, rest_joints)
    except UserError as error:
        assert seed not in READ, error
    else:
        assert seed in READ and len(motions[0])
    with pytest.raises(UserError):
        load_body(path)


# --- nobody goes round it ---------------------------------------------------------------------------------------------

SOURCES = sorted(path for package in ("refine", "renderers", "train") for path in (ROOT / package).rglob("*.py"))
# What runs code of a file, or unpacks where it likes.
NEVER = {
    "eval",
    "exec",
    "pickle.load",
    "pickle.loads",
    "marshal.loads",
    "yaml.load",
    "os.system",
    "extractall",
    "extract",
}
# How readers would open a file themselves.
AROUND = {"open", "read_text", "read_bytes", "fromfile", "loadtxt", "genfromtxt", "memmap"}


def calls(path: Path) -> list[tuple[str, ast.Call]]:
    """Every call in a file, by the name as it is written."""
    return [
        (ast.unparse(node.func), node) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
    ]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_nothing_in_a_file_is_ever_run(path):
    for name, call in calls(path):
        assert name not in NEVER and name.rpartition(".")[2] not in ("extractall", "extract"), name
        given = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
        assert name != "torch.load" or given.get("weights_only") == "True"
        assert "load" not in name or given.get("allow_pickle", "False") == "False"
        assert given.get("shell", "False") == "False"


@pytest.mark.parametrize("path", sorted((ROOT / "refine" / "formats").glob("*.py")), ids=lambda path: path.name)
def test_readers_open_no_file_themselves(path):
    if path.name in ("untrusted.py", "fbx_blender.py"):  # the door, and a program that Blender runs on our own files
        pytest.skip("opens files for others")
    for name, call in calls(path):
        method = name.rpartition(".")[2]
        if method not in AROUND or name in ("read_bytes", "np.loadtxt"):  # what comes through the door, and text of it
            continue
        assert method == "open", f"{name}, line {call.lineno}"
        assert name in ("packed.open", "stored.open") or '"w' in ast.unparse(call).replace("'", '"'), call.lineno
