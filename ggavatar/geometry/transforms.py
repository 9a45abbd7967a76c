"""Rotations, rigid transforms and projection as pure functions; quaternions wxyz, matrices act on columns.

`kornia.geometry.conversions` is not used: importing kornia takes 0.4 s on top of torch, it has no 6D rotations, its
`rotation_matrix_to_quaternion` takes twice the time and chooses other signs, and its `axis_angle_to_rotation_matrix`
differs by 5e-7, so trained weights would change.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.jit.constants import constant_like


def axis_angle_to_matrix(axis_angle: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation matrices of axis-angle vectors in rad (Rodrigues), differentiable at zero."""
    angle = axis_angle.norm(dim=-1, keepdim=True)[..., None]
    small = angle < 1e-4
    safe = torch.where(small, torch.ones_like(angle), angle)
    sine = torch.where(small, 1 - angle**2 / 6, torch.sin(safe) / safe)
    cosine = torch.where(small, 0.5 - angle**2 / 24, (1 - torch.cos(safe)) / safe**2)
    cross = skew(axis_angle)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + sine * cross + cosine * (cross @ cross)


def skew(vectors: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3 3"]:
    """Skew-symmetric matrices: `skew(a) @ b` is the cross product a × b."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).unflatten(-1, (3, 3))


def matrix_to_axis_angle(matrices: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 3"]:
    """Axis-angle vectors of rotation matrices, angle in [0, π] rad."""
    quats = matrix_to_quaternion(matrices)
    quats = torch.where(quats[..., :1] < 0, -quats, quats)
    sine = quats[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, quats[..., :1])
    ratio = torch.where(sine > 1e-7, angle / sine.clamp_min(1e-7), 2 * torch.ones_like(angle))
    return quats[..., 1:] * ratio


def matrix_to_quaternion(matrices: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 4"]:
    """Unit quaternions wxyz of rotation matrices, from the largest component; their signs are not continuous."""
    m = matrices
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = torch.stack((1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22), dim=-1)
    x, y, z = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    rows = torch.stack(
        (
            torch.stack((squares[..., 0], x, y, z), dim=-1),
            torch.stack((x, squares[..., 1], xy, xz), dim=-1),
            torch.stack((y, xy, squares[..., 2], yz), dim=-1),
            torch.stack((z, xz, yz, squares[..., 3]), dim=-1),
        ),
        dim=-2,
    )
    best = squares.argmax(dim=-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    return normalize(rows.gather(-2, best).squeeze(-2), dim=-1)


def quaternion_to_matrix(quats: Float[Tensor, "*B 4"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation matrices of quaternions wxyz, which need not be normalized; the zero quaternion is the identity."""
    w, x, y, z = normalize(quats, dim=-1).unbind(-1)
    return torch.stack(
        (
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ),
        dim=-1,
    ).unflatten(-1, (3, 3))  # fmt: skip


def quaternion_multiply(left: Float[Tensor, "*B 4"], right: Float[Tensor, "*B 4"]) -> Float[Tensor, "*B 4"]:
    """Hamilton product of quaternions wxyz: rotates by `right`, then by `left`."""
    a, b, c, d = left.unbind(-1)
    e, f, g, h = right.unbind(-1)
    return torch.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ),
        dim=-1,
    )


def rotation_6d_to_matrix(rows: Float[Tensor, "*B 6"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation matrices of flattened first two rows (PyTorch3D's convention); the identity is 1, 0, 0, 0, 1, 0."""
    first = normalize(rows[..., :3], dim=-1)
    second = normalize(rows[..., 3:] - (first * rows[..., 3:]).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack((first, second, torch.linalg.cross(first, second)), dim=-2)


def matrix_to_rotation_6d(matrices: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 6"]:
    """First two rows of rotation matrices, flattened (PyTorch3D's convention)."""
    return matrices[..., :2, :].flatten(-2)


def look_at(eye: Float[Tensor, "3"], target: Float[Tensor, "3"], up: Float[Tensor, "3"]) -> Float[Tensor, "4 4"]:
    """World-to-camera transform (OpenCV axes) of a camera at `eye` that looks at `target` with `up` pointing up."""
    forward = normalize(target - eye, dim=-1)
    right = normalize(torch.linalg.cross(forward, up), dim=-1)
    rotation = torch.stack((right, torch.linalg.cross(forward, right), forward))
    return rigid(rotation, -rotation @ eye)


def rigid(rotation: Float[Tensor, "3 3"], translation: Float[Tensor, "3"]) -> Float[Tensor, "4 4"]:
    """A rigid transform from its rotation and translation."""
    top = torch.cat((rotation, translation[:, None]), dim=1)
    return torch.cat((top, constant_like((0.0, 0.0, 0.0, 1.0), rotation)[None]))


def invert_rigid(transform: Float[Tensor, "4 4"]) -> Float[Tensor, "4 4"]:
    """The inverse of a rigid transform."""
    rotation = transform[:3, :3].T
    return rigid(rotation, -rotation @ transform[:3, 3])


def project(
    points: Float[Tensor, "N 3"], intrinsics: Float[Tensor, "3 3"], world_to_camera: Float[Tensor, "4 4"]
) -> Float[Tensor, "N 2"]:
    """Pixel positions of world points, without clipping; points behind the camera give mirrored positions."""
    camera_points = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    image = camera_points @ intrinsics.T
    return image[:, :2] / image[:, 2:]
