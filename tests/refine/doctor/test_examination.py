"""The doctor: what it finds here, what it says of what does not work, and that nothing stops it."""

import json
import sys
from importlib import metadata
from pathlib import Path

import pytest
import torch

from refine.cli.doctor import COLOURS, page
from refine.cli.main import main
from refine.doctor import examination, installed, machine, trials
from refine.doctor.asking import ask
from refine.doctor.examination import examine, steps
from refine.doctor.findings import Finding, healthy, size
from renderers.checks import UserError


@pytest.fixture
def no_programs(monkeypatch):
    """Without the trials that start Python anew, which take seconds each."""
    answers = {trials.DRAW: {"variants": ["scalar_rgb", "a", "b"], "version": "3", "area": 128.0}, trials.FIND: "/l.so"}
    monkeypatch.setattr(trials, "ask", lambda code, *_, **__: answers[code])
    monkeypatch.delenv("BPY_PYTHON", raising=False)


def only(findings) -> Finding:
    [found] = findings
    return found


# --- all of it -------------------------------------------------------------------------------------------------------


def test_all_that_is_needed_works_here(no_programs):
    seen = []
    findings = list(examine(progress=lambda: seen.append(1)))
    assert len(seen) == steps()
    assert healthy(findings), [each for each in findings if each.state != "ok"]
    named = {each.name: each for each in findings}
    assert named["torch"].values["version"] == torch.__version__.partition("+")[0] or named["torch"].state == "ok"
    assert named["refinement"].values["after"] < 0.8 * named["refinement"].values["before"]
    assert named["free, light"].values["vertices"] == 1800
    assert all(each.remedy for each in findings if each.state != "ok")
    assert not any(each.remedy for each in findings if each.state == "ok")
    assert {each.about for each in findings} == {
        "versions", "machine", "rendering", "files", "bodies", "self-test"
    }  # fmt: skip


