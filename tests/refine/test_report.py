import json
import re
from dataclasses import replace

import pytest
import torch

from refine.composition import Composition, compose, judge
from refine.decoupling import Decoupler, DecouplingConfig
from refine.energies import energy_signal, part_energies
from refine.mae import MAE, MAEConfig
from refine.ownership import Owned
from refine.refinement import RefinementConfig
from refine.report import losses, measure, write_report
from refine.stages import STAGES, answers_for, stage_sheet, stage_sheets
from refine.synthetic import draw, perform
from refine.text.parts import BODY_PARTS
from renderers.body import Body
from renderers.images import enlarged, part_picture
from renderers.skeleton import PART_NAMES


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.free("light")


@pytest.fixture(scope="module")
def decoupler(body) -> Decoupler:
    size = MAEConfig(size=32, width=16, depth=1, heads=1, decoder_width=16, decoder_depth=1, decoder_heads=1)
    return Decoupler(body, MAE(size), DecouplingConfig(views=(0.0, 90.0)))


@pytest.fixture(scope="module")
def composition(body, decoupler) -> Composition:
    random = torch.Generator().manual_seed(1)
    i, j = (perform(draw(name, random), frames, body.rest_joints) for name, frames in (("walk", 6), ("drink", 8)))
    return compose(i, j, decoupler, refinement=RefinementConfig(steps=2, frames=2))


def test_compose_cuts_both_to_the_shorter(composition):
    assert [len(clip) for clip in (composition.i, composition.j, composition.motion)] == [6, 6, 6]


def test_the_traces_are_those_of_coupled_and_refined(composition, decoupler):
    for trace, motion in ((composition.before, composition.coupling.motion), (composition.after, composition.motion)):
        judged = judge(motion, composition.i, composition.j, decoupler)
        assert losses(trace) == pytest.approx(losses(judged), rel=1e-4)


def test_numbers_are_those_of_the_engine(composition, body):
    report = measure(composition)
    energies = part_energies(energy_signal(composition.j.rotations, composition.j.root, body.rest_joints))
    assert list(report["energies"]["j"]) == list(PART_NAMES)
    assert list(report["energies"]["j"].values()) == pytest.approx(energies.tolist(), rel=1e-5)
    of_i, of_j = (report["energies"][side]["left_leg"] for side in "ij")
    assert report["share_of_i"]["left_leg"] == pytest.approx(of_i / (of_i + of_j), rel=1e-3)
    assert report["share_of_i"]["root"] == 1.0
    loss = report["decoupling_loss"]["coupled"]
    assert loss["total"] == pytest.approx(float(composition.before.loss), rel=1e-5)
    assert loss["total"] == pytest.approx(loss["i"] + loss["j"])
    assert report["refinement"]["steps"] == 2
    assert report["refinement"]["first_step"]["total"] == composition.history["total"][0]
    assert json.loads(json.dumps(report)) == report


def test_a_stage_sheet_shows_both_sides_in_every_stage(composition):
    trace = composition.before
    sheet = stage_sheet(trace, 3, ("walk", "drink"), side=64)
    assert sheet.shape[2] == len(STAGES) * 64 + (len(STAGES) + 1) * 8
    left = slice(8, 8 + 64)
    for reference in trace.references:
        expected = (enlarged(part_picture(reference.seen.pictures[3]), 2) * 255).round()
        found = (sheet[:, :, left] * 255).round().unfold(1, 64, 1).permute(1, 0, 3, 2)
        assert (found - expected).abs().amax((1, 2, 3)).min() <= 1


def test_the_sheets_show_their_frames_in_the_first_view(composition, decoupler):
    views = len(decoupler.config.views)
    assert views > 1
    sheets = stage_sheets(composition, 2)
    names, title = ("walk", "drink"), "refined motion at 0.17 s, first view"
    expected = stage_sheet(composition.after, 5 * views, names, title)
    assert torch.equal(sheets["stages-0005-refined"], expected)
    assert not torch.equal(expected, stage_sheet(composition.after, 5, names, title))


def test_the_last_stage_shows_only_what_its_action_answers_for(composition):
    trace, own = composition.before, 64
    disowned = [side._replace(owned=Owned(side.owned.answers * 0, side.owned.shown)) for side in trace.references]
    sheet = stage_sheet(trace._replace(references=tuple(disowned)), 3, ("walk", "drink"), side=own)
    difference, counted = (sheet[:, :, 8 + k * (own + 8) :][:, :, :own] for k in (6, 7))
    rows = [y for y in range(sheet.shape[1]) if (counted[:, y] == 1).all()]
    assert len(rows) == 2 * own
    assert (difference[:, rows] < 1).any()


def test_what_an_action_answers_for_is_named():
    assert answers_for(torch.tensor([0.0, 0.01, 0.75, 0.0, 1.0, 0.0])) == ", answers for left arm 75%, left leg 100%"
    assert answers_for(torch.zeros(6)) == ", answers for no part"
    assert answers_for(torch.ones(1)) == ""


def test_a_motion_that_is_only_coupled_is_reported_once(composition):
    once = replace(composition, motion=composition.coupling.motion, after=composition.before, made="coupled")
    assert list(measure(once)["decoupling_loss"]) == ["coupled"]
    assert list(stage_sheets(once, 1)) == ["stages-0000-coupled"]


def test_the_folder_holds_one_self_contained_page(composition, body, tmp_path):
    report = write_report(tmp_path, composition, body, frames=2, extra={"more": 1})
    assert json.loads((tmp_path / "report.json").read_text()) == report
    assert report["more"] == 1
    page = (tmp_path / "report.html").read_text()
    pictures = {path.stem for path in tmp_path.glob("*.png")}
    assert pictures == {
        "motions",
        "loss",
        *(f"stages-{frame:04d}-{when}" for frame in (0, 5) for when in ("coupled", "refined")),
    }
    assert set(re.findall(r'alt="([^"]+)"', page)) == pictures
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert all(f"{loss['total']:.6f}" in page for loss in report["decoupling_loss"].values())
    assert "share of walk" in page


def test_the_report_of_parts_says_who_owns_which(composition, body, tmp_path):
    owners = {part: "drink" if part == "left arm" else "walk <fast>" for part in BODY_PARTS}
    report = write_report(tmp_path, replace(composition, owners=owners), body, frames=1)
    assert report["owners"] == owners
    page = (tmp_path / "report.html").read_text()
    assert "<tr><th>left arm<td>drink" in page and "<tr><th>torso<td>walk &lt;fast&gt;" in page
    assert "composition by body parts" in page and "blend by energies" not in page
    assert "owners" not in measure(composition)
