"""The point-based morphable shape: points follow the mesh, rigid motions are rigid, and bases blend as point by point.

References: `HeadModel.vertices` and `HeadPoses.hold_torso` at the vertices, rigid transforms in closed form, and a twin
in float64 that blends bases and skinning weights for every point.
"""

from __future__ import annotations

import dataclasses

import pytest
import torch
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_to_matrix, rigid
from ggavatar.geometry.uv_sampling import SurfaceSamples
from ggavatar.geometry.vertex_frames import vertex_normals
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.points.morphable_shape import (
    CorrectionBases,
    blend,
    coefficient_spread,
    pose_along_normals,
    pose_points,
    skinned_mesh,
    upright_quaternions,
)

DOUBLE = torch.float64


@pytest.fixture
def head(toy_head: HeadModel) -> HeadModel:
    """The egg in float64 with pose correctives, lids, and a torso below, on the root."""
    random = torch.Generator().manual_seed(5)
    count = len(toy_head.template)
    weights = toy_head.skinning_weights.clone()
    low = toy_head.template[:, 1] < -0.06
    weights[low] = weights[low] * 0.3 + 0.7 * torch.eye(5)[0]
    return dataclasses.replace(
        toy_head,
        skinning_weights=weights,
        pose_basis=0.01 * torch.randn(count, 3, 36, generator=random),
        eyelid_basis=0.01 * torch.randn(count, 3, 2, generator=random),
    ).to("cpu", DOUBLE)


def drive_of(head: HeadModel, seed: int = 1, still: bool = False) -> Drive:
    random = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=random, dtype=DOUBLE)

    joints = 0.3 * draw(5, 3)
    if still:
        joints[:2] = 0
    pose = rigid(axis_angle_to_matrix(0.4 * draw(3)), 0.1 * draw(3))
    return Drive(0.5 * draw(3), joints, draw(2).sigmoid(), 0.05 * draw(3), pose)


def places(head: HeadModel, count: int = 300) -> tuple[Tensor, Tensor, Tensor]:
    """Corners, weights and places at rest of points on the skin."""
    random = torch.Generator().manual_seed(0)
    face = torch.randint(len(head.faces), (count,), generator=random)
    weights = torch.rand(count, 3, generator=random, dtype=DOUBLE).softmax(1)
    return head.faces[face], weights, SurfaceSamples(face, weights).points(head.template, head.faces)


def test_the_skinned_mesh_is_the_head(head: HeadModel) -> None:
    drive = drive_of(head)
    assert torch.allclose(skinned_mesh(head, drive).vertices(head.template), head.vertices(drive), atol=1e-12)
    bare = dataclasses.replace(head, pose_basis=head.pose_basis[:, :, :0])
    assert torch.allclose(skinned_mesh(bare, drive).vertices(bare.template), bare.vertices(drive), atol=1e-12)
    assert not torch.allclose(bare.vertices(drive), head.vertices(drive), atol=1e-4)


def test_a_held_torso_is_that_of_the_head_poses(head: HeadModel) -> None:
    drives = [drive_of(head, seed, still=True) for seed in range(3)]
    poses = HeadPoses.of(head, drives)
    assert poses.in_camera
    held = skinned_mesh(head, drives[1], poses)
    expected = poses.hold_torso(head.vertices(drives[1]), drives[1], head)
    assert torch.allclose(held.vertices(head.template), expected, atol=1e-12)
    assert not torch.allclose(held.vertices(head.template), head.vertices(drives[1]), atol=1e-3)
    turned = HeadPoses.of(head, [drive_of(head, seed) for seed in range(3)])
    mesh, plain = skinned_mesh(head, drive_of(head), turned), skinned_mesh(head, drive_of(head))
    assert not turned.in_camera and torch.equal(mesh.offsets, plain.offsets)


def test_points_at_corners_are_vertices_for_every_drive(head: HeadModel) -> None:
    corners = head.faces
    one_hot = torch.eye(3, dtype=DOUBLE)[torch.arange(len(corners)) % 3]
    vertex = corners[torch.arange(len(corners)), torch.arange(len(corners)) % 3]
    for seed in range(3):
        drive = drive_of(head, seed, still=seed == 2)
        poses = HeadPoses.of(head, [drive_of(head, seed, still=True) for seed in (7, 8)]) if seed == 2 else None
        expected = head.vertices(drive)
        if poses is not None:
            expected = poses.hold_torso(expected, drive, head)
        posed = pose_points(skinned_mesh(head, drive, poses), corners, one_hot, head.template[vertex])
        assert torch.allclose(posed.means, expected[vertex], atol=1e-12)


