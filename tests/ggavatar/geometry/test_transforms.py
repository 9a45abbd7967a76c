"""Geometry against group axioms, scipy's Rotation and closed forms, over scales from 1e-7 to 10.

Also covers `ggavatar/geometry/triangles_kernel.py`.
"""

from __future__ import annotations

import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.geometry.transforms import (
    axis_angle_to_matrix,
    invert_rigid,
    look_at,
    matrix_to_axis_angle,
    matrix_to_quaternion,
    matrix_to_rotation_6d,
    project,
    quaternion_multiply,
    quaternion_to_matrix,
    rigid,
    rotation_6d_to_matrix,
)
from ggavatar.geometry.triangles import triangle_frames, triangle_frames_torch

COUNT = 500


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def rotations(seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(Rotation.random(COUNT, random_state=seed).as_matrix())


@pytest.mark.parametrize("scale", [1e-9, 1e-7, 1e-4, 0.1, 1.0, 3.0])
def test_axis_angle_against_scipy(scale: float) -> None:
    vectors = random(COUNT, 3) * scale
    expected = torch.from_numpy(Rotation.from_rotvec(vectors.numpy()).as_matrix())
    assert torch.allclose(axis_angle_to_matrix(vectors), expected, atol=1e-12)


def test_axis_angle_gradient_is_finite_at_zero() -> None:
    vectors = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(axis_angle_to_matrix, vectors)


def test_matrix_to_axis_angle_round_trip() -> None:
    near_half_turn = random(COUNT, 3)
    near_half_turn *= (math.pi - 1e-4) / near_half_turn.norm(dim=-1, keepdim=True)
    for vectors in (
        random(COUNT, 3, seed=1) * 0.5,
        random(COUNT, 3, seed=2) * 1e-9,
        near_half_turn,
        torch.zeros(1, 3, dtype=torch.float64),
    ):
        matrices = axis_angle_to_matrix(vectors)
        assert torch.allclose(axis_angle_to_matrix(matrix_to_axis_angle(matrices)), matrices, atol=1e-7)


def test_quaternions_against_scipy() -> None:
    matrices = rotations()
    quats = matrix_to_quaternion(matrices)
    expected = torch.from_numpy(Rotation.from_matrix(matrices.numpy()).as_quat())[:, [3, 0, 1, 2]]
    assert torch.allclose((quats * expected).sum(-1).abs(), torch.ones(COUNT, dtype=torch.float64))
    assert torch.allclose(quaternion_to_matrix(quats * random(COUNT, 1)), matrices, atol=1e-12)


def test_quaternion_product_is_composition() -> None:
    left, right = random(COUNT, 4, seed=1), random(COUNT, 4, seed=2)
    composed = quaternion_to_matrix(left) @ quaternion_to_matrix(right)
    assert torch.allclose(quaternion_to_matrix(quaternion_multiply(left, right)), composed, atol=1e-12)


def test_quaternion_group_axioms() -> None:
    one = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).expand(COUNT, 4)
    a, b, c = (torch.nn.functional.normalize(random(COUNT, 4, seed=seed), dim=-1) for seed in (1, 2, 3))
    assert torch.allclose(quaternion_multiply(one, a), a) and torch.allclose(quaternion_multiply(a, one), a)
    left = quaternion_multiply(quaternion_multiply(a, b), c)
    assert torch.allclose(left, quaternion_multiply(a, quaternion_multiply(b, c)))
    conjugate = a * torch.tensor([1.0, -1, -1, -1], dtype=torch.float64)
    assert torch.allclose(quaternion_multiply(a, conjugate), one)


def test_rotation_6d_takes_the_first_two_rows() -> None:
    matrices = rotations(3)
    assert torch.equal(matrix_to_rotation_6d(matrices), matrices[:, :2].reshape(COUNT, 6))
    assert torch.allclose(rotation_6d_to_matrix(matrix_to_rotation_6d(matrices) * 2.5), matrices, atol=1e-12)
    identity = rotation_6d_to_matrix(torch.tensor([[1.0, 0, 0, 0, 1, 0]]))
    assert torch.equal(identity[0], torch.eye(3))


def test_rigid_inverse() -> None:
    transform = rigid(rotations()[0], random(3))
    assert torch.allclose(transform @ invert_rigid(transform), torch.eye(4, dtype=torch.float64), atol=1e-12)


