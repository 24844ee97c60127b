import base64
import io
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from reading import Arrays, Page

from refine.motion import canonicalise
from refine.stages import stage_pictures
from refine.viewer.looking import FACTOR, SHOWN, data_url, history, picture_corners
from refine.viewer.page import composition_page
from renderers.camera import frame
from renderers.rotations import rotation_about


@pytest.fixture(scope="module")
def data(small_composition, free_body) -> dict:
    return Page(composition_page(small_composition, free_body)).data


@pytest.mark.parametrize(("yaw", "elevation"), [(0.0, 0.0), (90.0, 0.0), (35.0, 20.0)])
def test_corners_are_where_the_camera_has_its_picture(rest_joints, yaw, elevation):
    joints = rest_joints[None] + torch.tensor([0.4, 0.1, -2.0])
    camera = frame(joints, (48, 64), math.radians(yaw), math.radians(elevation))
    corners = picture_corners(joints, camera.project(joints), camera.size)
    assert camera.project(corners.float())[0].tolist() == [
        pytest.approx(corner, abs=1e-3) for corner in ([0, 0], [64, 0], [64, 48], [0, 48])
    ]
    across, down = corners[0, 1] - corners[0, 0], corners[0, 3] - corners[0, 0]
    forward = torch.linalg.cross(across, down)
    assert torch.allclose(forward / forward.norm(), camera.rotation[0, 2].double(), atol=1e-4)


def test_a_body_that_is_moved_takes_its_picture_along(rest_joints):
    camera = frame(rest_joints[None], (32, 32))
    pixels = camera.project(rest_joints[None])
    turn, way = rotation_about("y", torch.tensor(0.7)), torch.tensor([1.0, 0.2, 3.0])
    before = picture_corners(rest_joints[None], pixels, (32, 32))
    after = picture_corners((rest_joints @ turn.T + way)[None], pixels, (32, 32))
    assert torch.allclose(before @ turn.T.double() + way, after, atol=1e-4)


def test_corners_of_the_page_put_joints_where_the_loop_drew_them(data, small_composition, rest_joints):
    array = Arrays(data)
    for made, (name, trace) in zip(data["looking"]["made"], small_composition.traces().items(), strict=True):
        assert made["name"] == name
        corners = array(made["corners"])
        views = made["views"]
        assert corners.shape == (8, views, 4, 3)
        joints = canonicalise(small_composition.motions()[name]).joints(rest_joints).numpy()
        size, pixels = trace.composed.pictures.shape[-1], trace.composed.joints_px.reshape(8, views, 24, 2)
        for view in range(views):
            origin = corners[:, view, :1]
            sides = corners[:, view, [1, 3]] - origin
            shares = np.einsum("njd,nkd->njk", joints - origin, sides) / np.square(sides).sum(-1)[:, None]
            assert np.abs(shares * size - pixels[:, view].numpy()).max() < 0.02


def test_sheets_hold_a_row_for_each_stage_and_a_column_for_each_moment(data, small_composition):
    looking = data["looking"]
    assert looking["moments"] == list(range(8))
    assert looking["stages"] == list(SHOWN.values())
    made, trace = looking["made"][1], small_composition.after
    side = 32 * FACTOR
    assert made["side"] == side
    for number, of_side in enumerate(made["sheets"]):
        assert len(of_side) == made["views"] == 2
        for view, url in enumerate(of_side):
            sheet = np.asarray(picture(url), dtype=float) / 255
            assert sheet.shape == (len(SHOWN) * side, 8 * side, 3)
            cell = sheet[side : 2 * side, 3 * side : 4 * side].transpose(2, 0, 1)
            expected = stage_pictures(trace, 3 * 2 + view, FACTOR)[number][1].numpy()
            assert np.abs(cell - expected).mean() < 0.01


def test_losses_are_the_traces_own(data, small_composition):
    array = Arrays(data)
    for made, trace in zip(data["looking"]["made"], small_composition.traces().values(), strict=True):
        for values, side in zip(made["loss"], trace.sides, strict=True):
            assert array(values).mean() == pytest.approx(float(side.loss.mean()), rel=1e-5)


def test_motions_are_named_for_what_they_are_in_the_composition(data, small_composition):
    names = [(motion["label"], motion["role"]) for motion in data["motions"]]
    assert names == [("walk", "sub-action i"), ("drink", "sub-action j"), ("coupled", ""), ("refined", "")]
    assert [made["motion"] for made in data["looking"]["made"]] == [2, 3]
    assert list(data["history"]) == list(small_composition.history)
    assert len(data["history"]["total"]) == 3


def test_a_loss_that_is_not_finite_is_no_number(small_composition):
    broken = {"total": [1.0, math.nan, math.inf, 0.123456], "feet": []}
    assert history(replace(small_composition, history=broken)) == {"total": [1.0, None, None, 0.1235]}
    assert history(replace(small_composition, history=None)) == {}


def test_data_urls_keep_the_picture():
    flat = torch.zeros(3, 4, 6)
    flat[0, 1:3] = 1.0
    assert np.asarray(picture(data_url(flat)))[1, 2].tolist() == [255, 0, 0]


def picture(url: str) -> Image.Image:
    head, _, content = url.partition(",")
    assert head == "data:image/png;base64"
    return Image.open(io.BytesIO(base64.b64decode(content))).convert("RGB")
