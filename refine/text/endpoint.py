"""Parts of the body from a language model, behind any address that speaks OpenAI's chat protocol."""

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from refine.text.answers import Key, Say, filled, labelled_by_answer, plain, read_answers, write_answers
from refine.text.chat import Endpoint, Message, NoAnswer, Server, Silence, Sleep
from refine.text.parts import Labelled, Labeller
from renderers.outputs import check_place

LISTED = ("left arm", "right arm", "left leg", "buttocks", "waist", "right leg", "torso", "neck")
INSTRUCTIONS = (
    "You say which parts of the body an action of a person involves. Choose from this list alone, and answer with one "
    "part a line and nothing else:\n\n" + "\n".join(LISTED)
)
QUESTION = "What are the body parts involved in the action of: {phrase}?"
EXAMPLES = {  # SINC, listing 1
    "walk forwards": ("right leg", "left leg", "buttocks"),
    "face to the left": ("torso", "neck"),
    "put headphones over ears": ("right arm", "left arm", "neck"),
    "sit down": ("right leg", "left leg", "buttocks", "waist"),
}
PROMPT = "1"  # changes with the words above, so that answers to other words are not taken for answers to these

KEPT_EVERY = 20  # answers
GIVE_UP = 3  # phrases in a row without a usable answer


def messages(phrase: str) -> list[Message]:
    """What is sent of a phrase: the instructions with the list, four examples, and the question."""
    found = [{"role": "system", "content": INSTRUCTIONS}]
    for example, parts in EXAMPLES.items():
        found.append({"role": "user", "content": QUESTION.format(phrase=example)})
        found.append({"role": "assistant", "content": "\n".join(parts)})
    return [*found, {"role": "user", "content": QUESTION.format(phrase=phrase)}]


def by_endpoint(
    endpoint: Endpoint,
    otherwise: Labeller,
    say: Say,
    answers: str | Path | None = None,
    key: str | None = None,
    progress: Callable[[Sequence[str]], Any] | None = None,
    sleep: Sleep = time.sleep,
) -> Labeller:
    """A labeller that asks a language model, and ``otherwise`` where it gives no usable answer.

    Args:
        say: is told of how many phrases that was, of which, and why.
        answers: JSON file of answers; what is in it is not asked, and what is asked is added every few answers.
        key: sent to ``endpoint`` and to nobody else; redirections are not followed.
        progress: goes over the phrases that are asked, as ``tqdm`` would.
        sleep: waits for that many seconds.

    The labeller raises:
        UserError: the server refuses the key, the model or the question, or has several models and none was named.
    """
    server = Server(endpoint, key, sleep)

    def label(phrases: Sequence[str]) -> list[Labelled]:
        kept = _kept(answers)
        reasons: dict[str, None] = {}  # in the order in which they came
        try:
            model = endpoint.model or server.only_model()
            texts = {
                phrase: text
                for (phrase, of, prompt), text in kept.items()
                if (of, prompt) in (("", ""), (model, PROMPT))
            }
            ask = {plain(phrase): phrase for phrase in phrases if plain(phrase) not in texts}
            asked = list(ask.values())
            texts |= _ask_all(server, model, progress(asked) if progress else asked, kept, reasons, answers)
        except NoAnswer as error:  # of the model's name: then what is known is used, of any model
            reasons[str(error)], model = None, "answers"
            texts = {phrase: text for (phrase, _, _), text in kept.items()}
        labelled = {phrase: labelled_by_answer(phrase, texts.get(plain(phrase)), model) for phrase in phrases}
        found = {phrase: each for phrase, each in labelled.items() if each is not None}
        return filled(phrases, found, otherwise, say, f"{endpoint.url}: {'; '.join(reasons) or 'no usable answer'}")

    return label


def _ask_all(
    server: Server,
    model: str,
    phrases: Sequence[str],
    kept: dict[Key, str],
    reasons: dict[str, None],
    path: str | Path | None,
) -> dict[str, str]:
    """The answers, also added to ``kept``; to ``reasons`` why a phrase has none. Gives up where asking is in vain."""
    found: dict[str, str] = {}
    new = failed = 0
    try:
        for phrase in phrases:
            try:
                answer = server.answer(model, messages(phrase), partial(_usable, phrase))
                found[plain(phrase)] = kept[plain(phrase), model, PROMPT] = answer
                new, failed = new + 1, 0
            except NoAnswer as error:
                reasons[str(error)] = None
                failed += 1
                if failed == GIVE_UP or isinstance(error, Silence):
                    break
            if path is not None and new == KEPT_EVERY:
                write_answers(path, kept)
                new = 0
    finally:  # so that nothing is asked twice, whatever stops it
        if path is not None and new:
            write_answers(path, kept)
    return found


def _usable(phrase: str, answer: str) -> bool:
    return labelled_by_answer(phrase, answer, "") is not None


def _kept(path: str | Path | None) -> dict[Key, str]:
    """What the file of answers holds, if there is one.

    Raises:
        UserError: answers cannot be added to it, or see `read_answers`.
    """
    if path is None:
        return {}
    check_place(path)
    return read_answers(path, own=True) if os.path.lexists(path) else {}
