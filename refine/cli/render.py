"""``refine render``: a motion as a picture or a film."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from torch import Tensor

    from renderers.camera import Camera


@dataclass(frozen=True)
class Render:
    """Draw a motion: .png poses side by side, .gif or .mp4 a film.

    Example: refine render both.bvh -o both.mp4 --yaw 40

    For a paper: refine render both.bvh -o both.png --quality --strobe --size 720
    """

    motion: Positional[str]
    """A motion file, - for standard input, or the name of a built-in action."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, .png, .gif or .mp4; - writes a PNG to standard output, -.gif another."""
    style: Literal["shaded", "parts", "silhouette"] = "shaded"
    """Shaded body, flat body parts, or the plain silhouette."""
    quality: bool = False
    """Render in a studio with soft shadows on a seamless floor; .png and shaded only. It takes some seconds a pose."""
    strobe: bool = False
    """Bodies along the path that the motion really takes, the earlier the paler, instead of side by side; .png and
    shaded only, with or without --quality. A motion that stays in place is still drawn side by side. Fewer --poses
    leave more room between bodies."""
    yaw: float | None = None
    """Degrees; 0 sees the front, 90 the body's left side. None takes 28, and for a --strobe the side from which the
    path runs from left to right."""
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
    output: Printed = AS_LINES

    def run(self) -> Result:
        from refine.cli.inputs import bar, body_of, clip_of, output_path, output_suffix, refuse_output
        from refine.drawing import BORDER, YAW, film, strip, strobe
        from renderers.images import save_gif, save_mp4, save_png
        from renderers.shade import shade

        suffix = output_suffix(self.out, ".png")
        if suffix not in (".png", ".gif", ".mp4"):
            raise UserError(self.out, "unknown picture format", "end it in .png, .gif or .mp4")
        if not (32 <= self.size <= 2160 and 1 <= self.poses <= 60 and 1 <= self.fps <= 120):
            raise UserError("refine render", "size must be 32 to 2160, poses 1 to 60 and fps 1 to 120")
        if self.yaw is not None and not math.isfinite(self.yaw):
            raise UserError("--yaw", f"expected degrees, got {self.yaw}")
        for asked, flag in ((self.quality, "--quality"), (self.strobe, "--strobe")):
            if asked and suffix != ".png":
                raise UserError(flag, f"draws still pictures, not {suffix}", "end the output in .png")
            if asked and self.style != "shaded":
                raise UserError(flag, f"draws shaded bodies, not {self.style}", "leave --style out")
        refuse_output(self.out, self.force, ".png")
        body = body_of(self.body, "full")
        motion = clip_of(self.motion, body.rest_joints, self.seed)
        yaw = YAW if self.yaw is None else self.yaw
        draw, border = (in_studio, BORDER) if self.quality else (shade, 0.0)
        with output_path(self.out, ".png") as path:
            if self.strobe:
                save_png(path, strobe(motion, body, self.poses, self.size, self.yaw, draw))
            elif suffix == ".png":
                [picture] = strip([motion], body, self.poses, self.size, yaw, self.style, draw, border)
                save_png(path, picture)
            else:
                size = (self.size, round(self.size * 0.85))
                with bar(round(motion.seconds * self.fps), "draw") as progress:
                    moments = film([motion], body, size, self.fps, yaw, self.style, progress)
                save = save_gif if suffix == ".gif" else save_mp4
                save(path, [picture for [picture] in moments], self.fps)
        return Result(str(self.out), (self.out,), {"frames": len(motion), "fps": motion.fps})


def in_studio(vertices: "Tensor", faces: "Tensor", colours: "Tensor", camera: "Camera") -> "Tensor":
    """As `renderers.shade.shade`, through Mitsuba and with a progress bar."""
    from refine.cli.inputs import bar
    from renderers.studio import STRIPES, studio

    with bar(STRIPES * len(vertices), "render") as progress:
        return studio(vertices, faces, colours, camera, progress=progress)
