"""A head posed on the device in four or five launches, and its facial condition in one (torch twin: `HeadModel`)."""

from __future__ import annotations

from typing import Any

import torch
import triton.language as tl
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.jit import device_kernels
from ggavatar.jit.constants import constant
from ggavatar.jit.triton_kernels import device_function, device_kernel
from ggavatar.jit.triton_vectors import added, combined, dot, load_3, scaled, store_3

BLOCK = 128
SMALL = tl.constexpr(1e-4)
"""Angle, rad, below which the series of sine and cosine are used, as in `axis_angle_to_matrix`."""


@device_function
def _rotation(a):
    """Rows of the rotation matrices of axis-angle vectors (Rodrigues)."""
    square = dot(a, a)
    angle = tl.sqrt(square)
    small = angle < SMALL
    safe = tl.where(small, 1.0, angle)
    sine = tl.where(small, 1 - square / 6, tl.sin(safe) / safe)
    cosine = tl.where(small, 0.5 - square / 24, (1 - tl.cos(safe)) / (safe * safe))
    x, y, z = a[0], a[1], a[2]
    along = 1 - cosine * square
    row_0 = along + cosine * x * x, cosine * x * y - sine * z, cosine * x * z + sine * y
    row_1 = cosine * x * y + sine * z, along + cosine * y * y, cosine * y * z - sine * x
    row_2 = cosine * x * z - sine * y, cosine * y * z + sine * x, along + cosine * z * z
    return row_0, row_1, row_2


@device_function
def _matrix(matrices, index):
    """The rows of one of several 3 × 3 matrices."""
    return (
        load_3(matrices, 3 * index, True),
        load_3(matrices, 3 * index + 1, True),
        load_3(matrices, 3 * index + 2, True),
    )


@device_function
def _turned(rows, a):
    """The vector that a matrix, given as three rows, makes of a vector."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


@device_function
def _row_times(a, rows):
    """A row vector times a matrix that is given as three rows."""
    return added(added(scaled(a[0], rows[0]), scaled(a[1], rows[1])), scaled(a[2], rows[2]))


@device_function
def _about(rows, place):
    """The offset of a rotation about a place."""
    return combined(1.0, place, -1.0, _turned(rows, place))


@device_kernel
def pose_joints(
    axis_angles, places, parents, linear, offsets, feature,
    JOINTS: tl.constexpr, DEPTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write rotation [J, 3, 3] and offset [J, 3] of every joint, and vec(R − I) [J − 1, 9] of all but the first.

    Every joint composes the rotations about its ancestors, so that no joint waits for another.
    """
    joint = tl.arange(0, BLOCK)
    alive = joint < JOINTS
    rows = _rotation(load_3(axis_angles, joint, alive))
    offset = _about(rows, load_3(places, joint, alive))
    later = alive & (joint > 0)
    at = 3 * (joint - 1)
    store_3(feature, at, later, (rows[0][0] - 1, rows[0][1], rows[0][2]))
    store_3(feature, at + 1, later, (rows[1][0], rows[1][1] - 1, rows[1][2]))
    store_3(feature, at + 2, later, (rows[2][0], rows[2][1], rows[2][2] - 1))
    ancestor = tl.load(parents + joint, mask=alive, other=-1)
    for _ in range(DEPTH):
        there = ancestor >= 0  # rotations of no angle about the origin stand in for missing ancestors
        above = _rotation(load_3(axis_angles, ancestor, there))
        offset = added(_turned(above, offset), _about(above, load_3(places, ancestor, there)))
        rows = _row_times(above[0], rows), _row_times(above[1], rows), _row_times(above[2], rows)
        ancestor = tl.load(parents + ancestor, mask=there, other=-1)
    store_3(offsets, joint, alive, offset)
    for axis in tl.static_range(3):
        store_3(linear, 3 * joint + axis, alive, rows[axis])


