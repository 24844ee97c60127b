"""A user's own SMPL file: .npz or .pkl, v1.0 or v1.1, neutral, male or female, under any name.

The files are licensed to their users and never ship here. They are told apart by the shapes of their arrays.
"""

from pathlib import Path
from typing import Any

import numpy as np

from refine.formats.npz import read_npz
from refine.formats.unpickle import Inert, read_pickle
from refine.formats.untrusted import kind_of
from renderers.body import SHAPES, Body, BodyArrays
from renderers.checks import UserError, check_finite, check_shapes
from renderers.skeleton import JOINT_NAMES, PARENTS

SMPL_VERTICES = 6890
MAX_DEPTH = 8  # of arrays in arrays
LARGEST = 1e6  # of any number in a body
POSE_CORRECTIVES = 9 * (len(JOINT_NAMES) - 1)
KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "f", "kintree_table")
AXES = {
    "v_template": "vertex coordinate",
    "shapedirs": "vertex coordinate direction",
    "posedirs": "vertex coordinate direction",
    "J_regressor": "joint vertex",
    "weights": "vertex joint",
    "f": "face corner",
    "kintree_table": "row joint",
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
    kind = kind_of(path)
    if kind == "npz":
        return read_npz(path, KEYS)
    if kind != "pickle" and path.suffix.lower() != ".pkl":
        raise UserError(path, "is no file that a body comes in", "give a .npz or .pkl")
    stored = read_pickle(path)
    if not isinstance(stored, dict):
        what = stored.name if isinstance(stored, Inert) else type(stored).__name__
        raise UserError(path, f"holds a {what}, not the dictionary of an SMPL body", REMEDY)
    return {key: _array(f"{path}, array '{key}'", stored[key]) for key in KEYS if key in stored}


def _array(where: str, value: Any, depth: int = 0) -> np.ndarray:
    """A plain array from what v1.0 stores: NumPy, chumpy or scipy.sparse."""
    if isinstance(value, Inert) and value.name.startswith("scipy.sparse."):
        return _dense(where, value)
    match value:
        case np.ndarray():
            return np.asarray(value)
        case Inert(name="chumpy.ch.Ch", state={"x": values}) if depth < MAX_DEPTH:
            return _array(where, values, depth + 1)
        case Inert(name="chumpy.reordering.Select", state=dict(state)) if depth < MAX_DEPTH:
            return _selected(where, state, depth + 1)
    what = value.name if isinstance(value, Inert) else type(value).__name__
    raise UserError(where, f"is stored as {what}, which cannot be read", REMEDY)


def _selected(where: str, state: dict[str, Any], depth: int) -> np.ndarray:
    """Some elements of another array, in a shape of their own."""
    chosen, shape = state.get("idxs"), state.get("preferred_shape")
    if not isinstance(chosen, np.ndarray) or chosen.dtype.kind not in "iu" or not isinstance(shape, tuple):
        raise UserError(where, "is stored as chumpy.reordering.Select, which cannot be read", REMEDY)
    try:
        return _array(where, state.get("a"), depth).ravel()[np.asarray(chosen)].reshape(shape)
    except (TypeError, ValueError, IndexError) as error:
        raise UserError(where, "is stored as chumpy.reordering.Select, which cannot be read", REMEDY) from error


def _dense(where: str, sparse: Inert) -> np.ndarray:
    """The state of a compressed sparse column or row matrix, written out."""
    try:
        rows, columns = (int(size) for size in sparse.state["_shape"])
        data, minor, starts = (sparse.state[name] for name in ("data", "indices", "indptr"))
        by_column = {"csc": True, "csr": False}[sparse.name.rsplit(".", 1)[-1][:3]]
        major_size, minor_size = (columns, rows) if by_column else (rows, columns)
        if not all(isinstance(array, np.ndarray) and array.ndim == 1 for array in (data, minor, starts)):
            raise ValueError("a part is no array")
        if min(rows, columns) < 1 or rows * columns > len(JOINT_NAMES) * 10 * SMPL_VERTICES:
            raise ValueError("the sizes do not fit")
        counts = np.diff(starts.astype(np.int64))
        if len(counts) != major_size or counts.min() < 0 or starts[0] != 0 or starts[-1] != len(data):
            raise ValueError("the places do not fit")  # each count is one that memory is taken for
        dense = np.zeros((major_size, minor_size))
        np.add.at(dense, (np.repeat(np.arange(major_size), counts), np.asarray(minor)), np.asarray(data))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(where, "is not an intact sparse matrix", REMEDY) from error
    return dense.T if by_column else dense


def _checked_arrays(path: str | Path, stored: dict[str, np.ndarray]) -> BodyArrays:
    missing = [key for key in KEYS if key not in stored]
    if missing:
        raise UserError(path, f"is not an SMPL body: it has no {', '.join(missing)}", REMEDY)
    for key, array in stored.items():
        if array.dtype.kind not in "iuf":
            raise UserError(f"{path}, array '{key}'", f"holds {array.dtype}, not numbers", REMEDY)
    skeleton = {"weights": (stored["weights"], "V J"), "kintree_table": (stored["kintree_table"], "2 J")}
    sizes = check_shapes(str(path), **skeleton)
    if sizes["J"] != len(JOINT_NAMES):
        relative = RELATIVES.get(sizes["J"], "some other")
        raise UserError(path, f"is {relative} body with {sizes['J']} joints, not SMPL with {len(JOINT_NAMES)}", REMEDY)
    check_shapes(
        str(path),
        sizes,
        v_template=(stored["v_template"], "V 3"),
        shapedirs=(stored["shapedirs"], "V 3 S"),
        posedirs=(stored["posedirs"], f"V 3 {POSE_CORRECTIVES}"),
        J_regressor=(stored["J_regressor"], "J V"),
        f=(stored["f"], "F 3"),
    )
    for key, axes in AXES.items():
        check_finite(f"{path}, array '{key}'", stored[key], axes)
        if key != "kintree_table" and np.abs(stored[key]).max(initial=0) > LARGEST:
            raise UserError(f"{path}, array '{key}'", "holds numbers larger than those of any body", REMEDY)
    if stored["shapedirs"].shape[-1] < SHAPES:
        raise UserError(path, f"has {stored['shapedirs'].shape[-1]} shape directions, fewer than {SHAPES}", REMEDY)
    if tuple(int(parent) for parent in stored["kintree_table"][0, 1:]) != PARENTS[1:]:
        raise UserError(f"{path}, array 'kintree_table'", "is not SMPL's tree of joints", REMEDY)
    faces = stored["f"].astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= sizes["V"]:
        raise UserError(
            f"{path}, array 'f'", f"has no faces, or some with vertices outside 0..{sizes['V'] - 1}", REMEDY
        )
    rest = stored["v_template"]
    return BodyArrays(
        v_template=rest - [0, rest[:, 1].min(), 0],  # SMPL's origin is at the chest, this project's on the floor
        shapedirs=stored["shapedirs"][..., :SHAPES],
        posedirs=stored["posedirs"],
        J_regressor=stored["J_regressor"],
        weights=stored["weights"],
        faces=faces,
        vertex_ids=_landmarks(len(rest)),
    )


def _landmarks(vertices: int) -> dict[str, int] | None:
    from smplx.vertex_ids import vertex_ids

    return vertex_ids["smplh"] if vertices == SMPL_VERTICES else None
