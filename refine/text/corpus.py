"""Sets of described clips on disk: a folder of packed clips with ``texts.json``, which says what each of them shows.

The texts are meant to be read, and to be mended by hand; the clips are held to their hashes.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, get_args

from refine.formats.clips import MANIFEST, Shards, load_clips, pack, shard_paths
from refine.formats.untrusted import read_json
from refine.motion import Motion
from refine.text.described import Described, Split
from renderers.checks import UserError
from renderers.outputs import replacing_folder

TEXTS = "texts.json"
TEXTS_BYTES = 1 << 27
SCHEMA, KIND = 1, "texts"
SPLITS: tuple[Split, ...] = get_args(Split)
REMEDY = "make the set again with 'refine data texts'"


@dataclass
class Counts:
    """What a set holds."""

    clips: int = 0
    frames: int = 0
    seconds: float = 0.0
    texts: set[tuple[str, ...]] = field(default_factory=set)
    """Different descriptions; each names the actions that happen at once."""
    by_split: dict[Split, Counter[int]] = field(default_factory=lambda: {split: Counter() for split in SPLITS})
    """Of each split, how many clips show one action, how many two, and so on."""

    def add(self, item: Described) -> None:
        self.clips += 1
        self.frames += len(item.motion)
        self.seconds += item.motion.seconds
        self.texts.update(item.phrasings)
        self.by_split[item.split][item.actions] += 1

    def values(self) -> dict[str, Any]:
        """For programs."""
        splits = {
            split: {
                "clips": counts.total(),
                "singles": counts[1],
                "pairs": counts[2],
                "more": counts.total() - counts[1] - counts[2],
            }
            for split, counts in self.by_split.items()
        }
        about = {"clips": self.clips, "frames": self.frames, "seconds": round(self.seconds, 3)}
        return about | {"texts": len(self.texts), "splits": splits}


def counted(items: Iterable[Described]) -> Counts:
    counts = Counts()
    for item in items:
        counts.add(item)
    return counts


def save_corpus(
    folder: str | Path, items: Iterable[Described], about: Mapping[str, Any], left_out: Sequence[str] = ()
) -> Counts:
    """Write described clips as they come; the folder is there whole or not at all, and an older one gives way.

    Args:
        about: where the set is from, in values that JSON has.
        left_out: lines on what could not be taken, to be kept; they are looked at when the items have ended.

    Raises:
        UserError: there is no item, two have one key, or the folder cannot be written.
    """
    counts, said = Counts(), {}
    with replacing_folder(folder) as partial:
        shards = Shards(partial)
        for item in items:
            if item.key in said:
                raise UserError(folder, f"would hold two clips called {item.key!r}", "give each its own key")
            said[item.key] = {"split": item.split, "phrasings": item.phrasings}
            shards.add(pack(item.motion))
            counts.add(item)
        if not said:
            first = f"the first that was left out: {left_out[0]}" if left_out else "look at what it is made of"
            raise UserError(folder, "would hold no clips", first)
        manifest = shards.close()
        head = {
            "schema": SCHEMA,
            "kind": KIND,
            "about": dict(about),
            "counts": counts.values(),
            "left_out": list(left_out),
            "hash": manifest["hash"],
        }
        (partial / TEXTS).write_text(_written(head, said), encoding="utf-8")
    return counts


def load_corpus(folder: str | Path, split: str | None = None) -> list[Described]:
    """What :func:`save_corpus` wrote, whole clips at their own frame rates, or those of one split ("train", "val",
    "test") alone.

    Raises:
        UserError: the folder is missing, is none of described clips, or the clips are damaged or not those of the
            texts.
    """
    folder = Path(folder)
    said = _read_texts(folder)
    names = iter(said)
    items = []
    for path in shard_paths(folder):
        clips = load_clips(path)
        pairs = [(next(names, None), clip) for clip in clips]
        if pairs[-1][0] is None:
            raise UserError(folder / TEXTS, "describes fewer clips than there are", REMEDY)
        kept = [(key, clip) for key, clip in pairs if split in (None, said[key][0])]
        # A file's clips are views of its one array, which the few that are kept would keep alive.
        kept = kept if len(kept) == len(clips) else [(key, _alone(clip)) for key, clip in kept]
        items += [Described(clip, said[key][1], key, said[key][0]) for key, clip in kept]
    if next(names, None) is not None:
        raise UserError(folder / TEXTS, "describes more clips than there are", REMEDY)
    return items


def is_corpus(folder: str | Path) -> bool:
    """Whether there are texts in a folder."""
    return (Path(folder) / TEXTS).is_file()


def about_corpus(folder: str | Path) -> dict[str, Any]:
    """Where a set is from, as it was given to :func:`save_corpus`."""
    return _content(Path(folder))["about"]


def _alone(motion: Motion) -> Motion:
    return replace(motion, rotations=motion.rotations.clone(), root=motion.root.clone())


def _written(head: dict[str, Any], said: dict[str, dict[str, Any]]) -> str:
    """One line a clip, so that a change by hand is a change of a line."""
    start = json.dumps(head, indent=1, ensure_ascii=False).removesuffix("\n}")
    lines = (
        f"  {json.dumps(key, ensure_ascii=False)}: {json.dumps(one, ensure_ascii=False)}" for key, one in said.items()
    )
    return f'{start},\n "clips": {{\n' + ",\n".join(lines) + "\n }\n}\n"


def _content(folder: Path) -> dict[str, Any]:
    if folder.is_dir() and not is_corpus(folder):
        raise UserError(folder, f"holds no described clips (no {TEXTS})", "make some with 'refine data texts'")
    if not folder.exists():
        raise UserError(folder, "does not exist", "make described clips with 'refine data texts'")
    path = folder / TEXTS
    content = read_json(path, TEXTS_BYTES, unique=True)
    if not isinstance(content, dict) or content.get("kind") != KIND or not isinstance(content.get("about"), dict):
        raise UserError(path, "is no file of texts", REMEDY)
    if content.get("schema") != SCHEMA:
        raise UserError(path, f"is of schema {content.get('schema')!r}", f"this Refine reads schema {SCHEMA}")
    return content


def _read_texts(folder: Path) -> dict[str, tuple[Split, tuple[tuple[str, ...], ...]]]:
    """Split and phrasings of each clip by its key, in the order of the clips."""
    content, path = _content(folder), folder / TEXTS
    clips = content.get("clips")
    if not isinstance(clips, dict):
        raise UserError(path, "has no list of clips", REMEDY)
    manifest = read_json(folder / MANIFEST, TEXTS_BYTES)
    if not isinstance(manifest, dict) or manifest.get("hash") != content.get("hash"):
        raise UserError(path, "is of other clips than those that lie beside it", REMEDY)
    said = {}
    for key, one in clips.items():
        if not isinstance(one, dict) or one.get("split") not in SPLITS:
            raise UserError(path, f"{key!r} is of no split", f"choose among {', '.join(SPLITS)}")
        phrasings = one.get("phrasings")
        sound = isinstance(phrasings, list) and all(isinstance(texts, list) for texts in phrasings)
        if not sound or not all(isinstance(text, str) for text in chain.from_iterable(phrasings)):
            raise UserError(path, f"{key!r} has phrasings that are no lists of texts", 'write [["walk", "wave"], ...]')
        said[key] = (one["split"], tuple(map(tuple, phrasings)))
    return said
