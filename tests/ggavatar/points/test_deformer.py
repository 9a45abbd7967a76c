"""The deformer's tangents against float64 autograd, and skinning against the head."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix
from ggavatar.head.model import HeadModel
from ggavatar.points.deformer import PointDeformation, PointDeformer
from ggavatar.points.rowwise import BLOCK, rowwise
from ggavatar.points.skinning import BoneTransforms, deform, deformed_normals, inverse_3x3

JOINTS, SHAPES = 4, 5


@pytest.fixture
def deformer() -> PointDeformer:
    """One that has learned something, in float64."""
    generator = torch.Generator().manual_seed(0)
    made = PointDeformer(SHAPES, JOINTS, generator).double()
    with torch.no_grad():
        for parameter in made.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
    return made


def random_bones(seed: int) -> BoneTransforms:
    generator = torch.Generator().manual_seed(seed)
    rotations = axis_angle_to_matrix(0.5 * torch.randn(JOINTS, 3, generator=generator, dtype=torch.float64))
    return BoneTransforms(rotations, 0.2 * torch.randn(JOINTS, 3, generator=generator, dtype=torch.float64))


def points(count: int) -> Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 0.5


def posed(deformer: PointDeformer, x: Tensor, coefficients: Tensor) -> tuple[Tensor, Tensor]:
    moved = deform(x, deformer.deformation(deformer.features(x), coefficients), random_bones(1), random_bones(2))
    return moved.points, moved.tangents


def test_the_jacobian_of_the_motion_is_exact(deformer: PointDeformer) -> None:
    x, coefficients = points(7), torch.linspace(-1, 1, SHAPES, dtype=torch.float64)
    _, tangents = posed(deformer, x, coefficients)
    for row in range(len(x)):
        jacobian = torch.autograd.functional.jacobian(
            lambda one: posed(deformer, one[None], coefficients)[0][0], x[row]
        )
        assert torch.allclose(tangents[row], jacobian.T, atol=1e-9)
        assert (jacobian - jacobian.diagonal().diag()).abs().max() > 1e-2


def test_normals_go_through_the_inverse_jacobian(deformer: PointDeformer) -> None:
    _, tangents = posed(deformer, points(9), torch.ones(SHAPES, dtype=torch.float64))
    normals = torch.nn.functional.normalize(points(9), dim=1)
    expected = torch.einsum("ni,nij->nj", normals, torch.linalg.inv(tangents.transpose(1, 2)))
    assert torch.allclose(deformed_normals(tangents, normals), torch.nn.functional.normalize(expected, dim=1))
    mirrored = tangents * torch.tensor([-1.0, 1.0, 1.0])[:, None]
    expected = torch.einsum("ni,nij->nj", normals, torch.linalg.inv(mirrored.transpose(1, 2)))
    assert torch.allclose(deformed_normals(mirrored, normals), torch.nn.functional.normalize(expected, dim=1))


def test_inverse() -> None:
    matrices = torch.randn(20, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(inverse_3x3(matrices), torch.linalg.inv(matrices))


def test_the_contracted_basis_is_the_basis(deformer: PointDeformer) -> None:
    x, coefficients = points(6), torch.linspace(-1, 2, SHAPES, dtype=torch.float64)
    motion, bases = deformer.deformation(deformer.features(x), coefficients), deformer.bases(x)
    assert torch.allclose(motion.correctives, torch.einsum("b,nbc->nc", coefficients, bases.blendshapes))
    assert torch.allclose(motion.weights, bases.weights) and torch.allclose(motion.offsets, bases.offsets)
    assert torch.allclose(bases.weights.sum(1), torch.ones(6, dtype=torch.float64))


def test_at_first_nothing_is_known() -> None:
    bases = PointDeformer(SHAPES, JOINTS, torch.Generator().manual_seed(0)).bases(points(5).float())
    assert not bases.blendshapes.any() and not bases.offsets.any()
    assert torch.equal(bases.weights, torch.full((5, JOINTS), 1 / JOINTS))


def test_weights_are_a_softmax_of_twenty_times_the_logits(deformer: PointDeformer) -> None:
    with torch.no_grad():
        deformer.skinning_weight.zero_()
        deformer.skinning_bias.copy_(torch.tensor([0.0, 0.05, 0.1, -0.1]))
    expected = torch.softmax(torch.tensor([0.0, 1.0, 2.0, -2.0], dtype=torch.float64), dim=0)
    assert torch.allclose(deformer.bases(points(3)).weights, expected.expand(3, -1))


def test_with_the_heads_own_bases_points_move_as_its_vertices(toy_head: HeadModel) -> None:
    head = toy_head.to("cpu", torch.float64)
    still = head.neutral_drive()
    turned = torch.tensor([[0.1, 0.0, 0.2], [0.0, 0.3, 0.0], [0.4, 0, 0], [0.1, 0, 0], [0, 0.2, 0]]).double()
    canonical = dataclasses.replace(still, expression=still.expression + 0.4, joint_rotations=0.3 * turned)
    drive = dataclasses.replace(still, expression=torch.tensor([1.0, -0.5, 0.2]).double(), joint_rotations=turned)

    def bones(one: Drive) -> BoneTransforms:
        return BoneTransforms(*head.joint_transforms(one))

    count = len(head.template)
    change = torch.einsum("vce,e->vc", head.expression_basis, drive.expression - canonical.expression)
    zero, none = torch.zeros(count, 3, 3).double(), torch.zeros(count, 3).double()
    motion = PointDeformation(none, zero, change, zero, head.skinning_weights, torch.zeros(count, 3, 5).double())
    moved = deform(head.vertices(canonical), motion, bones(canonical), bones(drive))
    assert torch.allclose(moved.points, head.vertices(drive), atol=1e-9)


def test_rowwise_is_the_function_itself(deformer: PointDeformer) -> None:
    """Values and all gradients, over two blocks, with rows that nobody looks at."""
    coefficients = torch.ones(SHAPES, dtype=torch.float64)
    looked_at = torch.arange(BLOCK + 60) % 3 == 0

    def run(by_rows: bool) -> list[Tensor]:
        deformer.zero_grad()
        x, shared = points(BLOCK + 60).requires_grad_(), coefficients.clone().requires_grad_()
        found = (
            rowwise(lambda rows, rest: posed(deformer, rows[0], rest[0]), [x], [shared], list(deformer.parameters()))
            if by_rows
            else posed(deformer, x, shared)
        )
        (found[0].square().sum(1) + found[1].sum((1, 2)))[looked_at].sum().backward()
        gradients = [parameter.grad.clone() for parameter in deformer.parameters()]
        return [*(value.detach() for value in found), x.grad, shared.grad, *gradients]

    expected = run(by_rows=False)
    for ours, theirs in zip(run(by_rows=True), expected, strict=True):
        assert torch.allclose(ours, theirs, atol=1e-10) and theirs.any()
