"""Stills for print: the studio and the strobe, as functions and as flags of ``refine render``."""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import pi

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from refine.cli.main import main
from refine.drawing import BORDER, strip, strobe
from refine.formats.files import save_motion
from refine.motion import Motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.palette import BACKGROUND, PARTS, rgb
from renderers.rotations import rotation_about
from renderers.shade import shade
from renderers.skeleton import DRAWN_PART_NAMES, JOINTS
from renderers.studio import Studio, studio

PAPER = torch.tensor(rgb(BACKGROUND))
QUICK = partial(studio, config=Studio(samples=9))
DRAWS = pytest.mark.parametrize("draw", [shade, QUICK], ids=["shade", "studio"])


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.free("light")


def sliding(body: Body, metres: float, heading: float = 0.0, frames: int = 31) -> Motion:
    """A body with hanging arms that faces +z and slides in a direction, 0 along z and a quarter turn along x."""
    rotations = torch.eye(3).repeat(frames, 24, 1, 1)
    for joint, turn in (("left_shoulder", -1.2), ("right_shoulder", 1.2)):
        rotations[:, JOINTS[joint]] = rotation_about("z", torch.tensor(turn))
    along = rotation_about("y", torch.tensor(heading)) @ torch.tensor([0.0, 0.0, 1.0])
    path = torch.linspace(0, metres, frames)[:, None] * along
    return Motion(rotations, body.rest_joints[0] + path, 30.0, "slide")


def colourfulness(picture: Tensor) -> Tensor:
    """[H W]: paper, shadows and lines on it have next to none."""
    relative = picture / PAPER[:, None, None]
    return relative.amax(0) - relative.amin(0)


def columns(picture: Tensor) -> list[tuple[int, int]]:
    """First and last column of each stretch in which something is coloured; gaps of a few columns are bridged."""
    seen = (colourfulness(picture) > 0.05).any(0).nonzero()[:, 0].tolist()
    ends = [k for k in range(1, len(seen)) if seen[k] - seen[k - 1] > 4]
    return [(seen[a], seen[b - 1]) for a, b in pairwise([0, *ends, len(seen)])]


@DRAWS
@pytest.mark.parametrize("heading", [0.0, 2.0, pi, -pi / 2])
def test_a_strobe_runs_from_left_to_right_from_pale_to_full(body, draw, heading):
    picture = strobe(sliding(body, 6.0, heading), body, poses=4, height=100, draw=draw)
    stretches = columns(picture)
    assert len(stretches) == 4
    fullness = [float(colourfulness(picture)[:, left : right + 1].amax()) for left, right in stretches]
    assert all(later > earlier + 0.05 for earlier, later in pairwise(fullness))


def test_a_strobe_keeps_the_real_distances(body):
    even = sliding(body, 6.0)
    start, end = torch.tensor([0.0, 0.0, 1.0]) * even.root[:1, 2:], even.root
    hurried = replace(even, root=torch.cat([end[:21] * torch.tensor([1.0, 1.0, 0.5]) + start, end[21:]]))
    gaps = []
    for motion in (even, hurried):
        middles = [(left + right) / 2 for left, right in columns(strobe(motion, body, poses=4, height=100, yaw=-90.0))]
        gaps.append(np.diff(middles))
    assert gaps[0].std() < 0.1 * gaps[0].mean()
    assert gaps[1][2] > 2 * gaps[1][0]


def test_the_last_body_of_a_strobe_has_its_full_colours(body):
    picture = strobe(sliding(body, 6.0), body, poses=3, height=160, yaw=-90.0)
    [*_, (left, right)] = columns(picture)
    alone = strobe(sliding(body, 6.0), body, poses=1, height=160, yaw=-90.0)
    full, found = colourfulness(alone).amax(), colourfulness(picture)[:, left : right + 1].amax()
    assert found == pytest.approx(float(full), abs=0.03)


def test_a_strobe_of_a_motion_in_place_stands_side_by_side(body):
    picture = strobe(sliding(body, 0.3), body, poses=4, height=120)
    [beside] = strip([sliding(body, 0.3)], body, poses=4, height=120, border=BORDER)
    assert picture.shape == beside.shape
    assert torch.equal(picture[:, :, -50:], beside[:, :, -50:])  # the last body
    drawn, expected = (colourfulness(image) > 0.04 for image in (picture, beside))
    assert (drawn & expected).sum() > 0.8 * expected.sum()
    assert colourfulness(picture)[:, :60].amax() < 0.5 * colourfulness(beside)[:, :60].amax()


def test_a_long_way_is_seen_from_aside_so_that_bodies_stay_large(body):
    picture = strobe(sliding(body, 20.0), body, poses=3, height=100)
    for left, right in columns(picture):
        rows = (colourfulness(picture)[:, left : right + 1] > 0.1).any(1).nonzero()[:, 0]
        assert rows[-1] - rows[0] > 40  # of the 84 inside the border; from 60 degrees at any length, 22


def test_a_way_too_long_for_a_picture_is_refused(body):
    with pytest.raises(UserError, match="16384 is the widest; crop the motion"):
        strobe(sliding(body, 20_000.0), body, poses=4, height=360)


