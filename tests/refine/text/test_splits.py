"""Splits of clips by their names: each group has its share, spread over its kinds, whatever the order."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from refine.text.splits import stratified

clips = st.dictionaries(st.text(min_size=1), st.tuples(st.sampled_from("ab"), st.sampled_from("xyz")), max_size=40)


@given(clips, st.integers(0, 5))
def test_each_group_has_its_share(groups, seed):
    splits = stratified(groups, seed)
    assert set(splits) == set(groups)
    assert splits == stratified(dict(reversed(groups.items())), seed)
    for group in "ab":
        counts = Counter(splits[name] for name, (mine, _) in groups.items() if mine == group)
        total = counts.total()
        assert counts["test"] == total // 6 and counts["val"] == (total + 1) // 6


def test_kinds_are_spread_and_seeds_draw_otherwise():
    groups = {f"{group}{kind}{n}": (group, kind) for group in "ab" for kind in "uvwxyz" for n in range(6)}
    splits = stratified(groups)
    for group in "ab":
        for kind in "uvwxyz":
            uses = Counter(splits[f"{group}{kind}{n}"] for n in range(6))
            assert uses == {"train": 4, "val": 1, "test": 1}
    assert splits != stratified(groups, seed=1)
    few = {f"{group}{kind}": (group, kind) for group in "abcdefgh" for kind in "uvwxyz"}
    tested = {kind for name, (_, kind) in few.items() if stratified(few)[name] == "test"}
    assert len(tested) > 1  # not the same kind in all groups
