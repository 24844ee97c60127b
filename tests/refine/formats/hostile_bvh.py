"""BVH files that claim, nest, repeat or count too much."""

import re
from pathlib import Path

from hostile_cases import hostile

ARM = """HIERARCHY
ROOT shoulder
{
  OFFSET 10 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT elbow
  {
    OFFSET 60 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 40 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 100 0 90 0 0 0 0 0
0 100 0 20 30 40 0 0 90
"""
TREE = ARM[: ARM.index("MOTION")]
ROW = "0 100 0 90 0 0 0 0 0\n"


@hostile("claims ten billion frames", ".bvh")
def billions_of_frames() -> str:
    return ARM.replace("Frames: 2", "Frames: 10000000000")


@hostile("claims two million frames and has two", ".bvh")
def million_frames() -> str:
    return ARM.replace("Frames: 2", "Frames: 2000000")


@hostile("claims a number of frames that has 100,000 digits", ".bvh")
def digits() -> str:
    return ARM.replace("Frames: 2", "Frames: " + "9" * 100_000)


@hostile("claims fewer frames than none", ".bvh")
def negative_frames() -> str:
    return ARM.replace("Frames: 2", "Frames: -2")


@hostile("nests 100,000 joints", ".bvh")
def depth() -> str:
    return "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n" for i in range(100_000))


@hostile("lists 100,000 joints", ".bvh")
def width() -> str:
    return "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n}}\n" for i in range(100_000))


@hostile("ends a joint 100,000 times", ".bvh")
def ends() -> str:
    return "HIERARCHY\nROOT a\n{\n" + "End Site\n{\nOFFSET 0 1 0\n}\n" * 100_000


@hostile("opens and closes 100,000 braces in one line", ".bvh")
def braces() -> str:
    return "HIERARCHY\nROOT a\n{\n" + "End {}" * 100_000


@hostile("has a million blank lines in its hierarchy", ".bvh")
def blank_hierarchy() -> str:
    return "HIERARCHY\n" + "\n" * 1_000_000 + TREE.removeprefix("HIERARCHY\n")


@hostile("has a million blank lines among its frames", ".bvh")
def blank_frames() -> str:
    return ARM.replace(ROW, ROW + "\n" * 1_000_000)


@hostile("has a line of 2 MB", ".bvh")
def long_line() -> str:
    return ARM.replace(ROW, "0 " * 1_000_000 + "\n")


@hostile("names a joint with 200,000 letters", ".bvh")
def long_name() -> str:
    return ARM.replace("JOINT elbow", "JOINT " + "x" * 200_000)


@hostile("promises a million channels", ".bvh")
def channels() -> str:
    return ARM.replace("CHANNELS 3", "CHANNELS 1000000")


@hostile("moves 1,000 joints that have no channels for 4,000 frames", ".bvh")
def still_joints() -> str:
    joints = "".join(f"JOINT b{i}\n{{\n}}\n" for i in range(1000))
    frames = "0\n" * 3900
    return f"HIERARCHY\nROOT a\n{{\nCHANNELS 1 Xrotation\n{joints}}}\nMOTION\nFrames: 3900\nFrame Time: 0.1\n{frames}"


@hostile("has values that are no numbers", ".bvh")
def nan() -> str:
    return ARM.replace("20 30 40", "20 nan inf")


@hostile("has lengths that overflow", ".bvh")
def overflow() -> str:
    return ARM.replace("0 100 0 20", "1e308 1e308 1e308 20")


@hostile("has bones that overflow", ".bvh")
def long_bones() -> str:
    return ARM.replace("OFFSET 60 0 0", "OFFSET 1e308 1e308 1e308")


@hostile("has bones too short to be divided by", ".bvh")
def short_bones() -> str:
    return re.sub(r"OFFSET .*", "OFFSET 0 1e-323 0", (Path(__file__).parent / "seeds" / "smpl.bvh").read_text())


@hostile("has a frame time whose inverse overflows", ".bvh")
def frame_time() -> str:
    return ARM.replace("0.0333333", "1e-320")


