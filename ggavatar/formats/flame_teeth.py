"""The teeth that VHAP and GaussianAvatars add to FLAME: 120 vertices and 168 triangles behind the lips.

GaussianAvatars' files refer to triangles of the head with teeth by index, so the order of vertices and triangles here
is theirs: eight strips of 15 vertices, the roots and edges of the upper and lower teeth, front and back.
"""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ggavatar.head.model import HeadModel

FLAME_VERTICES, FLAME_FACES = 5023, 9976
WITH_TEETH_VERTICES, WITH_TEETH_FACES = 5143, 10144
STRIP_LENGTH = 15
UPPER_LIP = (1713, 1715, 1716, 1735, 1696, 1694, 1657, 3543, 2774, 2811, 2813, 2850, 2833, 2832, 2830)
LOWER_LIP = (1576, 1577, 1773, 1774, 1795, 1802, 1865, 3503, 2948, 2905, 2898, 2881, 2880, 2713, 2712)

_UPPER_ROOT, _LOWER_ROOT, _UPPER_EDGE, _LOWER_EDGE = (FLAME_VERTICES + STRIP_LENGTH * strip for strip in range(4))
_UPPER_ROOT_BACK, _UPPER_EDGE_BACK, _LOWER_ROOT_BACK, _LOWER_EDGE_BACK = (
    FLAME_VERTICES + STRIP_LENGTH * strip for strip in range(4, 8)
)
_STRIPS = (
    (_UPPER_ROOT, _UPPER_EDGE, "ADC", "ABD", "ABC", "BDC"),
    (_UPPER_ROOT_BACK, _UPPER_EDGE_BACK, "ACD", "ADB", "ACB", "BCD"),
    (_UPPER_EDGE, _UPPER_EDGE_BACK, "CAD", "DAB", "CAB", "CBD"),
    (_LOWER_ROOT, _LOWER_EDGE, "CDA", "DBA", "CBA", "CDB"),
    (_LOWER_ROOT_BACK, _LOWER_EDGE_BACK, "ADC", "ABD", "ABC", "BDC"),
    (_LOWER_EDGE, _LOWER_EDGE_BACK, "CDA", "DBA", "CBA", "CDB"),
)
"""Two rows of vertices, and the pair of triangles of each of their cells: two for the right half, two for the left."""


def with_teeth(mean: HeadModel, head: HeadModel) -> HeadModel:
    """A FLAME head with teeth.

    Args:
        mean: FLAME without identity; the teeth are built in its mouth.
        head: FLAME with an identity, which moves the teeth as much as the mean of the two lips.

    References:
        VHAP (Qian 2024): the upper teeth follow the neck joint, the lower ones the jaw; expressions and pose
        correctives do not move them.
    """
    lips = torch.tensor([UPPER_LIP, LOWER_LIP])
    moved = (head.template - mean.template)[lips].mean(0).repeat(8, 1)
    template = torch.cat((head.template, _positions(*mean.template[lips].unbind(0)) + moved))
    count = WITH_TEETH_VERTICES - FLAME_VERTICES
    weights = head.skinning_weights.new_zeros(count, len(head.parents))
    lower = torch.tensor([strip in (1, 3, 6, 7) for strip in range(8)]).repeat_interleave(STRIP_LENGTH)
    weights[~lower, head.joint_index("neck")] = 1
    weights[lower, head.joint_index("jaw")] = 1

    def padded(values: Tensor) -> Tensor:
        return torch.cat((values, values.new_zeros(count, *values.shape[1:])))

    return dataclasses.replace(
        head,
        template=template,
        faces=torch.cat((head.faces, teeth_faces())),
        expression_basis=padded(head.expression_basis),
        pose_basis=padded(head.pose_basis),
        eyelid_basis=padded(head.eyelid_basis),
        joint_regressor=torch.cat((head.joint_regressor, head.joint_regressor.new_zeros(len(head.parents), count)), 1),
        skinning_weights=torch.cat((head.skinning_weights, weights)),
        uv=None,
    )


def _positions(upper: Float[Tensor, "15 3"], lower: Float[Tensor, "15 3"]) -> Float[Tensor, "120 3"]:
    """Vertices of the teeth between the inner rims of the lips, m."""
    opening = (upper - lower).norm(dim=1).mean()
    middle = (upper + lower) / 2
    middle[:, 1] = middle[:, 1].mean()
    middle[:, 2] -= 1.5 * opening
    up, back = opening * middle.new_tensor([0.0, 1.0, 0.0]), opening * middle.new_tensor([0.0, 0.0, -1.0])
    upper_edge, lower_edge = middle + 0.1 * up, middle - 0.1 * up + 0.4 * back
    upper_root, lower_root = upper_edge + 2 * up, lower_edge - 2 * up
    front = (upper_root, lower_root, upper_edge, lower_edge)
    behind = (upper_root + back, upper_edge + back, lower_root + back, lower_edge + back)
    return torch.cat((*front, *behind))


def teeth_faces() -> Int[Tensor, "168 3"]:
    """Triangles of the teeth in GaussianAvatars' order."""
    faces = []
    for first, second, *triangles in _STRIPS:
        for cell in range(STRIP_LENGTH - 1):
            corner = {"A": first + cell, "B": first + cell + 1, "C": second + cell, "D": second + cell + 1}
            pair = triangles[:2] if cell < STRIP_LENGTH // 2 else triangles[2:]
            faces += [[corner[letter] for letter in triangle] for triangle in pair]
    return torch.tensor(faces)
