"""PLY files of 3D Gaussian Splatting (Kerbl et al. 2023), and of GaussianAvatars, which adds the property `binding_0`.

Values are stored before activation, harmonics channel by channel (all of red, then green, then blue). Properties are
found by name, since writers differ in their order.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Literal

import numpy as np
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.ply import Header, read_columns, read_header, write_columns
from ggavatar.formats.stored_gaussians import StoredGaussians, rotate_180_about_x

Axes = Literal["auto", "world", "viewer"]
VIEWER_COMMENT = "ggavatar axes: x right, y down, z away"
MAX_POSITION, MAX_COEFFICIENT, MIN_LOG_SCALE, MAX_LOG_SCALE = 1e6, 1e4, -100.0, 14.0
"""Limits on positions (m), coefficients and logarithms of scales (m); numbers beyond them mean a damaged file."""
MAX_OPACITY_LOGIT = 80.0
"""Logits of opacities are clipped to this; beyond it an opacity is 0 or 1 in float32."""

_BINDING = "binding_0"


def read_gaussian_ply(path: Path, axes: Axes = "auto") -> StoredGaussians:
    """Read a PLY of 3D Gaussians.

    Args:
        path: The file.
        axes: `world`: the file is in our axes, as trained. `viewer`: it is in the axes of viewers (x right, y down,
            z away) and is rotated back. `auto`: `viewer` for files that ggavatar-export has rotated, else `world`.

    Returns:
        Gaussians in our axes; those with a binding are in the units of their triangles.

    Raises:
        InputError: The file is of another kind, or holds numbers that no Gaussian can have.
    """
    header = read_header(path)
    rest_names = _rest_names(path, header)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "scale_0", "scale_1", "scale_2"]
    table = read_columns(path, header, [*names, "rot_0", "rot_1", "rot_2", "rot_3", *rest_names])
    # Files converted from formats with one byte per opacity have infinite logits, of 0 and 255.
    logits = read_columns(path, header, ["opacity"], infinite=True)[:, 0]
    rows = StoredGaussians(
        means=table[:, 0:3].copy(),
        sh_dc=table[:, 3:6].copy(),
        sh_rest=np.ascontiguousarray(table[:, 13:].reshape(header.count, 3, -1).transpose(0, 2, 1)),
        opacity_logits=logits.clip(-MAX_OPACITY_LOGIT, MAX_OPACITY_LOGIT),
        log_scales=table[:, 6:9].copy(),
        quats=table[:, 9:13].copy(),
        faces=_faces(path, header),
    )
    _check(path, rows)
    viewer = axes == "viewer" or (axes == "auto" and VIEWER_COMMENT in header.comments)
    return rotate_180_about_x(rows) if viewer and rows.faces is None else rows


def _rest_names(path: Path, header: Header) -> list[str]:
    """Names of the properties of the harmonics beyond the constant one, in numerical order."""
    found = [name for name in header.properties if re.fullmatch(r"f_rest_\d{1,3}", name)]
    if len(found) not in (0, 9, 24, 45) or any(f"f_rest_{index}" not in found for index in range(len(found))):
        raise InputError(
            f"{path}: expected 0, 9, 24 or 45 properties f_rest_0, f_rest_1, … (degree 0, 1, 2 or 3), found "
            f"{len(found)}; export the file again"
        )
    return [f"f_rest_{index}" for index in range(len(found))]


def _faces(path: Path, header: Header) -> ndarray | None:
    """The triangle of every Gaussian, or None if the file has no binding."""
    if _BINDING not in header.properties:
        return None
    faces = read_columns(path, header, [_BINDING])[:, 0]
    if not ((faces >= 0) & (faces < 1 << 24) & (faces == np.floor(faces))).all():
        raise InputError(f"{path}: expected indices of triangles in {_BINDING}, found other numbers; export it again")
    return faces.astype(np.int64)


def _check(path: Path, rows: StoredGaussians) -> None:
    """Raise an `InputError` for numbers that only a damaged file holds."""
    limits = {
        "positions": (rows.means, -MAX_POSITION, MAX_POSITION),
        "logarithms of scales": (rows.log_scales, MIN_LOG_SCALE, MAX_LOG_SCALE),
        "colors": (rows.sh_dc, -MAX_COEFFICIENT, MAX_COEFFICIENT),
        "harmonics": (rows.sh_rest, -MAX_COEFFICIENT, MAX_COEFFICIENT),
        "rotations": (rows.quats, -MAX_POSITION, MAX_POSITION),
    }
    for what, (values, low, high) in limits.items():
        if values.size and not low <= float(values.min()) <= float(values.max()) <= high:
            raise InputError(
                f"{path}: expected {what} from {low:g} to {high:g}, found {float(values.min()):g} to "
                f"{float(values.max()):g}; the file is damaged or does not hold 3D Gaussians"
            )
    if float(np.linalg.norm(rows.quats, axis=1).min()) < 1e-6:
        raise InputError(
            f"{path}: expected quaternions of a length above zero, found some of length zero; export it again"
        )


def write_gaussian_ply(path: Path, rows: StoredGaussians, viewer_axes: bool = True) -> None:
    """Write Gaussians in the layout of 3DGS; the file appears complete or not at all.

    Args:
        path: The file.
        rows: In our axes. Those bound to triangles are written in GaussianAvatars' layout and never rotated.
        viewer_axes: Rotate them so that viewers show the head upright, and note it in a comment of the file.
    """
    rotate = viewer_axes and rows.faces is None
    rows = rotate_180_about_x(rows) if rotate else rows
    columns = {name: rows.means[:, index] for index, name in enumerate("xyz")}
    columns |= {name: np.zeros(len(rows), np.float32) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{index}": rows.sh_dc[:, index] for index in range(3)}
    by_channel = rows.sh_rest.transpose(0, 2, 1).reshape(len(rows), -1)
    columns |= {f"f_rest_{index}": by_channel[:, index] for index in range(by_channel.shape[1])}
    columns |= {"opacity": rows.opacity_logits}
    columns |= {f"scale_{index}": rows.log_scales[:, index] for index in range(3)}
    columns |= {f"rot_{index}": rows.quats[:, index] for index in range(4)}
    if rows.faces is not None:
        columns[_BINDING] = rows.faces
    write_columns(path, columns, [VIEWER_COMMENT] if rotate else [])


def full_degree(rows: StoredGaussians, degree: int = 3) -> StoredGaussians:
    """The same Gaussians padded with zeros to all harmonics of a degree, for readers that expect all of them."""
    missing = (degree + 1) ** 2 - 1 - rows.sh_rest.shape[1]
    return dataclasses.replace(rows, sh_rest=np.pad(rows.sh_rest, ((0, 0), (0, max(missing, 0)), (0, 0))))
