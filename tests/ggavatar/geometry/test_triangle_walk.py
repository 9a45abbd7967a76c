"""Walks over triangles: straight lines on parallelograms, and what holds on any mesh whatever the shift.

References: the affine map of a sheared grid, in which a walk without decay is a straight line; the definition of a
neighbor, by search over all edges; and invariants on random, broken and degenerate meshes.
"""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from ggavatar.geometry.triangle_walk import NO_FACE, Neighbors, neighbors, walk
from ggavatar.head.model import HeadModel

SIZE = 8
"""Cells along a side of the grid."""


def grid(size: int = SIZE) -> tuple[Tensor, Tensor]:
    """A sheared grid, each cell cut into two triangles alike: vertices (float64) and faces."""
    row, column = torch.meshgrid(torch.arange(size + 1), torch.arange(size + 1), indexing="ij")
    axes = torch.tensor([[1.0, 0.2, 0.3], [0.4, 0.9, -0.2]], dtype=torch.float64)
    vertices = torch.stack((column.flatten(), row.flatten()), dim=1).double() @ axes
    low = (torch.arange(size)[:, None] * (size + 1) + torch.arange(size)).flatten()
    first = torch.stack((low, low + 1, low + size + 1), dim=1)
    second = torch.stack((low + 1, low + size + 2, low + size + 1), dim=1)
    return vertices, torch.cat((first, second))


def points_at(vertices: Tensor, faces: Tensor, face: Tensor, weights: Tensor) -> Tensor:
    return (weights[:, :, None] * vertices[faces[face]]).sum(1)


def drawn_points(count: int, faces: int, seed: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    face = torch.randint(faces, (count,), generator=generator)
    return face, weights / weights.sum(1, keepdim=True)


def drawn_shift(count: int, length: float, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed + 1)
    uv = length * (2 * torch.rand(count, 2, dtype=torch.float64, generator=generator) - 1)
    return torch.cat((uv, -uv.sum(1, keepdim=True)), dim=1)


def valid(weights: Tensor) -> bool:
    return bool((weights >= 0).all() and ((weights.sum(1) - 1).abs() < 1e-12).all())


def components(mesh: Neighbors) -> list[int]:
    """The least triangle that can be reached from each, by search."""
    label = list(range(len(mesh.face)))
    changed = True
    while changed:
        changed = False
        for face, across in enumerate(mesh.face.tolist()):
            for other in (one for one in across if one != NO_FACE):
                low = min(label[face], label[other])
                changed |= label[face] != low or label[other] != low
                label[face] = label[other] = low
    return label


def assert_neighbors(faces: Tensor, mesh: Neighbors) -> None:
    """Mutual, and the shared vertices are the same two, reversed."""
    listed = faces.tolist()
    for face in range(len(listed)):
        for edge in range(3):
            other, there = int(mesh.face[face, edge]), int(mesh.edge[face, edge])
            assert (other == NO_FACE) == (there == NO_FACE)
            if other != NO_FACE:
                assert (int(mesh.face[other, there]), int(mesh.edge[other, there])) == (face, edge)
                ends = listed[face][(edge + 1) % 3], listed[face][(edge + 2) % 3]
                assert ends == (listed[other][(there + 2) % 3], listed[other][(there + 1) % 3])


def test_neighbors_of_a_head_by_search(toy_head: HeadModel) -> None:
    mesh = neighbors(toy_head.faces)
    assert_neighbors(toy_head.faces, mesh)
    assert (mesh.face != NO_FACE).all()  # the egg is closed


def test_neighbors_of_a_grid_end_at_its_border() -> None:
    _, faces = grid()
    mesh = neighbors(faces)
    assert_neighbors(faces, mesh)
    assert int((mesh.face == NO_FACE).sum()) == 4 * SIZE


@pytest.mark.parametrize(
    "faces",
    [
        [[0, 1, 2]],
        [[0, 1, 2], [0, 1, 3]],  # oriented against each other
        [[0, 1, 2], [1, 0, 3], [1, 0, 4]],  # three at an edge
        [[0, 0, 1]],  # an edge without length, and a triangle beside itself
        [[0, 1, 2], [0, 1, 2], [2, 1, 0]],  # the same twice
    ],
)
def test_edges_without_exactly_one_triangle_across_are_walls(faces: list[list[int]]) -> None:
    shared = torch.tensor(faces)
    mesh = neighbors(shared)
    assert_neighbors(shared, mesh)
    assert (mesh.face == NO_FACE).all()
    face, weights = drawn_points(50, len(faces), 3)
    ends, moved = walk(mesh, face, weights, drawn_shift(50, 3.0, 3))
    assert torch.equal(ends, face) and valid(moved)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.05, 0.5, 2.0]))
