import os

import pytest

from renderers.checks import UserError
from renderers.outputs import refuse_existing, replacing, replacing_folder


def names(folder) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_file_takes_its_name_at_the_end(tmp_path):
    with replacing(tmp_path / "new" / "a.txt") as partial:
        partial.write_text("whole")
        assert not (tmp_path / "new" / "a.txt").exists()
    assert (tmp_path / "new" / "a.txt").read_text() == "whole"
    assert names(tmp_path) == ["new", "new/a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_broken_write_leaves_the_old_file_alone(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(error), replacing(tmp_path / "a.txt") as partial:
        partial.write_text("half")
        raise error
    assert (tmp_path / "a.txt").read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_a_folder_gives_way_only_to_a_whole_one(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old").write_text("")
    with pytest.raises(KeyboardInterrupt), replacing_folder(tmp_path / "out") as partial:
        (partial / "half").write_text("")
        raise KeyboardInterrupt
    assert names(tmp_path) == ["out", "out/old"]
    with replacing_folder(tmp_path / "out") as partial:
        (partial / "new").write_text("")
    assert names(tmp_path) == ["out", "out/new"]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(UserError, match=r"file/a.txt: cannot be written .*; choose another place"),
        replacing(tmp_path / "file" / "a.txt"),
    ):
        pass


def test_what_is_there_is_refused_without_force(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("")
    for free in ("none", "empty"):
        refuse_existing(tmp_path / free, folder=True)
    for taken, folder in (("full", True), ("full/a.txt", False)):
        with pytest.raises(UserError, match="is already there; choose another name or pass --force"):
            refuse_existing(tmp_path / taken, folder=folder)
        refuse_existing(tmp_path / taken, force=True, folder=folder)


def test_force_never_puts_a_folder_for_a_file_or_the_other_way_round(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="folder: is a folder"):
        refuse_existing(tmp_path / "folder", force=True)
    with pytest.raises(UserError, match="file: is a file"):
        refuse_existing(tmp_path / "file", force=True, folder=True)


def test_what_could_not_be_written_is_refused_beforehand(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file is a file"):
        refuse_existing(tmp_path / "file" / "new" / "a.txt")
    for nameless in (".", "..", "/"):
        with pytest.raises(UserError, match="is no name for an output; name a new folder"):
            refuse_existing(nameless, folder=True)
    refuse_existing(tmp_path / "new" / "a.txt")
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere, so ask for the answer of others
    with pytest.raises(UserError, match="no permission to write"):
        refuse_existing(tmp_path / "new" / "a.txt")


def test_an_older_folder_survives_when_the_new_one_cannot_take_its_name(tmp_path, monkeypatch):
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "old.txt").write_text("old")
    rename = os.replace

    def refuse_the_new(source, target):
        if str(source).endswith(".part"):
            raise OSError(28, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(os, "replace", refuse_the_new)
    with pytest.raises(UserError, match="No space left"), replacing_folder(folder) as partial:
        (partial / "new.txt").write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["report"]
    assert (folder / "old.txt").read_text() == "old"
