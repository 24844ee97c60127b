"""What each clip of a set is used for, where the set itself does not say."""

import hashlib
from collections import defaultdict
from collections.abc import Mapping

from refine.text.described import Split

EVERY = 6  # of so many clips of a group one is for "val" and one for "test"
USES: dict[int, Split] = {EVERY - 2: "val", EVERY - 1: "test"}


def stratified(groups: Mapping[str, tuple[str, str]], seed: int = 0) -> dict[str, Split]:
    """A split of clips by their names, in which each group has its share.

    Args:
        groups: of each name its group, and within the group its kind, over which a split is spread.
        seed: draws it; the order of the names does not matter.

    Returns:
        Of every six names of a group, one for "val" and one for "test"; a group of four or fewer is all "train".
    """
    by_group = defaultdict(list)
    for name, (group, kind) in groups.items():
        by_group[group].append((_shuffled(f"{seed} {group} {kind}"), _shuffled(f"{seed} {name}"), name))
    return {
        name: USES.get(index % EVERY, "train")
        for names in by_group.values()
        for index, (*_, name) in enumerate(sorted(names))
    }


def _shuffled(text: str) -> bytes:
    """A place in an order that says nothing."""
    return hashlib.sha256(text.encode()).digest()