@device_kernel
def skin_vertices(
    shaped, weights, linear, offsets, lids, closed, translation, posed,
    rows, CARRIER: tl.constexpr, JOINTS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write vertices [V, 3]: blended by the weights [V, J], with eyelids [V, 3, 2] closed, and moved."""
    vertex = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    alive = vertex < rows
    at = load_3(shaped, vertex, alive)
    zero = tl.zeros([BLOCK], tl.float32)
    place = zero, zero, zero
    for joint in range(JOINTS):
        matrix = _matrix(linear, joint)
        weight = tl.load(weights + JOINTS * vertex + joint, mask=alive, other=0.0)
        place = added(place, scaled(weight, added(_turned(matrix, at), load_3(offsets, joint, True))))
    left, right = tl.load(closed), tl.load(closed + 1)
    first = lids + 6 * vertex
    lid_x = left * tl.load(first, mask=alive, other=0.0) + right * tl.load(first + 1, mask=alive, other=0.0)
    lid_y = left * tl.load(first + 2, mask=alive, other=0.0) + right * tl.load(first + 3, mask=alive, other=0.0)
    lid_z = left * tl.load(first + 4, mask=alive, other=0.0) + right * tl.load(first + 5, mask=alive, other=0.0)
    place = added(place, _turned(_matrix(linear, CARRIER), (lid_x, lid_y, lid_z)))
    store_3(posed, vertex, alive, added(place, load_3(translation, 0, True)))


@device_kernel
def write_condition(
    expression, axis_angles, closed, moving, condition,
    EXPRESSIONS: tl.constexpr, MOVING: tl.constexpr, BLOCK: tl.constexpr, BLOCK_JOINTS: tl.constexpr,
):  # fmt: skip
    """Write expression [E], two rows of the rotation of every moving joint, and eyelids [2] as one vector."""
    place = tl.arange(0, BLOCK)
    tl.store(condition + place, tl.load(expression + place, mask=place < EXPRESSIONS), mask=place < EXPRESSIONS)
    index = tl.arange(0, BLOCK_JOINTS)
    alive = index < MOVING
    joint = tl.load(moving + index, mask=alive, other=0)
    rows = _rotation(load_3(axis_angles, joint, alive))
    for axis in tl.static_range(2):
        store_3(condition + EXPRESSIONS, 2 * index + axis, alive, rows[axis])
    lid = tl.arange(0, 2)
    tl.store(condition + EXPRESSIONS + 6 * MOVING + lid, tl.load(closed + lid))


def vertices(head: Any, drive: Drive) -> Tensor:
    """`vertices` of a `HeadModel`, m, without gradients."""
    shaped = torch.addmv(head.template.flatten(), head.expression_basis.flatten(0, 1), drive.expression)
    linear, offsets, feature = _posed_joints(head, drive.joint_rotations, head.joint_regressor @ shaped.view(-1, 3))
    if head.pose_basis.shape[2]:
        shaped = torch.addmv(shaped, head.pose_basis.flatten(0, 1), feature)
    posed = torch.empty_like(head.template)
    device_kernels.launch(
        skin_vertices, -(-len(posed) // BLOCK), shaped, head.skinning_weights, linear, offsets, head.eyelid_basis,
        drive.eyelids, drive.translation, posed, len(posed),
        CARRIER=head.lid_carrier, JOINTS=len(head.parents), BLOCK=BLOCK,
    )  # fmt: skip
    return posed


def _posed_joints(head: Any, axis_angles: Tensor, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rotation, offset (m) and pose feature of the joints at `places`, m."""
    joints = len(head.parents)
    linear, offsets = places.new_empty(joints, 3, 3), places.new_empty(joints, 3)
    feature = places.new_empty(9 * (joints - 1))
    parents = constant(head.parents, torch.int32, places.device)
    device_kernels.launch(
        pose_joints, 1, axis_angles, places, parents, linear, offsets, feature,
        JOINTS=joints, DEPTH=_depth(head.parents), BLOCK=_power_of_two(joints), warps=1,
    )  # fmt: skip
    return linear, offsets, feature


def condition(head: Any, drive: Drive) -> Tensor:
    """`condition` of a `HeadModel`, without gradients."""
    expressions, moving = len(drive.expression), head.moving_joints
    found = drive.expression.new_empty(expressions + 6 * len(moving) + 2)
    device_kernels.launch(
        write_condition, 1, drive.expression, drive.joint_rotations, drive.eyelids,
        constant(moving, torch.int32, found.device), found,
        EXPRESSIONS=expressions, MOVING=len(moving), BLOCK=_power_of_two(expressions),
        BLOCK_JOINTS=_power_of_two(len(moving)), warps=1,
    )  # fmt: skip
    return found


def _depth(parents: tuple[int, ...]) -> int:
    """The most ancestors that a joint has; parents precede their children."""
    depths: list[int] = []
    for parent in parents:
        depths.append(0 if parent < 0 else depths[parent] + 1)
    return max(depths)


def _power_of_two(count: int) -> int:
    """The least power of two that is not smaller."""
    return 1 << max(0, count - 1).bit_length()
