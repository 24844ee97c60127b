"""What labels say in plain English: a phrase for each built-in action, and for any other label its words."""

import re

PHRASES: dict[str, str] = {
    "stand": "stand still",
    "marking-time-and-knee-lifting": "march in place, lifting the knees",
    "punching-and-knee-lifting": "punch with both arms and lift the knees",
    "left-lunging": "lunge to the left",
    "left-kicking": "kick with the left leg",
    "forward-lunging": "lunge forwards",
    "pulling-chest-expanders": "pull a chest expander with both arms",
    "punching": "punch with both arms",
    "elbow-circling": "circle both elbows",
    "shoulder-abduction": "raise both arms sideways",
    "standing-rotation": "stand and rotate the torso with the arms stretched out",
    "walk": "walk forwards",
    "run": "run forwards",
    "squat": "squat",
    "wave-left-hand": "wave with the left hand",
    "wave-right-hand": "wave with the right hand",
    "wave-both-hands": "wave with both hands",
    "raise-up-left-hand": "raise the left hand",
    "drink": "drink from a cup",
}


def phrase_of(label: str) -> str:
    """The phrase of a built-in action, or the label's words; nothing where there are none.

    >>> phrase_of("walk"), phrase_of("walk-turn_left")
    ('walk forwards', 'walk turn left')
    """
    return PHRASES.get(label) or " ".join(re.split(r"[\s_+-]+", label)).strip()
