"""SMPL files in the layouts that users have, with a made-up body in place of the licensed one."""

import pickle
import sys
import types
import zipfile

import numpy as np
import pytest
import torch

from refine.formats.smpl import _array, load_body
from refine.formats.unpickle import Inert
from renderers.body import Body, _free_arrays
from renderers.checks import UserError
from renderers.skeleton import PARENTS

VERTICES = 60


def smpl(vertices: int = VERTICES, joints: int = 24, shapes: int = 10) -> dict[str, np.ndarray]:
    """Random numbers in the shapes, types and order of an SMPL file."""
    draw = np.random.default_rng(0)
    weights, regressor = draw.random((vertices, joints)), draw.random((joints, vertices))
    parents = np.array([*PARENTS, *range(24, joints)])[:joints]
    return {
        "v_template": draw.normal(size=(vertices, 3)),
        "shapedirs": draw.normal(size=(vertices, 3, shapes)) * 0.01,
        "posedirs": draw.normal(size=(vertices, 3, 9 * (joints - 1))) * 0.01,
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "f": draw.integers(0, vertices, size=(100, 3)).astype(np.uint32),
        "kintree_table": np.stack([parents, np.arange(joints)]).astype(np.int64).astype(np.uint32),
    }


def as_stored_by_v10(data: dict[str, np.ndarray], protocol: int) -> bytes:
    """v1.0: chumpy objects and a sparse regressor, pickled while modules of those names are there."""

    class Ch:
        pass

    class csc_matrix:
        pass

    def record(cls: type, module: str, state: dict) -> object:
        cls.__module__, cls.__qualname__ = module, cls.__name__
        made = cls()
        made.__dict__.update(state)
        return made

    columns = data["J_regressor"].T
    column, row = np.nonzero(columns)
    starts = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=len(columns)))])
    sparse = {
        "_shape": data["J_regressor"].shape,
        "data": columns[column, row],
        "indices": row.astype(np.int32),
        "indptr": starts.astype(np.int32),
        "maxprint": 50,
        "format": "csc",
    }
    stored = {
        **data,
        "shapedirs": record(Ch, "chumpy.ch", {"x": data["shapedirs"], "_dirty_vars": set(), "_itr": None}),
        "v_template": record(Ch, "chumpy.ch", {"x": data["v_template"]}),
        "J_regressor": record(csc_matrix, "scipy.sparse.csc", sparse),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }
    names = {"chumpy.ch": Ch, "scipy.sparse.csc": csc_matrix}
    before = {name: sys.modules.get(name) for name in (*names, "chumpy", "scipy", "scipy.sparse")}
    try:
        for name in before:
            sys.modules[name] = types.ModuleType(name)
        for name, cls in names.items():
            setattr(sys.modules[name], cls.__name__, cls)
        return pickle.dumps(stored, protocol=protocol)
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def write(path, data: dict[str, np.ndarray]):
    np.savez(path, **data)
    return path


def check_same(body: Body, data: dict[str, np.ndarray]):
    """The body poses as smplx does with the same numbers, up to where the origin is."""
    import smplx
    from smplx.utils import Struct
    from smplx.vertex_ids import vertex_ids

    padded = np.concatenate([data["shapedirs"][..., :10], np.zeros((len(data["v_template"]), 3, 290))], axis=-1)
    ids = dict.fromkeys(vertex_ids["smplh"], 0)
    model = smplx.SMPLLayer("", data_struct=Struct(**{**data, "shapedirs": padded}), vertex_ids=ids)
    generator = torch.Generator().manual_seed(1)
    rotations = torch.linalg.qr(torch.randn(2, 24, 3, 3, generator=generator)).Q
    shape = torch.randn(2, 10, generator=generator)
    expected = model(betas=shape, global_orient=rotations[:, :1], body_pose=rotations[:, 1:])
    posed = body(rotations, expected.joints[:, 0], shape)
    torch.testing.assert_close(posed.vertices, expected.vertices, atol=1e-4, rtol=0)
    torch.testing.assert_close(posed.joints, expected.joints[:, :24], atol=1e-4, rtol=0)
    assert body.rest_vertices[:, 1].min() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("shapes", (10, 300))
