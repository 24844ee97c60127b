"""``refine check-renderer``: what it writes, when it objects, what it refuses."""

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import create_autospec

import pytest
import torch
from PIL import Image

from refine.cli.main import main
from renderers import judging, raster_mitsuba
from renderers.silhouette import silhouette

QUICK = ("--size", "32", "40", "--poses", "2", "--samples", "70")


@pytest.fixture
def no_llvm(monkeypatch):
    monkeypatch.setattr(raster_mitsuba, "find_llvm", lambda: None)


def check(out: Path, *arguments: str) -> int:
    return main(["check-renderer", *arguments, "-o", str(out)])


def written(out: Path) -> dict:
    return json.loads((out / "check.json").read_text())


def shifted(by: float):
    """Our silhouettes, ``by`` pixels to the right."""
    return lambda vertices, mesh, camera: silhouette(
        vertices, mesh, replace(camera, centre=camera.centre + torch.tensor([by, 0.0]))
    )


def test_a_table_numbers_and_a_sheet_are_written(tmp_path, capsys, no_llvm):
    out = tmp_path / "new" / "check"
    assert check(out, *QUICK) == 0
    assert sorted(path.name for path in out.iterdir()) == ["check.json", "sheet.png", "table.md"]
    numbers = written(out)
    assert numbers["agrees"] is True
    assert numbers["samples"] == 81
    assert [(of["size"], of["images"]) for of in numbers["images"]] == [(32, 1), (40, 1), (32, 6), (40, 6)]
    for of in numbers["images"]:
        assert 0 < of["noise"] < of["mean_tolerance"] < 0.01
        assert of["mean"] < of["mean_tolerance"]
        assert of["iou"] > 0.97
    printed, page = capsys.readouterr().out, (out / "table.md").read_text()
    table = printed[: printed.index("\n\n")]
    assert table in page
    assert table.count("| agrees") == 4
    assert f"{numbers['images'][0]['mean']:.2e}" in table
    for text in (printed, page):
        assert "Gradients were not compared: no LLVM was found" in text
        assert "finite differences" in text
    assert "81 stratified rays" in page
    width, height = Image.open(out / "sheet.png").size
    assert width > 900 and height > 600


@pytest.mark.parametrize(("by", "samples"), [(0.5, "64"), (0.05, "256")])
def test_a_shift_of_a_part_of_a_pixel_is_noticed(tmp_path, capsys, no_llvm, monkeypatch, by, samples):
    monkeypatch.setattr(judging, "silhouette", shifted(by))
    assert check(tmp_path / "check", "--size", "32", "--poses", "1", "--samples", samples, "--camera", "weak") == 1
    assert not written(tmp_path / "check")["agrees"]
    assert "DIFFERS" in capsys.readouterr().out
    assert (tmp_path / "check" / "sheet.png").exists()


def test_one_wrong_pixel_is_noticed(tmp_path, no_llvm, monkeypatch):
    def with_a_hole(vertices, mesh, camera):
        images = silhouette(vertices, mesh, camera)
        images[0, 0, 20, 20] = 1 - images[0, 0, 20, 20].round()
        return images

    monkeypatch.setattr(judging, "silhouette", with_a_hole)
    assert check(tmp_path / "check", "--size", "32", "--poses", "1", "--samples", "64") == 1
    plain, parts = written(tmp_path / "check")["images"]
    assert plain["largest"] > plain["largest_tolerance"]
    assert not plain["agrees"] and not parts["agrees"]


@pytest.mark.parametrize(("factor", "code"), [(1.0, 0), (0.7, 1), (-1.0, 1)])
def test_gradients_are_compared_where_there_is_an_llvm(tmp_path, capsys, monkeypatch, factor, code):
    def gradient(vertices, mesh, camera, weights, samples, seed):
        vertices = vertices.detach().requires_grad_()
        return factor * torch.autograd.grad(silhouette(vertices, mesh, camera, 8), vertices, weights)[0]

    monkeypatch.setattr(raster_mitsuba, "find_llvm", lambda: Path("/here/libLLVM.so"))
    monkeypatch.setattr(raster_mitsuba, "gradient", create_autospec(raster_mitsuba.gradient, side_effect=gradient))
    assert check(tmp_path / "check", "wave-left-hand", "--size", "32", "--poses", "1", "--samples", "64") == code
    numbers = written(tmp_path / "check")
    assert numbers["gradients_by"].endswith("projective integrator, with /here/libLLVM.so.")
    assert [of["motion"] for of in numbers["gradients"]] == ["shift in x", "shift in y", "scale", "left arm"]
    assert all(of["agrees"] for of in numbers["gradients"]) is (code == 0)
    assert all(of["cosine"] * factor > 0.99 * abs(factor) for of in numbers["gradients"])
    assert numbers["gradients_by"] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("no-such-action",), "neither a file nor a built-in action: unknown name 'no-such-action'"),
        (("nowhere.bvh",), "nowhere.bvh"),
        (("--size", "64", "8"), "--size: expected sides of 32 to 512 pixels, got 64 8"),
        (("--poses", "0"), "poses must be 1 to 100"),
        (("--samples", "5000"), "samples 64 to 4096"),
        (("--seed", "-1"), "--seed"),
        (("--body", "nobody.npz"), "nobody.npz"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_one_line(tmp_path, capsys, arguments, words):
    assert check(tmp_path / "check", *arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    assert words in said
    assert not (tmp_path / "check").exists()


def test_a_folder_that_is_there_stays_without_force(tmp_path, capsys, no_llvm):
    out = tmp_path / "check"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    assert check(out, *QUICK) == 2
    assert "is already there" in capsys.readouterr().err
    assert (out / "mine.txt").exists()
    assert check(out, "--size", "32", "--poses", "1", "--samples", "64", "--force") == 0
    assert not (out / "mine.txt").exists()
