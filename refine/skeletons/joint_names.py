"""Whose joints are these? Skeletons told by the names of their joints, however these are spelled.

A name is read as words: namespaces and what all names share are dropped, so are signs and case, and the word for the
side is taken off. ``mixamorig:LeftUpLeg``, ``Character_LeftUpLeg`` and ``left_up.leg`` all read as (left, "upleg").
The trunk needs no table: it is what lies between the legs, the arms and the head.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from refine.skeletons.known import SIDES

# The joints of a limb that a body cannot do without, then those that it may lack.
NEEDED = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
SPARE = ("foot", "collar")
# The columns of the table below.
COLUMNS = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
# Skeleton -> what it calls the joints above, "-" for one that it has not.
TABLE = {
    "Mixamo": "upleg leg foot toebase shoulder arm forearm hand",
    "LAFAN1": "upleg leg foot toe shoulder arm forearm hand",
    "Xsens MVN": "hip knee ankle toe collar shoulder elbow wrist",
    "SMPL": "hip knee ankle foot collar shoulder elbow wrist",
    "CMU (Acclaim)": "femur tibia foot toes clavicle humerus radius wrist",
    "Bandai-Namco": "upperleg lowerleg foot toes shoulder upperarm lowerarm hand",
    "3ds Max Biped": "thigh calf foot toe clavicle upperarm forearm hand",
    "Unreal": "thigh calf foot ball clavicle upperarm lowerarm hand",
    "Blender": "thigh shin foot toe shoulder upperarm forearm hand",
    "VRM": "upperleg lowerleg foot toebase shoulder upperarm lowerarm hand",
    "Daz": "thigh shin foot toe collar shldr forearm hand",
    "Poser": "upleg lowleg foot - collar uparm lowarm hand",
    "Kinect": "hip knee ankle foot - shoulder elbow wrist",
}
# Names that are none's in particular; each row of candidates is tried in order, and a joint is taken once.
CANDIDATES = {
    "hip": "upleg upperleg thigh femur hip uleg leg",
    "knee": "knee lowleg lowerleg shin calf tibia lleg leg",
    "ankle": "ankle foot",
    "foot": "toebase toe toes ball foot",
    "shoulder": "upperarm uparm humerus shldr arm shoulder",
    "collar": "collar clavicle shoulder scapula",
    "elbow": "elbow forearm lowarm lowerarm radius",
    "wrist": "wrist hand",
}
SIDE_WORDS = {"l": "left", "left": "left", "lft": "left", "lf": "left", "lt": "left"}
SIDE_WORDS |= {"r": "right", "right": "right", "rgt": "right", "rt": "right"}
MIDDLE_WORDS = ("c", "center", "centre", "mid", "def", "jnt")
# A joint with such a word turns about its bone, steers, or is too small to be looked at.
HELPER_WORDS = """
    twist roll helper end nub ik fk pole target ctrl control effector site tip orient ref attach socket
    thumb index middle ring pinky little finger fingers fingerbase inhand metacarpal carpal
    eye jaw tongue hair ear brow lid lip cheek nose teeth breast pec skirt cloth tail wing prop weapon camera light
"""
HELPERS = frozenset(HELPER_WORDS.split())
PELVIS, NECK, HEAD = ("pelvis", "hips", "hip"), ("neck", "lowerneck", "neck1"), ("head",)
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[^\W\d_a-zA-Z]+")


@dataclass(frozen=True)
class Word:
    """A joint's name as it is read."""

    side: str  # "left", "right" or ""
    key: str  # small letters without digits
    helper: bool


@dataclass(frozen=True)
class Named:
    """Joints found by their names: which skeleton's they are, and SMPL joint -> index in the file."""

    skeleton: str
    joints: dict[str, int]