def test_an_npz_file_poses_as_smplx_does(tmp_path, shapes):
    data = smpl(shapes=shapes)
    extras = {"bs_type": np.array("lrotmin"), "J": np.zeros((24, 3))}
    check_same(load_body(write(tmp_path / "anything.npz", {**data, **extras})), data)


@pytest.mark.parametrize("protocol", (0, 2, 4))
def test_a_v10_pickle_needs_neither_chumpy_nor_scipy(tmp_path, protocol):
    data, path = smpl(), tmp_path / "basicModel_f_lbs_10_207_0_v1.0.0.pkl"
    path.write_bytes(as_stored_by_v10(data, protocol))
    assert "chumpy" not in sys.modules
    check_same(load_body(path), data)
    assert "chumpy" not in sys.modules


def test_a_selection_of_chumpy_is_evaluated():
    whole, chosen, inner = Inert(), Inert(), np.arange(12.0).reshape(4, 3)
    whole.name, whole.state = "chumpy.ch.Ch", {"x": inner}
    chosen.name = "chumpy.reordering.Select"
    chosen.state = {"a": whole, "idxs": np.arange(6, 12), "preferred_shape": (2, 3)}
    np.testing.assert_array_equal(_array("body.pkl, array 'shapedirs'", chosen), inner[2:])
    chosen.state["idxs"] = np.arange(6, 13)
    with pytest.raises(UserError, match="'shapedirs': is stored as chumpy.reordering.Select, which cannot be read"):
        _array("body.pkl, array 'shapedirs'", chosen)


def test_a_v11_pickle_holds_plain_arrays(tmp_path):
    data, path = smpl(shapes=300), tmp_path / "SMPL_NEUTRAL.PKL"
    path.write_bytes(pickle.dumps(data, protocol=2))
    check_same(load_body(path), data)


def test_a_mesh_of_smpls_size_has_smpls_landmarks(tmp_path):
    body = load_body(write(tmp_path / "body.npz", smpl(vertices=6890)))
    from smplx.vertex_ids import vertex_ids

    assert body._smpl.vertex_joint_selector.extra_joints_idxs[0] == vertex_ids["smplh"]["nose"]


def test_the_free_body_goes_through_a_file_unchanged(tmp_path):
    free = _free_arrays("light")
    data = smpl(vertices=len(free.v_template)) | {
        "posedirs": np.zeros((len(free.v_template), 3, 207)),
        "f": free.faces,
        **{name: getattr(free, name) for name in ("v_template", "shapedirs", "J_regressor", "weights")},
    }
    body = load_body(write(tmp_path / "free.npz", data))
    torch.testing.assert_close(body.rest_vertices, Body.free("light").rest_vertices, atol=1e-6, rtol=0)
    assert torch.equal(body.face_parts, Body.free("light").face_parts)


RELATIVES = {52: "is an SMPL-H body with 52 joints", 55: "is an SMPL-X body with 55 joints", 16: "is a MANO body"}


@pytest.mark.parametrize(("joints", "message"), RELATIVES.items())
def test_the_relatives_of_smpl_are_named(tmp_path, joints, message):
    with pytest.raises(UserError, match=f"{message}.*not SMPL with 24; give an SMPL file"):
        load_body(write(tmp_path / "model.npz", smpl(joints=joints)))


def changed(**changes) -> dict[str, np.ndarray]:
    return smpl() | changes


def with_nan() -> dict[str, np.ndarray]:
    data = smpl()
    data["weights"][7, 3] = np.nan
    return data


