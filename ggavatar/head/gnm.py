"""Google's GNM head (gnm_head.npz, Apache-2.0) as a `HeadModel` with an identity folded in.

Layout and forward function: google/GNM, gnm/shape (gnm_data_loader.py, gnm_common.py): meters, +Y up, +Z forward;
vertices are the template plus identity and expression bases, then skinned by neck, head and both eyes. GNM has no jaw
joint and no eyelids: expressions move both.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.errors import InputError
from ggavatar.head.array_shapes import describe_shape, shape_fits
from ggavatar.head.model import HeadModel
from ggavatar.head.still_joints import still_joint_regressor
from ggavatar.io.npz import npz_headers, read_npz

_REAL: dict[str, tuple[str, ...]] = {
    "template_vertex_positions": ("V", "3"),
    "template_joint_positions": ("J", "3"),
    "vertex_identity_basis": ("I", "V", "3"),
    "joint_identity_basis": ("I", "J", "3"),
    "expression_basis": ("E", "V", "3"),
    "skinning_weights": ("J", "V"),
}
_OPTIONAL = ("pose_correctives_regressor", "triangle_uvs", "vertex_groups", "vertex_group_names", "version", "variant")
_KEYS = (*_REAL, "triangles", "joint_parent_indices", "joint_names", *_OPTIONAL)
_JOINT_NAMES = {"head": "neck", "neck": "root"}
"""GNM's neck carries everything and its head turns on it: those are FLAME's root and neck."""


def is_gnm(path: Path) -> bool:
    """Whether a file is GNM's npz, judging by the arrays in it."""
    try:
        return path.is_file() and {"template_vertex_positions", "vertex_identity_basis"} <= set(npz_headers(path))
    except InputError:
        return False


def load_gnm(path: Path, identity: Float[np.ndarray, " S"] | None = None, expressions: int | None = None) -> HeadModel:
    """Read GNM's file and fold an identity into its template.

    Args:
        path: `gnm_head.npz`.
        identity: Identity coefficients, at most as many as the file has; None is the mean head.
        expressions: Number of expression coefficients to keep, all if None.

    Raises:
        InputError: An array is missing or of a wrong shape, type or value, or the head has what `HeadModel` lacks.
    """
    arrays = read_npz(path, _KEYS)
    sizes = _check(path, arrays)
    template, joints = _shaped(path, arrays, identity)
    count = sizes["E"] if expressions is None else min(expressions, sizes["E"])
    basis = np.moveaxis(arrays["expression_basis"][:count].astype(np.float32), 0, 2)
    return HeadModel(
        template=_float(template),
        faces=torch.from_numpy(arrays["triangles"].astype(np.int64)),
        expression_basis=_float(basis),
        pose_basis=_float(_pose_basis(path, arrays.get("pose_correctives_regressor"), sizes["V"], sizes["J"])),
        eyelid_basis=torch.zeros(sizes["V"], 3, 2),
        joint_regressor=_float(still_joint_regressor(path, template, basis, joints)),
        skinning_weights=_float(arrays["skinning_weights"].T),
        parents=_parents(path, arrays["joint_parent_indices"], sizes["J"]),
        joint_names=_names(path, arrays["joint_names"], sizes["J"]),
        version=f"gnm-{_text(arrays.get('variant'), 'head')}-{_text(arrays.get('version'), '3.0')}",
        regions=_regions(arrays, sizes["V"]),
        uv=_uv(arrays.get("triangle_uvs"), len(arrays["triangles"])),
    )


