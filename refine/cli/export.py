"""``refine export``: motions in any format that others read."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError

if TYPE_CHECKING:
    from refine.formats.files import Reading
    from refine.motion import Motion
    from renderers.body import Body

PICTURES = (".mp4", ".gif", ".png")
FILM_FPS = {".mp4": 30.0, ".gif": 20.0}  # at most
POSES = 8


@dataclass(frozen=True)
class Export:
    """Write motions in the format of the output's suffix.

    For programs: .bvh (skeleton and motion, centimetres), .glb (mesh, skin, skeleton and motion in one file), .fbx (by
    Blender's module, see BPY_PYTHON), .npz (AMASS, SMPL-H's layout), .npy (joint positions), .json. To look at: .mp4,
    .gif, .png (poses along the path), .obj (the mesh at --start). With --format, a folder with a file for each motion;
    with obj, a mesh for each frame, and a folder for each motion where there are several.

    Example: refine export both.bvh -o both.glb

    Example: refine export 'clips/*.bvh' -o exported --format glb --fps 30 --in-place

    Example: refine export both.bvh -o frames --format obj
    """

    motions: Positional[tuple[str, ...]]
    """Motion files, patterns of these, - for standard input, or names of built-in actions. Several need --format, or an
    output in .glb, which holds each as a take."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write, or with --format a folder; - writes BVH to standard output, -.json another format."""
    format: Literal["bvh", "glb", "fbx", "npz", "npy", "json", "obj", "mp4", "gif", "png"] | None = None
    """Write a folder with files in this format."""
    start: float = 0.0
    """Seconds that are left out at the beginning."""
    seconds: float | None = None
    """Length; more than there is is refused. None goes to the end."""
    fps: float | None = None
    """Frame rate to resample to: rotations by slerp, places linearly."""
    mirror: bool = False
    """Exchange left and right, also in labels and in the names of files in a folder."""
    in_place: bool = False
    """Take out the travel; height and turns stay."""
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of length of files that do not say it; none guesses it from the body's height."""
    up: Literal["y", "z"] | None = None
    """Axis that points up in files that do not say it."""
    source_fps: float | None = None
    """Frame rate of files that have none."""
    mapping: Path | None = None
    """JSON file that says which joint is which, as `refine data inspect --mapping` writes it."""
    body: Path | None = None
    """Your SMPL file instead of the free body: its mesh, and its bones' lengths."""
    force: bool = False
    """Replace the file or folder if it is there."""
    seed: int = 0
    """Of built-in actions."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from refine.cli.inputs import body_of, output_path, output_suffix, say
        from refine.formats.files import Reading
        from refine.motion import crop, lies

        suffix = f".{self.format}" if self.format else output_suffix(self.out)
        self.check(suffix)
        body = body_of(self.body, "full")
        reading = Reading(self.unit, self.source_fps, self.mapping, self.up)
        motions = motions_of(self.motions, body, reading, self.seed)
        for motion in filter(lies, motions):
            say(f"refine: {motion.source} lies from beginning to end; if another axis is up, give --up y or --up z")
        motions = [self.changed(motion) for motion in motions]
        if suffix == ".obj" and not self.format:
            motions = [crop(motion, 0, 1) for motion in motions]
        values = {
            "motions": [
                {"label": motion.label, "source": motion.source, "frames": len(motion), "fps": motion.fps}
                for motion in motions
            ]
        }
        if self.format:
            files = write_folder(self.out, motions, body, suffix, self.mirror)
        else:
            if len(motions) > 1 and suffix != ".glb":
                problem = f"{len(motions)} motions do not go into one {suffix} file"
                raise UserError(self.out, problem, f"add --format {suffix[1:]}, and name a folder; .glb takes several")
            with output_path(self.out) as path:
                write_one(path, motions, body, suffix)
            files = (self.out,)
        frames = sum(map(len, motions))
        kinds = "1 motion" if len(motions) == 1 else f"{len(motions)} motions"
        rates = " or ".join(f"{fps:g}" for fps in sorted({motion.fps for motion in motions}))
        frames_said = "1 frame" if frames == 1 else f"{frames:,} frames"
        return Result(f"{self.out}  {kinds}, {frames_said} at {rates} fps", files, values)

    def check(self, suffix: str) -> None:
        """Refuse before any work what would be refused after it."""
        from refine.cli.inputs import refuse_output
        from refine.formats.files import SUFFIXES, check_suffix
        from renderers.outputs import refuse_existing

        known = (*SUFFIXES, *PICTURES, ".obj")
        if suffix not in known:
            raise UserError(self.out, f"no format has the suffix '{suffix}'", f"known are {' '.join(known)}")
        if suffix == ".obj" and not self.format and self.seconds is not None:
            problem = f"is one mesh, and --seconds {self.seconds:g} asks for many"
            raise UserError(self.out, problem, "leave it out, or name a folder and add --format obj")
        if self.fps is not None and not 0 < self.fps < 10_000:
            raise UserError("--fps", f"expected a positive frame rate, got {self.fps:g}", "give frames per second")
        if suffix in SUFFIXES:
            check_suffix(f"x{suffix}")
        if self.format:
            refuse_existing(self.out, self.force, folder=True)
        else:
            refuse_output(self.out, self.force)

    def changed(self, motion: "Motion") -> "Motion":
        """The motion as the flags want it."""
        from refine.motion import cut, in_place, mirror, resample

        motion = cut(motion, self.start, self.seconds)
        if self.fps is not None:
            motion = resample(motion, self.fps)
        if self.mirror:
            motion = mirror(motion)
        return in_place(motion) if self.in_place else motion


def motions_of(names: tuple[str, ...], body: "Body", reading: "Reading", seed: int) -> list["Motion"]:
    """Every motion of every file, and built-in actions."""
    from refine.cli.inputs import STDIN, clip_of, expand, input_path
    from refine.formats.files import load_motions

    motions: list[Motion] = []
    for name in expand(names):
        if str(name) == STDIN:
            with input_path(name) as path:
                read = load_motions(path, body.rest_joints, reading)
            motions += [replace(motion, source="standard input") for motion in read]
        elif name.exists() or name.suffix:
            motions += load_motions(name, body.rest_joints, reading)
        else:
            motions.append(clip_of(str(name), body.rest_joints, seed))
    return motions


def write_one(path: Path, motions: list["Motion"], body: "Body", suffix: str) -> None:
    """One file; only a .glb may hold several motions."""
    from refine.formats.files import WRITERS
    from refine.formats.glb import write_glb
    from refine.formats.obj import write_obj

    if suffix == ".glb":
        write_glb(path, motions, body)
    elif suffix == ".obj":
        write_obj(path, motions[0], body)
    elif suffix in PICTURES:
        write_picture(path, motions[0], body, suffix)
    else:
        WRITERS[suffix](path, motions[0], body)


def write_picture(path: Path, motion: "Motion", body: "Body", suffix: str) -> None:
    """A film at the motion's own rate or the format's highest, or one picture of poses along the path."""
    from refine.cli.inputs import bar
    from refine.drawing import film, strobe
    from renderers.images import save_gif, save_mp4, save_png

    if suffix == ".png":
        save_png(path, strobe(motion, body, min(POSES, len(motion))))
        return
    fps = min(motion.fps, FILM_FPS[suffix])
    with bar(max(1, round(motion.seconds * fps)), "draw") as progress:
        moments = film([motion], body, fps=fps, progress=progress)
    (save_gif if suffix == ".gif" else save_mp4)(path, [picture for [picture] in moments], fps)


def write_folder(
    out: Path, motions: list["Motion"], body: "Body", suffix: str, mirrored: bool = False
) -> tuple[Path, ...]:
    """A file for each motion, of .obj a folder with one for each frame; what was written, in the motions' order.

    The frames of a single motion lie in the folder itself.
    """
    from refine.cli.inputs import bar
    from refine.formats.obj import write_obj_sequence
    from renderers.outputs import replacing_folder

    meshes = suffix == ".obj"
    named = [name + suffix * (not meshes) for name in stems(motions, mirrored)]
    names = ["."] if meshes and len(motions) == 1 else named
    steps = sum(map(len, motions)) if meshes else len(motions)
    with replacing_folder(out) as partial, bar(steps, "export") as progress:
        for name, motion in zip(names, motions, strict=True):
            if meshes:
                (partial / name).mkdir(exist_ok=True)
                write_obj_sequence(partial / name, motion, body, progress)
            else:
                write_one(partial / name, [motion], body, suffix)
                progress()
    return tuple(out / name for name in names)


def stems(motions: list["Motion"], mirrored: bool = False) -> list[str]:
    """A file name for each motion, from its file, or from its label where it shares the file or has none; names that
    are taken are numbered.

    Labels are read from file names, so a mirrored motion's names the other side than the file that it came from.
    """
    from refine.cli.generate import file_stem
    from refine.motion import other_side

    found: list[str] = []
    held = Counter((motion.source, motion.label) for motion in motions)
    labels = Counter(source for source, _ in held)  # how many different ones a file has
    for motion in motions:
        source = Path(motion.source)
        stem = other_side(source.stem) if mirrored else source.stem
        own = source.suffix and (labels[motion.source] == 1 or not motion.label)
        name = file_stem(stem if own else motion.label or motion.source) or "motion"
        numbered = (f"{name}_{number:03d}" for number in range(2, len(motions) + 2))
        found.append(name if name not in found else next(one for one in numbered if one not in found))
    return found
