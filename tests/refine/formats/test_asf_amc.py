"""ASF/AMC: files written here by their definition, posed here with NumPy, and files that are not well."""

import math

import numpy as np
import pytest
import torch

from refine.formats.asf_amc import CMU_FPS, asf_beside, read_amc
from refine.formats.bvh import bvh_text, read_bvh, world
from refine.formats.files import Reading, load_motion
from refine.skeletons.mapping import mapping_of
from renderers.checks import UserError
from renderers.skeleton import JOINTS

SCALE = 0.45 / 0.0254  # numbers of the CMU files to a metre
# Bone -> (parent, from, to) among SMPL's joints; a joint is where its bone begins.
BONES = {
    "lowerback": ("root", "pelvis", "spine1"), "upperback": ("lowerback", "spine1", "spine2"),
    "thorax": ("upperback", "spine2", "spine3"), "lowerneck": ("thorax", "spine3", "neck"),
    "upperneck": ("lowerneck", "neck", "head"),
}  # fmt: skip
for _letter, _side in (("l", "left"), ("r", "right")):
    for _name, _parent, _start, _end in (
        ("hipjoint", "root", "pelvis", f"{_side}_hip"),
        ("femur", f"{_letter}hipjoint", f"{_side}_hip", f"{_side}_knee"),
        ("tibia", f"{_letter}femur", f"{_side}_knee", f"{_side}_ankle"),
        ("foot", f"{_letter}tibia", f"{_side}_ankle", f"{_side}_foot"),
        ("clavicle", "thorax", "spine3", f"{_side}_shoulder"),
        ("humerus", f"{_letter}clavicle", f"{_side}_shoulder", f"{_side}_elbow"),
        ("radius", f"{_letter}humerus", f"{_side}_elbow", f"{_side}_wrist"),
        ("wrist", f"{_letter}radius", f"{_side}_wrist", f"{_side}_hand"),
    ):
        BONES[_letter + _name] = (_parent, _start, _end)


