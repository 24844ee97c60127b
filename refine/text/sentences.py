"""Several descriptions in one sentence: SINC's text augmentation (section 3.2, protocol D.3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from refine.text.gerunds import as_gerund
from renderers.checks import UserError, check_known


@dataclass(frozen=True)
class Template:
    """How descriptions are joined.

    Attributes:
        join: what stands between two.
        before, after: what stands around them all.
        gerund: all but the first go on in the -ing form.
        last: what stands before the last one, unless it is as before the others.
    """

    join: str
    before: str = ""
    after: str = ""
    gerund: bool = False
    last: str | None = None

    def __call__(self, texts: Sequence[str]) -> str:
        if len(texts) == 1:
            return texts[0]
        first, *others = texts
        said = [first, *map(as_gerund, others)] if self.gerund else list(texts)
        head, tail = self.join.join(said[:-1]), said[-1]
        return f"{self.before}{head}{self.join if self.last is None else self.last}{tail}{self.after}"


TEMPLATES = {
    "while": Template(" while ", gerund=True),
    "during": Template(" during ", gerund=True),
    "simultaneously": Template(", ", before="simultaneously ", last=" and "),
    "comma": Template(", "),
    "at the same time": Template(", ", after=" at the same time", last=" and "),
}
"""The five that training draws from."""

UNSEEN = {
    "in parallel": Template(", ", after=" in parallel", last=" and "),
    "whilst": Template(" whilst ", gerund=True),
    "synchronously": Template(", ", after=" synchronously", last=" and "),
}
"""The three that the paper tests besides (Table A.3)."""


def combine(texts: Sequence[str], conjunction: str = "while") -> str:
    """One sentence for actions that happen at once; one text alone stays as it is.

    >>> combine(["walk forwards", "take a bow"]), combine(["walk", "wave"], "at the same time")
    ('walk forwards while taking a bow', 'walk and wave at the same time')
    >>> combine(["walk", "wave", "look up"]), combine(["walk", "wave", "look up"], "simultaneously")
    ('walk while waving while looking up', 'simultaneously walk, wave and look up')

    Raises:
        UserError: no text, or no such conjunction.
    """
    check_known("combine(conjunction)", conjunction, TEMPLATES | UNSEEN)
    if not texts:
        raise UserError("combine", "there is no text", "describe an action")
    return (TEMPLATES | UNSEEN)[conjunction](texts)


def combine_randomly(texts: Sequence[str], random: torch.Generator) -> str:
    """With one of ``TEMPLATES``, each as likely."""
    names = list(TEMPLATES)
    return combine(texts, names[int(torch.randint(len(names), (), generator=random))])