WRONG = {
    "missing": ({key: value for key, value in smpl().items() if key != "weights"}, "it has no weights"),
    "motion": ({"poses": np.zeros((10, 72)), "trans": np.zeros((10, 3))}, "is not an SMPL body: it has no v_template"),
    "nan": (with_nan(), "array 'weights': value nan at vertex 7, joint 3"),
    "template": (
        changed(v_template=np.zeros((VERTICES, 2))),
        r"\(v_template\): expected shape \[V 3\] with V=60, got \[60, 2\]",
    ),
    "scalar": (changed(v_template=np.float64(1)), r"\(v_template\): expected shape \[V 3\].*got \[\]"),
    "flat weights": (changed(weights=np.float64(1)), r"\(weights\): expected shape \[V J\], got \[\]"),
    "regressor": (
        changed(J_regressor=np.zeros((24, 59))),
        r"\(J_regressor\): expected shape \[J V\] with V=60, J=24, got \[24, 59\]",
    ),
    "faces": (changed(f=np.full((3, 3), VERTICES)), "'f': has no faces, or some with vertices outside 0..59"),
    "no faces": (changed(f=np.zeros((0, 3), dtype=int)), "'f': has no faces, or"),
    "tree": (changed(kintree_table=np.zeros((2, 24))), "'kintree_table': is not SMPL's tree"),
    "shapes": (smpl(shapes=4), "has 4 shape directions, fewer than 10"),
    "text": (changed(v_template=np.full((VERTICES, 3), "a")), "'v_template': holds <U1, not numbers"),
}


@pytest.mark.parametrize(("data", "message"), WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("suffix", (".npz", ".pkl"))
def test_what_is_wrong_is_said(tmp_path, data, message, suffix):
    path = tmp_path / f"body{suffix}"
    if suffix == ".npz":
        write(path, data)
    else:
        path.write_bytes(pickle.dumps({key: np.asarray(value) for key, value in data.items()}))
    with pytest.raises(UserError, match=message) as caught:
        load_body(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_a_pickle_that_is_no_dictionary_is_refused(tmp_path):
    path = tmp_path / "body.pkl"
    path.write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(UserError, match="holds a list, not the dictionary of an SMPL body"):
        load_body(path)


def test_values_of_other_kinds_are_refused(tmp_path):
    path = tmp_path / "body.pkl"
    path.write_bytes(pickle.dumps(smpl() | {"weights": "all"}))
    with pytest.raises(UserError, match="array 'weights': is stored as str, which cannot be read"):
        load_body(path)


def test_a_damaged_sparse_matrix_is_refused(tmp_path):
    path = tmp_path / "body.pkl"
    content = as_stored_by_v10(smpl(), 2).replace(b"indptr", b"indptx")
    path.write_bytes(content)
    with pytest.raises(UserError, match="array 'J_regressor': is not an intact sparse matrix"):
        load_body(path)


def test_code_in_a_body_file_does_not_run(tmp_path):
    path, harmed = tmp_path / "SMPL_MALE.pkl", tmp_path / "harmed"
    path.write_bytes(b"cos\nsystem\n(S'touch " + str(harmed).encode() + b"'\ntR.")
    with pytest.raises(UserError, match="asks for os.system"):
        load_body(path)
    assert not harmed.exists()


def test_objects_in_an_npz_file_are_refused(tmp_path):
    path = write(tmp_path / "body.npz", changed(J_regressor=np.array([{}], dtype=object)))
    with pytest.raises(UserError, match="array 'J_regressor'.*holds Python objects, which are never loaded"):
        load_body(path)


def test_a_header_that_claims_more_than_the_file_holds_is_refused(tmp_path):
    path = write(tmp_path / "body.npz", smpl())
    with zipfile.ZipFile(path) as packed:
        content = packed.read("weights.npy")
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("weights.npy", content.replace(b"(60, 24)", b"(9999,9)"))
    with pytest.raises(UserError, match=r"array 'weights'.*claims shape \[9999, 9\]"):
        load_body(path)


@pytest.mark.parametrize("name", ("body.pkl", "body.npz"))
def test_a_page_that_was_saved_as_a_body_is_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"<!DOCTYPE html><html>Please sign in</html>")
    with pytest.raises(UserError, match="is a web page that was saved instead of the file"):
        load_body(path)


@pytest.mark.parametrize("name", ("body.obj", "body"))
def test_other_suffixes_are_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"v 0 0 0")
    with pytest.raises(UserError, match=r"give a \.npz or \.pkl"):
        load_body(path)


def test_a_missing_file_is_named(tmp_path):
    for name in ("none.npz", "none.pkl"):
        with pytest.raises(UserError, match=rf"{name}: cannot be read \(No such file"):
            load_body(tmp_path / name)