def about(axis: str, angle: float) -> np.ndarray:
    """3 by 3, right-handed."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.eye(3)
    i, j = [k for k in range(3) if k != "xyz".index(axis)]
    turn[i, i] = turn[j, j] = cos
    turn[i, j], turn[j, i] = (-sin, sin) if axis != "y" else (sin, -sin)
    return turn


def fixed(angles, axes: str) -> np.ndarray:
    """One turn after the other about axes that stand still."""
    turn = np.eye(3)
    for angle, axis in zip(angles, axes, strict=True):
        turn = about(axis, angle) @ turn
    return turn


class Figure:
    """A figure with axes, degrees of freedom and angles drawn from a seed, written and posed by the definition."""

    def __init__(self, rest_joints, radians: bool = False, frames: int = 5, seed: int = 0, order: str = "xyz"):
        draw = np.random.default_rng(seed)
        self.radians, self.order = radians, order
        rest = rest_joints.double().numpy()
        self.bones = {
            name: (parent, SCALE * (rest[JOINTS[end]] - rest[JOINTS[start]]))
            for name, (parent, start, end) in BONES.items()
        }
        self.axis = {name: draw.uniform(-2, 2, 3) for name in self.bones}
        self.dof = {name: ("rx ry rz", "rx", "ry rz")[index % 3].split() for index, name in enumerate(self.bones)}
        self.dof["lhipjoint"] = self.dof["rhipjoint"] = []
        self.angles = {name: draw.uniform(-0.4, 0.4, (frames, len(dof))) for name, dof in self.dof.items()}
        self.root_angles, self.root = draw.uniform(-0.5, 0.5, (frames, 3)), 20 * draw.normal(size=(frames, 3))
        self.frames = frames

    def joints(self) -> dict[str, np.ndarray]:
        """Where each bone begins, [T 3] in the file's unit, and where it ends under its name with a prime."""
        found = {name: np.zeros((self.frames, 3)) for bone in self.bones for name in (bone, bone + "'")}
        for frame in range(self.frames):
            turns = {"root": fixed(self.root_angles[frame], "xyz")}
            ends = {"root": self.root[frame]}
            for name, (parent, vector) in self.bones.items():
                own = fixed(self.axis[name], self.order)
                moved = fixed(self.angles[name][frame], "".join(dof[1] for dof in self.dof[name]))
                turns[name] = turns[parent] @ own @ moved @ np.linalg.inv(own)
                found[name][frame] = ends[parent]
                ends[name] = found[name + "'"][frame] = ends[parent] + turns[name] @ vector
        return found

    def write(self, folder, name="01_02", skeleton="01"):
        angle = 1.0 if self.radians else 180 / math.pi
        lines = ["# made here", ":version 1.10", ":name VICON", ":units", "  mass 1.0", "  length 0.45"]
        lines += [f"  angle {'rad' if self.radians else 'deg'}", ":documentation", "   anything begin end", ":root"]
        lines += ["   order TX TY TZ RX RY RZ", "   axis XYZ", "   position 0 0 0", "   orientation 0 0 0", ":bonedata"]
        for index, (bone, (_, vector)) in enumerate(self.bones.items()):
            length = np.linalg.norm(vector)
            axis = " ".join(f"{angle * value:.12f}" for value in self.axis[bone])
            lines += ["  begin", f"     id {index + 1}", f"     name {bone}"]
            lines += [f"     direction {' '.join(f'{x:.12f}' for x in vector / length)}", f"     length {length:.12f}"]
            lines += [f"     axis {axis}  {self.order.upper()}"]
            if self.dof[bone]:
                limits = [f"{'limits' if k == 0 else '      '} (-160.0 20.0)" for k in range(len(self.dof[bone]))]
                lines += [f"    dof {' '.join(self.dof[bone])}", *limits]
            lines.append("  end")
        lines += [":hierarchy", "  begin"]
        for parent in ("root", *self.bones):
            children = [bone for bone, (above, _) in self.bones.items() if above == parent]
            lines += [f"    {parent} {' '.join(children)}"] if children else []
        (folder / f"{skeleton}.asf").write_text("\n".join([*lines, "  end"]) + "\n")
        lines = ["#!OML:ASF x", ":FULLY-SPECIFIED", ":RADIANS" if self.radians else ":DEGREES"]
        for frame in range(self.frames):
            lines.append(str(frame + 1))
            values = [*self.root[frame], *(angle * self.root_angles[frame])]
            lines.append("root " + " ".join(f"{value:.10f}" for value in values))
            for bone in sorted(self.bones):
                if self.dof[bone]:
                    lines.append(bone + " " + " ".join(f"{angle * value:.10f}" for value in self.angles[bone][frame]))
        path = folder / f"{name}.amc"
        path.write_text("\n".join(lines) + "\n")
        return path


@pytest.mark.parametrize(("radians", "order"), [(False, "xyz"), (True, "zyx"), (False, "yxz")])
def test_joints_are_where_the_definition_has_them(tmp_path, rest_joints, radians, order):
    figure = Figure(rest_joints, radians, order=order)
    bvh = read_amc(figure.write(tmp_path))
    assert (len(bvh), bvh.fps, bvh.unit, set(bvh.names)) == (5, CMU_FPS, "in", {"root", *BONES})
    ours, theirs = world(bvh)[0], figure.joints()
    for bone in BONES:
        expected = torch.from_numpy(theirs[bone]) / SCALE
        torch.testing.assert_close(ours[:, bvh.names.index(bone)], expected, atol=1e-7, rtol=0)
    tips = {bvh.names[joint] for joint, _ in bvh.ends}
    assert tips == {"upperneck", "lwrist", "rwrist", "lfoot", "rfoot"}
    turns = world(bvh)[1]
    for joint, offset in bvh.ends:
        tip = ours[:, joint] + turns[:, joint] @ torch.tensor(offset, dtype=torch.float64)
        expected = torch.from_numpy(theirs[bvh.names[joint] + "'"]) / SCALE
        torch.testing.assert_close(tip, expected, atol=1e-7, rtol=0)


