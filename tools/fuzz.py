"""Look for files that break a reader: a mutation of the seeds that reaches new code is kept and mutated again.

python tools/fuzz.py bvh --seconds 600

It needs atheris (pip install atheris), which is not among the dependencies. What is allowed is a motion, or a UserError
in one line; anything else, five seconds or a gigabyte stop the run, and the file that did it lies in the folder of
``--out``. Coverage is counted in refine.formats, and in Python's pickle.
"""

import argparse
import io
import math
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import atheris

sys.modules.pop("pickle", None)  # which atheris has imported itself, without counting
with atheris.instrument_imports(include=["refine.formats", "pickle"]):
    import pickle  # noqa: F401
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
ASF = SEEDS / "skeleton.asf"
MEMBERS = ("poses", "trans", "mocap_framerate", "betas", "gender", "label", "six", "root", "lengths", "fps", "labels")
TYPES = ("<f4", "<f8", "<i8", "|u1", "<U4", "|O", ">f8", "|b1")


def as_file(kind: str, data: bytes) -> bytes:
    """What is written for the fuzzer's bytes: an archive is made of them, since no mutation keeps one intact."""
    if kind != "npz" or data[:2] == b"PK":
        return data
    given, packed = atheris.FuzzedDataProvider(data), io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name in MEMBERS:
            if not given.ConsumeBool():
                continue
            shape = tuple(given.ConsumeIntInRange(-1, 4) for _ in range(given.ConsumeIntInRange(0, 4)))
            shape = (shape[0], 156) if name == "poses" and shape and given.ConsumeBool() else shape
            code = given.PickValueInList(list(TYPES))
            header = f"{{'descr': '{code}', 'fortran_order': {given.ConsumeBool()}, 'shape': {shape}, }}"
            width = 4 if code == "<U4" else 1
            length = abs(math.prod(shape)) * width * int(code[2:] if code[1] != "O" else 8)
            content = given.ConsumeBytes(length).ljust(length if given.ConsumeBool() else 0, b"\1")
            start = b"\x93NUMPY\x01\0" + len(header).to_bytes(2, "little") + header.encode()
            archive.writestr(f"{name}.npy", start + content)
    return packed.getvalue()


def readers(kind: str) -> tuple[Callable[[Path], object], ...]:
    """The ways in which such a file is read."""
    read = files.READERS.get(kind)
    whole = (lambda path: read(path, REST, files.Reading()),) if read else ()
    more = {"npz": (read_npz, load_body), "pickle": (lambda path: read_humanact(path, REST), load_body)}
    return (kind_of, *whole, *more.get(kind, ()))


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
    if args.kind == "amc" and ASF.exists():
        (place / "file.asf").write_bytes(ASF.read_bytes())
    ways = readers(args.kind)

    def one(data: bytes) -> None:
        path.write_bytes(as_file(args.kind, data))
        for read in ways:
            try:
                read(path)
            except UserError as error:
                if "\n" in str(error) or len(str(error)) > 1000:
                    raise AssertionError("the message is no line") from error

    seeds = sorted(SEEDS.glob(f"*.{args.kind}"))
    for seed in seeds:
        (kept / seed.name).write_bytes(seed.read_bytes())
    flags = [f"-max_total_time={args.seconds}", "-timeout=5", "-rss_limit_mb=2500", "-max_len=20000", "-len_control=0"]
    words = SEEDS / f"{args.kind}.dict"
    flags += [f"-dict={words}"] if words.exists() else []
    flags += [f"-artifact_prefix={args.out}/{args.kind}-", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], str(kept), *flags], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
