"""``refine check-renderer``: our silhouettes beside those of an independent renderer."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from torch import Tensor

    from renderers.body import Body
    from renderers.camera import Camera
    from renderers.judging import Slope

YAW, ELEVATION = 28.0, 14.0  # degrees, of the camera
GRADIENT_SIZE, LOSSES = 64, 8  # pixels, and how many losses are sloped
TURN = 1e-3  # radians, of an arm
COMPARED = "Gradients at {} px: by Mitsuba's projective integrator, with {}."
NOT_COMPARED = (
    "Gradients were not compared: no LLVM was found that Mitsuba's projective integrator runs with. The tests compare "
    "them with finite differences of Mitsuba's renders."
)


@dataclass(frozen=True)
class CheckRenderer:
    """Compare our silhouettes with Mitsuba's: bodies, their parts, and gradients where an LLVM is found.

    Writes table.md, check.json and sheet.png. Exit code 1 says that they differ by more than the stated tolerance.

    Example: refine check-renderer -o check
    """

    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write; replaced as a whole with --force."""
    motion: Positional[str | None] = None
    """A motion file, - for standard input, or the name of a built-in action; none takes sixteen still poses."""
    size: tuple[int, ...] = (64, 112, 224)
    """Sides of the images in pixels."""
    poses: int = 16
    """Poses, evenly spread over the motion."""
    samples: int = 144
    """Mitsuba's rays a pixel, in each of two renders; rounded up to a square."""
    camera: Literal["pinhole", "weak"] = "pinhole"
    """Perspective, or weak perspective."""
    body: Path | None = None
    """Your SMPL file instead of the free body."""
    force: bool = False
    """Replace the folder if something is in it."""
    seed: int = 0
    """Of a built-in action, and of Mitsuba's rays."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from math import ceil, sqrt

        from refine.cli.inputs import bar, body_of
        from renderers.judging import Judgement, compare, numbers, steps, tables, write
        from renderers.mesh import Mesh
        from renderers.outputs import refuse_existing, replacing_folder
        from renderers.raster_mitsuba import find_llvm

        if not self.size or not all(32 <= side <= 512 for side in self.size):
            raise UserError("--size", f"expected sides of 32 to 512 pixels, got {' '.join(map(str, self.size))}")
        if not (1 <= self.poses <= 100 and 64 <= self.samples <= 4096):
            raise UserError("refine check-renderer", "poses must be 1 to 100 and samples 64 to 4096")
        refuse_existing(self.out, self.force, folder=True)
        body, samples = body_of(self.body), ceil(sqrt(self.samples)) ** 2
        names, rotations, root = self._posed(body)
        vertices = body(rotations, root).vertices
        meshes = [Mesh.build(body.faces), Mesh.build(body.faces, body.face_parts)]

        with bar(len(meshes) * len(self.size) * steps(len(names)), "compare") as progress:
            plain, parts = (
                [
                    compare(vertices, mesh, self._views(vertices, side), samples, self.seed, progress)
                    for side in self.size
                ]
                for mesh in meshes
            )
        llvm = find_llvm()
        count = "1 pose" if len(names) == 1 else f"{len(names)} poses"
        judgement = Judgement(
            subject=f"{count} of {self.motion or 'the built-in set'}, {self.camera} camera",
            names=names,
            samples=samples,
            plain=plain,
            parts=parts,
            slopes=self._slopes(body, rotations, root, samples) if llvm else [],
            gradients=COMPARED.format(GRADIENT_SIZE, llvm) if llvm else NOT_COMPARED,
        )
        with replacing_folder(self.out) as partial:
            write(partial, judgement)
        said = "\n\n".join([tables(judgement), judgement.gradients, str(self.out / "sheet.png")])
        files = tuple(self.out / name for name in ("sheet.png", "table.md", "check.json"))
        return Result(said, files, numbers(judgement), 0 if judgement.agrees else 1)

    def _posed(self, body: "Body") -> "tuple[list[str], Tensor, Tensor]":
        """Names of the poses, their rotations [N 24 3 3] and roots [N 3]."""
        import torch

        from refine.cli.inputs import clip_of
        from renderers.poses import POSE_NAMES, sixteen_poses

        if self.motion is None:
            names, rotations, root = list(POSE_NAMES), sixteen_poses(), torch.zeros(len(POSE_NAMES), 3)
        else:
            motion = clip_of(self.motion, body.rest_joints, self.seed)
            rotations, root = motion.rotations, motion.root
            names = [f"frame {frame}" for frame in range(len(motion))]
        chosen = torch.linspace(0, len(names) - 1, min(self.poses, len(names))).round().long()
        return [names[k] for k in chosen], rotations[chosen], root[chosen]

    def _views(self, vertices: "Tensor", side: int, round_about: float = 0.0) -> "Camera":
        """A camera for each of the bodies [N V 3], which fills the picture with it; degrees from one to the next."""
        from math import radians

        from renderers.camera import cat, frame

        turns = [radians(YAW + round_about * k) for k in range(len(vertices))]
        return cat(
            [
                frame(body, (side, side), yaw, radians(ELEVATION), kind=self.camera)
                for body, yaw in zip(vertices, turns, strict=True)
            ]
        )

    def _slopes(self, body: "Body", rotations: "Tensor", root: "Tensor", samples: int) -> "list[Slope]":
        """Gradients along shifts in the image's x and y, scale, and a turn of one arm, from all sides."""
        import torch

        from renderers.judging import OWN_LIMB_SLOPE, OWN_SLOPE, compare_gradients
        from renderers.mesh import Mesh
        from renderers.rotations import axis_angle_to_matrix
        from renderers.skeleton import JOINTS

        some = torch.linspace(0, len(root) - 1, LOSSES).round().long()
        rotations, root, turned = rotations[some], root[some], rotations[some]
        turn = axis_angle_to_matrix(torch.tensor([0.0, 0.0, TURN]))
        turned[:, JOINTS["left_shoulder"]] = turn @ turned[:, JOINTS["left_shoulder"]]
        vertices = body(rotations, root).vertices
        camera = self._views(vertices, GRADIENT_SIZE, 360 / LOSSES)
        motions = {
            "shift in x": (camera.rotation[:, :1].expand_as(vertices), OWN_SLOPE),
            "shift in y": (camera.rotation[:, 1:2].expand_as(vertices), OWN_SLOPE),
            "scale": (vertices - vertices.mean(1, keepdim=True), OWN_SLOPE),
            "left arm": ((body(turned, root).vertices - vertices) / TURN, OWN_LIMB_SLOPE),
        }
        return compare_gradients(vertices, motions, Mesh.build(body.faces), camera, samples, self.seed)
