"""``refine text parts``: what it prints, what it is evaluated by, and what it refuses."""

import json
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from refine.cli.main import main
from refine.formats.files import save_motion
from refine.synthetic import draw, perform

WALK, WAVE = "walk forwards", "wave with the right hand"
LABELS = {WALK: [1, 0, 0.5, 0.5, 1, 1], WAVE: [0, 1, 0, 1, 0, 0]}


@pytest.fixture
def parts(capsys):
    """Runs the verb; what it printed and what it said."""

    def run(*words: str | Path) -> tuple[str, str]:
        capsys.readouterr()
        assert main(["text", "parts", *map(str, words)]) == 0
        printed = capsys.readouterr()
        return printed.out, printed.err

    return run


@pytest.fixture
def file(tmp_path):
    def write(name: str, content: object) -> Path:
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return write


def test_people_get_a_row_for_each_phrase(parts):
    printed, said = parts(WALK, WAVE)
    head, walk, wave = printed.splitlines()
    columns = [head.index(name) for name in ("global", "torso", "left arm", "right arm", "left leg", "right leg")]
    assert [walk[column] for column in columns] == list("x...xx") and walk.endswith(f"  {WALK}")
    assert [wave[column] for column in columns] == list("...x..") and wave.endswith(f"  {WAVE}")
    assert not said


def test_programs_get_the_same(parts):
    found = json.loads(parts(WALK, WAVE, "--json")[0])
    assert found["verb"] == "text parts"
    assert [(each["phrase"], each["parts"]) for each in found["phrases"]] == [
        (WALK, ["global", "left leg", "right leg"]),
        (WAVE, ["right arm"]),
    ]
    assert all(each["by"] and each["unknown"] == [] for each in found["phrases"])


def test_words_that_are_not_known_are_said(parts):
    printed, said = parts(f"{WAVE} and frobnicate", WALK, "--json")
    assert "not known: frobnicate" in said and said.count("\n") == 1
    assert [each["unknown"] for each in json.loads(printed)["phrases"]] == [["frobnicate"], []]


def test_one_phrase_of_many_that_is_not_understood_gets_no_part(parts, file):
    printed, said = parts("xqzvk", WALK, "--json")
    assert [each["parts"] for each in json.loads(printed)["phrases"]] == [[], ["global", "left leg", "right leg"]]
    assert "'xqzvk': not known: xqzvk" in said
    answers = file("answers.json", {WALK: "neck"})
    assert "nobody" in parts("xqzvk", WALK, "--answers", answers, "--json")[0]


def test_of_many_phrases_not_all_unknown_words_are_said(parts, file):
    said = parts("--phrases", file("phrases.txt", "\n".join(f"{WAVE} frob{letter}" for letter in "abcdefghijklmno")))[1]
    assert said.count("\n") == 11 and "5 more" in said


def test_many_phrases_come_from_a_file(parts, file):
    path = file("phrases.txt", f"\ufeff{WALK}\r\n\n  {WAVE}  \n")
    assert parts("--phrases", path) == parts(WALK, WAVE)


def test_answers_of_a_file_go_before_the_default(parts, file):
    answers = file("answers.json", {WALK: ["neck", "neck", "Answer: torso\nneck"], "frobnicate": "left leg"})
    printed, said = parts(WALK, WAVE, "frobnicate", "--answers", answers, "--json")
    found = [(each["parts"], each["by"]) for each in json.loads(printed)["phrases"]]
    assert found[0] == (["torso"], "answers") and found[2] == (["left leg"], "answers")
    assert found[1][0] == ["right arm"] and found[1][1] != "answers"
    assert said.count("\n") == 1 and WAVE in said and WALK not in said


def test_evaluation_counts_by_both_rules(parts, file):
    labels = file("labels.json", LABELS)
    found = json.loads(parts("--evaluate", labels, "--json")[0])
    assert found["mean"] == pytest.approx((5 + 1 / 2) / 6)
    assert found["mean_strict"] == pytest.approx((3 * 1 + 3 * 1 / 2) / 6)
    assert found["parts"]["torso"] == {"accuracy": 0.5, "strict": 0.5, "n": 2}
    assert found["parts"]["left arm"] == {"accuracy": 1.0, "strict": 0.5, "n": 1}
    assert found["wrong"] == [{"phrase": WAVE, "parts": ["torso"]}] and found["n"] == 2
    printed = parts("--evaluate", labels)[0]
    assert "0.917" in printed and "0.750" in printed and "paper: GPT-3, list and examples" in printed
    assert f'"{WAVE}": torso' in printed


def test_answers_are_evaluated_too(parts, file):
    labels, answers = file("labels.json", LABELS), file("answers.json", {WALK: "waist", WAVE: "neck, right arm"})
    found = json.loads(parts("--evaluate", labels, "--answers", answers, "--json")[0])
    assert found["by"] == {"answers": 2} and found["wrong"] == [{"phrase": WALK, "parts": ["left leg", "right leg"]}]


# --- a language model ------------------------------------------------------------------------------------------------


@pytest.fixture
def model(monkeypatch):
    """The address of a language model to which everything is about the neck; and the keys that it was sent."""
    monkeypatch.setenv("NO_PROXY", "*")
    keys = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            keys.append(self.headers["Authorization"])
            content = json.dumps({"choices": [{"message": {"content": "neck"}}]}).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_arguments) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/v1", keys
        server.shutdown()


