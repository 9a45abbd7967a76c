"""A point-based morphable shape: points that the skinning, bases and lids of a head's mesh carry, and learned bases.

Whatever is linear in the mesh is contracted with a frame's coefficients on the mesh first, then blended to the points
by the weights of their triangle's corners; the result is that of blending bases and skinning weights point by point.

References:
    PSAvatar (Zhao et al. 2024): M(θ, ψ) = W(T_P(θ, ψ), J(ψ), θ, W) for points on and off FLAME's mesh, and its
    correction G(θ, ψ) = B_P(θ; P′) + B_E(ψ; E′), as its readers describe them; its code was never published.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import normalize

from ggavatar.core import Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, matrix_to_quaternion, quaternion_multiply
from ggavatar.geometry.vertex_frames import vertex_normals
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.jit.constants import constant_like
from ggavatar.points.driving import shape_coefficients


class SkinnedMesh(NamedTuple):
    """How a drive moves the vertices of a head: vertex v goes to matrices_v (v + shifts_v) + offsets_v.

    Attributes:
        shifts: Displacements at rest by expressions, pose correctives and corrections, m.
        matrices: Blended rotations of the joints, and of the torso if it is held.
        offsets: Blended offsets, with lids and translation, m.
        turns: Blended quaternions wxyz of the same rotations, not normalized.
    """

    shifts: Float[Tensor, "V 3"]
    matrices: Float[Tensor, "V 3 3"]
    offsets: Float[Tensor, "V 3"]
    turns: Float[Tensor, "V 4"]

    def vertices(self, rest: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """The posed vertices, m; without corrections those of `HeadModel.vertices` and `HeadPoses.hold_torso`."""
        return (self.matrices * (rest + self.shifts)[:, None]).sum(-1) + self.offsets


def skinned_mesh(head: HeadModel, drive: Drive, torso: HeadPoses | None = None) -> SkinnedMesh:
    """The mesh posed by a drive, without corrections.

    Args:
        head: The head model.
        drive: What poses it.
        torso: Holds the torso still where the head pose is in the camera; None lets it move with the head.
    """
    shifts = head.expression_basis.flatten(0, 1) @ drive.expression
    if head.pose_basis.shape[2]:
        rotations = axis_angle_to_matrix(drive.joint_rotations[1:])
        identity = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
        shifts = shifts + head.pose_basis.flatten(0, 1) @ (rotations - identity).flatten()
    linear, offset = head.joint_transforms(drive)
    weights = head.skinning_weights
    carrier = linear[head.joint_index("neck")] if "neck" in head.joint_names else linear[0]
    lids = (head.eyelid_basis.flatten(0, 1) @ drive.eyelids).view(-1, 3)
    mesh = SkinnedMesh(
        shifts.view(-1, 3),
        (weights @ linear.flatten(1)).view(-1, 3, 3),
        weights @ offset + lids @ carrier.T + drive.translation,
        weights @ upright_quaternions(linear),
    )
    return mesh if torso is None or not torso.in_camera else _held(mesh, torso.torso(drive), head)


def _held(mesh: SkinnedMesh, torso: Float[Tensor, "4 4"], head: HeadModel) -> SkinnedMesh:
    """The mesh after `HeadPoses.hold_torso`: a share of the torso's transform, by the weight of the root."""
    share = head.skinning_weights[:, head.joint_index("root"), None]
    rotation = torso[:3, :3]
    turned = quaternion_multiply(upright_quaternions(rotation[None]).expand_as(mesh.turns), mesh.turns)
    return mesh._replace(
        matrices=torch.lerp(mesh.matrices, rotation @ mesh.matrices, share[:, :, None]),
        offsets=torch.lerp(mesh.offsets, mesh.offsets @ rotation.T + torso[:3, 3], share),
        turns=torch.lerp(mesh.turns, turned, share),
    )