def test_look_at_centers_the_target_upright() -> None:
    eye, target = torch.tensor([0.3, 0.2, 1.5]), torch.tensor([0.0, 0.1, 0.0])
    view = look_at(eye, target, torch.tensor([0.0, 1.0, 0.0]))
    intrinsics = torch.tensor([[500.0, 0, 128], [0, 500.0, 96], [0, 0, 1]])
    points = torch.stack((target, target + torch.tensor([0.0, 0.1, 0.0])))
    seen = project(points, intrinsics, view)
    assert torch.allclose(seen[0], torch.tensor([128.0, 96.0]), atol=1e-3)
    assert seen[1, 1] < 96 and abs(float(seen[1, 0]) - 128) < 1e-2
    assert torch.allclose(torch.linalg.det(view[:3, :3]), torch.tensor(1.0))
    assert torch.allclose(view[:3, :3] @ eye + view[:3, 3], torch.zeros(3), atol=1e-6)


def random_mesh(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    return random(3 * COUNT, 3, seed=seed), torch.arange(3 * COUNT).view(COUNT, 3)


@pytest.mark.parametrize("scale", [1e-7, 1.0, 10.0])
def test_triangle_frames_are_proper_rotations(scale: float) -> None:
    vertices, faces = random_mesh()
    frames = triangle_frames(vertices * scale, faces)
    identity = torch.eye(3, dtype=torch.float64).expand(COUNT, 3, 3)
    assert torch.allclose(frames.rotations @ frames.rotations.mT, identity, atol=1e-9)
    assert torch.allclose(torch.linalg.det(frames.rotations), torch.ones(COUNT, dtype=torch.float64))


def test_triangle_frames_follow_a_similarity() -> None:
    vertices, faces = random_mesh()
    rotation, shift, factor = rotations()[7], random(3, seed=9), 2.5
    before, after = triangle_frames(vertices, faces), triangle_frames(factor * vertices @ rotation.T + shift, faces)
    assert torch.allclose(after.rotations, rotation @ before.rotations, atol=1e-9)
    assert torch.allclose(after.scales, factor * before.scales)
    assert torch.allclose(after.centers, factor * before.centers @ rotation.T + shift)


@pytest.mark.parametrize(
    "corner", [[[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1, 2, 3]] * 3, [[0, 0, 0], [0, 0, 0], [0, 1, 0]]]
)
def test_degenerate_triangles_get_a_valid_rotation(corner: list[list[float]]) -> None:
    frames = triangle_frames(torch.tensor(corner, dtype=torch.float32), torch.tensor([[0, 1, 2]]))
    assert torch.allclose(torch.linalg.det(frames.rotations), torch.ones(1), atol=1e-5)
    assert torch.isfinite(frames.scales).all() and torch.isfinite(frames.centers).all()


@pytest.mark.parametrize("shape", ["random", "flat", "points"])
def test_compiled_triangle_frames_equal_the_twin(shape: str) -> None:
    generator = torch.Generator().manual_seed(3)
    vertices = torch.randn(300, 3, generator=generator) * 0.01
    faces = torch.stack([torch.randperm(300, generator=generator)[:3] for _ in range(500)])
    if shape == "flat":
        faces[:, 2] = faces[:, 1]
    elif shape == "points":
        faces[:, 1], faces[:, 2] = faces[:, 0], faces[:, 0]
    found, expected = triangle_frames(vertices, faces), triangle_frames_torch(vertices, faces)
    assert torch.allclose(found.centers, expected.centers, atol=1e-8)
    assert torch.allclose(found.scales, expected.scales, rtol=1e-5, atol=1e-8)
    unit = found.rotations.transpose(1, 2) @ found.rotations
    assert torch.allclose(unit, torch.eye(3).expand_as(unit), atol=1e-5)
    if shape == "random":  # without area any frame along the edge is right, and rounding chooses
        assert torch.allclose(found.rotations, expected.rotations, atol=2e-4)


def test_triangle_frames_pass_gradients_to_vertices() -> None:
    vertices = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]])
    assert torch.autograd.gradcheck(lambda v: tuple(triangle_frames(v, faces)), (vertices,))


def test_rotations_agree_with_kornia() -> None:
    """Reference: kornia.geometry.conversions, another implementation in torch."""
    from kornia.geometry import conversions

    axis_angle = torch.randn(200, 3, generator=torch.Generator().manual_seed(8), dtype=torch.float64)
    axis_angle *= 3.0 / axis_angle.norm(dim=1, keepdim=True).clamp_min(3.0)  # below a half turn, where signs agree
    matrices = axis_angle_to_matrix(axis_angle)
    torch.testing.assert_close(matrices, conversions.axis_angle_to_rotation_matrix(axis_angle), atol=2e-6, rtol=0)
    quats = matrix_to_quaternion(matrices)
    theirs = conversions.rotation_matrix_to_quaternion(matrices)
    torch.testing.assert_close(quats * (quats * theirs).sum(1, keepdim=True).sign(), theirs, atol=2e-6, rtol=0)
    torch.testing.assert_close(
        quaternion_to_matrix(quats), conversions.quaternion_to_rotation_matrix(quats), atol=1e-9, rtol=0
    )
