"""Look for files that break a reader: a mutation of the seeds that reaches new code is kept and mutated again.

python tools/fuzz.py bvh --seconds 600

It needs atheris (pip install atheris), which is not among the dependencies. What is allowed is a motion, or a UserError
in one line; anything else, five seconds or two gigabytes stop the run, and the file that did it lies in the folder of
``--out``. Coverage is counted in refine.formats, and in Python's pickle.
"""

import argparse
import importlib
import io
import math
import re
import struct
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import atheris

sys.modules.pop("pickle", None)  # which atheris has imported itself, without counting
with atheris.instrument_imports(include=["refine.formats", "pickle"]):
    importlib.import_module("pickle")
    from refine.formats import files
    from refine.formats.actor import read_humanact
    from refine.formats.npz import read_npz
    from refine.formats.smpl import load_body
    from refine.formats.untrusted import kind_of
    from renderers.body import Body
    from renderers.checks import UserError

SEEDS = Path(__file__).resolve().parents[1] / "tests" / "refine" / "formats" / "seeds"
KINDS = ("bvh", "amc", "npz", "pickle", "glb")
REST = Body.free("light").rest_joints
BETWEEN = b"\n====\n"  # skeleton and motion
# What the arrays of our archives are like; T is the number of frames.
AMASS = {
    "poses": ("<f4", "(T, 72)"),
    "trans": ("<f4", "(T, 3)"),
    "mocap_framerate": ("<f8", "()"),
    "root_orient": ("<f8", "(T, 3)"),
    "pose_body": ("<f8", "(T, 63)"),
    "betas": ("<f4", "(10,)"),
    "gender": ("<U7", "()"),
    "label": ("<U4", "()"),
}
CLIPS = {
    "six": ("<f4", "(T, 24, 6)"),
    "root": ("<f4", "(T, 3)"),
    "lengths": ("<i8", "(1,)"),
    "fps": ("<f8", "(1,)"),
    "labels": ("<U4", "(1,)"),
    "sources": ("<U4", "(1,)"),
    "betas": ("<f4", "(1, 10)"),
    "genders": ("<U7", "(1,)"),
}
TYPES = ("<f4", "<f8", "<i8", "|u1", "<U4", "|O", ">f8", "|b1", "|S3", "<c8", "<f2")
SHAPES = ("()", "(T,)", "(0,)", "(-1,)", "(T, 156)", "(T, 165)", "(1, T, 3)", "(2, 2)", "(4294967296, 0)")
SOUND = {"fps": struct.pack("<d", 30.0), "mocap_framerate": struct.pack("<d", 30.0)}


def archive(data: bytes) -> bytes:
    """An .npz of the fuzzer's bytes, mostly sound: no mutation of an archive keeps its checksums."""
    given, packed = atheris.FuzzedDataProvider(data), io.BytesIO()
    frames, arrays = given.ConsumeIntInRange(1, 3), CLIPS if given.ConsumeBool() else AMASS
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED if given.ConsumeBool() else zipfile.ZIP_STORED) as made:
        for name, (code, shape) in arrays.items():
            change = given.ConsumeIntInRange(0, 31)
            if change == 0:
                continue
            code = given.PickValueInList(list(TYPES)) if change == 1 else code
            shape = (given.PickValueInList(list(SHAPES)) if change == 2 else shape).replace("T", str(frames))
            header = f"{{'descr': '{code}', 'fortran_order': {change == 3}, 'shape': {shape}, }}".encode()
            header = given.ConsumeBytes(40) if change == 4 else header
            count = abs(math.prod(int(word) for word in re.findall(r"-?\d+", shape)))
            size = min(count * {"O": 8, "U": 16, "b": 1}.get(code[1], int(code[2:] if code[2:].isdigit() else 8)), 9999)
            content = given.ConsumeBytes(size if change < 16 else min(size, 8))
            if change > 5:
                content = content.ljust(size, b"\0")
                content = struct.pack("<q", frames) if name == "lengths" else SOUND.get(name, content)
            made.writestr(f"{name}.npy", b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header + content)
    return packed.getvalue()


def write(kind: str, data: bytes, path: Path) -> None:
    """The file, or the files, of the fuzzer's bytes."""
    if kind == "npz" and data[:2] != b"PK":
        data = archive(data)
    if kind == "amc":
        skeleton, between, motion = data.partition(BETWEEN)
        path.with_suffix(".asf").write_bytes(skeleton if between else (SEEDS / "skeleton.asf").read_bytes())
        data = motion if between else data
    path.write_bytes(data)


def readers(kind: str) -> tuple[Callable[[Path], object], ...]:
    """The ways in which such a file is read."""
    more = {"npz": (read_npz, load_body), "pickle": (lambda path: read_humanact(path, REST), load_body)}
    return (kind_of, lambda path: files.READERS[kind](path, REST, files.Reading()), *more.get(kind, ()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--out", type=Path, default=Path("fuzzing"), help="folder of kept files and of crashes")
    args = parser.parse_args()
    kept = args.out / args.kind
    kept.mkdir(parents=True, exist_ok=True)
    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    path = place / f"file.{'pkl' if args.kind == 'pickle' else args.kind}"
    ways = readers(args.kind)

    def one(data: bytes) -> None:
        write(args.kind, data, path)
        for read in ways:
            try:
                read(path)
            except UserError as error:
                if "\n" in str(error) or len(str(error)) > 1000:
                    raise AssertionError("the message is no line") from error

    for seed in sorted(SEEDS.glob(f"*.{args.kind}")):
        content = seed.read_bytes()
        (kept / seed.name).write_bytes(content)
        if args.kind == "amc":
            (kept / f"{seed.name}.both").write_bytes((SEEDS / "skeleton.asf").read_bytes() + BETWEEN + content)
    words = SEEDS / f"{args.kind}.dict"
    flags = [f"-max_total_time={args.seconds}", "-timeout=5", "-rss_limit_mb=2500", "-max_len=20000", "-len_control=0"]
    flags += [f"-artifact_prefix={args.out}/{args.kind}-", "-print_final_stats=1"]
    flags += [f"-dict={words}"] if words.exists() else []
    atheris.Setup([sys.argv[0], str(kept), *flags], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
