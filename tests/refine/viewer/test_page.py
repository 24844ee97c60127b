import base64
import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from reading import Arrays, Page, pose, turned

from refine.energies import energy_signal, part_energies
from refine.motion import Motion, canonicalise, resample
from refine.synthetic import draw, perform
from refine.viewer import page as page_module
from refine.viewer.packing import Packer, calmed, heaviest, part_speeds
from refine.viewer.page import page, poster
from renderers.body import Body
from renderers.checks import UserError
from renderers.skeleton import PART_NAMES

NASTY = "</script><script>hacked = 1</script><b onclick='x'>\"&amp; {{script}} \u2028<!--"


@pytest.fixture(scope="module")
def motions(rest_joints) -> list[Motion]:
    random = torch.Generator().manual_seed(3)
    return [perform(draw(name, random), 60, rest_joints) for name in ("walk", "run", "wave-left-hand", "squat")]


@pytest.fixture(scope="module")
def made(motions, free_body) -> str:
    return page(motions, free_body)


def test_the_joints_of_the_page_are_those_of_the_motions(made, motions, rest_joints):
    data = Page(made).data
    for index, motion in enumerate(motions):
        expected = canonicalise(motion).joints(rest_joints).numpy()
        joints, _ = pose(data, index)
        assert np.abs(joints - expected).max() < 3e-4
        assert (data["motions"][index]["fps"], data["motions"][index]["label"]) == (motion.fps, motion.label)
    assert data["body"]["names"][22] == "left_hand"


def test_a_real_clip_keeps_its_joints(real_clips, free_body, rest_joints):
    from refine.formats.files import load_motion

    motion = load_motion(real_clips[7], rest_joints)
    joints, _ = pose(Page(page([motion], free_body)).data, 0)
    assert np.abs(joints - canonicalise(motion).joints(rest_joints).numpy()).max() < 5e-4


def test_the_skin_is_that_of_the_body(made, motions, free_body):
    data = Page(made).data
    array, body = Arrays(data), data["body"]
    rest, weights = array(body["rest"]), array(body["weights"]) / 255
    vertices, joints_of = array(body["positions"]) * body["scale"], array(body["joints"]).astype(int)
    assert np.abs(vertices - free_body.rest_vertices.numpy()).max() < 5e-5
    assert (array(body["faces"]).astype(int) == free_body.faces.numpy()).all()
    joints, world = pose(data, 1)
    frame = 20
    carried = turned(world[frame][joints_of], vertices[:, None] - rest[joints_of]) + joints[frame][joints_of]
    skinned = (carried * weights[..., None]).sum(1)
    placed = canonicalise(motions[1])
    expected = free_body(placed.rotations[frame, None], placed.root[frame, None]).vertices[0].numpy()
    away = np.linalg.norm(skinned - expected, axis=1)
    assert np.median(away) < 1e-3
    assert away.max() < 0.012  # where more than four joints pull at a vertex


def test_the_heaviest_joints_are_kept_and_weights_sum_to_255(free_body):
    weights = free_body.weights.double().numpy()
    joints, shares = heaviest(weights)
    assert (shares.astype(int).sum(1) == 255).all()
    kept = np.take_along_axis(weights, joints.astype(int), 1)
    assert np.allclose(kept, -np.sort(-weights, axis=1)[:, :4])
    assert np.abs(shares / 255 - kept / kept.sum(1, keepdims=True)).max() <= 1 / 255


def test_speeds_are_the_energies_of_the_engine(made, motions, rest_joints):
    data = Page(made).data
    for motion, entry in zip(motions, data["motions"], strict=True):
        energies = part_energies(energy_signal(motion.rotations, motion.root, rest_joints)) * motion.fps**2
        assert entry["speed"] == pytest.approx(energies.sqrt().tolist(), rel=1e-3, abs=1e-5)
    assert Arrays(data)(data["motions"][0]["speeds"]).shape == (60, len(PART_NAMES))


def test_speeds_are_averaged_over_a_fifth_of_a_second():
    steps = torch.zeros(30, 5, dtype=torch.float64)
    steps[10] = 2.0
    smooth = calmed(steps, fps=30.0)
    assert smooth.shape == (31, 5)
    told = (smooth[:, 0] > 1e-9).nonzero()[:, 0].tolist()
    assert told == list(range(8, 14))
    assert smooth[9, 0] == pytest.approx(2 / 6**0.5)


