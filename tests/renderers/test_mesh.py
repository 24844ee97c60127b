import pytest
import torch

from renderers.checks import ShapeError, UserError
from renderers.mesh import Mesh

SQUARE = torch.tensor([[0, 1, 2], [0, 2, 3]])


def passages(mesh: Mesh) -> dict[tuple[int, ...], list[str]]:
    """Edge (channel, low, high) -> how its faces pass along it."""
    faces = len(mesh.faces)
    words = [f"up {face}" for face in range(faces)] + [f"down {face}" for face in range(faces)]
    return {
        (channel, *ends): sorted(words[face] for face in along if face < 2 * faces)
        for channel, ends, along in zip(
            mesh.edge_channels.tolist(), mesh.edges.tolist(), mesh.edge_faces.tolist(), strict=True
        )
    }


def test_neighbours_pass_their_common_edge_in_opposite_directions():
    assert passages(Mesh.build(SQUARE)) == {
        (0, 0, 1): ["up 0"],
        (0, 0, 2): ["down 0", "up 1"],
        (0, 0, 3): ["down 1"],
        (0, 1, 2): ["up 0"],
        (0, 2, 3): ["up 1"],
    }


def test_a_flipped_neighbour_passes_the_common_edge_the_same_way():
    assert passages(Mesh.build(torch.tensor([[0, 1, 2], [0, 3, 2]])))[0, 0, 2] == ["down 0", "down 1"]


def test_an_edge_between_parts_is_open_in_both():
    mesh = Mesh.build(SQUARE, torch.tensor([0, 1]))
    assert mesh.channels == 2
    assert passages(mesh)[0, 0, 2] == ["down 0"] and passages(mesh)[1, 0, 2] == ["up 1"]


def test_any_number_of_faces_meets_at_an_edge():
    book = torch.tensor([[0, 1, page] for page in range(2, 302)])
    mesh = Mesh.build(book)
    assert passages(mesh)[0, 0, 1] == sorted(f"up {page}" for page in range(300))
    assert mesh.edges.shape == (601, 2)


def test_unused_vertices_and_parts_are_allowed():
    mesh = Mesh.build(SQUARE + 5, torch.tensor([0, 3]))
    assert (mesh.vertices, mesh.channels) == (9, 4)
    assert mesh.edges.min() == 5


def test_a_mesh_may_have_no_faces_and_more_channels_than_parts():
    mesh = Mesh.build(SQUARE[:0], channels=3)
    assert (len(mesh.faces), len(mesh.edges), mesh.vertices, mesh.channels) == (0, 0, 0, 3)
    assert Mesh.build(SQUARE, torch.tensor([0, 4]), channels=3).channels == 5


@pytest.mark.parametrize(
    ("faces", "parts", "error", "words"),
    [
        (-SQUARE, None, UserError, r"Mesh.build\(faces\): expected whole numbers, 0 to below"),
        (SQUARE + 0.9, None, UserError, "whole numbers"),
        (SQUARE + 2**40, None, UserError, "whole numbers"),
        (SQUARE, torch.tensor([0, -1]), UserError, r"Mesh.build\(parts\): expected whole numbers"),
        (SQUARE, torch.tensor([0, 2000]), UserError, "to below 1024"),
        (SQUARE, torch.tensor([0, 1, 2]), ShapeError, r"expected shape \[F\] with F=2, got \[3\]"),
        (SQUARE[0], None, ShapeError, r"expected shape \[F 3\]"),
    ],
)
def test_refuses_what_is_no_mesh(faces, parts, error, words):
    with pytest.raises(error, match=words):
        Mesh.build(faces, parts)
