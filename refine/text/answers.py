"""Answers of a language model: as the six parts, and kept in a JSON file."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from refine.formats.untrusted import MAX_TABLE, read_json
from refine.text.parts import BODY_PARTS, Labelled, Labeller, Parts
from renderers.checks import UserError, check_known
from renderers.outputs import replacing

# What answers call the parts, beside their names.
MEANT = {"buttocks": "global", "waist": "global", "global orientation": "global", "neck": "torso"}
MEANT |= {"right shoulder": "right arm", "left shoulder": "left arm"}
ARMS = {"left arm", "right arm"}
# Labels of BABEL that SINC counts as about the whole body, whatever is answered.
VOID = {f"{kind} behavior series" for kind in ("animal", "bird", "marine animal", "elephant")} | {"swim on air"}
THOUGHTS = re.compile(r"<think>.*?(?:</think>|\Z)", re.DOTALL)  # what some models write before they answer

USED_PROMPT = 2  # of the three that the published list of answers is about: with examples, buttocks and waist
FORMAT, VERSION = "refine-answers", 1
REMEDY = 'give {"walk forwards": "left leg, right leg, buttocks"}, what --answers wrote, or SINC\'s list of answers'

Key = tuple[str, str, str]  # phrase, model, prompt: what an answer depends on
Say = Callable[[str], None]  # takes a line for the person who waits


def parts_of_answer(answer: str) -> Parts:
    """The parts that an answer lists, by lines or commas, in SINC's way: what is no part (a hand, an eye) is left out.

    >>> parts_of_answer("Answer: right leg\\nleft leg\\nbuttocks").names
    ('global', 'left leg', 'right leg')

    Raises:
        UserError: no part is named.
    """
    lines = re.split(r"[\n,;]|\band\b", THOUGHTS.sub("", answer).lower())
    plain = (" ".join(re.sub(r"[\W\d_]+", " ", line).replace("answer", "").split()) for line in lines)
    listed = {MEANT.get(line, line) for line in plain}
    if "shoulders" in listed and not listed & ARMS:
        listed |= ARMS
    if not listed & set(BODY_PARTS):
        raise UserError("the answer", "names no part of the body", "list parts one a line: torso, right arm")
    return Parts.of(listed & set(BODY_PARTS))


def parts_for(phrase: str, answer: str) -> Parts:
    """As `parts_of_answer`, but for the five labels that SINC takes as about everything.

    Raises:
        UserError: no part is named.
    """
    return Parts.of(BODY_PARTS) if plain(phrase) in VOID else parts_of_answer(answer)


def plain(phrase: str) -> str:
    """The phrase in small letters, with single spaces: by this it is looked up."""
    return " ".join(phrase.lower().split())


def read_answers(path: str | Path, own: bool = False) -> dict[Key, str]:
    """The answers of a file, in the order in which they were given.

    Three forms are read: what `write_answers` writes; an object of phrases and their answers; and the list that SINC
    published, an object of labels and three answers each, of which the third is taken.

    Args:
        own: read the first form alone: the file is about to be written in it.

    Raises:
        UserError: the file is missing, too large, no JSON, or of another form, or has two answers for a phrase.
    """
    content = read_json(path, MAX_TABLE, unique=True)
    if not isinstance(content, dict):
        raise UserError(path, f"holds a {type(content).__name__}, not answers", REMEDY)
    if content.get("format") == FORMAT and isinstance(content.get("answers"), list):
        if content.get("version") != VERSION:
            raise UserError(path, f"is of version {content.get('version')!r}", f"this Refine reads version {VERSION}")
        entries = [_entry(path, number, entry) for number, entry in enumerate(content["answers"])]
    elif own:
        raise UserError(path, "is not a file that answers are added to", "name a new one, or leave --llm-url out")
    else:
        entries = [((plain(phrase), "", ""), _text(path, phrase, answer)) for phrase, answer in content.items()]
    found: dict[Key, str] = {}
    for key, answer in entries:
        if found.setdefault(key, answer) != answer:  # equal but for capitals and spaces
            raise UserError(path, f"has two answers for {key[0]!r}", "keep one of them")
    return found


def write_answers(path: str | Path, answers: Mapping[Key, str]) -> None:
    """Replace a file by these answers; it is whole at any moment."""
    entries = [dict(zip(("phrase", "model", "prompt"), key, strict=True)) | {"answer": answers[key]} for key in answers]
    content = {"format": FORMAT, "version": VERSION, "answers": entries}
    with replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def by_answers(answers: Mapping[Key, str], otherwise: Labeller, say: Say) -> Labeller:
    """A labeller that looks phrases up, of several answers to one the last; it asks ``otherwise`` where none is usable.

    Args:
        say: is told of how many phrases that was, and of which.
    """
    texts = {phrase: answer for (phrase, _, _), answer in answers.items()}

    def label(phrases: Sequence[str]) -> list[Labelled]:
        found: dict[str, Labelled] = {}
        for phrase in phrases:
            if (labelled := labelled_by_answer(phrase, texts.get(plain(phrase)), "answers")) is not None:
                found[phrase] = labelled
        return filled(phrases, found, otherwise, say, "no usable answer")

    return label


def labelled_by_answer(phrase: str, answer: str | None, by: str) -> Labelled | None:
    """What an answer says of a phrase; none where there is no answer, or it names no part."""
    if answer is None:
        return None
    try:
        parts = parts_for(phrase, answer)
    except UserError:
        return None
    said = ", ".join(line.strip() for line in THOUGHTS.sub("", answer).splitlines() if line.strip())
    return Labelled(phrase, parts, by, said[:200])


def filled(
    phrases: Sequence[str], found: Mapping[str, Labelled], otherwise: Labeller, say: Say, why: str
) -> list[Labelled]:
    """What was found, in the order of the phrases, and ``otherwise`` for those that are lacking, which is said."""
    lacking = [phrase for phrase in dict.fromkeys(phrases) if phrase not in found]
    if not lacking:
        return [found[phrase] for phrase in phrases]
    shown = ", ".join(map(repr, lacking[:3])) + (f" and {len(lacking) - 3} more" if len(lacking) > 3 else "")
    say(f"{why} for {shown}: labelled by the default labeller")
    every = {**found, **dict(zip(lacking, otherwise(lacking), strict=True))}
    return [every[phrase] for phrase in phrases]


def _text(path: str | Path, phrase: str, answer: Any) -> str:
    """An answer by itself, or the one of three that is used."""
    if isinstance(answer, list) and len(answer) == USED_PROMPT + 1:
        answer = answer[USED_PROMPT]
    if not isinstance(answer, str):
        raise UserError(path, f"{phrase!r}: neither an answer nor three", REMEDY)
    return answer


def _entry(path: str | Path, number: int, entry: Any) -> tuple[Key, str]:
    """An answer of our form; the model and the prompt may be left out."""
    where = f"{path}, answer {number}"
    if not isinstance(entry, dict) or not all(isinstance(value, str) for value in entry.values()):
        raise UserError(where, "is not an object of texts", REMEDY)
    for name in entry:
        check_known(where, name, ("phrase", "model", "prompt", "answer"))
    if not {"phrase", "answer"} <= set(entry):
        raise UserError(where, "lacks its phrase or its answer", REMEDY)
    return (plain(entry["phrase"]), entry.get("model", ""), entry.get("prompt", "")), entry["answer"]
