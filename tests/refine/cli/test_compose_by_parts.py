"""``refine compose --by parts`` on tiny clips: whose joints come out, what is said, what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from refine.cli.by_parts import texts_of
from refine.cli.main import main
from refine.formats.files import load_motion, save_motion
from refine.motion import Motion
from refine.synthetic import ACTIONS, draw, perform
from refine.text.labellers import labeller
from refine.text.phrases import PHRASES, phrase_of
from renderers.body import Body
from renderers.checks import UserError
from renderers.skeleton import PARTS

RIGHT, LEFT = list(PARTS["right_arm"]), list(PARTS["left_arm"])


@pytest.fixture(scope="module")
def rest_joints() -> torch.Tensor:
    return Body.free("light").rest_joints


@pytest.fixture(scope="module")
def clips(tmp_path_factory, rest_joints, free_body) -> dict[str, Path]:
    """A walk of 8 frames, waves of 12 and 8, and a run."""
    folder, random, found = tmp_path_factory.mktemp("clips"), torch.Generator().manual_seed(3), {}
    for name, frames in (("walk", 8), ("wave-right-hand", 12), ("wave-left-hand", 8), ("run", 8)):
        found[name] = folder / f"{name}.npz"
        save_motion(perform(draw(name, random), frames, rest_joints), found[name], free_body)
    return found


@pytest.fixture
def compose(clips, tmp_path, rest_joints, capsys):
    """Runs the verb without refinement; the motion, what was printed, and what was said."""

    def run(*words: str) -> tuple[Motion, dict, str]:
        out = tmp_path / "both.npz"
        names = [str(clips.get(word, word)) for word in words]
        capsys.readouterr()
        assert main(["compose", *names, "--by", "parts", "-o", str(out), "--steps", "0", "--json", "--force"]) == 0
        printed = capsys.readouterr()
        return load_motion(out, rest_joints), json.loads(printed.out), printed.err

    return run


def rotations(clips, rest_joints, name: str) -> torch.Tensor:
    return load_motion(clips[name], rest_joints).rotations


def test_each_part_comes_from_the_action_that_is_about_it(compose, clips, rest_joints):
    made, found, said = compose(
        "walk", "wave-right-hand", "--text-a", "walk forwards", "--text-b", "wave with the right hand"
    )
    walk, wave = (rotations(clips, rest_joints, name) for name in ("walk", "wave-right-hand"))
    assert torch.allclose(made.rotations[:, RIGHT], wave[2:10, RIGHT], atol=1e-3)
    others = [joint for joint in range(24) if joint not in RIGHT]
    assert torch.allclose(made.rotations[:, others], walk[:, others], atol=1e-3)
    assert found["by"] == "parts" and found["made"] == "coupled" and found["frames"] == 8
    assert found["actions"]["B"]["text"] == "wave with the right hand"
    assert found["actions"]["B"]["parts"] == ["right arm"]
    assert {part for part, owner in found["owners"].items() if owner == "B"} == {"right arm"}
    assert "wins" not in said


def test_trimming_can_be_from_the_start(compose, clips, rest_joints):
    made = compose("walk", "wave-right-hand", "--trim", "start")[0]
    wave = rotations(clips, rest_joints, "wave-right-hand")
    assert torch.allclose(made.rotations[:, RIGHT], wave[:8, RIGHT], atol=1e-3)


def test_texts_are_the_labels_unless_given(compose):
    found = compose("walk", "wave-left-hand")[1]
    assert [action["text"] for action in found["actions"].values()] == ["walk forwards", "wave with the left hand"]


def test_a_text_that_lists_parts_is_taken_at_its_word(compose):
    found = compose("walk", "wave-right-hand", "--text-b", "Torso, left arm")[1]
    assert found["actions"]["B"]["parts"] == ["torso", "left arm"]
    assert found["owners"]["right arm"] == "A"


def test_a_third_action_joins(compose, clips, rest_joints):
    words = ("--more", "wave-left-hand", "--text-more", "wave with the left hand")
    made, found, _ = compose("walk", "wave-right-hand", *words)
    assert torch.allclose(made.rotations[:, LEFT], rotations(clips, rest_joints, "wave-left-hand")[:, LEFT], atol=1e-3)
    assert (found["owners"]["left arm"], found["owners"]["right arm"], found["owners"]["global"]) == ("C", "B", "A")


def test_who_wins_what_both_need_is_said_in_one_line(compose):
    _, found, said = compose("walk", "run")
    assert said == "refine: both A and B need the legs, B wins (fewer parts win over more, of equals the later)\n"
    assert found["owners"]["left leg"] == "B" and found["owners"]["left arm"] == "A"


@pytest.mark.parametrize(
    "words, reason",
    [
        (["--text-a", "walk"], "--text-a: is for composing by parts"),
        (["--by", "parts", "--lam", "0.3"], "--lam: weighs energies"),
        (["--by", "parts", "--text-b", " "], "--text-b: is empty"),
        (["--by", "parts", "--text-more", "nod"], "--text-more: 1 texts for the 0 clips"),
        (["--by", "parts", "--more", "walk", "--text-more", "nod", "bow"], "--text-more: 2 texts for the 1 clips"),
    ],
)
def test_what_does_not_fit_is_refused(words, reason, tmp_path, capsys):
    out = tmp_path / "both.bvh"
    assert main(["compose", "walk", "wave-left-hand", "-o", str(out), "--steps", "0", *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"refine: {reason}") and said.count("\n") == 1
    assert not out.exists()


def test_a_clip_without_a_label_needs_a_text(rest_joints):
    clip = perform(draw("walk", torch.Generator().manual_seed(0)), 4, rest_joints)
    nameless = replace(clip, label="")
    with pytest.raises(UserError, match="x.bvh: has no label.*--text-b"):
        texts_of([clip, nameless], ["walk", "x.bvh"], [None, None], ["--text-a", "--text-b"])
    assert texts_of([clip, nameless], ["walk", "x.bvh"], [None, "nod"], ["", ""]) == ["walk forwards", "nod"]


def test_every_built_in_action_has_a_phrase():
    assert set(PHRASES) == set(ACTIONS)
    assert labeller()(list(PHRASES.values()))[-1].parts.names == ("right arm",)
    assert phrase_of("walk-turn_left") == "walk turn left" and phrase_of("") == ""