def by_name(names: Sequence[str]) -> Named | None:
    """The limbs of a skeleton, its pelvis, neck and head as far as it names them, or None if a limb's joint is missing.

    Args:
        names: J joint names, a parent before its children; of two that read alike the first is taken.
    """
    words = read_names(names)
    first: dict[tuple[str, str], int] = {}
    for index, word in enumerate(words):
        if not word.helper:
            first.setdefault((word.side, word.key), index)
    keys = {key for side, key in first if side and all((other, key) in first for other in SIDES)}
    columns = _known(keys, words)
    if columns is None:
        return None
    skeleton, columns = columns
    joints = {f"{side}_{joint}": first[side, key] for joint, key in columns.items() for side in SIDES}
    for joint, spellings in (("pelvis", PELVIS), ("neck", NECK), ("head", HEAD)):
        found = [first["", key] for key in spellings if ("", key) in first]
        if found:
            joints[joint] = min(found)
    return Named(skeleton, joints)


def read_names(names: Sequence[str]) -> list[Word]:
    """The names as words, see the head of this module."""
    split = [WORD.findall(re.split(r"[:|]", name)[-1]) or [name] for name in names]
    split = [[word.lower() for word in words] for words in _without_prefix(split)]
    return [_word(words) for words in split]


def _word(words: list[str]) -> Word:
    letters = [word for word in words if not word.isdigit()]
    letters = [word for word in letters if word not in MIDDLE_WORDS] or letters
    side = ""
    for place in (0, -1):
        if letters and len(words) > 1 and not side and letters[place] in SIDE_WORDS:
            side = SIDE_WORDS[letters.pop(place)]
    for place in range(1, len(letters) - 1):  # J_Bip_L_Hand with nothing shared
        if not side and letters[place] in SIDE_WORDS:
            side = SIDE_WORDS[letters[place]]
            letters = letters[place + 1 :]
            break
    key = "".join(word for word in letters if word != "bend")
    if not side and key not in KEYS and key[:1] in ("l", "r") and key[1:] in KEYS:
        side, key = SIDE_WORDS[key[0]], key[1:]
    return Word(side, key, not HELPERS.isdisjoint(letters) or key in HELPERS)


def _without_prefix(split: list[list[str]]) -> list[list[str]]:
    """Leading words that nearly all names share are no part of them: ``Bip01 L Hand``, ``mixamorig_LeftHand``."""
    while True:
        leading = Counter(words[0] for words in split if len(words) > 1)
        word, count = max(leading.items(), key=lambda item: item[1], default=("", 0))
        if count < max(3, 0.8 * len(split)):
            return split
        split = [words[1:] if words[0] == word and len(words) > 1 else words for words in split]


def _known(keys: set[str], words: list[Word]) -> tuple[str, dict[str, str]] | None:
    """The skeleton's name and joint -> key; the row of the table that fits in most columns, else a mixture."""
    best: tuple[int, str, dict[str, str]] = (-len(COLUMNS), "", {})
    for name, row in TABLE.items():
        wanted = {joint: key for joint, key in zip(COLUMNS, row.split(), strict=True) if key != "-"}
        columns = {joint: key for joint, key in wanted.items() if key in keys}
        score = 2 * len(columns) - len(wanted)
        if set(NEEDED) <= set(columns) and score > best[0]:
            best = (score, name, columns)
    _, name, columns = best
    if name == "Mixamo" and any(word.key == "lowerback" for word in words):
        name = "CMU (BVH)"
    columns = _mixed(keys - set(columns.values()), columns)
    if columns.get("wrist") == "wrist" and "hand" in keys:
        columns["hand"] = "hand"
    return (name or "of mixed names", columns) if set(NEEDED) <= set(columns) else None


def _mixed(keys: set[str], columns: dict[str, str]) -> dict[str, str]:
    """``columns`` with what is missing in it taken from the keys left."""
    columns, left = dict(columns), set(keys)
    for joint, row in CANDIDATES.items():
        key = next((key for key in row.split() if key in left), None)
        if joint not in columns and key:
            columns[joint] = key
            left.discard(key)
    return columns


KEYS = frozenset(key for row in (*TABLE.values(), *CANDIDATES.values()) for key in row.split()) | {"hipjoint", "eye"}
