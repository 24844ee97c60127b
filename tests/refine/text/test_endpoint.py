"""A language model behind a local server that speaks the protocol, and everything that such a server can do wrong."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from refine.text.answers import read_answers, write_answers
from refine.text.chat import MAX_REPLY, Endpoint, _wait
from refine.text.endpoint import EXAMPLES, LISTED, PROMPT, by_endpoint, messages
from refine.text.parts import Labelled, Parts
from renderers.checks import UserError

KEY = "sk-not-a-real-key"
ANSWERS = {"walk": "Answer: right leg\nleft leg\nbuttocks", "nod": "neck", "clap": "right arm\nleft arm"}
Reply = tuple[int, bytes, dict[str, str]]


@dataclass
class Fake:
    """What the server was asked, and what it replies; an exhausted list of replies is followed by good ones."""

    url: str = ""
    asked: list[dict] = field(default_factory=list)
    keys: list[str | None] = field(default_factory=list)
    replies: list[Reply | Callable[[BaseHTTPRequestHandler], None]] = field(default_factory=list)
    models: list[str] = field(default_factory=lambda: ["small"])

    def phrases(self) -> list[str]:
        return [asked["messages"][-1]["content"].split("action of: ")[1].rstrip("?") for asked in self.asked]


def good(content: str | None) -> Reply:
    return 200, json.dumps({"choices": [{"message": {"role": "assistant", "content": content}}]}).encode(), {}


def failing(code: int, message: str = "", **headers: str) -> Reply:
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    return code, json.dumps({"error": {"message": message}}).encode(), headers


@pytest.fixture
def fake(monkeypatch) -> Iterator[Fake]:
    monkeypatch.setenv("NO_PROXY", "*")
    made = Fake()

    class Handler(BaseHTTPRequestHandler):
        def send(self, code: int, content: bytes, headers: dict[str, str]) -> None:
            self.send_response(code)
            for name, value in {"Content-Length": str(len(content)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def do_GET(self) -> None:
            made.keys.append(self.headers.get("Authorization"))
            content = json.dumps({"object": "list", "data": [{"id": name} for name in made.models]}).encode()
            self.send(200 if self.path == "/v1/models" else 404, content, {})

        def do_POST(self) -> None:
            made.asked.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            made.keys.append(self.headers.get("Authorization"))
            reply = made.replies.pop(0) if made.replies else good(ANSWERS.get(made.phrases()[-1], "torso"))
            with suppress(OSError):  # nobody waits any more
                reply(self) if callable(reply) else self.send(*reply)

        def log_message(self, *_arguments) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    made.url = f"http://127.0.0.1:{server.server_port}/v1"
    yield made
    server.shutdown()
    server.server_close()


@dataclass
class Asked:
    """A labeller of the fake, and what it says and waits."""

    endpoint: Endpoint
    answers: Path | None = None
    key: str | None = None
    said: list[str] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)

    def __call__(self, *phrases: str) -> list[tuple[str, ...]]:
        label = by_endpoint(
            self.endpoint, by_default, self.said.append, self.answers, self.key, sleep=self.waits.append
        )
        self.found = label(phrases)
        assert [each.phrase for each in self.found] == list(phrases)
        return [each.parts.names for each in self.found]


def by_default(phrases) -> list[Labelled]:
    return [Labelled(phrase, Parts.of(["left arm"]), "default") for phrase in phrases]


def asking(fake: Fake, timeout: float = 5.0, answers: Path | None = None, key: str | None = None) -> Asked:
    return Asked(Endpoint(fake.url, "small", timeout), answers, key)


DEFAULT, WALK = ("left arm",), ("global", "left leg", "right leg")


def test_a_phrase_is_asked_as_the_paper_asks(fake) -> None:
    ask = asking(fake, key=KEY)
    assert ask("walk", "nod", "walk") == [WALK, ("torso",), WALK]
    assert [each.by for each in ask.found] == ["small"] * 3
    assert fake.phrases() == ["walk", "nod"] and fake.keys == [f"Bearer {KEY}"] * 2
    assert (ask.said, ask.waits) == ([], [])
    asked = fake.asked[0]
    assert asked["model"] == "small" and asked["temperature"] == 0
    assert all(f"\n{part}" in asked["messages"][0]["content"] for part in LISTED)
    assert asked["messages"] == messages("walk") and len(asked["messages"]) == 2 + 2 * len(EXAMPLES)


def test_without_a_key_none_is_sent(fake) -> None:
    asking(fake)("walk")
    assert fake.keys == [None]


def test_nothing_is_asked_twice(fake, tmp_path) -> None:
    path = tmp_path / "answers.json"
    asking(fake, answers=path, key=KEY)("walk", "nod")
    assert asking(fake, answers=path)("Walk ", "clap") == [WALK, ("left arm", "right arm")]
    assert fake.phrases() == ["walk", "nod", "clap"]
    assert read_answers(path) == {(phrase, "small", PROMPT): answer for phrase, answer in ANSWERS.items()}
    assert KEY not in path.read_text()
    Asked(Endpoint(fake.url, "large"), path)("walk")  # another model has other answers
    assert fake.phrases()[3:] == ["walk"]


def test_answers_to_another_prompt_are_asked_again_and_those_by_hand_are_not(fake, tmp_path) -> None:
    path = tmp_path / "answers.json"
    write_answers(path, {("walk", "small", "0"): "torso", ("nod", "", ""): "left arm"})
    assert asking(fake, answers=path)("walk", "nod") == [WALK, ("left arm",)]
    assert fake.phrases() == ["walk"]


def test_what_was_answered_is_kept_when_something_stops_it(fake, tmp_path) -> None:
    fake.replies = [good("neck"), failing(401)]
    with pytest.raises(UserError):
        asking(fake, answers=tmp_path / "answers.json")("nod", "walk")
    assert read_answers(tmp_path / "answers.json") == {("nod", "small", PROMPT): "neck"}


def test_answers_of_another_form_are_not_written_over(fake, tmp_path) -> None:
    path = tmp_path / "list.json"
    path.write_text('{"walk": ["a", "b", "neck"]}')
    with pytest.raises(UserError, match="not a file that answers are added to"):
        asking(fake, answers=path)("nod")
    assert path.read_text() == '{"walk": ["a", "b", "neck"]}' and not fake.asked


def test_the_model_of_a_server_that_has_one_need_not_be_named(fake) -> None:
    label = by_endpoint(Endpoint(fake.url + "/"), by_default, pytest.fail)
    assert label(["walk"])[0].parts.names == WALK and fake.asked[0]["model"] == "small"
    fake.models = ["small", "large"]
    with pytest.raises(UserError, match="has small, large; name one with --llm-model"):
        label(["walk"])


def test_a_server_that_is_down_is_tried_and_then_left(tmp_path) -> None:
    write_answers(tmp_path / "answers.json", {("nod", "small", PROMPT): "neck"})
    for model in ("small", None):
        ask = Asked(Endpoint("http://127.0.0.1:9/v1", model, 2.0), tmp_path / "answers.json")
        assert ask("walk", "nod", "clap") == [DEFAULT, ("torso",), DEFAULT]
        assert ask.waits == [1, 2, 4]  # for one phrase: the others would fare alike
        assert len(ask.said) == 1 and "refused" in ask.said[0] and "'walk', 'clap'" in ask.said[0]
        assert [each.by for each in ask.found][::2] == ["default", "default"]


def test_a_name_that_no_host_has_is_like_one_that_is_down() -> None:
    ask = Asked(Endpoint("http://a..b/v1", "small"))
    assert ask("walk") == [DEFAULT] and "no answer (" in ask.said[0]


def drip(handler: BaseHTTPRequestHandler) -> None:
    """Never late with the next byte."""
    handler.send_response(200)
    handler.end_headers()
    for _ in range(100):
        handler.wfile.write(b" ")
        handler.wfile.flush()
        time.sleep(0.05)


@pytest.mark.parametrize("slow", [lambda _: time.sleep(0.6), drip])
def test_a_slow_server_is_not_waited_for(fake, slow) -> None:
    fake.replies = [slow] * 4
    ask, start = asking(fake, timeout=0.2), time.monotonic()
    assert ask("walk", "nod") == [DEFAULT, DEFAULT]
    assert time.monotonic() - start < 3 and len(fake.asked) == 4
    assert "no answer in 0.2 s" in ask.said[0]


def test_a_server_that_is_slow_once_is_asked_again(fake) -> None:
    fake.replies = [lambda _: time.sleep(0.6)]
    ask = asking(fake, timeout=0.3)
    assert ask("walk") == [WALK] and ask.waits == [1] and not ask.said


@pytest.mark.parametrize(
    ("reply", "said"),
    [
        ((200, b"<html>hello</html>", {}), "not in JSON"),
        ((200, b"[" * 100_000, {}), "not in JSON"),
        ((200, b"\xff\xfe", {}), "not in JSON"),
        ((200, b"", {}), "not in JSON"),
        ((200, b"[]", {}), "not in the chat protocol"),
        ((200, b'{"choices": []}', {}), "not in the chat protocol"),
        ((200, b'{"choices": {"a": 1}}', {}), "not in the chat protocol"),
        (good(None), "not in the chat protocol"),
        (good("As a language model I have no body."), "cannot be used"),
        ((200, b" " * (MAX_REPLY + 2), {}), f"more than {MAX_REPLY} bytes"),
        (failing(500, "oops"), "error 500"),
        (failing(429), "error 429"),
        ((200, b"{", {"Content-Length": "50"}), "no answer|not in JSON"),
    ],
)
def test_nonsense_is_asked_again_and_then_left_to_the_default(fake, tmp_path, reply, said: str) -> None:
    fake.replies = [reply] * 4
    ask = asking(fake, timeout=1.0, answers=tmp_path / "answers.json")
    assert ask("walk", "nod")[0] == DEFAULT
    assert ask.waits == [1, 2, 4] and len(ask.said) == 1
    assert any(each in ask.said[0] for each in said.split("|")), ask.said
    if len(fake.asked) > 4:  # other phrases are asked after one that was answered with nonsense
        assert ask.found[1].parts.names == ("torso",)
        assert [phrase for phrase, _, _ in read_answers(tmp_path / "answers.json")] == ["nod"]


def test_a_server_that_answers_nothing_but_nonsense_is_given_up(fake) -> None:
    fake.replies = [good("no")] * 100
    assert asking(fake)(*"abcdefgh") == [DEFAULT] * 8
    assert len(fake.asked) == 3 * 4


def test_nonsense_now_and_then_does_not_stop_it(fake) -> None:
    fake.replies = [reply for _ in range(4) for reply in [*[good("no")] * 4, good("neck")]]
    assert asking(fake)(*"abcdefgh") == [DEFAULT, ("torso",)] * 4


def test_an_error_that_passes_is_forgotten(fake) -> None:
    fake.replies = [failing(500), failing(429, Retry_After="7"), failing(503, Retry_After="nonsense")]
    ask = asking(fake)
    assert ask("walk") == [WALK] and ask.waits == [1, 7, 4] and not ask.said


def test_nobody_waits_for_an_hour(fake) -> None:
    fake.replies = [failing(429, Retry_After="3600")] * 2
    ask = asking(fake)
    assert ask("walk", "walk again") == [DEFAULT, DEFAULT]
    assert ask.waits == [] and "asks to wait for 3600 s" in ask.said[0]


def test_a_server_may_name_the_moment() -> None:
    assert _wait("Wed, 21 Oct 2015 07:28:00 GMT") == 0
    assert _wait("Wed, 21 Oct 2065 07:28:00 GMT") > 1e6
    assert _wait("9" * 400) is None and _wait("9" * 9000) is None
    assert _wait("-5") == 0 and _wait("soon") is None and _wait(None) is None


@pytest.mark.parametrize("key", [KEY, None])
def test_a_refused_key_is_said_at_once(fake, key: str | None) -> None:
    fake.replies = [failing(401, f"Incorrect key {KEY}")]
    ask = asking(fake, key=key)
    with pytest.raises(UserError) as refused:
        ask("walk", "nod")
    assert len(fake.asked) == 1 and ask.waits == [] and "OPENAI_API_KEY" in str(refused.value)
    assert KEY not in str(refused.value)


def test_what_the_server_says_of_a_bad_question_is_passed_on_without_the_key(fake) -> None:
    fake.replies = [failing(404, f"no model small\nfor {KEY}" + "x" * 999)]
    with pytest.raises(UserError) as refused:
        asking(fake, key=KEY)("walk")
    said = str(refused.value)
    assert "error 404 (no model small for ...x" in said and KEY not in said and len(said) < 500 and "\n" not in said


def test_options_that_a_model_does_not_have_are_left_out(fake) -> None:
    fake.replies = [failing(400, "Unsupported parameter: 'max_tokens'"), failing(400, "'temperature' must be 1")]
    assert asking(fake)("walk") == [WALK]
    assert [sorted({"temperature", "max_tokens"} & set(asked)) for asked in fake.asked] == [
        ["max_tokens", "temperature"],
        ["temperature"],
        [],
    ]


@pytest.mark.parametrize("code", [301, 302, 307, 308])
def test_redirections_are_not_followed(fake, code: int) -> None:
    fake.replies = [failing(code, Location=f"{fake.url}/elsewhere")]
    with pytest.raises(UserError, match="sends us elsewhere"):
        asking(fake, key=KEY)("walk")
    assert len(fake.keys) == 1


@pytest.mark.parametrize("key", ["sk\nInjected: 1", "schlüssel"])
def test_a_key_that_is_none_is_refused_unseen(fake, key: str) -> None:
    with pytest.raises(UserError) as refused:
        asking(fake, key=key)("walk")
    assert key not in str(refused.value) and "OPENAI_API_KEY" in str(refused.value) and not fake.asked


@pytest.mark.parametrize(
    "url",
    [
        "localhost:8000/v1",
        "file:///etc/passwd",
        "ftp://host/v1",
        "http://",
        "http://[::1/v1",
        "http://host:port/v1",
        "http://user:secret@host/v1",
        "http://secret@host/v1",
        "http://host/v1?key=secret",
        "http://host /v1",
        "http://host/v1\r\nX: 1",
        "",
    ],
)
def test_addresses_that_are_none_are_refused(url: str) -> None:
    with pytest.raises(UserError) as refused:
        Endpoint(url)
    assert "secret" not in str(refused.value) and "http://localhost:8000/v1" in str(refused.value)


def test_impatience_is_refused() -> None:
    for timeout in (0, -1, float("nan"), 1e9):
        with pytest.raises(UserError, match="3600 seconds"):
            Endpoint("http://host/v1", timeout=timeout)