@pytest.mark.parametrize("height", [32, 97])
def test_a_strobe_is_as_high_as_asked_and_has_a_border(body, height):
    picture = strobe(sliding(body, 6.0), body, poses=4, height=height)
    assert picture.shape[1] == height
    rows = (colourfulness(picture) > 0.05).any(1).nonzero()[:, 0]
    edge = BORDER * height - 2
    [(left, _), *_, (_, right)] = columns(picture)
    assert min(rows[0], height - 1 - rows[-1], left, picture.shape[2] - 1 - right) >= edge


def test_a_strip_in_the_studio_stands_where_the_other_does(body):
    motion = sliding(body, 0.0)
    [lit] = strip([motion], body, 3, 90, yaw=0.0, draw=QUICK, border=BORDER)
    [dark] = strip([motion], body, 3, 90, yaw=0.0, style="silhouette", border=BORDER)
    drawn, covered = colourfulness(lit) > 0.08, dark.mean(0) < 0.55
    assert float((drawn & covered).sum() / (drawn | covered).sum()) > 0.85
    side = {name: torch.tensor(rgb(PARTS[DRAWN_PART_NAMES.index(name)])) for name in ("left_arm", "right_arm")}
    middle = lit[:, :, lit.shape[2] // 3 : 2 * lit.shape[2] // 3]
    near = {name: (middle / middle.sum(0) - (c / c.sum())[:, None, None]).abs().sum(0) for name, c in side.items()}
    place = {name: float((distance < 0.15).nonzero()[:, 1].double().mean()) for name, distance in near.items()}
    assert place["left_arm"] > place["right_arm"] + 5


# --- the command line ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slide(tmp_path_factory, body) -> str:
    path = tmp_path_factory.mktemp("clips") / "slide.bvh"
    save_motion(sliding(body, 4.0), path, body)
    return str(path)


def refused(capsys, *arguments) -> str:
    assert main([*map(str, arguments)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ") and said.count("\n") == 1
    return said


@pytest.mark.parametrize("flags", [["--quality"], ["--quality", "--strobe"], ["--strobe"]])
def test_stills_are_written(slide, tmp_path, capsys, flags):
    out = tmp_path / "still.png"
    assert main(["render", slide, "-o", str(out), "--size", "48", "--poses", "2", *flags]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    with Image.open(out) as picture:
        assert (picture.height, picture.mode) == (48, "RGB")
        pixels = np.asarray(picture).astype(int)
    apart = len(columns(torch.from_numpy(pixels).permute(2, 0, 1) / 255)) == 2  # side by side they nearly touch
    assert apart == ("--strobe" in flags)
    assert (pixels[:3] == (PAPER * 255).round().int().numpy()).all()
    assert [path.name for path in tmp_path.iterdir()] == ["still.png"]


def test_a_still_shows_shadows_on_a_floor_without_lines(slide, tmp_path):
    out = tmp_path / "still.png"
    assert main(["render", slide, "-o", str(out), "--size", "64", "--poses", "1", "--quality"]) == 0
    with Image.open(out) as picture:
        light = (torch.from_numpy(np.asarray(picture).copy()).permute(2, 0, 1) / 255 / PAPER[:, None, None]).mean(0)
    assert light[48:].amin() < 0.85
    assert (light[:, :2] - 1).abs().max() < 0.02


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "a.mp4", "--quality"], "--quality: draws still pictures, not .mp4; end the output in .png"),
        (["-o", "a.gif", "--strobe"], "--strobe: draws still pictures, not .gif; end the output in .png"),
        (["-o", "a.png", "--quality", "--style", "parts"], "--quality: draws shaded bodies, not parts; leave --style"),
        (["-o", "a.png", "--strobe", "--style", "silhouette"], "--strobe: draws shaded bodies, not silhouette"),
        (["-o", "a.png", "--quality", "--poses", "0"], "poses 1 to 60"),
        (["-o", "a.png", "--strobe", "--yaw", "inf"], "--yaw: expected degrees, got inf"),
    ],
)
def test_what_cannot_be_a_still_is_refused(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert said in refused(capsys, "render", "walk", *arguments)
    assert not list(tmp_path.iterdir())


def test_a_still_that_is_there_is_replaced_only_by_force(slide, tmp_path, capsys):
    out = tmp_path / "mine.png"
    out.write_text("mine")
    command = ["render", slide, "-o", str(out), "--quality", "--size", "32", "--poses", "1"]
    assert "is already there" in refused(capsys, *command)
    assert out.read_text() == "mine"
    assert main([*command, "--force"]) == 0
    with Image.open(out) as picture:
        assert picture.height == 32


def test_an_interrupted_still_leaves_the_older_one(slide, tmp_path, capsys, monkeypatch):
    out, rendered = tmp_path / "mine.png", []
    out.write_text("mine")

    def exposed(*arguments):
        rendered.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr("renderers.studio._exposed", exposed)
    assert main(["render", slide, "-o", str(out), "--quality", "--size", "32", "--force"]) == 130
    assert capsys.readouterr().err == "refine: stopped; nothing half-written is left\n"
    assert rendered == [1]
    assert (out.read_text(), len(list(tmp_path.iterdir()))) == ("mine", 1)