def test_without_decay_a_walk_on_parallelograms_is_a_straight_line(seed: int, length: float) -> None:
    """P + Σ s_i V_i, for all walks that stay inside; there and back is where it began."""
    vertices, faces = grid()
    mesh = neighbors(faces)
    face, weights = drawn_points(40, len(faces), seed)
    shift = drawn_shift(40, length, seed)
    begin = points_at(vertices, faces, face, weights)
    motion = (shift[:, :, None] * vertices[faces[face]]).sum(1)
    cells = torch.linalg.lstsq(vertices[[1, SIZE + 1]].T, (begin + motion).T).solution
    inside = ((cells > 0) & (cells < SIZE)).all(0)
    ends, moved = walk(mesh, face, weights, shift, decay=1.0)
    found = points_at(vertices, faces, ends, moved)
    assert torch.allclose(found[inside], (begin + motion)[inside], atol=1e-12) and valid(moved)
    back = torch.linalg.lstsq((vertices[faces[ends]][:, :2] - vertices[faces[ends]][:, 2:]).mT, -motion).solution
    returned = walk(mesh, ends, moved, torch.cat((back, -back.sum(1, keepdim=True)), dim=1), decay=1.0)
    assert torch.allclose(points_at(vertices, faces, *returned)[inside], begin[inside], atol=1e-11)


def test_a_walk_that_leaves_the_mesh_ends_on_its_border() -> None:
    vertices, faces = grid()
    mesh = neighbors(faces)
    face, weights = drawn_points(300, len(faces), 1)
    ends, moved = walk(mesh, face, weights, drawn_shift(300, 40.0, 1), decay=1.0)
    on_wall = ((moved == 0) & (mesh.face[ends] == NO_FACE)).any(1)
    assert valid(moved) and int(on_wall.sum()) > 280
    cells = torch.linalg.lstsq(vertices[[1, SIZE + 1]].T, points_at(vertices, faces, ends, moved).T).solution
    borders = torch.minimum(cells.abs(), (cells - SIZE).abs()).amin(0)
    assert (borders[on_wall] < 1e-12).all()


@pytest.mark.parametrize("decay", [1.0, 0.9])
def test_walks_through_vertices_and_along_edges_arrive(decay: float) -> None:
    """From the corners and edge centers of a cell in the middle, in the directions of the grid."""
    vertices, faces = grid()
    mesh = neighbors(faces)
    middle = SIZE * SIZE // 2 + SIZE // 2
    starts = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5]], dtype=torch.float64)
    ways = [[1.0, -1, 0], [0, 1, -1], [-1, 0, 1], [2, -1, -1], [-1, 2, -1], [1, 1, -2], [-2, 1, 1]]
    shifts = torch.tensor(ways, dtype=torch.float64)
    weights, shift = starts.repeat_interleave(len(shifts), 0), shifts.repeat(len(starts), 1)
    face = torch.full((len(weights),), middle)
    ends, moved = walk(mesh, face, weights, shift, decay)
    begin = points_at(vertices, faces, face, weights)
    motion = (shift[:, :, None] * vertices[faces[face]]).sum(1)
    traveled = points_at(vertices, faces, ends, moved) - begin
    assert valid(moved)
    if decay == 1:
        assert torch.allclose(traveled, motion, atol=1e-12)
    along = (traveled * motion).sum(1) / motion.square().sum(1)
    assert torch.allclose(traveled, along[:, None] * motion, atol=1e-12) and (along > 0.6).all()