def _float(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _text(value: np.ndarray | None, default: str) -> str:
    text = str(value) if value is not None and value.shape == () and value.dtype.kind == "U" else default
    return text if len(text) < 20 else default


def _check(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """Sizes by letter; `InputError` if an array is missing or does not fit the others."""
    sizes = {"3": 3}
    for key, letters in _REAL.items():
        array = arrays.get(key)
        shape = tuple(sizes.get(letter) for letter in letters)
        fits = array is not None and array.dtype.kind == "f" and shape_fits(array.shape, shape)
        if array is None or not fits or not np.isfinite(array).all() or 0 in array.shape:
            found = "none" if array is None else f"{array.dtype} {list(array.shape)}"
            raise InputError(
                f"{path}: expected finite numbers of shape {describe_shape(shape)} for {key!r}, found {found}; "
                "download gnm_head.npz again"
            )
        sizes |= dict(zip(letters, array.shape, strict=True))
    weights = np.abs(arrays["skinning_weights"].astype(np.float64).sum(axis=0) - 1).max()
    height = float(np.ptp(arrays["template_vertex_positions"][:, 1]))
    if weights > 1e-3 or not 0.1 < height < 2:
        raise InputError(
            f"{path}: expected skinning weights that sum to 1 and a head in meters, found sums off by {weights:.3g} "
            f"and a height of {height:.3g}; download gnm_head.npz again"
        )
    triangles = arrays.get("triangles", np.zeros(0))
    if triangles.dtype.kind not in "iu" or triangles.ndim != 2 or triangles.shape[1:] != (3,) or not len(triangles):
        raise InputError(
            f"{path}: expected 'triangles' of shape [T, 3], found {list(triangles.shape)}; download it again"
        )
    if triangles.min() < 0 or triangles.max() >= sizes["V"]:
        raise InputError(f"{path}: expected vertex indices below {sizes['V']} in 'triangles'; download it again")
    return sizes


def _shaped(path: Path, arrays: dict[str, np.ndarray], identity: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Template and joints with the identity."""
    template = arrays["template_vertex_positions"].astype(np.float64)
    joints = arrays["template_joint_positions"].astype(np.float64)
    if identity is None or not np.any(identity):
        return template, joints
    known = len(arrays["vertex_identity_basis"])
    if np.any(identity[known:]):
        raise InputError(
            f"{path}: expected at most {known} identity coefficients, found {len(identity)}; use GNM's own"
        )
    used = np.asarray(identity[:known], dtype=np.float64)
    for target, key in ((template, "vertex_identity_basis"), (joints, "joint_identity_basis")):
        target += np.einsum("i,ijk->jk", used, arrays[key][: len(used)].astype(np.float64))
    return template, joints


def _pose_basis(path: Path, regressor: np.ndarray | None, vertices: int, joints: int) -> np.ndarray:
    """Pose correctives of all joints but the root; none if they are all zero, as in version 3.0."""
    if regressor is None or not np.any(regressor):
        return np.zeros((vertices, 3, 0))
    fits = regressor.shape == (9 * joints, 3 * vertices) and regressor.dtype.kind == "f"
    if not fits or not np.isfinite(regressor).all() or np.any(regressor[:9]):
        raise InputError(f"{path}: expected pose correctives of all joints but the root; use version 3.0 of GNM")
    return np.moveaxis(regressor[9:].reshape(9 * (joints - 1), vertices, 3), 0, 2)


def _parents(path: Path, parents: np.ndarray, joints: int) -> tuple[int, ...]:
    values = [int(parent) for parent in parents.reshape(-1)] if parents.dtype.kind in "iu" else []
    if len(values) != joints or not all(0 <= parent < child for child, parent in enumerate(values[1:], start=1)):
        raise InputError(f"{path}: expected a parent before every joint, found {values}; download gnm_head.npz again")
    return (-1, *values[1:])


def _names(path: Path, names: np.ndarray, joints: int) -> tuple[str, ...]:
    own = tuple(str(name) for name in names.reshape(-1)) if names.dtype.kind == "U" else ()
    if len(own) != joints or len(set(own)) != joints:
        raise InputError(f"{path}: expected {joints} joint names, found {len(own)}; download gnm_head.npz again")
    return tuple(_JOINT_NAMES.get(name, name) for name in own) if {"neck", "head"} <= set(own) else own


def _regions(arrays: dict[str, np.ndarray], vertices: int) -> dict[str, torch.Tensor]:
    """GNM's vertex groups; vertices belong to a group from a weight of 10⁻⁴ on."""
    groups, names = arrays.get("vertex_groups"), arrays.get("vertex_group_names")
    if groups is None or names is None or names.dtype.kind != "U" or groups.shape != (names.size, vertices):
        return {}
    found: dict[str, Any] = {str(name): np.flatnonzero(row > 1e-4) for name, row in zip(names, groups, strict=True)}
    return {name: torch.from_numpy(rows.astype(np.int64)) for name, rows in found.items() if len(rows)}


def _uv(uv: np.ndarray | None, faces: int) -> torch.Tensor | None:
    if uv is None or uv.dtype.kind != "f" or uv.shape != (faces, 3, 2):
        return None
    return _float(uv) if np.isfinite(uv).all() and uv.min() >= 0 and uv.max() <= 1 else None