@hostile("has a frame time of NaN", ".bvh")
def frame_time_nan() -> str:
    return ARM.replace("0.0333333", "nan")


@hostile("steers the terminal that shows its error", ".bvh")
def terminal() -> str:
    return ARM.replace("JOINT elbow", "JOINT \x1b[2J\x1b]0;harmed\x07\x1b[8m\u202eelbow\nJOINT \x1b[2J")


@hostile("is cut inside a number", ".bvh")
def cut() -> str:
    return ARM[:-12]


@hostile("has zero bytes and other binary data", ".bvh")
def binary() -> bytes:
    return b"HIERARCHY\n" + bytes(range(256)) * 20


@hostile("is of a camera, not of a body", ".bvh")
def two_joints() -> str:
    return ARM


# --- Acclaim ----------------------------------------------------------------------------------------------------------

SEEDS = Path(__file__).parent / "seeds"
ASF, AMC = ((SEEDS / name).read_text() for name in ("skeleton.asf", "walk.amc"))


def acclaim(folder: Path, name: str, motion: str = AMC, skeleton: str = ASF) -> Path:
    (folder / f"{name}.asf").write_text(skeleton)
    (folder / f"{name}.amc").write_text(motion)
    return folder / f"{name}.amc"


@hostile("has no skeleton", ".amc")
def no_skeleton() -> str:
    return AMC


@hostile("leads to a skeleton elsewhere")
def linked_skeleton(folder: Path) -> Path:
    path = acclaim(folder, "linked_skeleton")
    path.with_suffix(".asf").rename(folder / "private")
    path.with_suffix(".asf").symlink_to("private")
    return path


@hostile("has a skeleton that is its own child")
def asf_cycle(folder: Path) -> Path:
    return acclaim(folder, "asf_cycle", skeleton=ASF.replace("begin\n root", "begin\n lfemur root\n root", 1))


@hostile("has a skeleton of 20,000 bones")
def many_bones(folder: Path) -> Path:
    bones = "".join(f"begin\nid {i}\nname b{i}\nend\n" for i in range(20_000))
    return acclaim(folder, "many_bones", skeleton=ASF.replace(":bonedata\n", ":bonedata\n" + bones))


@hostile("has a thousand bones that do not move, and 3,900 frames")
def still_bones(folder: Path) -> Path:
    bones = "".join(f"begin\nname b{i}\nend\n" for i in range(990))
    names = " ".join(f"b{i}" for i in range(990))
    skeleton = f":version 1.1\n:root\norder TX\n:bonedata\n{bones}:hierarchy\nbegin\nroot {names}\nend\n"
    return acclaim(folder, "still_bones", ":DEGREES\n" + "".join(f"{i}\nroot 0\n" for i in range(3900)), skeleton)


@hostile("has bones that overflow")
def long_asf_bones(folder: Path) -> Path:
    return acclaim(folder, "long_asf_bones", skeleton=re.sub(r"length .*", "length 1e308", ASF))


@hostile("has two million blank lines")
def blank_amc(folder: Path) -> Path:
    return acclaim(folder, "blank_amc", AMC + "\n" * 2_000_000)


@hostile("has a million comments")
def comments(folder: Path) -> Path:
    return acclaim(folder, "comments", AMC + "#\n" * 1_000_000)


@hostile("has angles of NaN")
def nan_amc(folder: Path) -> Path:
    return acclaim(folder, "nan_amc", AMC.replace("lfemur 1", "lfemur nan"))


@hostile("has more values than its skeleton has degrees of freedom")
def wide_amc(folder: Path) -> Path:
    return acclaim(folder, "wide_amc", AMC.replace("lfemur 1", "lfemur 1" + " 1" * 50_000))


@hostile("names a bone with 200,000 letters")
def long_amc_name(folder: Path) -> Path:
    return acclaim(folder, "long_amc_name", AMC + "x" * 200_000 + " 1\n")


@hostile("is a skeleton alone", ".asf")
def only_asf() -> str:
    return ASF