def test_points_on_the_skin_stay_on_it(head: HeadModel) -> None:
    """Exact where no joint turns; else they differ by the product of two small changes over a triangle."""
    corners, weights, rest = places(head)
    drive = dataclasses.replace(drive_of(head), joint_rotations=torch.zeros(5, 3, dtype=DOUBLE))
    for one, limit in ((head.neutral_drive(), 1e-8), (drive, 1e-8), (drive_of(head), 4e-3)):
        means = pose_points(skinned_mesh(head, one), corners, weights, rest).means
        apart = (means - blend(head.vertices(one), corners, weights)).norm(dim=1)
        assert float(apart.max()) < limit
    assert float((blend(head.vertices(drive_of(head)), corners, weights) - rest).norm(dim=1).mean()) > 0.03


def test_contracting_on_the_mesh_is_blending_every_basis(head: HeadModel) -> None:
    """x′ = x + E_i ψ + P_i vec(R − I), posed by Σ_J W_iJ A_J, with E_i, P_i, W_i blended by the weights; then lids."""
    corners, weights, rest = places(head)
    drive = drive_of(head)
    offset = 0.03 * torch.randn(len(rest), 3, generator=torch.Generator().manual_seed(2), dtype=DOUBLE)
    found = pose_points(skinned_mesh(head, drive), corners, weights, rest + offset)

    def blended(basis: Tensor) -> Tensor:
        return torch.einsum("nj,nj...->n...", weights, basis[corners])

    rotations = axis_angle_to_matrix(drive.joint_rotations)
    feature = (rotations[1:] - torch.eye(3, dtype=DOUBLE)).flatten()
    shaped = rest + offset + blended(head.expression_basis) @ drive.expression + blended(head.pose_basis) @ feature
    linear, shift = head.joint_transforms(drive)
    skin = blended(head.skinning_weights)
    expected = torch.einsum("nj,jab,nb->na", skin, linear, shaped) + skin @ shift
    expected = expected + (blended(head.eyelid_basis) @ drive.eyelids) @ linear[1].T + drive.translation
    assert torch.allclose(found.means, expected, atol=1e-12)
    quats = torch.nn.functional.normalize(skin @ upright_quaternions(linear), dim=1)
    assert torch.allclose(found.turns, quats, atol=1e-12)


def test_a_neck_turn_moves_points_of_the_neck_rigidly(head: HeadModel) -> None:
    """Off the skin too, with exactly its rotation; points of the root do not move."""
    weights_of = torch.zeros_like(head.skinning_weights)
    weights_of[:, 1] = 1.0
    head = dataclasses.replace(head, skinning_weights=weights_of, pose_basis=head.pose_basis[:, :, :0])
    corners, weights, rest = places(head)
    rest = rest * 1.4
    axis = torch.tensor([0.3, -0.8, 0.2], dtype=DOUBLE)
    drive = head.neutral_drive()
    drive.joint_rotations[1] = axis
    posed = pose_points(skinned_mesh(head, drive), corners, weights, rest)
    rotation = axis_angle_to_matrix(axis)
    joint = head.joint_regressor[1] @ head.template
    assert torch.allclose(posed.means, (rest - joint) @ rotation.T + joint, atol=1e-12)
    assert torch.allclose(quaternion_to_matrix(posed.turns), rotation.expand(len(rest), 3, 3), atol=1e-12)


def test_turns_are_rotations_and_follow_a_held_torso(head: HeadModel) -> None:
    corners, weights, rest = places(head)
    drives = [drive_of(head, seed, still=True) for seed in range(3)]
    poses = HeadPoses.of(head, drives)
    weights_of = torch.zeros_like(head.skinning_weights)
    weights_of[:, 0] = 1.0
    stuck = dataclasses.replace(head, skinning_weights=weights_of)
    for one in (head, stuck):
        turns = pose_points(skinned_mesh(one, drives[0], poses), corners, weights, rest).turns
        assert torch.allclose(turns.norm(dim=1), torch.ones(len(rest), dtype=DOUBLE), atol=1e-12)
    torso = poses.torso(drives[0])[:3, :3]
    assert torch.allclose(quaternion_to_matrix(turns), torso.expand(len(rest), 3, 3), atol=1e-12)


def test_a_jaw_moves_only_what_it_carries(head: HeadModel) -> None:
    corners, weights, rest = places(head)
    drive = head.neutral_drive()
    drive.joint_rotations[2, 0] = 0.35
    head = dataclasses.replace(head, pose_basis=head.pose_basis[:, :, :0])
    weights_of = head.skinning_weights.clone()
    weights_of[weights_of[:, 2] < 0.01, 2] = 0.0
    head = dataclasses.replace(head, skinning_weights=weights_of / weights_of.sum(1, keepdim=True))
    moved = (pose_points(skinned_mesh(head, drive), corners, weights, rest).means - rest).norm(dim=1)
    free = (head.skinning_weights[corners][:, :, 2] == 0).all(1)
    assert free.any() and float(moved[free].max()) < 1e-12 and float(moved[~free].max()) > 5e-3