def test_one_frame_has_no_speed(rest_joints, motions, free_body):
    still = replace(motions[0], rotations=motions[0].rotations[:1], root=motions[0].root[:1])
    assert part_speeds(still, rest_joints).shape == (0, 5)
    entry = Page(page([still], free_body)).data["motions"][0]
    assert (entry["frames"], entry["seconds"], entry["speed"]) == (1, 0.0, [0.0] * 5)


def test_all_motions_start_at_one_place_and_face_the_same_way(made, motions, free_body):
    moved = replace(motions[0], root=motions[0].root + torch.tensor([3.0, 0.0, -8.0]))
    joints, _ = pose(Page(page([moved], free_body)).data, 0)
    assert np.abs(joints - pose(Page(made).data, 0)[0]).max() < 1e-5


def test_a_page_is_small_enough_to_mail(made, motions, free_body):
    assert len(made.encode()) < 1_000_000
    body = Body.free("full")
    assert len(page(motions, body, poster=poster(motions, free_body)).encode()) < 5_000_000


@pytest.mark.parametrize("where", ["label", "title", "role"])
def test_every_text_is_shown_as_text(where, motions, free_body):
    named = {"label": NASTY} if where == "label" else {}
    found = Page(page([replace(motions[0], **named)], free_body, roles=[NASTY if where == "role" else ""], title="T"))
    plain = Page(page([motions[0]], free_body, title="T"))
    assert [tag for tag, _ in found.tags] == [tag for tag, _ in plain.tags]
    assert found.raw[0] == plain.raw[0] and found.raw[2] == plain.raw[2]
    if where != "title":
        # A motion has escaped what would steer a terminal in its label already.
        wanted = replace(motions[0], label=NASTY).label if where == "label" else NASTY
        assert found.data["motions"][0][where] == wanted
    titled = Page(page([motions[0]], free_body, title=NASTY))
    assert titled.texts["h1"] == titled.texts["title"] == NASTY


def test_where_files_lie_is_nobodys_business(motions, free_body):
    assert "/home/me" not in page([replace(motions[0], source="/home/me/walk.bvh")], free_body)


def test_the_policy_allows_what_is_in_the_page_and_nothing_else(made):
    read = Page(made)
    [policy] = [
        attributes["content"] for tag, attributes in read.tags if attributes.get("http-equiv", "").startswith("Con")
    ]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for kind, tag in (("script-src", "script"), ("style-src", "style")):
        text = read.raw[-1][1] if tag == "script" else read.raw[0][1]
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[kind] == f"'sha256-{digest}'"
    for tag, attributes in read.tags:
        assert not [name for name in attributes if name.startswith("on") or name == "style"], tag
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:")


def test_the_script_fetches_nothing_and_writes_no_html(made):
    script = Page(made).raw[-1][1]
    for word in ("fetch(", "XMLHttpRequest", "WebSocket", "import(", "innerHTML", "eval(", "document.write", "Worker("):
        assert word not in script
    assert not re.findall(r"https?://(?!www\.w3\.org/2000/svg)", made)


def test_what_cannot_be_shown_is_refused(motions, free_body, monkeypatch):
    with pytest.raises(UserError, match="1 to 9 motions at once, not 0"):
        page([], free_body)
    with pytest.raises(UserError, match="not 10; give more or fewer"):
        page([motions[0]] * 10, free_body)
    monkeypatch.setattr(page_module, "LONGEST", 100)
    with pytest.raises(UserError, match="120 frames, 100 are the most"):
        page(motions[:2], free_body)


def test_the_summary_says_what_differs(motions, free_body):
    assert page_module.summary(motions) == "4 motions, 60 frames at 30 a second"
    assert page_module.summary([motions[0], resample(motions[1], 12.5)]) == "2 motions, up to 2.00 seconds"
    assert page_module.summary(motions[:1]) == "60 frames at 30 a second"


def test_arrays_lie_at_multiples_of_four():
    packer = Packer()
    entries = [packer.add(np.arange(n, dtype=kind)) for n, kind in ((3, np.uint8), (5, np.int16), (2, np.float32))]
    read = Arrays({"bytes": packer.base64()})
    assert [entry["at"] for entry in entries] == [0, 4, 16]
    assert [read(entry).tolist() for entry in entries] == [[0, 1, 2], [0, 1, 2, 3, 4], [0, 1]]
