"""Deformation transfer against float64 closed forms: affine maps, rotations, and linearity."""

from __future__ import annotations

import torch
from scipy.spatial.transform import Rotation

from ggavatar.geometry.deformation_transfer import nearest_rotation, transfer_blendshapes
from ggavatar.geometry.transforms import quaternion_to_matrix
from ggavatar.head.model import HeadModel


def test_a_rotated_mesh_turns_every_triangle_by_that_rotation(toy_head: HeadModel) -> None:
    head = toy_head.to("cpu", torch.float64)
    turn = torch.from_numpy(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix())
    shift = torch.tensor([0.01, 0.02, -0.03], dtype=torch.float64)
    moved = head.template @ turn.T + shift - head.template
    linear, offset, quats = transfer_blendshapes(head.template, head.faces, moved[:, :, None]).at(
        torch.ones(1).double()
    )
    assert torch.allclose(linear, turn.expand_as(linear), atol=1e-9)
    assert torch.allclose(offset, shift.expand_as(offset), atol=1e-9)
    assert torch.allclose(quaternion_to_matrix(quats), turn.expand_as(linear), atol=1e-9)


def test_corners_and_centroid_go_where_the_mesh_goes(toy_head: HeadModel) -> None:
    head = toy_head.to("cpu", torch.float64)
    changes = transfer_blendshapes(head.template, head.faces, head.expression_basis)
    for unit in torch.eye(3).double():
        linear, offset, _ = changes.at(unit)
        wanted = (head.template + head.expression_basis @ unit)[head.faces]
        corners = head.template[head.faces]
        got = torch.einsum("fij,fcj->fci", linear, corners) + offset[:, None]
        assert torch.allclose(got, wanted, atol=1e-9)
    distance = head.expression_basis[head.faces].mean(1).norm(dim=1)
    assert torch.equal(changes.displacement, distance)


def test_blends_are_linear_and_nothing_is_the_identity(toy_head: HeadModel) -> None:
    changes = transfer_blendshapes(toy_head.template, toy_head.faces, toy_head.expression_basis)
    still = changes.at(torch.zeros(3))
    assert torch.equal(still[0], torch.eye(3).expand_as(still[0])) and not still[1].any()
    assert torch.equal(still[2], torch.tensor([1.0, 0.0, 0.0, 0.0]).expand_as(still[2]))
    one, two = torch.tensor([0.3, 0.0, -0.2]), torch.tensor([0.1, 0.7, 0.4])
    for base, a, b, both in zip(still, changes.at(one), changes.at(two), changes.at(one + two), strict=True):
        assert torch.allclose(both - base, (a - base) + (b - base), atol=1e-6)


def test_triangles_without_area_are_only_translated() -> None:
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0, 0.1, 0]])
    shape = torch.tensor([[0.0, 0, 0.03], [0, 0, 0.03], [0, 0, 0.03], [0.01, 0, 0]])
    changes = transfer_blendshapes(points, torch.tensor([[0, 1, 2], [0, 1, 3]]), shape[:, :, None])
    assert not changes.table[0, :9].any() and not changes.table[0, 12:].any()
    assert torch.allclose(changes.table[0, 9:12, 0], torch.tensor([0.0, 0.0, 0.03]))
    assert torch.isfinite(changes.table).all()
    more = changes.with_static_faces(2)
    assert torch.equal(more.table[:2], changes.table) and not more.table[2:].any() and not more.displacement[2:].any()


def test_nearest_rotation_is_that_of_the_polar_decomposition() -> None:
    """Reference: U Vᵀ of the singular value decomposition in float64."""
    generator = torch.Generator().manual_seed(0)
    matrices = torch.eye(3).double() + 0.3 * torch.randn(50, 3, 3, generator=generator, dtype=torch.float64)
    matrices = matrices[torch.linalg.det(matrices) > 0.2]
    left, _, right = torch.linalg.svd(matrices)
    assert len(matrices) > 30
    assert torch.allclose(nearest_rotation(matrices), left @ right, atol=1e-5)
