"""``refine text``: what texts say of bodies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from refine.cli.labelling import BY_DEFAULT, Chosen
from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.motion import Motion
    from refine.text.accuracy import Label
    from refine.text.parts import Parts


@dataclass(frozen=True)
class TextParts:
    """Say which parts of the body phrases are about: global (travel, turning), torso, arms, legs.

    Without a network, unless --llm-url names a language model to ask. With --evaluate, how often that is right.

    Example: refine text parts "walk forwards" "wave with the right hand"
    Example: refine text parts --phrases phrases.txt --json
    Example: refine text parts "juggle" --llm-url http://localhost:8000/v1 --answers answers.json
    Example: refine text parts --velocity code walk.bvh "clips/*.bvh"
    Example: refine text parts --evaluate labels.json
    """

    texts: Positional[tuple[str, ...]] = ()
    """Phrases, each in quotes; with --velocity motion files, quoted patterns, or names of built-in actions."""
    phrases: Path | None = None
    """Text file with one phrase a line, for many."""
    labelling: Chosen = BY_DEFAULT
    velocity: Literal["paper", "code"] | None = None
    """Go by how fast parts move in motions instead, SINC's baseline: as its paper has it, or as its code does."""
    threshold: float | None = None
    """With --velocity: a part is marked that scores more; none is 0 standard deviations (paper) and 0.65 (code)."""
    evaluate: Path | None = None
    """JSON file of phrases labelled by hand, {"walk": [1, 0, 0.5, 0.5, 1, 1]}, in the order global, torso, left arm,
    right arm, left leg, right leg, 0.5 where it may be either: prints how often each part is right."""
    seed: int = 0
    """Of built-in actions."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        self._check_flags()
        if self.velocity is not None:
            return self._by_velocity(self.velocity)
        from refine.cli.labelling import NOBODY, check_phrases, say_unknown

        labels = self._labels()
        phrases = list(labels) if labels else [*self.texts, *self._lines()]
        if not phrases:
            raise UserError("text parts", "has no phrase", 'give one, such as "walk forwards", or --phrases FILE')
        check_phrases(str(self.evaluate) if labels else "text parts", phrases)
        labelled = self.labelling.labeller(lenient=len(phrases) > 1 or bool(labels))(phrases)
        if all(each.by == NOBODY for each in labelled):
            raise UserError("text parts", "no phrase has a word that is known", "say them otherwise")
        parts = [each.parts for each in labelled]
        say_unknown(labelled, map(repr, phrases))
        if labels:
            return _evaluated(phrases, labels, parts, [each.by for each in labelled])
        found = [
            {"phrase": one.phrase, "parts": one.parts.names, "by": one.by, "why": one.why, "unknown": one.unknown}
            for one in labelled
        ]
        return Result(_marks(phrases, parts), values={"phrases": found})

    def _check_flags(self) -> None:
        """Refuse flags that say nothing together."""
        if self.threshold is not None and self.velocity is None:
            raise UserError("--threshold", "is for speeds", "add --velocity, or leave it out")
        if self.velocity is not None:
            for flag in [*self.labelling.given(), *(["--phrases"] if self.phrases else [])]:
                raise UserError(flag, "is for phrases, and --velocity for motions", "leave one of them out")
        elif self.evaluate is not None and (self.texts or self.phrases):
            raise UserError("--evaluate", "brings its own phrases", "leave the others out")

    def _labels(self) -> "dict[str, Label]":
        from refine.text.accuracy import read_labels

        return {} if self.evaluate is None else read_labels(self.evaluate)

    def _lines(self) -> list[str]:
        """The phrases of the file; lines without anything are left out."""
        if self.phrases is None:
            return []
        from refine.formats.untrusted import MAX_TABLE, read_bytes

        try:
            lines = read_bytes(self.phrases, MAX_TABLE).decode("utf-8-sig").splitlines()
        except UnicodeDecodeError as error:
            raise UserError(self.phrases, "is not text in UTF-8", "save it as such") from error
        return [line.strip() for line in lines if line.strip()]

    def _by_velocity(self, rule: str) -> Result:
        from refine.cli.inputs import body_of
        from refine.text.velocity import RULES, parts_above, scores_of

        if not self.texts:
            raise UserError("text parts", "has no motion", "give files, or names of built-in actions")
        threshold = RULES[rule].threshold if self.threshold is None else self.threshold
        labels, rest_joints = self._labels(), body_of(None).rest_joints
        motions = self._motions(rest_joints)
        scores = [scores_of(motion, rest_joints, rule) for motion in motions]
        parts = [parts_above(each, threshold) for each in scores]
        if labels:
            return _evaluated_motions(motions, labels, parts, f"velocity, {rule}")
        found = [
            {"source": motion.source, "label": motion.label, "parts": each.names, "scores": score}
            for motion, each, score in zip(motions, parts, scores, strict=True)
        ]
        names = [_name(motion) for motion in motions]
        return Result(_marks(names, parts), values={"rule": rule, "threshold": threshold, "motions": found})

    def _motions(self, rest_joints: Any) -> "list[Motion]":
        import os

        from refine.cli.inputs import bar, clip_of, expand
        from refine.formats.files import load_motions

        paths, found = expand(self.texts), []
        with bar(len(paths), "read") as progress:
            for path in paths:
                is_file = os.path.lexists(path) or path.suffix
                found += load_motions(path, rest_joints) if is_file else [clip_of(str(path), rest_joints, self.seed)]
                progress()
        return found


def _name(motion: "Motion") -> str:
    return motion.source if motion.label in motion.source else f"{motion.label} ({motion.source})"


def _marks(names: Sequence[str], parts: "Sequence[Parts]") -> str:
    """A row for each name, with a mark for each part that it is about."""
    from refine.text.parts import BODY_PARTS

    rows = [
        [f"{'x' if about else '.':<{len(part)}}" for part, about in zip(BODY_PARTS, row, strict=True)] for row in parts
    ]
    return "\n".join(
        [
            "  ".join(BODY_PARTS),
            *("  ".join([*row, " ".join(name.split())]) for row, name in zip(rows, names, strict=True)),
        ]
    )


def _evaluated(
    phrases: Sequence[str],
    labels: "Mapping[str, Label]",
    parts: "Sequence[Parts]",
    by: Sequence[str],
    what: str = "phrases",
) -> Result:
    from collections import Counter

    from refine.text.accuracy import accuracy, report

    found, makers = accuracy(phrases, [labels[phrase] for phrase in phrases], parts), Counter(by)
    return Result(report(found, " and ".join(makers), what), values=found.values() | {"by": dict(makers)})


def _evaluated_motions(
    motions: "Sequence[Motion]", labels: "dict[str, Label]", parts: "Sequence[Parts]", by: str
) -> Result:
    """Of the motions whose label, or what it says in plain words, is among those labelled by hand; others are said."""
    from refine.cli.inputs import say
    from refine.text.phrases import phrase_of

    known = [
        next((name for name in (motion.label, phrase_of(motion.label)) if name in labels), None) for motion in motions
    ]
    lacking = sorted(
        {motion.label or motion.source for motion, name in zip(motions, known, strict=True) if name is None}
    )
    if len(lacking) and not any(known):
        raise UserError("--evaluate", f"has no label for {', '.join(lacking[:5])}", "label the motions' labels by hand")
    if lacking:
        more = f" and {len(lacking) - 5} more" if len(lacking) > 5 else ""
        say(f"refine: not labelled by hand and left out: {', '.join(lacking[:5])}{more}")
    pairs = [(name, each) for name, each in zip(known, parts, strict=True) if name is not None]
    return _evaluated([name for name, _ in pairs], labels, [each for _, each in pairs], [by] * len(pairs), "motions")