def test_the_verb_prints_lines_or_json_and_says_by_its_code(no_programs, capsys, monkeypatch, tmp_path):
    checks = [check for check in examination._checks(()) if check[0] == "machine"]
    monkeypatch.setattr(
        examination,
        "_checks",
        lambda bodies: [*checks, *(("bodies", str(p), lambda about, p=p: trials.try_body(about, p)) for p in bodies)],
    )
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("machine\n  ok      processor") and printed.endswith("all that is needed works\n")
    (tmp_path / "a.npz").write_bytes(b"no body")
    assert main(["doctor", "--body", str(tmp_path / "*.npz"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["healthy"] is False and found["verb"] == "doctor"
    last = found["findings"][-1]
    assert (last["about"], last["state"], last["needed"]) == ("bodies", "broken", True) and last["remedy"]


def test_what_breaks_in_its_own_way_is_a_finding_too(monkeypatch):
    def breaks(about):
        yield Finding(about, "first", "ok", "there")
        raise RuntimeError("core on fire")

    def refuses(about):
        raise UserError("here", "is wrong", "turn it round")
        yield

    monkeypatch.setattr(examination, "_checks", lambda _: [("a", "one", breaks), ("b", "two", refuses)])
    first, fire, wrong = examine()
    assert first.state == "ok"
    assert (fire.about, fire.name, fire.state, fire.found) == ("a", "one", "broken", "RuntimeError: core on fire")
    assert "reinstall" in fire.remedy
    assert (wrong.found, wrong.remedy) == ("here: is wrong", "turn it round")


def test_the_page():
    findings = [
        Finding("versions", "Python", "ok", "3.12"),
        Finding("files", "Blender", "missing", "not set", "set it", needed=False),
        Finding("files", "MP4", "broken", "no codec", "get one"),
    ]
    assert page(findings, False).splitlines() == [
        "versions",
        "  ok      Python   3.12",
        "",
        "files",
        "  missing Blender  not set",
        "                   optional: set it",
        "  broken  MP4      no codec",
        "                   get one",
        "",
        "1 thing that is needed does not work",
    ]
    assert healthy(findings[:2]) and not healthy(findings)
    assert set(COLOURS) == {"ok", "missing", "broken"}


# --- what is installed, what the machine is --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "bound", "fits"),
    [
        ("2.11.0+cpu", ">=2.11", True),
        ("2.9", ">=2.11", False),
        ("3.9.1", "<3.10", True),
        ("3.10", "<3.10", False),
        ("3.10.0", "<3.10", False),
        ("5.0.0.93", ">=4.10", True),
        ("1", "!=1", True),
    ],
)
def test_versions_are_compared_by_their_numbers(version, bound, fits):
    assert installed._within(version, bound) is fits


def test_packages_that_are_missing_or_old_are_named(monkeypatch):
    versions = {"refine-motion": "0.1.0", "old": "1.2", "new": "9"}

    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    asked = ["old<3,>=2", "new>=2", "gone>=1", "extra>=1; extra == 'test'"]
    monkeypatch.setattr(installed.metadata, "requires", lambda name: asked)
    monkeypatch.setattr(installed.metadata, "version", version)
    found = {each.name: each for each in installed.find_packages("versions")}
    assert {name: each.state for name, each in found.items()} == {
        "refine-motion": "ok",
        "gone": "missing",
        "new": "ok",
        "old": "broken",
    }
    assert found["old"].found == "1.2, and <3,>=2 is needed" and found["old"].remedy == "pip install 'old<3,>=2'"
    assert found["gone"].remedy == "pip install 'gone>=1'"


def test_files_that_ship_and_are_not_there(monkeypatch, tmp_path):
    monkeypatch.setattr(installed, "ROOM", tmp_path)
    assert {each.state for each in installed.find_assets("files")} == {"missing"}


def test_the_machine_as_its_files_say(monkeypatch, tmp_path):
    (tmp_path / "driver/nvidia").mkdir(parents=True)
    (tmp_path / "cpuinfo").write_text("processor : 0\nmodel name\t: Some  CPU @ 3 GHz\n")
    (tmp_path / "meminfo").write_text("MemTotal:  2048 kB\nMemFree: 1 kB\nMemAvailable:  1024 kB\n")
    (tmp_path / "memory.max").write_text("1048576\n")
    words = "NVRM version: NVIDIA UNIX Open Kernel Module for x86_64  570.86.15  Release Build\n"
    (tmp_path / "driver/nvidia/version").write_text(words)
    monkeypatch.setattr(machine, "PROC", tmp_path)
    monkeypatch.setattr(machine, "CGROUP", tmp_path)
    assert machine.processor() == "Some CPU @ 3 GHz"
    assert machine.memory() == {"total": 2 << 20, "available": 1 << 20, "limit": 1 << 20}
    assert machine.driver_version() == "570.86.15"
    assert "1.0 MiB limit" in only(machine.find_memory("machine")).found


@pytest.mark.parametrize(
    ("cuda", "driver", "state", "words"),
    [
        (None, "", "missing", "PyTorch for processors alone"),
        (None, "570.1", "missing", "driver 570.1, but PyTorch is for processors alone"),
        ("12.8", "", "missing", "no NVIDIA driver"),
        ("12.8", "470.1", "broken", "PyTorch cannot use it"),
    ],
)
def test_why_there_is_no_graphics_card(monkeypatch, cuda, driver, state, words):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", cuda)
    monkeypatch.setattr(machine, "driver_version", lambda: driver)
    found = only(machine.find_graphics_card("machine"))
    assert (found.state, found.needed) == (state, False)
    assert words in found.found and found.remedy


def test_a_graphics_card_that_fails_is_not_needed(monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("CUDA error: no kernel image is available\nfurther lines")

    card = type("Card", (), {"name": "Old Card", "total_memory": 1 << 30})
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda _: card)
    monkeypatch.setattr(torch, "ones", fail)
    found = only(machine.find_graphics_card("machine"))
    assert (found.state, found.needed) == ("broken", False) and found.remedy
    assert found.found == "Old Card does not compute (CUDA error: no kernel image is available)"


def test_a_full_disk(monkeypatch):
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 10_000})())
    found = only(machine.find_disk("machine"))
    assert (found.state, found.found.partition(" free")[0]) == ("broken", "9.8 KiB") and "TMPDIR" in found.remedy


@pytest.mark.parametrize(
    ("count", "words"), [(0, "0 bytes"), (1536, "1.5 KiB"), (3 << 20, "3.0 MiB"), (5 << 30, "5.0 GiB")]
)
def test_sizes_in_words(count, words):
    assert size(count) == words


