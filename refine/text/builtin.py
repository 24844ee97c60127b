"""The built-in actions as described clips: single ones in many words, and pairs that are truly done at once."""

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import Any

import torch
from torch import Tensor

from refine.procedural.draws import Draw
from refine.synthetic import ACTIONS, draw, intended, perform, perform_together
from refine.text.described import Described, Split
from refine.text.parts import Parts
from renderers.skeleton import LEGS

# {hand} is the hand that a performance takes.
PHRASINGS: dict[str, tuple[str, ...]] = {
    "stand": ("stand still", "stand", "stand upright", "stay in place", "remain standing"),
    "marking-time-and-knee-lifting": (
        "march in place, lifting the knees",
        "march on the spot",
        "lift the knees in turn",
        "do high knees",
        "step in place with high knees",
    ),
    "punching-and-knee-lifting": (
        "punch with both arms and lift the knees",
        "punch and lift the knees in turn",
        "lift each knee and punch with the other arm",
        "strike with both fists and raise the knees",
        "do knee lifts with punches",
    ),
    "left-lunging": (
        "lunge to the left",
        "step into a side lunge",
        "do side lunges",
        "lunge sideways",
        "do lunges to the left",
    ),
    "left-kicking": (
        "kick with the left leg",
        "kick with the left foot",
        "do a left kick",
        "raise the left leg in a kick",
        "kick forwards with the left leg",
    ),
    "forward-lunging": (
        "lunge forwards",
        "lunge forward",
        "do forward lunges",
        "step forward into a lunge",
        "do a deep lunge",
    ),
    "pulling-chest-expanders": (
        "pull a chest expander with both arms",
        "pull the arms apart in front of the chest",
        "stretch a chest expander",
        "pull both hands apart",
        "train the chest with an expander",
    ),
    "punching": (
        "punch with both arms",
        "punch",
        "throw punches",
        "box with both fists",
        "strike with both fists in turn",
    ),
    "elbow-circling": (
        "circle both elbows",
        "circle the elbows",
        "rotate the elbows with the hands on the shoulders",
        "make circles with both elbows",
        "roll the elbows",
    ),
    "shoulder-abduction": (
        "raise both arms sideways",
        "lift the arms to the sides",
        "spread the arms out to the sides",
        "raise and lower both arms at the sides",
        "do lateral raises",
    ),
    "standing-rotation": (
        "stand and rotate the torso with the arms stretched out",
        "rotate the torso with the arms out",
        "twist the upper body with the arms spread",
        "turn the trunk left and right with stretched arms",
        "twist the torso, arms stretched out",
    ),
    "walk": ("walk forwards", "walk", "stroll", "take a walk", "walk ahead", "walk straight forward"),
    "run": ("run forwards", "run", "jog", "run ahead", "run straight forward"),
    "squat": ("squat", "do squats", "squat down and stand up", "bend the knees into a squat", "go down into a squat"),
    "wave-left-hand": (
        "wave with the left hand",
        "wave the left hand",
        "greet with the left hand",
        "wave hello with the left arm",
        "wave goodbye with the left hand",
    ),
    "wave-right-hand": (
        "wave with the right hand",
        "wave the right hand",
        "greet with the right hand",
        "wave hello with the right arm",
        "wave goodbye with the right hand",
    ),
    "wave-both-hands": (
        "wave with both hands",
        "wave both hands",
        "wave both arms overhead",
        "greet with both hands",
        "wave goodbye with both hands",
    ),
    "raise-up-left-hand": (
        "raise the left hand",
        "raise the left arm",
        "lift the left hand up",
        "put the left hand up",
        "hold the left arm up high",
    ),
    "drink": (
        "drink from a cup with the {hand} hand",
        "drink with the {hand} hand",
        "bring a cup to the mouth with the {hand} hand",
        "take a sip with the {hand} hand",
        "lift a glass to the lips with the {hand} hand",
    ),
}

SECONDS = 4.0
LEARNED = 0.4
"""Share of the pairs whose true compositions are learned; the others are tested."""
TESTED_CLIPS = 2
"""Of each tested pair."""


def phrasings_of(performance: Draw) -> tuple[str, ...]:
    """Ways to say what a performance shows, with the hand that it really takes."""
    return tuple(text.format(hand=performance.hand) for text in PHRASINGS[performance.action])


def parts_of(performance: Draw) -> Parts:
    """What a performance is truly about; someone who stands is about both legs, and legs bring global along."""
    about = {part.replace("_", " ") for part in intended(performance)}
    if performance.action == "stand":
        about = {"left leg", "right leg"}
    elif intended(performance) & set(LEGS):
        about.add("global")
    return Parts.of(about)


def builtin_pairs(seed: int = 0) -> dict[Split, list[tuple[str, str]]]:
    """Pairs of actions that can be done at once, each whose true compositions are learned or tested, never both."""
    random = torch.Generator().manual_seed(seed)
    about = {name: {part for _ in range(8) for part in intended(draw(name, random))} for name in ACTIONS}
    pairs = [(i, j) for i, j in combinations(ACTIONS, 2) if about[i] and about[j] and not about[i] & about[j]]
    order = [pairs[n] for n in torch.randperm(len(pairs), generator=random).tolist()]
    count = round(LEARNED * len(order))
    return {"train": order[:count], "test": order[count:]}


def builtin_corpus(
    rest_joints: Tensor,
    seed: int = 0,
    clips: int = 20,
    fps: float = 30.0,
    seconds: float = SECONDS,
    progress: Callable[[Sequence[Any]], Iterable[Any]] = iter,
) -> list[Described]:
    """Single actions and true pairs, no two clips alike.

    Of each action's clips one in five is for "val" and one in five for "test". Of a learned pair there are
    ``clips // 4`` for "train" and one for "val"; of another one ``TESTED_CLIPS`` for "test".

    Args:
        rest_joints: [24 3] T-pose joints, metres.
        clips: of each single action.
        progress: wraps the list of actions, and those of pairs, as ``tqdm`` does.
    """
    frames = round(seconds * fps)
    items = []
    for index, name in progress(list(enumerate(ACTIONS))):
        random = torch.Generator().manual_seed(seed * 1009 + index)
        for number in range(clips):
            drawn = draw(name, random, fps)
            split: Split = ("val", "test", "train", "train", "train")[number % 5]
            said = tuple((text,) for text in phrasings_of(drawn))
            items.append(Described(perform(drawn, frames, rest_joints), said, f"{name}-{number:03d}", split))
    for split, pairs in builtin_pairs(seed).items():
        counts = {"train": max(1, clips // 4), "val": 1} if split == "train" else {"test": TESTED_CLIPS}
        for index, (i, j) in progress(list(enumerate(pairs))):
            random = torch.Generator().manual_seed(seed * 1009 + 100 + index + 500 * (split == "test"))
            for use, count in counts.items():
                for number in range(count):
                    drawn = [draw(name, random, fps) for name in (i, j)]
                    motion = perform_together(*drawn, frames, rest_joints)
                    said = tuple(zip(*map(phrasings_of, drawn), strict=False))
                    said += tuple((second, first) for first, second in said)
                    items.append(Described(motion, said, f"{i}+{j}-{use}-{number:03d}", use))
    return items
