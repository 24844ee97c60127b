"""``refine view``: motions as moving bodies on one page."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from torch import Tensor

    from refine.motion import Motion

SUFFIXES = (".html", ".htm")


@dataclass(frozen=True)
class View:
    """Show motions as moving bodies, in step and side by side, on one page that opens from disk without a network.

    Motions of different frame rates run together in seconds; each starts at the same place and faces the same way.

    Example: refine view walk.bvh wave.bvh both.bvh -o page.html
    Example: refine view walk wave-both-hands --serve --open
    """

    motions: Positional[tuple[str, ...]]
    """Motion files, patterns of these, or names of built-in actions: one to nine motions."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """File to write, .html; - writes to standard output."""
    serve: bool = False
    """Serve the page on 127.0.0.1, for browsers of this machine alone, until Ctrl-C."""
    port: int = 8765
    """To serve on; 0 takes one that is free."""
    open: bool = False
    """Open the page in a browser; without --out it is served."""
    title: str = ""
    """Title of the page; none takes the motions' labels."""
    body: Path | None = None
    """Your SMPL file instead of the free body."""
    force: bool = False
    """Replace the file if it is there."""
    seed: int = 0
    """Of built-in actions."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        import webbrowser

        from refine.cli.inputs import body_of, output_path, output_suffix, refuse_output, say
        from refine.cli.results import is_stdout
        from refine.viewer.page import check_motions, page, poster
        from refine.viewer.serving import serve

        serving = self.serve or (self.open and self.out is None)
        if not serving and self.out is None:
            raise UserError("refine view", "there is nowhere to put the page", "give -o page.html, or --serve")
        if self.out is not None:
            if output_suffix(self.out, ".html") not in SUFFIXES:
                raise UserError(self.out, "is no name for a page", "end it in .html")
            refuse_output(self.out, self.force, ".html")
        if not 0 <= self.port <= 65535:
            raise UserError("--port", f"expected 0 to 65535, got {self.port}")
        body = body_of(self.body, "full")
        motions = motions_of(self.motions, body.rest_joints, self.seed)
        check_motions(motions)
        content = page(motions, body, roles_of(motions), self.title, poster=poster(motions, body))

        values = {"motions": [motion.label for motion in motions], "bytes": len(content.encode())}
        if self.out is not None:
            with output_path(self.out, ".html") as path:
                write(path, content)
            if self.open and not serving and not is_stdout(self.out):
                webbrowser.open(self.out.resolve().as_uri())
        if serving:

            def ready(address: str) -> None:
                say(f"{address}  Ctrl-C stops")
                if self.open:
                    webbrowser.open(address)

            serve(content, self.port, ready)
        files = () if self.out is None else (self.out,)
        return Result("\n".join(map(str, files)), files, values)


def write(path: Path, content: str) -> None:
    from renderers.outputs import replacing

    with replacing(path) as partial:
        partial.write_text(content, encoding="utf-8")


def motions_of(names: tuple[str, ...], rest_joints: "Tensor", seed: int) -> list["Motion"]:
    """Every motion of every file, and built-in actions."""
    from refine.cli.inputs import clip_of, expand
    from refine.formats.files import load_motions

    motions: list[Motion] = []
    for path in expand(names):
        motions += load_motions(path, rest_joints) if path.is_file() else [clip_of(str(path), rest_joints, seed)]
    return motions


def roles_of(motions: list["Motion"]) -> list[str]:
    """What tells motions of one label apart: their files."""
    labels = [motion.label for motion in motions]
    return [Path(motion.source).name if labels.count(motion.label) > 1 else "" for motion in motions]
