"""Flags that choose what says which parts of the body texts are about. Light to import."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from refine.cli.inputs import say
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.text.parts import Labelled, Labeller

LONGEST_PHRASE = 500  # characters
MOST_SAID = 10  # lines
NOBODY = "nobody"  # has labelled a phrase of which nothing is understood


@dataclass(frozen=True)
class Labelling:
    """Flags of every verb that asks which parts a text is about."""

    answers: Path | None = None
    """JSON file of a language model's answers, to be used instead of asking: as --llm-url keeps them there, phrases
    with their answers, or the list that SINC published."""
    llm_url: str | None = None
    """Ask a language model at this address, such as http://localhost:8000/v1, by OpenAI's chat protocol; the key is
    taken from OPENAI_API_KEY. Nothing else uses a network."""
    llm_model: str | None = None
    """Its name there; none takes the one that the server has."""
    llm_timeout: float = 30.0
    """Seconds to wait for one of its answers."""

    def given(self) -> list[str]:
        """The flags that are set."""
        values = {"--answers": self.answers, "--llm-url": self.llm_url, "--llm-model": self.llm_model}
        return [flag for flag, value in values.items() if value is not None]

    def labeller(self, lenient: bool = False) -> "Labeller":
        """The default one, or what the flags ask for with the default one where that has no answer, which is said.

        Args:
            lenient: phrases of which nothing is understood get no part, instead of being refused.

        Raises:
            UserError: the flags contradict each other, or the file or the address cannot be used.
        """
        from refine.text.answers import by_answers, read_answers
        from refine.text.labellers import labeller

        if self.llm_model is not None and self.llm_url is None:
            raise UserError("--llm-model", "names a model, but nowhere to ask it", "add --llm-url, or leave it out")
        default = forgiving(labeller()) if lenient else labeller()
        if self.llm_url is not None:
            return self._asking(default)
        if self.answers is not None:
            return by_answers(read_answers(self.answers), default, _say)
        return default

    def _asking(self, default: "Labeller") -> "Labeller":
        import os
        from functools import partial

        from tqdm import tqdm

        from refine.text.chat import Endpoint
        from refine.text.endpoint import by_endpoint

        endpoint = Endpoint(self.llm_url or "", self.llm_model, self.llm_timeout)
        progress = partial(tqdm, desc="ask", unit="phrase", disable=None, leave=False)
        return by_endpoint(endpoint, default, _say, self.answers, os.environ.get("OPENAI_API_KEY"), progress)


# In a verb: ``labelling: Chosen = BY_DEFAULT``.
Chosen = Annotated[Labelling, arg(name="")]
BY_DEFAULT = Labelling()


def forgiving(labeller: "Labeller") -> "Labeller":
    """A labeller that gives no part to phrases which the other refuses: of many, one does not spoil the rest."""
    from refine.text.parts import Labelled, Parts

    def label(phrases: Sequence[str]) -> list[Labelled]:
        found = []
        for phrase in phrases:
            try:
                found += labeller([phrase])
            except UserError as error:
                found.append(Labelled(phrase, Parts.of(()), NOBODY, error.problem, tuple(phrase.split())))
        return found

    return label


def check_phrases(where: str, phrases: Iterable[str]) -> None:
    """Refuse what nobody would call the name of an action.

    Raises:
        UserError: a phrase is empty, or longer than ``LONGEST_PHRASE``.
    """
    for phrase in phrases:
        if not phrase.strip():
            raise UserError(where, "is empty", 'say what is done, such as "walk forwards"')
        if len(phrase) > LONGEST_PHRASE:
            problem = f"{phrase[:40]!r}... has {len(phrase)} characters, more than {LONGEST_PHRASE}"
            raise UserError(where, problem, "say it shorter")


def say_unknown(labelled: Iterable["Labelled"], names: Iterable[str]) -> None:
    """A line on stderr for each text with words that are not known, for the first few of many."""
    lines = [
        f"{name}: not known: {', '.join(each.unknown)}"
        for name, each in zip(names, labelled, strict=False)
        if each.unknown
    ]
    for line in lines[:MOST_SAID]:
        _say(line)
    if len(lines) > MOST_SAID:
        _say(f"and words of {len(lines) - MOST_SAID} more phrases")


def _say(line: str) -> None:
    say(f"refine: {line}")
