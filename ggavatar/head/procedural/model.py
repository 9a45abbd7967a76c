"""A license-free head in FLAME's parameter layout, computed within seconds and without any data file.

It is the head of the synthetic subjects, and the generic head that supplies scalp, neck and shoulders to tracked heads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.expression import expression_basis, expression_names, lower_lip_weight
from ggavatar.head.procedural.identity import identity_basis, identity_names
from ggavatar.head.procedural.parts import Part, eyeball, left_ear, lid_margin, mouth_bag, strip, teeth, tongue
from ggavatar.head.procedural.regions import named_regions
from ggavatar.head.procedural.rig import JOINT_NAMES, PARENTS, eyelid_basis, joint_regressor, skinning_weights
from ggavatar.head.procedural.skin import Skin, build_skin
from ggavatar.head.procedural.surface import EYE_CENTER
from ggavatar.head.procedural.uv import unwrap

VERSION = "procedural-1"


@dataclass(frozen=True)
class _Assembly:
    """All parts with common vertex indices: vertices, faces, vertex sets by part, loops of the lid and lip margins."""

    vertices: ndarray
    faces: ndarray
    groups: dict[str, ndarray]
    lids: tuple[ndarray, ndarray]
    lips: ndarray


def procedural_head(identity: Sequence[float] | Float[ndarray, " I"] | None = None, *, seed: int = 0) -> HeadModel:
    """The procedural head with an identity folded in.

    Args:
        identity: Up to `len(identity_names())` coefficients, about one standard deviation per unit; None is the
            generic head.
        seed: Seed of the vertex placement; heads with the same seed have the same triangles.

    Raises:
        InputError: There are more coefficients than the basis has, or one is not finite.
    """
    generic, basis = _generic(seed)
    coefficients = np.zeros(basis.shape[2])
    given = np.asarray([] if identity is None else identity, dtype=np.float64)
    if given.ndim != 1 or len(given) > len(coefficients) or not np.isfinite(given).all():
        raise InputError(
            f"expected at most {len(coefficients)} finite identity coefficients, found {given.tolist()}; "
            "procedural_names() lists them"
        )
    coefficients[: len(given)] = given
    return _as_model(generic, generic.vertices + basis @ coefficients)


def procedural_names() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the expression and of the identity coefficients."""
    return expression_names(), identity_names()


@cache
def _generic(seed: int) -> tuple[_Assembly, ndarray]:
    """The generic head's parts and its identity basis, computed once per process."""
    assembly = _assemble(build_skin(seed))
    soft = np.zeros(len(assembly.vertices), bool)
    for name in ("skin", "mouth_bag", "ears"):
        soft[assembly.groups[name]] = True
    eyes = {name: assembly.groups[name] for name in ("left_eyeball", "right_eyeball")}
    return assembly, identity_basis(assembly.vertices, eyes, soft)


def _assemble(skin: Skin) -> _Assembly:
    """Attach lid margins and mouth bag to the skin and append the separate parts."""
    vertices, faces, groups = [skin.vertices], [skin.faces], {}
    count = len(skin.vertices)
    center = np.asarray(EYE_CENTER)
    for loop, eye, outwards in ((skin.left_lids, center, True), (skin.right_lids, center * (-1, 1, 1), False)):
        count = _append_rings(vertices, faces, count, loop, lid_margin(skin.vertices[loop], eye), inwards=outwards)
    groups["skin"] = np.arange(count)
    first = count
    count = _append_rings(vertices, faces, count, skin.lips, mouth_bag(skin.vertices[skin.lips]), inwards=True)
    last = np.arange(count - len(skin.lips), count)
    vertices.append(np.concatenate(vertices)[last].mean(axis=0, keepdims=True) - (0, 0, 0.003))
    faces.append(np.stack((np.full(len(last), count), last, np.roll(last, -1)), axis=1))
    count += 1
    groups["mouth_bag"] = np.arange(first, count)
    for name, part in _separate_parts():
        groups[name] = np.arange(count, count + len(part.vertices))
        vertices.append(part.vertices)
        faces.append(part.faces + count)
        count += len(part.vertices)
    groups["ears"] = np.concatenate((groups["left_ear"], groups["right_ear"]))
    return _Assembly(
        np.concatenate(vertices), np.concatenate(faces), groups, (skin.left_lids, skin.right_lids), skin.lips
    )


def _append_rings(
    vertices: list, faces: list, count: int, loop: ndarray, rings: list[ndarray], *, inwards: bool
) -> int:
    """Append rings and the strips between them, starting from an existing loop; the new number of vertices."""
    for ring in rings:
        following = np.arange(count, count + len(ring))
        band = strip(loop, following)
        faces.append(band if inwards else band[:, ::-1])
        vertices.append(ring)
        loop, count = following, count + len(ring)
    return count


def _separate_parts() -> list[tuple[str, Part]]:
    center = np.asarray(EYE_CENTER)
    ear = left_ear()
    mirrored = Part(ear.vertices * (-1, 1, 1), ear.faces[:, ::-1])
    return [
        ("left_eyeball", eyeball(center)),
        ("right_eyeball", eyeball(center * (-1, 1, 1))),
        ("upper_teeth", teeth(upper=True)),
        ("lower_teeth", teeth(upper=False)),
        ("tongue", tongue()),
        ("left_ear", ear),
        ("right_ear", mirrored),
    ]


def _as_model(generic: _Assembly, template: ndarray) -> HeadModel:
    """A head model of the given template; bases and weights are per vertex and those of the generic head."""
    points, groups = generic.vertices, generic.groups
    on_skin, on_tongue = (
        np.isin(np.arange(len(points)), rows)
        for rows in (np.concatenate((groups["skin"], groups["mouth_bag"])), groups["tongue"])
    )

    def real(values: ndarray) -> Tensor:
        return torch.tensor(values, dtype=torch.float32)

    return HeadModel(
        template=real(template),
        faces=torch.tensor(generic.faces, dtype=torch.int64),
        expression_basis=real(expression_basis(points, lower_lip_weight(points), on_skin, on_tongue)),
        pose_basis=torch.zeros(len(points), 3, 0),
        eyelid_basis=real(eyelid_basis(points, groups["skin"], generic.lids)),
        joint_regressor=real(joint_regressor(points, groups)),
        skinning_weights=real(skinning_weights(points, groups)),
        parents=PARENTS,
        joint_names=JOINT_NAMES,
        version=VERSION,
        regions={
            name: torch.tensor(rows, dtype=torch.int64)
            for name, rows in named_regions(points, groups, generic.lids, generic.lips).items()
        },
        uv=real(unwrap(points, generic.faces, groups)),
        expression_names=expression_names(),
    )