def test_at_a_corner_the_way_that_leads_on_is_taken() -> None:
    """Both other weights would fall below 0 at once; behind the first edge there is nothing."""
    for faces in ([[0, 1, 2], [1, 0, 3]], [[0, 1, 2], [0, 2, 3]]):
        mesh = neighbors(torch.tensor(faces))
        start, shift = torch.tensor([[1.0, 0, 0]]), torch.tensor([[0.4, -0.2, -0.2]])
        ends, _ = walk(mesh, torch.zeros(1, dtype=torch.int64), start, shift, decay=1.0)
        assert ends.tolist() == [1]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12), st.sampled_from([1e-9, 0.1, 3.0, 1e6]))
def test_any_mesh_any_shift(seed: int, count: int, length: float) -> None:
    """Random triangles of few vertices: edges of all kinds, triangles with one vertex twice, several components."""
    generator = torch.Generator().manual_seed(seed)
    faces = torch.randint(7, (count, 3), generator=generator)
    mesh = neighbors(faces)
    assert_neighbors(faces, mesh)
    face, weights = drawn_points(30, count, seed)
    weights[:6] = torch.eye(3, dtype=torch.float64).repeat(2, 1)
    weights[6:9] = torch.tensor([0.5, 0.5, 0.0], dtype=torch.float64)
    label = torch.tensor(components(mesh))
    ends, moved = walk(mesh, face, weights, drawn_shift(30, length, seed))
    assert valid(moved) and torch.equal(label[ends], label[face])


def test_no_shift_and_shifts_that_are_not_numbers_move_nothing() -> None:
    _, faces = grid()
    face, weights = drawn_points(4, len(faces), 5)
    shift = torch.zeros_like(weights)
    shift[1, 0], shift[2, 1], shift[3, 2] = torch.nan, torch.inf, -torch.inf
    ends, moved = walk(neighbors(faces), face, weights, shift)
    assert torch.equal(ends, face) and torch.equal(moved, weights)


def test_inside_a_triangle_the_shift_is_added() -> None:
    _, faces = grid()
    face, weights = drawn_points(100, len(faces), 7)
    shift = drawn_shift(100, 0.5, 7)
    shift *= (0.9 * (weights / shift.neg().clamp_min(1e-9)).amin(1).clamp_max(1))[:, None]
    ends, moved = walk(neighbors(faces), face, weights, shift)
    assert torch.equal(ends, face) and torch.allclose(moved, weights + shift, atol=1e-15)


def test_at_a_crossing_a_tenth_of_the_rest_is_lost() -> None:
    """From the center of a cell's first triangle through its long edge: 1/3 up to it, and 0.9 of what is left."""
    vertices, faces = grid()
    start = torch.full((1, 3), 1 / 3, dtype=torch.float64)
    shift = torch.tensor([[-0.6, 0.3, 0.3]], dtype=torch.float64)
    face = torch.tensor([SIZE * 3 + 3])
    ends, moved = walk(neighbors(faces), face, start, shift)
    motion = (shift[:, :, None] * vertices[faces[face]]).sum(1)
    share = (1 / 3) / 0.6
    expected = points_at(vertices, faces, face, start) + (share + 0.9 * (1 - share)) * motion
    assert ends.tolist() == [SIZE * SIZE + SIZE * 3 + 3]
    assert torch.allclose(points_at(vertices, faces, ends, moved), expected, atol=1e-14)


def test_inputs_are_not_changed() -> None:
    _, faces = grid()
    face, weights = drawn_points(20, len(faces), 9)
    copies = face.clone(), weights.clone()
    walk(neighbors(faces), face, weights, drawn_shift(20, 2.0, 9))
    assert torch.equal(face, copies[0]) and torch.equal(weights, copies[1])
