"""OBJ sequences: read by hand, the meshes are the body's."""

import numpy as np
import pytest

from refine.formats.obj import write_obj, write_obj_sequence
from refine.motion import cut
from refine.synthetic import ACTIONS, draw, perform
from renderers.checks import UserError


def parsed(path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [V 3] and faces [F 3], counted from 0."""
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:] for row in rows if row[0] == "v"], dtype=float)
    return vertices, np.array([row[1:] for row in rows if row[0] == "f"], dtype=int) - 1


@pytest.fixture
def walk(generator, rest_joints):
    assert "walk" in ACTIONS
    return perform(draw("walk", generator, 30.0), 70, rest_joints)


def test_each_frame_is_the_posed_body(tmp_path, free_body, walk):
    counted = []
    written = write_obj_sequence(tmp_path, walk, free_body, lambda: counted.append(1))
    assert [path.name for path in written][::69] == ["frame_00000.obj", "frame_00069.obj"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [path.name for path in written]
    assert len(written) == len(counted) == 70
    for frame in (0, 66):  # the second chunk too
        vertices, faces = parsed(written[frame])
        posed = free_body(walk.rotations[frame : frame + 1], walk.root[frame : frame + 1]).vertices[0]
        np.testing.assert_allclose(vertices, posed.numpy(), atol=1e-6)
        np.testing.assert_array_equal(faces, free_body.faces.numpy())


def test_one_mesh_is_the_first_frame_s(tmp_path, free_body, walk):
    write_obj(tmp_path / "a.obj", walk, free_body)
    vertices, faces = parsed(tmp_path / "a.obj")
    np.testing.assert_allclose(vertices, free_body(walk.rotations[:1], walk.root[:1]).vertices[0].numpy(), atol=1e-6)
    np.testing.assert_array_equal(faces, free_body.faces.numpy())


def test_faces_look_outwards(tmp_path, free_body, walk):
    [path] = write_obj_sequence(tmp_path, cut(walk, 0, 1 / 30), free_body)
    vertices, faces = parsed(path)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    volume = np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6
    assert 0.03 < volume < 0.12  # cubic metres; negative were the faces turned inwards


def test_endless_motions_are_refused(tmp_path, free_body, walk, monkeypatch):
    monkeypatch.setattr("refine.formats.obj.MOST", 69)
    with pytest.raises(UserError, match="has 70 frames, and at most 69 are written"):
        write_obj_sequence(tmp_path, walk, free_body)
