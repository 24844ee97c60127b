"""The page in a real browser without a window: it opens from disk, plays, listens to keys, and asks for nothing."""

import io
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from webdriver import Browser, missing

from refine.motion import canonicalise, resample
from refine.synthetic import draw, perform
from refine.viewer.page import composition_page, page, poster

NASTY = "</script><script>window.hacked = 1</script><img src=x onerror='hacked = 1'>\"&amp;"
ESCAPE = "\ue00c"
pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())


@pytest.fixture(scope="module")
def motions(rest_joints):
    random = torch.Generator().manual_seed(2)
    walk, wave = (perform(draw(name, random), 45, rest_joints) for name in ("walk", "wave-both-hands"))
    return [replace(walk, label=NASTY), resample(wave, 12.0)]


@pytest.fixture(scope="module")
def address(motions, free_body, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "two.html"
    path.write_text(page(motions, free_body, poster=poster(motions[:1], free_body)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(640, 640) as made:
        yield made


@pytest.fixture
def opened(browser, address) -> Iterator[Callable[..., Browser]]:
    """Opens a page, or finds it open as the last test left it: still, half a second on.

    What the browser is told of its user, as in ``prefers_color_scheme="dark"``, lasts for the test.
    """

    def open_it(path: Path = address, fresh: bool = False, **features: str) -> Browser:
        if fresh or features or browser.run("return location.href") != path.as_uri():
            told = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
            browser.devtools("Emulation.setEmulatedMedia", features=told)
            browser.open(path)
            browser.wait("return document.documentElement.dataset.lively === 'true'")
        if not fresh:
            browser.run("refine.play(false); refine.seek(0.5)")
        return browser

    yield open_it
    if browser.run("return matchMedia('(prefers-color-scheme: dark), (prefers-reduced-motion)').matches"):
        browser.devtools("Emulation.setEmulatedMedia", features=[])
        browser.open("about:blank")


def stage(browser: Browser) -> np.ndarray:
    """The canvas's upper part as [H W 3], without names and the bar, once it is drawn."""
    browser.run("return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    left, top, width, height = browser.run(
        "const box = document.getElementById('canvas').getBoundingClientRect();"
        "return [box.left, box.top, box.width, box.height].map(Math.round)"
    )
    whole = np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"), dtype=np.int16)
    return whole[top + 50 : top + height, left : left + width]


def differing(first: np.ndarray, second: np.ndarray) -> int:
    """Pixels that are plainly of another colour."""
    return int((np.abs(first - second).max(-1) > 24).sum())


def test_it_opens_from_disk_plays_and_asks_for_nothing(opened, address):
    browser = opened(fresh=True)
    began = browser.run("return refine.seconds")
    browser.wait("return refine.playing && refine.seconds > arguments[0] + 0.2", began)
    messages = [json.loads(entry["message"])["message"] for entry in browser.logs("performance")]
    asked = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    assert address.as_uri() in asked
    assert [url[:80] for url in asked if url != address.as_uri() and not url.startswith("data:")] == []
    assert browser.logs("browser") == []


def test_the_canvas_shows_bodies_that_move(opened):
    browser = opened()
    first = stage(browser)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500
    assert differing(first, stage(browser)) == 0
    browser.run("refine.seek(0.9)")
    assert differing(first, stage(browser)) > 1000
    browser.run("refine.seek(0.5)")
    assert differing(first, stage(browser)) == 0


def test_joints_are_those_of_forward_kinematics_in_step_by_seconds(opened, motions, rest_joints):
    browser = opened()
    for index, motion in enumerate(motions):
        joints = canonicalise(motion).joints(rest_joints).numpy()
        for frame in (0, 7, len(motion) - 1):
            found = browser.run("return refine.joints(...arguments)", index, frame / motion.fps)
            assert np.abs(np.reshape(found, (24, 3)) - joints[frame]).max() < 5e-4
        between = canonicalise(resample(motion, 4 * motion.fps)).joints(rest_joints).numpy()[22]
        found = browser.run("return refine.joints(...arguments)", index, 5.5 / motion.fps)
        assert np.abs(np.reshape(found, (24, 3)) - between).max() < 2e-3
        over = browser.run("return refine.joints(...arguments)", index, 99)
        assert np.abs(np.reshape(over, (24, 3)) - joints[-1]).max() < 5e-4


def test_keys(opened, motions):
    browser = opened()
    browser.keys(" ")
    assert browser.run("return refine.playing")
    browser.keys(" ")
    assert not browser.run("return refine.playing")
    browser.run("refine.seek(0.5)")
    browser.keys("\ue014")  # right
    assert browser.run("return refine.seconds") == pytest.approx(16 / 30)
    browser.keys("\ue012", "\ue012")  # left
    assert browser.run("return refine.seconds") == pytest.approx(14 / 30)
    plain = stage(browser)
    for key in ("c", "b", "]", "2"):
        browser.keys(key)
        changed = stage(browser)
        assert differing(plain, changed) > 300, key
        plain = changed
    named = "return document.querySelectorAll('#names button').length === arguments[0]"
    browser.wait(named, 1)
    browser.keys("\ue014")  # now in frames of the motion that is shown alone
    assert browser.run("return refine.seconds * 12") == pytest.approx(7)
    browser.keys("0")
    browser.wait(named, 2)
    browser.keys("h")
    assert browser.run("return document.getElementById('help').open")
    browser.keys(ESCAPE)
    assert not browser.run("return document.getElementById('help').open")
    assert browser.logs("browser") == []
    browser.open("about:blank")


def test_keys_work_what_was_reached_by_keys_and_the_player_otherwise(opened):
    browser = opened()
    browser.run("document.querySelector('input[value=plain]').click()")
    browser.keys("\ue014")
    assert browser.run("return refine.seconds") == pytest.approx(16 / 30)
    browser.run("document.querySelector('input[value=plain]').focus({ focusVisible: true })")
    browser.keys("\ue012")
    assert browser.run("return document.querySelector('input[name=colours]:checked').value") == "motion"
    assert browser.run("return refine.seconds") == pytest.approx(16 / 30)
    browser.run("document.getElementById('on').focus({ focusVisible: true })")
    browser.keys(" ")
    assert browser.run("return [refine.playing, refine.seconds]") == [False, pytest.approx(17 / 30)]
    browser.run("document.getElementById('scrubber').focus({ focusVisible: true })")
    browser.keys("\ue014", "\ue011")  # right, home
    assert browser.run("return refine.seconds") == 0
    browser.run("scrollTo(0, 0); document.getElementById('canvas').focus({ preventScroll: true })")
    before = stage(browser)
    browser.keys("\ue013", "\ue013")  # up: nearer
    assert differing(before, stage(browser)) > 300
    assert browser.run("return scrollY") == 0
    browser.open("about:blank")


def test_labels_are_text(opened):
    browser = opened()
    assert browser.run("return [document.scripts.length, document.images.length, typeof hacked]") == [2, 1, "undefined"]
    shown = "return document.querySelector(arguments[0]).textContent"
    for place in ("h1", "title", "#names button", "#numbers tbody th", "#speeds thead th"):
        assert NASTY in browser.run(shown, place)


def test_the_scrubber_seeks_and_the_clock_follows(opened):
    browser = opened()
    browser.run("const it = document.getElementById('scrubber'); it.value = 1.2; it.dispatchEvent(new Event('input'))")
    browser.wait("return document.getElementById('time').textContent.startsWith('1.20 /')")
    assert browser.run("return document.getElementById('frame').textContent") == "frame 37 of 45"
    assert "frame 37" in browser.run("return document.getElementById('scrubber').getAttribute('aria-valuetext')")


def test_it_repeats_only_when_told_to(opened):
    browser = opened()
    browser.run("refine.seek(1.4); refine.play(true)")
    browser.wait("return refine.seconds < 1")
    browser.run("document.getElementById('loop').click(); refine.seek(1.4)")
    browser.wait("return !refine.playing")
    browser.run("document.getElementById('loop').click()")
    assert browser.run("return refine.seconds") == pytest.approx(44 / 30)


def test_dark_and_light(opened):
    browser = opened(prefers_color_scheme="dark")
    dark = stage(browser)
    browser.keys("t")
    assert dark.mean() < 80 < 180 < stage(browser).mean()
    browser.keys("t")
    assert differing(dark, stage(browser)) == 0


def test_nothing_moves_for_those_who_want_less_motion(opened):
    browser = opened(fresh=True, prefers_reduced_motion="reduce")
    assert not browser.run("return refine.playing")
    assert browser.run("return refine.seconds") == pytest.approx(44 / 60)


@pytest.mark.parametrize("width", [360, 1280])
def test_nothing_is_wider_than_the_window(opened, width):
    browser = opened()
    browser.devtools("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
    try:
        browser.wait("return innerWidth === arguments[0]", width)
        browser.run("document.getElementById('canvas').scrollIntoView()")
        assert browser.run("return document.documentElement.scrollWidth") <= width
        assert browser.run(
            "return [...document.querySelectorAll('.player button, .player select')].every((it) => it.hidden ||"
            " it.getBoundingClientRect().right <= innerWidth)"
        )
    finally:
        browser.devtools("Emulation.clearDeviceMetricsOverride")


def test_every_control_has_a_name(opened):
    browser = opened()
    nameless = browser.run("""
        const named = (it) => it.textContent.trim() || it.ariaLabel || it.labels?.[0]?.textContent.trim();
        const controls = [...document.querySelectorAll("button, select, input, canvas")];
        return controls.filter((it) => !named(it)).map((it) => it.outerHTML.slice(0, 90));
    """)
    assert nameless == []


def test_a_composition_shows_what_the_loop_saw(opened, small_composition, free_body, tmp_path):
    path = tmp_path / "composition.html"
    path.write_text(composition_page(small_composition, free_body), encoding="utf-8")
    browser = opened(path)
    assert browser.run("return [...document.querySelectorAll('#names button span')].map((it) => it.textContent)") == [
        *("walk", "drink", "coupled", "refined"),
    ]
    browser.run("refine.seek(0)")
    place = "return document.querySelectorAll('#loop-card .cell')[1].style.backgroundPosition"
    browser.wait(f"{place}.startsWith('0% ')")
    browser.run("refine.seek(1)")
    browser.wait(f"{place}.startsWith('100% ')")
    assert browser.run("return document.querySelector('#loop-card .cell').style.backgroundImage").startswith(
        'url("data'
    )
    assert browser.run("return document.querySelectorAll('#loss path.curve').length") >= 3
    steps = "return [...document.querySelectorAll('#loss text')].map((it) => it.textContent).slice(-3)"
    assert browser.run(steps) == ["1", "2", "3"]
    without = stage(browser)
    browser.keys("v")
    assert differing(without, stage(browser)) > 1000
    assert browser.logs("browser") == []


def test_nine_motions_and_a_single_frame(opened, motions, free_body, tmp_path):
    path = tmp_path / "nine.html"
    still = replace(motions[0], rotations=motions[0].rotations[:1], root=motions[0].root[:1], label="")
    path.write_text(page([still] * 9, free_body), encoding="utf-8")
    browser = opened(path)
    assert browser.run("return [refine.playing, refine.seconds]") == [False, 0]
    assert browser.run("return document.querySelectorAll('#names button').length") == 9
    assert "motion 9" in browser.run("return document.getElementById('names').textContent")
    assert len(np.unique(stage(browser).reshape(-1, 3), axis=0)) > 300
    assert browser.logs("browser") == []


def test_motions_of_other_lengths_and_names(opened, motions, free_body, tmp_path):
    walk, path = motions[0], tmp_path / "lengths.html"
    short = replace(walk, rotations=walk.rotations[:10], root=walk.root[:10], label="short")
    names = ["", "a-name-as-long-as-those-of-files-are-" * 4, ""]
    path.write_text(page([short, short, replace(walk, label="longest")], free_body, names), encoding="utf-8")
    browser = opened(path)
    browser.wait("return document.getElementById('frame').textContent === 'frame 16 of 45'")  # of the longest
    values = "return [...document.querySelectorAll('#numbers tbody tr')].map((row) => row.cells[3].textContent)"
    assert browser.run(values) == ["0.33", "0.33", "1.50"]
    apart = browser.run("""
        const boxes = [...document.querySelectorAll("#names button")].map((it) => it.getBoundingClientRect());
        return boxes.every((box, k) => box.right < (boxes[k + 1]?.left ?? innerWidth));
    """)
    assert apart
    assert browser.run("return document.querySelectorAll('#names button span')[1].clientWidth") > 30
    table = "return document.querySelector('#numbers tbody th').offsetWidth"
    assert browser.run(table) < 300


def test_nine_motions_laid_over_one_another_have_nine_colours(opened, motions, free_body, tmp_path):
    path = tmp_path / "over.html"
    path.write_text(page([replace(motions[0], label="walk")] * 9, free_body), encoding="utf-8")
    browser = opened(path)
    browser.keys("o")
    colours = "[...document.querySelectorAll('#names button')].map((it) => it.style.getPropertyValue('--dot'))"
    browser.wait(f"return {colours}.every(Boolean)")
    assert len(set(browser.run(f"return {colours}"))) == 9


def test_without_webgl_a_message_and_poses_appear(address):
    with Browser(800, 700, "--disable-3d-apis") as browser:
        browser.open(address)
        browser.wait("return document.documentElement.dataset.lively === 'false'")
        assert "cannot draw the moving bodies" in browser.run("return document.getElementById('unable').innerText")
        seen = "return [...document.querySelectorAll('.poster img, .player, .cards')].map((it) => it.checkVisibility())"
        assert browser.run(seen) == [True, False, False]
        assert browser.run("return document.images[0].naturalWidth") > 500
