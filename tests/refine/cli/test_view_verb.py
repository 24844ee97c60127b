"""``refine view``: what it writes, what it refuses, and what it answers when it serves."""

import http.client
import json
import signal
import subprocess
import sys
import webbrowser

import pytest

from refine.cli.main import main
from refine.cli.view import roles_of
from refine.formats.files import save_motion
from refine.synthetic import draw, perform


@pytest.fixture(scope="module")
def clips(tmp_path_factory, free_body):
    import torch

    folder = tmp_path_factory.mktemp("clips")
    for number, name in enumerate(("walk_1", "walk_2")):
        random = torch.Generator().manual_seed(number)
        save_motion(perform(draw("walk", random), 12, free_body.rest_joints), folder / f"{name}.bvh", free_body)
    return folder


def refused(capsys, *arguments: str) -> str:
    assert main(["view", *map(str, arguments)]) == 2
    written = capsys.readouterr()
    assert written.out == ""
    [line] = written.err.splitlines()
    return line


def test_it_writes_one_page_of_files_patterns_and_actions(clips, tmp_path, capsys):
    out = tmp_path / "deep" / "page.html"
    assert main(["view", f"{clips}/walk_*.bvh", "squat", "-o", str(out), "--title", "Two <walks>", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    content = out.read_text(encoding="utf-8")
    assert found["files"] == [str(out)]
    assert (found["motions"], found["bytes"]) == (["walk", "walk", "squat"], len(content.encode()))
    assert "<title>Two &lt;walks&gt;</title>" in content
    assert '"role":"walk_1.bvh"' in content and '"role":"walk_2.bvh"' in content
    assert 'class="poster"' in content
    assert [path.name for path in out.parent.iterdir()] == ["page.html"]


def test_what_it_refuses(clips, tmp_path, capsys):
    there = tmp_path / "there.html"
    there.write_text("mine")
    walk = clips / "walk_1.bvh"
    assert "nowhere to put the page; give -o page.html, or --serve" in refused(capsys, walk)
    assert "is already there" in refused(capsys, walk, "-o", there)
    assert "end it in .html" in refused(capsys, walk, "-o", tmp_path / "page.pdf")
    assert "expected 0 to 65535" in refused(capsys, walk, "--serve", "--port", "65536")
    assert "1 to 9 motions at once, not 10" in refused(capsys, *[walk] * 10, "-o", tmp_path / "page.html")
    assert "matches no file" in refused(capsys, clips / "*.npz", "-o", tmp_path / "page.html")
    assert there.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there.html"]


def test_it_opens_what_it_wrote(clips, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(webbrowser, "open", asked.append)
    assert main(["view", str(clips / "walk_1.bvh"), "-o", str(tmp_path / "page.html"), "--open", "--quiet"]) == 0
    assert asked == [(tmp_path / "page.html").as_uri()]


def test_files_tell_motions_of_one_label_apart(clips, free_body):
    from refine.formats.files import load_motion

    walks = [load_motion(clips / f"walk_{number}.bvh", free_body.rest_joints) for number in (1, 2)]
    assert roles_of(walks) == ["walk_1.bvh", "walk_2.bvh"]
    assert roles_of(walks[:1]) == [""]


@pytest.fixture
def server():
    code = "from refine.viewer.serving import serve; serve('<p>été', 0, lambda address: print(address, flush=True))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    yield process, process.stdout.readline().strip()
    process.kill()
    process.communicate()


def answer(address: str, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, str, dict[str, str]]:
    connection = http.client.HTTPConnection(address.removeprefix("http://").strip("/"), timeout=10)
    connection.request(method, path, headers=headers)
    response = connection.getresponse()
    content = response.read().decode()
    connection.close()
    return response.status, content, dict(response.getheaders())


def test_it_serves_one_page_to_this_machine_alone(server):
    process, address = server
    assert address.startswith("http://127.0.0.1:")
    status, content, headers = answer(address)
    assert (status, content, headers["Content-Type"]) == (200, "<p>été", "text/html; charset=utf-8")
    assert (headers["Cache-Control"], headers["X-Content-Type-Options"]) == ("no-store", "nosniff")
    assert answer(address, method="HEAD")[:2] == (200, "")
    assert answer(address, "/../etc/passwd")[0] == answer(address, "/page.html")[0] == 404
    assert answer(address, Host="evil.example")[0] == 403
    assert answer(address, method="POST")[0] == 501
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=10)
    assert (process.returncode, *said) == (0, "", "")


def test_a_port_that_is_taken_is_said_in_one_line(server, clips, capsys):
    port = server[1].strip("/").rpartition(":")[2]
    assert f"cannot listen on 127.0.0.1:{port}" in refused(capsys, clips / "walk_1.bvh", "--serve", "--port", port)