def test_the_other_readings_are_elsewhere(tmp_path, rest_joints):
    """The turns of the axes matter: without them the wrists are half a metre off."""
    figure = Figure(rest_joints)
    bvh = read_amc(figure.write(tmp_path))
    figure.axis = {bone: np.zeros(3) for bone in figure.axis}
    plain = torch.from_numpy(figure.joints()["lwrist"]) / SCALE
    assert (world(bvh)[0][:, bvh.names.index("lwrist")] - plain).norm(dim=-1).max() > 0.2


def test_limbs_point_where_the_files_do(tmp_path, rest_joints):
    figure = Figure(rest_joints, seed=3)
    path = figure.write(tmp_path)
    motion, theirs = load_motion(path, rest_joints, Reading(fps=60.0)), figure.joints()
    assert (motion.fps, motion.label) == (60.0, "01")
    ours = motion.joints(rest_joints).double().numpy()
    for side, letter in (("left", "l"), ("right", "r")):
        for bone, start, end in (
            ("femur", "hip", "knee"),
            ("tibia", "knee", "ankle"),
            ("humerus", "shoulder", "elbow"),
        ):
            vector = theirs[f"{letter}{bone}'"] - theirs[f"{letter}{bone}"]
            limb = ours[:, JOINTS[f"{side}_{end}"]] - ours[:, JOINTS[f"{side}_{start}"]]
            cross = np.linalg.norm(np.cross(vector, limb), axis=-1)
            assert np.degrees(np.arctan2(cross, (vector * limb).sum(-1))).max() < 0.1
    assert mapping_of(read_amc(path)).skeleton == "CMU (Acclaim)"


def test_it_can_be_written_as_bvh(tmp_path, rest_joints):
    bvh = read_amc(Figure(rest_joints).write(tmp_path))
    (tmp_path / "same.bvh").write_text(bvh_text(bvh))
    back = read_bvh(tmp_path / "same.bvh", unit=bvh.unit)
    order = [back.names.index(name) for name in bvh.names]
    torch.testing.assert_close(world(back)[0][:, order], world(bvh)[0], atol=1e-5, rtol=0)


def test_a_rest_motion_is_the_skeleton(tmp_path, rest_joints):
    """With all angles at zero our T-pose comes back, whatever the axes are."""
    figure = Figure(rest_joints, frames=2)
    figure.angles = {bone: 0 * angles for bone, angles in figure.angles.items()}
    figure.root_angles *= 0
    motion = load_motion(figure.write(tmp_path), rest_joints)
    torch.testing.assert_close(motion.rotations, torch.eye(3).repeat(2, 24, 1, 1), atol=1e-5, rtol=0)


def test_the_skeleton_is_found(tmp_path, rest_joints):
    figure = Figure(rest_joints)
    path = figure.write(tmp_path, "07_11", "07")
    assert asf_beside(path).name == "07.asf"
    assert asf_beside(tmp_path / "my_dancer_02.amc").name == "07.asf"  # the only one
    (tmp_path / "my_dancer.asf").write_text("x")
    assert asf_beside(tmp_path / "my_dancer_02.amc").name == "my_dancer.asf"
    (tmp_path / "my_dancer.asf").unlink()
    (tmp_path / "08.asf").write_text("x")
    (tmp_path / "07_11.ASF").write_text("x")
    assert asf_beside(path).name == "07_11.ASF"
    (tmp_path / "07_11.ASF").unlink()
    assert asf_beside(path).name == "07.asf"
    (tmp_path / "07.asf").rename(tmp_path / "09.asf")
    with pytest.raises(
        UserError, match=r"07_11.amc: none of the 2 skeletons \(.asf\) beside it has its name; put 07.asf"
    ):
        read_amc(path)
    (tmp_path / "08.asf").unlink()
    assert asf_beside(path).name == "09.asf"
    (tmp_path / "09.asf").unlink()
    with pytest.raises(UserError, match="its skeleton is missing; put 07.asf beside it"):
        read_amc(path)