def test_a_folders_size_follows_no_links(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a").write_bytes(bytes(100))
    (tmp_path / "loop").symlink_to(tmp_path)
    files, taken = installed.folder_size(tmp_path)
    assert files in (1, 2) and 100 <= taken < 1000


# --- what is tried ---------------------------------------------------------------------------------------------------


def test_code_is_asked_in_a_process_of_its_own():
    assert ask("import json, sys; print('noise'); print(json.dumps([1, 'refine' in sys.modules]))", 60) == [1, False]
    for code, words in (
        ("import os; os.abort()", "was ended by SIGABRT"),
        ("raise SystemExit('no such luck')", "failed (no such luck)"),
        ("print('no json')", "failed (no json)"),
        ("pass", "failed (no message)"),
    ):
        with pytest.raises(UserError) as caught:
            ask(code, 60)
        assert words in caught.value.problem
    with pytest.raises(UserError, match="gave no answer within 0.5 s"):
        ask("import time; time.sleep(60)", 0.5)
    with pytest.raises(UserError, match="does not run"):
        ask("pass", 60, "/no/such/python")


def test_mitsuba_that_draws_wrong_or_crashes(monkeypatch):
    found = {"variants": ["scalar_rgb"], "version": "3.9.1", "area": 90.0}
    monkeypatch.setattr(trials, "ask", lambda code: found)
    wrong = only(trials.try_mitsuba("rendering"))
    assert (wrong.state, wrong.needed) == ("broken", False) and "90.0 pixels where 128 are right" in wrong.found

    def crashes(code):
        raise UserError("python", "was ended by SIGSEGV")

    monkeypatch.setattr(trials, "ask", crashes)
    for found in (only(trials.try_mitsuba("rendering")), only(trials.try_llvm("rendering"))):
        assert found.state != "ok" and found.found == "was ended by SIGSEGV" and found.remedy


def test_mitsuba_draws_the_triangle_that_is_asked(monkeypatch):
    """Half of a square of 16 pixels' side, 128 pixels: what the trial's code prints, run here."""
    printed = []
    exec(trials.DRAW.replace("print(", "printed.append("), {"printed": printed})
    assert json.loads(printed[0])["area"] == pytest.approx(128, abs=2)


def test_encoders_that_fail_are_named(monkeypatch):
    from renderers import images

    def fails(*_):
        raise OSError("no such encoder")

    monkeypatch.setattr(images, "save_mp4", fails)
    found = {each.name: each for each in trials.try_encoders("files")}
    assert {name for name, each in found.items() if each.state != "ok"} == {"MP4"}
    assert found["MP4"].found == "OSError: no such encoder"


def test_blender_is_asked_where_it_is_named(monkeypatch, tmp_path):
    monkeypatch.delenv("BPY_PYTHON", raising=False)
    assert only(trials.try_blender("files")).state == "missing"
    monkeypatch.setenv("BPY_PYTHON", sys.executable)
    found = only(trials.try_blender("files"))
    assert (found.state, found.needed) == ("broken", False) and "No module named 'bpy'" in found.found
    fake = tmp_path / "python"
    fake.write_text("#!/bin/sh\necho '\"4.5.0\"'\n")
    fake.chmod(0o755)
    monkeypatch.setenv("BPY_PYTHON", str(fake))
    found = only(trials.try_blender("files"))
    assert (found.state, found.values) == ("ok", {"version": "4.5.0"})


def test_a_body_is_told_by_what_it_holds(tmp_path):
    (tmp_path / "SMPL.npz").write_bytes(b"PK\x03\x04 damaged")
    found = only(trials.try_body("bodies", tmp_path / "SMPL.npz"))
    assert found.state == "broken" and found.remedy
    assert only(trials.try_body("bodies", Path("nobody.pkl"))).state == "broken"


def test_a_picture_or_a_loop_that_is_wrong_is_noticed(monkeypatch):
    monkeypatch.setattr(trials, "PINNED_AREA", 436.0)
    found = only(trials.try_silhouette("self-test"))
    assert found.state == "broken" and found.found == "435.26 pixels, and 436.00 are right"
    monkeypatch.setattr("refine.report.losses", lambda trace: {"total": 0.0})
    assert only(trials.try_loop("self-test")).state == "broken"