def upright_quaternions(matrices: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 4"]:
    """Quaternions wxyz with a nonnegative real part, so that turns of less than 180° never cancel by sign."""
    quats = matrix_to_quaternion(matrices)
    return torch.where(quats[:, :1] < 0, -quats, quats)


class PosedPoints(NamedTuple):
    """Posed points.

    Attributes:
        means: Positions, m.
        turns: Rotations since rest, unit quaternions wxyz.
    """

    means: Float[Tensor, "N 3"]
    turns: Float[Tensor, "N 4"]


def pose_points(
    mesh: SkinnedMesh, corners: Int[Tensor, "N 3"], weights: Float[Tensor, "N 3"], rest: Float[Tensor, "N 3"]
) -> PosedPoints:
    """Points carried by a mesh: bases, skinning, lids and turns of its vertices, blended by the weights.

    Args:
        mesh: The posed mesh.
        corners: Vertices of the triangle of each point.
        weights: Their weights; sum 1.
        rest: Places of the points at rest, on the mesh or off it, m.
    """
    fixed = torch.cat((mesh.matrices.flatten(1), mesh.offsets, mesh.turns), dim=1)
    matrices, offsets, turns = blend(fixed, corners, weights).split((9, 3, 4), dim=1)
    shaped = rest + blend(mesh.shifts, corners, weights)
    means = (matrices.unflatten(1, (3, 3)) * shaped[:, None]).sum(-1) + offsets
    return PosedPoints(means, normalize(turns, dim=-1))


def pose_along_normals(
    mesh: SkinnedMesh,
    head: HeadModel,
    corners: Int[Tensor, "N 3"],
    weights: Float[Tensor, "N 3"],
    offsets: Float[Tensor, " N"],
    moved: Float[Tensor, "N 3"],
) -> PosedPoints:
    """Points at offsets along the normals of the posed mesh, as in SplattingAvatar, with their turns blended as before.

    Args:
        mesh: The posed mesh.
        head: The head.
        corners: Vertices of the triangle of each point.
        weights: Their weights; sum 1.
        offsets: Distance along the smooth normal, m.
        moved: Displacements of the points at rest, m, which are skinned.
    """
    vertices = mesh.vertices(head.neutral())
    normals = normalize(blend(vertex_normals(vertices, head.faces), corners, weights), dim=-1)
    skin = blend(torch.cat((mesh.matrices.flatten(1), mesh.turns), dim=1), corners, weights)
    matrices, turns = skin.split((9, 4), dim=1)
    moved = (matrices.unflatten(1, (3, 3)) * moved[:, None]).sum(-1)
    means = blend(vertices, corners, weights) + offsets[:, None] * normals + moved
    return PosedPoints(means, normalize(turns, dim=-1))


def blend(
    values: Float[Tensor, "V C"], corners: Int[Tensor, "N 3"], weights: Float[Tensor, "N 3"]
) -> Float[Tensor, "N C"]:
    """Σ w_j x_j over the corners of triangles."""
    # As in `face_vectors`, `index_select` adds its gradient in order.
    return (weights[:, :, None] * values.index_select(0, corners.flatten()).unflatten(0, (-1, 3))).sum(1)


class CorrectionBases(nn.Module):
    """Learned displacements of the vertices at rest: G = P′ vec(R − I) + E′ ψ, zero at first; ψ includes the lids.

    The basis of a coefficient is stored divided by how much the coefficient moves in training, as a share of the most
    moving one of its kind. What never moves thus gets no correction, and cannot get a wild one in other performances.
    """

    spread: Tensor

    def __init__(self, head: HeadModel, drives: Sequence[Drive], rate: float) -> None:
        """Zero bases, and Adam for them.

        Args:
            head: The head model.
            drives: Those of the training frames.
            rate: Learning rate of the bases of the most moving coefficients, m per unit.
        """
        super().__init__()
        spread = coefficient_spread(drives or [head.neutral_drive()])
        self.register_buffer("spread", spread)
        self.basis = nn.Parameter(spread.new_zeros(3 * len(head.template), len(spread)))
        self.optimizer = torch.optim.Adam([self.basis], lr=rate, betas=(0.9, 0.999), eps=1e-15, fused=True)

    def forward(self, drive: Drive) -> Float[Tensor, "V 3"]:
        """Displacements of the vertices at rest, m."""
        return (self.basis @ (self.spread * shape_coefficients(drive))).view(-1, 3)

    def set_rate(self, rate: float) -> None:
        """Set the learning rate, m per unit."""
        self.optimizer.param_groups[0]["lr"] = rate


def coefficient_spread(drives: Sequence[Drive]) -> Float[Tensor, " B"]:
    """Standard deviation of every shape coefficient over some drives, as a share of the largest of its kind.

    Kinds are joint rotations, vec(R − I), and expressions with eyelids. All are 1 for a single drive.
    """
    coefficients = torch.stack([shape_coefficients(drive) for drive in drives])
    if len(drives) == 1:
        return torch.ones_like(coefficients[0])
    deviation = coefficients.std(0, correction=0)
    poses = 9 * (len(drives[0].joint_rotations) - 1)
    kinds = deviation.split((poses, len(deviation) - poses))
    least = constant_like((1e-12,), deviation)
    return torch.cat([kind / torch.cat((kind, least)).max() for kind in kinds])