def test_a_skeleton_alone_is_no_motion(tmp_path, rest_joints):
    Figure(rest_joints).write(tmp_path)
    with pytest.raises(UserError, match="is a skeleton without a motion; give the .amc"):
        load_motion(tmp_path / "01.asf", rest_joints)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("01.asf", ":bonedata", ":bones", "is not there, or has a parent"),
        ("01.asf", "name lfemur", "name lhipjoint", "a second bone"),
        ("01.asf", "dof rx\n", "dof rx l\n", "known are rx ry rz"),
        ("01.asf", "length 0.45", "length nan", "1 finite numbers expected"),
        ("01.asf", "axis XYZ", "axis XYY", "no order of axes"),
        ("01.asf", "ltibia lfoot", "ltibia nobody", "is not there, or has a parent"),
        ("01.asf", "direction 1", "direction one", "finite|belong"),
        ("01_02.amc", "\nroot ", "\nroots ", "'roots .* is not what the skeleton has"),
        ("01_02.amc", "lfemur", "# ", "the frame before has no values of lfemur"),
        ("01_02.amc", "lfemur ", "lfemur 1 ", "is not what the skeleton has"),
        ("01_02.amc", "root ", "root nan ", "is not what"),
        ("01_02.amc", "\n1\n", "\n", "comes before any frame"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, rest_joints, file, old, new, message):
    path = Figure(rest_joints).write(tmp_path)
    text = (tmp_path / file).read_text()
    if old == "direction 1":
        old = "direction " + text.partition("direction ")[2].split()[0]
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(UserError, match=message) as caught:
        read_amc(path)
    assert "\n" not in str(caught.value)


def test_values_that_are_not_finite_are_refused(tmp_path, rest_joints):
    path = Figure(rest_joints).write(tmp_path)
    lines = path.read_text().splitlines()
    words = lines[4].split()
    path.write_text("\n".join([*lines[:4], " ".join([*words[:-1], "inf"]), *lines[5:]]))
    with pytest.raises(UserError, match=r"line 5: 'root .* is not all finite numbers"):
        read_amc(path)


def test_a_clip_without_frames_is_refused(tmp_path, rest_joints):
    path = Figure(rest_joints).write(tmp_path)
    path.write_text(":DEGREES\n")
    with pytest.raises(UserError, match="holds no frames"):
        read_amc(path)


def test_more_frames_than_are_read_are_refused(tmp_path, rest_joints, monkeypatch):
    monkeypatch.setattr("refine.formats.asf_amc.MAX_JOINT_FRAMES", 3 * (len(BONES) + 1))
    with pytest.raises(UserError, match="goes on after 4 frames"):
        read_amc(Figure(rest_joints).write(tmp_path))


def test_a_loop_hangs_nowhere(tmp_path, rest_joints):
    path = Figure(rest_joints).write(tmp_path)
    text = (tmp_path / "01.asf").read_text().partition(":hierarchy")[0]
    (tmp_path / "01.asf").write_text(text + ":hierarchy\nbegin\nlfemur ltibia\nltibia lfemur\nend\n")
    with pytest.raises(UserError, match="says of no bone that it hangs from the root"):
        read_amc(path)


def test_a_rate_that_is_said_is_the_rate_even_if_it_is_none(tmp_path, rest_joints):
    path = Figure(rest_joints).write(tmp_path)
    assert load_motion(path, rest_joints, Reading(fps=60.0)).fps == 60.0
    with pytest.raises(UserError, match="frame rate 0.0 is not a number of frames per second"):
        load_motion(path, rest_joints, Reading(fps=0.0))
