"""Normals and turns of vertices: by hand, by rotation, and on meshes without area. Reference: scipy's rotations."""

from __future__ import annotations

import math

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_to_matrix
from ggavatar.geometry.vertex_frames import RestFrames, vertex_normals, vertex_turns
from ggavatar.head.model import HeadModel


def sphere() -> tuple[Tensor, Tensor]:
    """An octahedron."""
    vertices = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    return vertices, torch.tensor(faces)


def test_normals_of_an_octahedron_are_its_corners() -> None:
    vertices, faces = sphere()
    assert torch.allclose(vertex_normals(vertices, faces), vertices, atol=1e-6)


def test_normals_are_weighted_by_area() -> None:
    """A roof of two rectangular triangles of areas 1/2 and 1 at a common edge."""
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -2.0]])
    faces = torch.tensor([[0, 1, 2], [1, 0, 3]])
    expected = torch.tensor([0.0, -2.0, 1.0])  # (0, 0, 1) · 1 and (0, −1, 0) · 2
    assert torch.allclose(vertex_normals(vertices, faces)[0], expected / expected.norm(), atol=1e-6)


def test_without_area_there_is_some_unit_vector_and_no_nan() -> None:
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5.0, 5, 5]], requires_grad=True)
    faces = torch.tensor([[0, 1, 2], [1, 1, 0]])
    normals = vertex_normals(vertices, faces)
    assert torch.allclose(normals.norm(dim=1), torch.ones(4))
    turns = vertex_turns(RestFrames.of(vertices, faces), vertices, faces)
    assert torch.allclose(turns, torch.tensor([1.0, 0, 0, 0]).expand(4, 4))
    (normals.sum() + turns.sum()).backward()
    assert vertices.grad is not None and vertices.grad.isfinite().all()


def test_normals_have_the_gradient_of_finite_differences() -> None:
    vertices, faces = sphere()
    generator = torch.Generator().manual_seed(0)
    rough = vertices.double() + 0.2 * torch.rand(6, 3, dtype=torch.float64, generator=generator)
    assert torch.autograd.gradcheck(lambda value: vertex_normals(value, faces), rough.requires_grad_())


def test_a_rigid_turn_is_the_turn_of_every_vertex(toy_head: HeadModel) -> None:
    """Up to 180°; the real part is never negative."""
    vertices, faces = toy_head.neutral(), toy_head.faces
    rest = RestFrames.of(vertices, faces)
    for angle in (0.0, 0.5, 1.5, 3.0):
        axis = torch.tensor([0.6, -0.64, 0.48])
        turned = vertices @ axis_angle_to_matrix(angle * axis).T + torch.tensor([0.1, 0.2, 0.3])
        turns = vertex_turns(rest, turned, faces)
        expected = Rotation.from_rotvec((angle * axis).numpy()).as_quat(canonical=True, scalar_first=True)
        assert torch.allclose(turns, torch.as_tensor(expected).float().expand_as(turns), atol=1e-4)


def test_turns_go_forward_not_backward(toy_head: HeadModel) -> None:
    """Eq. 4 as printed is the inverse: the turn takes normals at rest to posed ones, as on a bent strip."""
    vertices, faces = toy_head.neutral(), toy_head.faces
    angle = 2.0 * vertices[:, 1]
    bent = (axis_angle_to_matrix(torch.stack((angle, 0 * angle, 0 * angle), dim=1)) @ vertices[:, :, None]).squeeze(-1)
    turned = quaternion_to_matrix(vertex_turns(RestFrames.of(vertices, faces), bent, faces))
    expected = vertex_normals(bent, faces)
    forward = (turned @ vertex_normals(vertices, faces)[:, :, None]).squeeze(-1)
    assert (forward * expected).sum(1).amin() > math.cos(0.15)


def test_turns_are_means_by_area_at_rest() -> None:
    """A flat strip folded along its middle: at the fold, a third of the turn of the side twice as large."""
    vertices = torch.tensor([[0.0, 0, 0], [0, 1, 0], [-1.0, 0, 0], [2.0, 0, 0]])
    faces = torch.tensor([[0, 1, 2], [1, 0, 3]])
    rest = RestFrames.of(vertices, faces)
    assert torch.allclose(rest.areas, torch.tensor([0.5, 1.0]))
    posed = vertices.clone()
    posed[3] = torch.tensor([0.0, 0, -2.0])
    half = math.sqrt(0.5)
    expected = torch.tensor([1 * 0.5 + half * 1.0, 0.0, half * 1.0, 0.0])
    found = vertex_turns(rest, posed, faces)
    assert torch.allclose(found[0], expected / expected.norm(), atol=1e-6)
    assert torch.allclose(found[3], torch.tensor([half, 0, half, 0]), atol=1e-6)
