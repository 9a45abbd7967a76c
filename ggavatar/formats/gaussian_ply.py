"""The PLY of 3D Gaussian Splatting (Kerbl et al. 2023), and GaussianAvatars' with `binding_0` beside it.

Values are stored before activation; harmonics channel by channel (all of red, then green, then blue). Names decide,
not positions: writers differ in their order.
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
from ggavatar.formats.stored_gaussians import Stored, turned

Axes = Literal["auto", "world", "viewer"]
VIEWER_NOTE = "ggavatar axes: x right, y down, z away"
FARTHEST, LARGEST_COLOR, SMALLEST_LOG, LARGEST_LOG = 1e6, 1e4, -100.0, 14.0
"""Beyond these (m, coefficients, logarithms of m) a number is damage, not a Gaussian."""
LARGEST_LOGIT = 80.0
"""Of an opacity; beyond it is 0 or 1 for certain."""

_BINDING = "binding_0"


def read_gaussian_ply(path: Path, axes: Axes = "auto") -> Stored:
    """Read a PLY of 3D Gaussians.

    Args:
        path: The file.
        axes: `world`: the Gaussians stand where the capture's cameras see them. `viewer`: they were turned for viewers
            (x right, y down, z away) and are turned back. `auto`: `viewer` for files that ggavatar-export turned.

    Returns:
        Gaussians in our axes; those with a binding are in their triangles' units.

    Raises:
        InputError: Not such a file, or numbers no Gaussian can have.
    """
    header = read_header(path)
    rest = _rest_names(path, header)
    wanted = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "scale_0", "scale_1", "scale_2"]
    table = read_columns(path, header, [*wanted, "rot_0", "rot_1", "rot_2", "rot_3", *rest])
    logits = read_columns(path, header, ["opacity"], infinite=True)[:, 0]  # of files made from bytes: 0 and 255
    rows = Stored(
        means=table[:, 0:3].copy(),
        constant=table[:, 3:6].copy(),
        rest=np.ascontiguousarray(table[:, 13:].reshape(header.count, 3, -1).transpose(0, 2, 1)),
        opacity_logits=logits.clip(-LARGEST_LOGIT, LARGEST_LOGIT),
        log_scales=table[:, 6:9].copy(),
        quats=table[:, 9:13].copy(),
        faces=_faces(path, header),
    )
    _check(path, rows)
    viewer = axes == "viewer" or (axes == "auto" and VIEWER_NOTE in header.comments)
    return turned(rows) if viewer and rows.faces is None else rows


def _rest_names(path: Path, header: Header) -> list[str]:
    """Names of the harmonics beyond the constant one, in the order of their numbers."""
    found = [name for name in header.properties if re.fullmatch(r"f_rest_\d{1,3}", name)]
    if len(found) not in (0, 9, 24, 45) or any(f"f_rest_{index}" not in found for index in range(len(found))):
        raise InputError(
            f"{path}: expected f_rest_0 … for degree 0, 1, 2 or 3 (0, 9, 24 or 45 of them), found {len(found)}; "
            "export the file again"
        )
    return [f"f_rest_{index}" for index in range(len(found))]


def _faces(path: Path, header: Header) -> ndarray | None:
    """The triangle of every Gaussian, if the file binds them."""
    if _BINDING not in header.properties:
        return None
    faces = read_columns(path, header, [_BINDING])[:, 0]
    if not ((faces >= 0) & (faces < 1 << 24) & (faces == np.floor(faces))).all():
        raise InputError(f"{path}: expected whole numbers of triangles in {_BINDING}, found others; export it again")
    return faces.astype(np.int64)


def _check(path: Path, rows: Stored) -> None:
    """Refuse numbers that only damage explains."""
    limits = {
        "positions": (rows.means, -FARTHEST, FARTHEST),
        "logarithms of scales": (rows.log_scales, SMALLEST_LOG, LARGEST_LOG),
        "colours": (rows.constant, -LARGEST_COLOR, LARGEST_COLOR),
        "harmonics": (rows.rest, -LARGEST_COLOR, LARGEST_COLOR),
        "rotations": (rows.quats, -FARTHEST, FARTHEST),
    }
    for what, (values, low, high) in limits.items():
        if values.size and not low <= float(values.min()) <= float(values.max()) <= high:
            raise InputError(
                f"{path}: expected {what} from {low:g} to {high:g}, found {float(values.min()):g} to "
                f"{float(values.max()):g}; the file is damaged or holds something else"
            )
    if float(np.linalg.norm(rows.quats, axis=1).min()) < 1e-6:
        raise InputError(f"{path}: expected rotations as quaternions, found some of length zero; export it again")


def write_gaussian_ply(path: Path, rows: Stored, viewer_axes: bool = True) -> None:
    """Write Gaussians as 3DGS does.

    Args:
        path: The file to appear, whole or not at all.
        rows: In our axes. Those bound to triangles are written as GaussianAvatars does and never turned.
        viewer_axes: Turn them so that viewers show the head upright; a comment says so.
    """
    turning = viewer_axes and rows.faces is None
    rows = turned(rows) if turning else rows
    columns = {name: rows.means[:, index] for index, name in enumerate("xyz")}
    columns |= {name: np.zeros(len(rows), np.float32) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{index}": rows.constant[:, index] for index in range(3)}
    by_channel = rows.rest.transpose(0, 2, 1).reshape(len(rows), -1)
    columns |= {f"f_rest_{index}": by_channel[:, index] for index in range(by_channel.shape[1])}
    columns |= {"opacity": rows.opacity_logits}
    columns |= {f"scale_{index}": rows.log_scales[:, index] for index in range(3)}
    columns |= {f"rot_{index}": rows.quats[:, index] for index in range(4)}
    if rows.faces is not None:
        columns[_BINDING] = rows.faces
    write_columns(path, columns, [VIEWER_NOTE] if turning else [])


def full_degree(rows: Stored, degree: int = 3) -> Stored:
    """The same Gaussians with zeros for the harmonics up to a degree, for readers that expect all of them."""
    lacking = (degree + 1) ** 2 - 1 - rows.rest.shape[1]
    return dataclasses.replace(rows, rest=np.pad(rows.rest, ((0, 0), (0, max(lacking, 0)), (0, 0))))