def test_translation_is_added(head: HeadModel) -> None:
    corners, weights, rest = places(head)
    drive, shift = drive_of(head), torch.tensor([0.1, -0.2, 0.3], dtype=DOUBLE)
    moved = dataclasses.replace(drive, translation=drive.translation + shift)
    before, after = (pose_points(skinned_mesh(head, one), corners, weights, rest).means for one in (drive, moved))
    assert torch.allclose(after - before, shift.expand_as(rest), atol=1e-12)


def test_along_normals_points_are_off_the_posed_skin(head: HeadModel) -> None:
    corners, weights, _ = places(head)
    drive = drive_of(head)
    offsets = torch.linspace(-0.01, 0.05, len(corners), dtype=DOUBLE)
    moved = 0.01 * torch.randn(len(corners), 3, generator=torch.Generator().manual_seed(2), dtype=DOUBLE)
    mesh = skinned_mesh(head, drive)
    vertices = head.vertices(drive)
    normals = torch.nn.functional.normalize(blend(vertex_normals(vertices, head.faces), corners, weights), dim=1)
    skin = blend(vertices, corners, weights) + offsets[:, None] * normals
    found = pose_along_normals(mesh, head, corners, weights, offsets, 0 * moved)
    assert torch.allclose(found.means, skin, atol=1e-12)
    matrices = blend(mesh.matrices.flatten(1), corners, weights).view(-1, 3, 3)
    pushed = pose_along_normals(mesh, head, corners, weights, offsets, moved)
    assert torch.allclose(pushed.means - skin, (matrices @ moved[:, :, None]).squeeze(-1), atol=1e-12)
    assert torch.equal(found.turns, pose_points(mesh, corners, weights, moved).turns)


def test_corrections_are_linear_in_the_coefficients_and_act_at_rest(head: HeadModel) -> None:
    """G = P′ vec(R − I) + E′ ψ, before skinning, with ψ = expressions, then lids; zero and without gradient at zero."""
    drives = [drive_of(head, seed) for seed in range(4)]
    bases = CorrectionBases(head, drives, 1e-4)
    assert not bases(drives[0]).any() and bases.basis.shape == (3 * len(head.template), 36 + 3 + 2)
    with torch.no_grad():
        bases.basis.copy_(0.01 * torch.randn(bases.basis.shape, generator=torch.Generator().manual_seed(1)))
    drive = drives[2]
    learned = (bases.basis * bases.spread).view(-1, 3, 41)
    feature = (axis_angle_to_matrix(drive.joint_rotations[1:]) - torch.eye(3, dtype=DOUBLE)).flatten()
    coefficients = torch.cat((feature, drive.expression, drive.eyelids))
    assert torch.allclose(bases(drive), learned @ coefficients, atol=1e-12)
    assert not torch.autograd.grad(bases(head.neutral_drive()).sum(), bases.basis)[0].any()
    assert torch.autograd.grad(bases(drive).sum(), bases.basis)[0].any()
    other = dataclasses.replace(
        head,
        pose_basis=head.pose_basis + learned[:, :, :36],
        expression_basis=head.expression_basis + learned[:, :, 36:39],
        joint_regressor=head.joint_regressor * 0,
    )
    still = dataclasses.replace(drive, eyelids=torch.zeros(2, dtype=DOUBLE))
    mesh = skinned_mesh(dataclasses.replace(head, joint_regressor=head.joint_regressor * 0), still)
    mesh = mesh._replace(shifts=mesh.shifts + bases(still))
    assert torch.allclose(mesh.vertices(head.template), other.vertices(still), atol=1e-12)


def test_coefficients_learn_as_much_as_they_move(head: HeadModel) -> None:
    drives = [dataclasses.replace(head.neutral_drive()) for _ in range(2)]
    for drive, sign in zip(drives, (1, -1), strict=True):
        drive.expression.copy_(torch.tensor([2.0, 0.5, 0.0]) * sign)
        drive.joint_rotations[2, 0] = 0.3 * sign
    spread = coefficient_spread(drives)
    assert torch.allclose(spread[36:], torch.tensor([1.0, 0.25, 0.0, 0.0, 0.0], dtype=DOUBLE))
    assert float(spread[:36].max()) == 1.0 and int((spread[:36] > 1e-9).sum()) == 2  # ± sine of the jaw's angle
    assert coefficient_spread(drives[:1]).eq(1).all()
    still = coefficient_spread([head.neutral_drive()] * 3)
    assert not still.any()
    bases = CorrectionBases(head, drives, 1e-3)
    bases(drives[0]).sum().backward()
    bases.optimizer.step()
    assert bases.optimizer.param_groups[0]["lr"] == 1e-3 and bases.optimizer.defaults["eps"] == 1e-15
    for axis, share in enumerate((1.0, 0.25, 0.0)):
        one = head.neutral_drive()
        one.expression[axis] = 1.0
        assert torch.allclose(bases(one).abs(), torch.tensor(1e-3 * share, dtype=DOUBLE), rtol=1e-6)
    bases.set_rate(1e-5)
    assert bases.optimizer.param_groups[0]["lr"] == 1e-5
