"""A user's own SMPL file: .npz or .pkl, v1.0 or v1.1, neutral, male or female, under any name.

The files are licensed to their users and never ship here. They are told apart by the shapes of their arrays.
"""

from pathlib import Path
from typing import Any

import numpy as np

from refine.formats.npz import read_npz
from refine.formats.unpickle import Inert, read_pickle
from renderers.body import SHAPES, Body, BodyArrays
from renderers.checks import UserError, check_finite
from renderers.skeleton import JOINT_NAMES, PARENTS

SMPL_VERTICES = 6890
POSE_CORRECTIVES = 9 * (len(JOINT_NAMES) - 1)
KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "f", "kintree_table")
AXES = {
    "v_template": "vertex coordinate",
    "shapedirs": "vertex coordinate direction",
    "posedirs": "vertex coordinate direction",
    "J_regressor": "joint vertex",
    "weights": "vertex joint",
}
# What else comes with the same array names, by its number of joints.
RELATIVES = {5: "a FLAME", 16: "a MANO", 52: "an SMPL-H", 55: "an SMPL-X"}
REMEDY = "give an SMPL file with 24 joints (from https://smpl.is.tue.mpg.de), or leave --body out"


def load_body(path: str | Path) -> Body:
    """Read an SMPL body; nothing in the file is executed.

    Raises:
        UserError: the file is missing, damaged, not SMPL (and what it is, where that shows), or holds values that are
            not finite, with the array and the place named.
    """
    return Body(_checked_arrays(path, _read(Path(path))))


def _read(path: Path) -> dict[str, np.ndarray]:
    if path.suffix.lower() == ".npz":
        return read_npz(path, KEYS)
    if path.suffix.lower() != ".pkl":
        raise UserError(path, f"is a {path.suffix or 'nameless'} file, which no body comes in", "give a .npz or .pkl")
    stored = read_pickle(path)
    if not isinstance(stored, dict):
        raise UserError(path, f"holds a {type(stored).__name__}, not the dictionary of an SMPL body", REMEDY)
    return {key: _array(path, key, stored[key]) for key in KEYS if key in stored}


def _array(path: Path, key: str, value: Any) -> np.ndarray:
    """A plain array from what v1.0 stores: NumPy, chumpy (``x`` holds the values) or scipy.sparse."""
    if isinstance(value, Inert) and isinstance(value.state, dict):
        if value.name.startswith("chumpy.") and "x" in value.state:
            return _array(path, key, value.state["x"])
        if value.name.startswith("scipy.sparse."):
            return _dense(path, key, value)
    if not isinstance(value, np.ndarray):
        what = value.name if isinstance(value, Inert) else type(value).__name__
        raise UserError(f"{path}, array '{key}'", f"is stored as {what}, which cannot be read", REMEDY)
    return np.asarray(value)


def _dense(path: Path, key: str, sparse: Inert) -> np.ndarray:
    """The state of a compressed sparse column or row matrix, written out."""
    where = f"{path}, array '{key}'"
    try:
        rows, columns = (int(size) for size in sparse.state["_shape"])
        data, minor, starts = (np.asarray(sparse.state[name]) for name in ("data", "indices", "indptr"))
        by_column = {"csc": True, "csr": False}[sparse.name.rsplit(".", 1)[-1][:3]]
        major_size, minor_size = (columns, rows) if by_column else (rows, columns)
        if rows * columns > len(JOINT_NAMES) * 10 * SMPL_VERTICES or len(starts) != major_size + 1:
            raise ValueError("the sizes do not fit")
        dense = np.zeros((major_size, minor_size))
        np.add.at(dense, (np.repeat(np.arange(major_size), np.diff(starts.astype(np.int64))), minor), data)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(where, "is not an intact sparse matrix", REMEDY) from error
    return dense.T if by_column else dense


def _checked_arrays(path: str | Path, stored: dict[str, np.ndarray]) -> BodyArrays:
    missing = [key for key in KEYS if key not in stored]
    if missing:
        raise UserError(path, f"is not an SMPL body: it has no {', '.join(missing)}", REMEDY)
    vertices, joints = len(stored["v_template"]), stored["weights"].shape[-1]
    if joints != len(JOINT_NAMES):
        relative = RELATIVES.get(joints, "some other")
        raise UserError(path, f"is {relative} body with {joints} joints, not SMPL with {len(JOINT_NAMES)}", REMEDY)
    expected = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, None),
        "posedirs": (vertices, 3, POSE_CORRECTIVES),
        "J_regressor": (joints, vertices),
        "weights": (vertices, joints),
        "f": (None, 3),
        "kintree_table": (2, joints),
    }
    for key, sizes in expected.items():
        shape = stored[key].shape
        if len(shape) != len(sizes) or any(want not in (None, got) for want, got in zip(sizes, shape, strict=True)):
            wanted = ", ".join("any" if size is None else str(size) for size in sizes)
            raise UserError(f"{path}, array '{key}'", f"has shape {list(shape)}, expected [{wanted}]", REMEDY)
        if stored[key].dtype.kind not in "iuf":
            raise UserError(f"{path}, array '{key}'", f"holds {stored[key].dtype}, not numbers", REMEDY)
    for key, axes in AXES.items():
        check_finite(f"{path}, array '{key}'", stored[key], axes)
    if stored["shapedirs"].shape[-1] < SHAPES:
        raise UserError(path, f"has {stored['shapedirs'].shape[-1]} shape directions, fewer than {SHAPES}", REMEDY)
    if tuple(int(parent) for parent in stored["kintree_table"][0, 1:]) != PARENTS[1:]:
        raise UserError(f"{path}, array 'kintree_table'", "is not SMPL's tree of joints", REMEDY)
    faces = stored["f"].astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= vertices:
        raise UserError(f"{path}, array 'f'", f"names vertices outside 0..{vertices - 1}", REMEDY)
    rest = stored["v_template"]
    return BodyArrays(
        v_template=rest - [0, rest[:, 1].min(), 0],  # SMPL's origin is at the chest, this project's on the floor
        shapedirs=stored["shapedirs"][..., :SHAPES],
        posedirs=stored["posedirs"],
        J_regressor=stored["J_regressor"],
        weights=stored["weights"],
        faces=faces,
        vertex_ids=_landmarks(vertices),
    )


def _landmarks(vertices: int) -> dict[str, int] | None:
    from smplx.vertex_ids import vertex_ids

    return vertex_ids["smplh"] if vertices == SMPL_VERTICES else None
