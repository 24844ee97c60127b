"""Labelled clips as described ones: the label's words say what a clip shows."""

from collections import Counter
from collections.abc import Callable, Iterable

from refine.motion import Motion
from refine.text.described import Described
from refine.text.phrases import phrase_of
from refine.text.splits import stratified
from renderers.checks import UserError

AT_ONCE = "+"  # between the labels of a composition, such as "walk+drink"


def described_by_labels(
    motions: Iterable[Motion], seed: int = 0, refused: Callable[[UserError], object] = lambda error: None
) -> list[Described]:
    """Clips in the words of their labels, see `phrase_of`; "walk+drink" names two actions at once.

    Of each label one clip in six is for "val" and one for "test".

    Args:
        seed: of the split.
        refused: told of each clip whose label has no words.
    """
    named: dict[str, tuple[Motion, tuple[str, ...]]] = {}
    times = Counter()
    for motion in motions:
        texts = tuple(map(phrase_of, motion.label.split(AT_ONCE)))
        if not all(texts):
            refused(UserError(motion.source, f"has a label without words ({motion.label!r})", "give it one"))
            continue
        times[motion.source] += 1
        count = times[motion.source]
        named[motion.source if count == 1 else f"{motion.source}#{count}"] = motion, texts
    splits = stratified({name: (motion.label, "") for name, (motion, _) in named.items()}, seed)
    return [Described(motion, (texts,), name, splits[name]) for name, (motion, texts) in named.items()]
