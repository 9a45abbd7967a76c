"""Points on a mesh in proportion to area; the cylinder of the mouth by hand."""

from __future__ import annotations

import dataclasses

import torch

from ggavatar.geometry.surface_sampling import sample_surface
from ggavatar.head.model import HeadModel
from ggavatar.head.mouth_interior import MouthCylinder


def test_points_lie_on_their_face_and_follow_area() -> None:
    """Two triangles of areas 3 : 1 in the plane z = 2."""
    vertices = torch.tensor([[0.0, 0, 2], [3, 0, 2], [0, 2, 2], [-1, 0, 2], [0, -2, 2]])
    faces = torch.tensor([[0, 1, 2], [0, 3, 4]])
    points, face, apart = sample_surface(vertices, faces, 400, torch.Generator().manual_seed(0))
    assert abs(int((face == 0).sum()) - 300) <= 1
    assert torch.equal(points[:, 2], torch.full((400,), 2.0))
    first = points[face == 0]
    assert (first[:, :2] >= -1e-6).all() and (first[:, 0] / 3 + first[:, 1] / 2 <= 1 + 1e-5).all()
    assert torch.allclose(first.mean(0), vertices[faces[0]].mean(0), atol=0.15)
    assert abs(apart - (4 / 400) ** 0.5) < 1e-6


def test_cylinder_is_read_off_the_lips(toy_head: HeadModel) -> None:
    lips = toy_head.template.clone()
    lips[:4] = torch.tensor([[-0.02, 0, 0.08], [0.03, 0.01, 0.07], [0.0, -0.01, 0.09], [0.0, 0.0, 0.06]])
    head = dataclasses.replace(toy_head, template=lips, regions={"lips": torch.arange(4)})
    mouth = MouthCylinder.of(head)
    assert mouth is not None
    assert abs(mouth.radius - 0.025) < 1e-7 and abs(mouth.half_height - 0.02) < 1e-7
    assert torch.allclose(mouth.center, torch.tensor([0.005, 0.0, 0.065]))
    inside = mouth.points(500, torch.Generator().manual_seed(0))
    assert not mouth.outside(inside).gt(1e-12).any()
    assert MouthCylinder.of(dataclasses.replace(toy_head, regions={})) is None
    assert MouthCylinder.of(dataclasses.replace(head, regions={**head.regions, "teeth": torch.arange(2)})) is None


def test_distance_from_the_cylinder_is_squared_and_has_finite_gradients() -> None:
    mouth = MouthCylinder(torch.zeros(3), 0.02, 0.01)
    points = torch.tensor(
        [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, -0.04, 0.0], [0.03, 0.03, 0.04]], requires_grad=True
    )
    apart = mouth.outside(points)
    assert torch.allclose(apart, torch.tensor([0.0, 0.03**2, 0.03**2, 0.03**2 + 0.02**2]), atol=1e-8)
    apart.sum().backward()
    assert points.grad is not None and torch.isfinite(points.grad).all()
    assert torch.allclose(points.grad[1], torch.tensor([0.06, 0.0, 0.0]), atol=1e-6)