def test_a_language_model_is_asked_once(parts, model, tmp_path, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", "sk-not-a-real-key")
    url, keys = model
    words = (WALK, "--llm-url", url, "--llm-model", "small", "--answers", tmp_path / "answers.json", "--json")
    for _ in range(2):
        printed, said = parts(*words)
        assert [each["parts"] for each in json.loads(printed)["phrases"]] == [["torso"]]
        assert "sk-not" not in printed + said
    assert keys == ["Bearer sk-not-a-real-key"]
    offline = parts(WALK, "--answers", tmp_path / "answers.json", "--json")[0]
    assert json.loads(offline)["phrases"][0]["parts"] == ["torso"]


def test_compose_takes_the_same_labellers(model, tmp_path, rest_joints, free_body, generator, capsys):
    for name in ("walk", "wave-right-hand"):
        save_motion(perform(draw(name, generator), 8, rest_joints), tmp_path / f"{name}.npz", free_body)
    words = [
        *("compose", str(tmp_path / "walk.npz"), str(tmp_path / "wave-right-hand.npz"), "--steps", "0"),
        *("--by", "parts", "--text-a", "left leg, right leg", "-o", str(tmp_path / "c.npz"), "--json"),
        *("--text-b", "frobnicate", "--llm-url", model[0], "--llm-model", "small"),
    ]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["actions"]["B"]["parts"] == ["torso"]


def test_blending_by_energies_takes_no_labeller(tmp_path, capsys):
    words = ["compose", "walk", "run", "-o", str(tmp_path / "c.npz"), "--answers", "answers.json"]
    assert main(words) == 2
    assert "--answers: is for composing by parts" in capsys.readouterr().err


# --- by speed --------------------------------------------------------------------------------------------------------


def test_motions_are_labelled_by_their_speeds(parts, tmp_path, rest_joints, free_body, generator):
    path = tmp_path / "wave.npz"
    save_motion(perform(draw("wave-right-hand", generator), 40, rest_joints), path, free_body)
    for rule in ("paper", "code"):
        found = json.loads(parts("--velocity", rule, path, "wave-left-hand", "--json")[0])
        assert [each["parts"] for each in found["motions"]] == [["right arm"], ["left arm"]]
        assert found["rule"] == rule and len(found["motions"][0]["scores"]) == 6
    found = json.loads(parts("--velocity", "code", path, "--threshold", "1", "--json")[0])
    assert found["motions"][0]["parts"] == [] and found["threshold"] == 1
    assert "wave.npz" in parts("--velocity", "code", path)[0]


def test_speeds_are_evaluated_by_the_motions_labels(parts, file):
    labels = file("labels.json", {"wave with the left hand": [0, 0, 1, 0, 0, 0], "wave-right-hand": [0, 1, 0, 1, 0, 0]})
    words = ("wave-left-hand", "wave-right-hand", "walk", "--velocity", "code", "--evaluate", labels)
    printed, said = parts(*words, "--json")
    found = json.loads(printed)
    assert found["n"] == 2 and found["by"] == {"velocity, code": 2}
    assert found["wrong"] == [{"phrase": "wave-right-hand", "parts": ["torso"]}]
    assert "walk" in said and "velocity, code, 2 motions" in parts(*words)[0]


# --- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "has no phrase"),
        ([""], "is empty"),
        (["xqzvk"], "has no word that is known"),
        (["xqzvk", "zzkqv"], "no phrase has a word that is known"),
        ([WALK, "  "], "is empty"),
        (["walk " * 101], "text parts: 'walk walk walk walk walk walk walk walk '... has 505 characters"),
        (["--phrases", "EMPTY"], "is empty"),
        (["--phrases", "BINARY"], "not text in UTF-8"),
        (["--phrases", "missing.txt"], "missing.txt"),
        ([WALK, "--threshold", "0.5"], "--velocity"),
        (["--velocity", "code"], "no motion"),
        (["--velocity", "code", "walks"], "did you mean"),
        (["--velocity", "code", "walk", "--llm-url", "http://localhost/v1"], "--llm-url"),
        (["--velocity", "code", "walk", "--phrases", "EMPTY"], "--phrases"),
        ([WALK, "--evaluate", "LABELS"], "own phrases"),
        (["--velocity", "code", "squat", "--evaluate", "LABELS"], "has no label for squat"),
        (["--evaluate", "ANSWERS"], "has not six values"),
        ([WALK, "--answers", "LABELS"], "neither an answer nor three"),
        ([WALK, "--answers", "missing.json"], "missing.json"),
        ([WALK, "--llm-model", "small"], "add --llm-url"),
        ([WALK, "--llm-url", "localhost"], "no address"),
        ([WALK, "--llm-url", "http://localhost/v1", "--llm-timeout", "0"], "3600 seconds"),
        ([WALK, "--llm-url", "http://localhost/v1", "--answers", "ANSWERS"], "not a file that answers are added to"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(words, said, file, capsys):
    files = {
        "EMPTY": file("empty.txt", "\n \n"),
        "LABELS": file("labels.json", LABELS),
        "ANSWERS": file("answers.json", {WALK: "neck"}),
        "BINARY": file("binary.txt", "x"),
    }
    files["BINARY"].write_bytes(b"walk\xff\n")
    assert main(["text", "parts", *(str(files.get(word, word)) for word in words)]) == 2
    printed = capsys.readouterr()
    assert said in printed.err and printed.err.count("\n") == 1 and not printed.out
