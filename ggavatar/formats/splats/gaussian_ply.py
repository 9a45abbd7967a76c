"""PLY files of 3D Gaussian Splatting (Kerbl et al. 2023), and of GaussianAvatars, which adds the property `binding_0`.

Values are stored before activation, harmonics channel by channel (all of red, then green, then blue). Properties are
found by name, since writers differ in their order. PlayCanvas' compressed PLY is read too (`compressed_ply`).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.activations import OpacityKind, ScaleKind, log_scales, opacity_logits
from ggavatar.formats.splats.axes import Axes, in_our_axes
from ggavatar.formats.splats.compressed_ply import decompress, is_compressed
from ggavatar.formats.splats.ply import Header, read_columns, read_header, read_table, trailing_bytes, write_columns
from ggavatar.formats.splats.sound_rows import sound_rows
from ggavatar.formats.splats.stored_gaussians import MIN_SCALE, StoredGaussians, rotate_180_about_x

VIEWER_COMMENT = "ggavatar axes: x right, y down, z away"
LAM_OFFSET = 0.02
"""Median distance (m) of a vertex offset in LAM's files; Gaussians of a head lie about 0.1 m from its center."""

_BINDING = "binding_0"
_CHANNEL_SIZES = (0, 3, 8, 15, 24)
"""Harmonics of a channel, for degree 0 to 4; of degree 4, which the renderers here do not know, 15 are used."""


def read_gaussian_ply(
    path: Path, axes: Axes = "auto", scales: ScaleKind = "auto", opacities: OpacityKind = "auto"
) -> StoredGaussians:
    """Read a PLY of 3D Gaussians, plain or compressed.

    Args:
        path: The file.
        axes: `world`: the file is in our axes, as trained. `viewer`: it is in the axes of viewers (x right, y down,
            z away) and is rotated back. `auto`: `viewer` for files that ggavatar-export has rotated and for compressed
            ones, else `world`.
        scales: `log` or `linear` (lengths); `auto` decides by the values.
        opacities: `logit` or `linear` (0 to 1); `auto` decides by the values.

    Returns:
        Gaussians in our axes; those with a binding are in the units of their triangles. What was assumed or dropped is
        in `notes`.

    Raises:
        InputError: The file is of another kind, or holds numbers that no Gaussian can have.
    """
    header = read_header(path)
    if is_compressed(header):
        if (scales, opacities) != ("auto", "auto"):
            raise InputError(f"{path}: a compressed PLY says how its numbers are meant; omit --scales and --opacities")
        return in_our_axes(sound_rows(path, decompress(path, header)), axes, is_for_viewers=True)
    table = read_table(path, header, "vertex")
    _refuse_point_clouds(path, table)
    # The scales of bound Gaussians are in triangles, so that logarithms of any sign are plausible.
    bound = _BINDING in (table.dtype.names or ())
    rows = _rows(path, table, "log" if bound and scales == "auto" else scales, opacities)
    rows = sound_rows(path, rows)
    surplus = trailing_bytes(path, header)
    behind = [f"{surplus} bytes behind its last row are ignored"] if surplus else []
    rows = dataclasses.replace(rows, notes=(*rows.notes, *behind, *_remarks(header, rows)))
    if rows.faces is not None:
        return rows
    viewer = axes == "viewer" or (axes == "auto" and VIEWER_COMMENT in header.comments)
    return rotate_180_about_x(rows) if viewer else rows


def _rows(path: Path, table: ndarray, scales: ScaleKind, opacities: OpacityKind) -> StoredGaussians:
    """The rows of a table before anything is dropped."""
    means, sh_dc = read_columns(path, table, "xyz"), read_columns(path, table, _numbered("f_dc", 3))
    flat = "scale_2" not in (table.dtype.names or ())
    logs, notes = log_scales(read_columns(path, table, _numbered("scale", 2 if flat else 3)), means, scales)
    if flat:
        logs = np.pad(logs, ((0, 0), (0, 1)), constant_values=np.log(MIN_SCALE))
        notes = (*notes, "it holds flat Gaussians (2DGS), read with a thickness of zero")
    logits, of_opacities = opacity_logits(read_columns(path, table, ["opacity"])[:, 0], opacities)
    sh_rest, of_harmonics = _harmonics(path, table)
    return StoredGaussians(
        means=means,
        sh_dc=sh_dc,
        sh_rest=sh_rest,
        opacity_logits=logits,
        log_scales=logs,
        quats=read_columns(path, table, _numbered("rot", 4)),
        faces=_faces(path, table),
        notes=(*notes, *of_opacities, *of_harmonics),
    )


def _numbered(name: str, count: int) -> list[str]:
    return [f"{name}_{index}" for index in range(count)]


def _harmonics(path: Path, table: ndarray) -> tuple[ndarray, tuple[str, ...]]:
    """Harmonics beyond the constant one [N, K, 3], and a note where some are left out."""
    found = [name for name in table.dtype.names or () if re.fullmatch(r"f_rest_\d{1,3}", name)]
    size = len(found) // 3
    if size not in _CHANNEL_SIZES or set(found) != set(_numbered("f_rest", 3 * size)):
        raise InputError(
            f"{path}: expected 0, 9, 24 or 45 properties f_rest_0, f_rest_1, … (degree 0, 1, 2 or 3), found "
            f"{len(found)}; export the file again"
        )
    used = min(size, _CHANNEL_SIZES[3])
    names = [f"f_rest_{channel * size + index}" for channel in range(3) for index in range(used)]
    rest = read_columns(path, table, names).reshape(len(table), 3, used).transpose(0, 2, 1)
    return np.ascontiguousarray(rest), ("its harmonics of degree 4 are left out",) if size > used else ()


def _faces(path: Path, table: ndarray) -> ndarray | None:
    """The triangle of every Gaussian, or None if the file has no binding."""
    if _BINDING not in (table.dtype.names or ()):
        return None
    faces = read_columns(path, table, [_BINDING])[:, 0]
    if not ((faces >= 0) & (faces < 1 << 24) & (faces == np.floor(faces))).all():
        raise InputError(f"{path}: expected indices of triangles in {_BINDING}, found other numbers; export it again")
    return faces.astype(np.int64)


def _refuse_point_clouds(path: Path, table: ndarray) -> None:
    """Raise an `InputError` for points with colors, which many viewers of splats open."""
    names: Iterable[str] = table.dtype.names or ()
    if "f_dc_0" not in names and {"x", "red", "green", "blue"} <= set(names):
        raise InputError(
            f"{path}: expected 3D Gaussians, found points with colors (red, green, blue) and neither f_dc nor scale; "
            "this is a point cloud, such as the start of a training; open its result (point_cloud.ply) instead"
        )


def _remarks(header: Header, rows: StoredGaussians) -> list[str]:
    """What a user should know of a sound file that will not look right."""
    names, found = header.elements["vertex"].properties, []
    modes = {comment.split()[-1] for comment in header.comments if comment.startswith("SplatRenderMode")}
    if "mip" in modes or any(comment.split() == ["antialiased", "1"] for comment in header.comments):
        found.append("it was trained with antialiasing (mip-splatting); here its Gaussians look a little too strong")
    could_be_lam = "nx" in names and "f_rest_0" not in names and rows.faces is None
    could_be_lam &= float(rows.sh_dc.min()) >= 0 and float(rows.sh_dc.max()) <= 1
    if could_be_lam and float(np.median(np.linalg.norm(rows.means, axis=1))) < LAM_OFFSET:
        found.append("it looks like LAM's offset.ply: offsets from a mesh, not positions, and f_dc is RGB")
    return found


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
