"""``refine render``: a motion as a picture or a film."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from renderers.checks import UserError


@dataclass(frozen=True)
class Render:
    """Draw a motion: .png poses side by side, .gif or .mp4 a film.

    Example: refine render both.bvh -o both.mp4 --yaw 40
    """

    motion: Positional[str]
    """A .bvh or .npz file, or the name of a built-in action."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, .png, .gif or .mp4."""
    style: Literal["shaded", "parts", "silhouette"] = "shaded"
    """Shaded body, flat body parts, or the plain silhouette."""
    yaw: float = 28.0
    """Degrees; 0 sees the front, 90 the body's left side."""
    size: int = 360
    """Height in pixels."""
    poses: int = 8
    """Poses in a .png."""
    fps: float = 15.0
    """Frames a second of a film."""
    body: Path | None = None
    """Your SMPL file instead of the free body."""
    force: bool = False
    """Replace the file if it is there."""
    seed: int = 0
    """Of a built-in action."""

    def run(self) -> None:
        from refine.cli.inputs import bar, body_of, clip_of
        from refine.drawing import film, strip
        from renderers.images import save_gif, save_mp4, save_png
        from renderers.outputs import refuse_existing

        suffix = self.out.suffix.lower()
        if suffix not in (".png", ".gif", ".mp4"):
            raise UserError(self.out, "unknown picture format", "end it in .png, .gif or .mp4")
        if not (32 <= self.size <= 2160 and 1 <= self.poses <= 60 and 1 <= self.fps <= 120):
            raise UserError("refine render", "size must be 32 to 2160, poses 1 to 60 and fps 1 to 120")
        if not math.isfinite(self.yaw):
            raise UserError("--yaw", f"expected degrees, got {self.yaw}")
        refuse_existing(self.out, self.force)
        body = body_of(self.body, "full")
        motion = clip_of(self.motion, body.rest_joints, self.seed)
        if suffix == ".png":
            [picture] = strip([motion], body, self.poses, self.size, self.yaw, self.style)
            save_png(self.out, picture)
        else:
            size = (self.size, round(self.size * 0.85))
            with bar(round(motion.seconds * self.fps), "draw") as progress:
                moments = film([motion], body, size, self.fps, self.yaw, self.style, progress)
            save = save_gif if suffix == ".gif" else save_mp4
            save(self.out, [picture for [picture] in moments], self.fps)
        print(self.out)
