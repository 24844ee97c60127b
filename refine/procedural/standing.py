"""Standing at ease, which every other action is added to."""

from math import pi

import torch

from refine.procedural.draws import Beat
from refine.procedural.gesture import Arm, Foot, Gesture, Pelvis, Torso

BREATHS = 0.27  # per second


def stand(beat: Beat) -> Gesture:
    """At ease: the drawn posture, breath, the weight shifting from foot to foot."""
    style, noise = beat.draw.style, beat.noise
    breath = torch.sin(2 * pi * BREATHS * beat.seconds + beat.draw.phase)
    turn, tilt = 0.02 * noise["turn"], -0.012 * noise["shift"] + 0.01 * noise["tilt"]
    foot = Foot(aside=style.feet_apart, out=style.toes_out)
    return Gesture(
        torso=Torso(
            lean=style.lean + 0.015 * noise["lean"] - 0.006 * breath,
            turn=turn,
            tilt=tilt,
            nod=style.nod - 0.6 * style.lean + 0.03 * noise["nod"],
            look=style.look + 0.06 * noise["look"],
            head_tilt=style.head_tilt - tilt,
        ),
        pelvis=Pelvis(
            x=0.022 * noise["shift"],
            z=0.008 * noise["advance"],
            turn=0.012 * noise["turn"],
            tilt=0.012 * noise["shift"],
        ),
        left_foot=foot,
        right_foot=foot,
        **{
            f"{side}_arm": Arm(
                forward=0.03 * noise[f"{side}_forward"] - 0.5 * style.lean,
                sideways=style.arms_apart + 0.025 * noise[f"{side}_sideways"] + 0.008 * breath,
                bend=style.elbow + 0.05 * noise[f"{side}_bend"],
            )
            for side in ("left", "right")
        },
    )
