"""The colours of every picture."""

# One colour a drawn part (renderers.skeleton.DRAWN_PARTS): torso, head, left arm, right arm, left leg, right leg.
# The body's left is warm and its right is cold, so that a mirrored motion is seen at once.
PARTS = ("#8d99ae", "#e5c29f", "#e76f51", "#2a9d8f", "#f4a259", "#4f7cac")
LINES = ("#d1495b", "#00798c", "#edae49", "#5f4bb6", "#66a182", "#2e4057")
HEAT = ("#fdf6e3", "#fcd28b", "#f58f5c", "#c8446b", "#5c2a72")
BACKGROUND, INK, FAINT = "#f7f5f0", "#2b2d42", "#d8d4c8"


def rgb(colour: str) -> tuple[float, float, float]:
    """``"#ff8000"`` -> (1.0, 0.5, 0.0)."""
    return tuple(int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5))
