"""Reader of PlayCanvas' compressed PLY: 16 bytes per Gaussian, in chunks of 256 that share their ranges.

Elements: `chunk` (float ranges of positions, logarithms of scales and, but for older files, colors), `vertex` (four
packed 32-bit words) and, with harmonics, `sh` (bytes). Axes are those of the PLY it was made from.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.ply import Header, read_columns, read_table
from ggavatar.formats.splats.quaternion_packing import quats_from_smallest
from ggavatar.formats.splats.stored_gaussians import StoredGaussians
from ggavatar.gaussians.initial_colors import SH_C0

CHUNK_ROWS = 256
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_ADVICE = "compress it again with splat-transform"


def is_compressed(header: Header) -> bool:
    """Whether a PLY file is a compressed one."""
    return "vertex" in header.elements and _PACKED[0] in header.elements["vertex"].properties


def decompress(path: Path, header: Header) -> StoredGaussians:
    """The Gaussians of a compressed PLY file, in its axes.

    Raises:
        InputError: An element or a property is missing, of another type, or of another length than it must be.
    """
    table, chunks = read_table(path, header, "vertex"), read_table(path, header, "chunk")
    kinds = header.elements["vertex"].properties
    wrong = [name for name in _PACKED if kinds.get(name) not in ("u4", "i4")]
    if wrong:
        raise InputError(f"{path}: expected the property {wrong[0]} as uint, found none or another type; {_ADVICE}")
    if len(chunks) != -(-len(table) // CHUNK_ROWS):
        raise InputError(
            f"{path}: expected {-(-len(table) // CHUNK_ROWS)} chunks for {len(table)} Gaussians, found {len(chunks)}; "
            f"{_ADVICE}"
        )
    position, rotation, scale, color = (table[name].astype(np.uint32) for name in _PACKED)
    chunk = np.arange(len(table)) // CHUNK_ROWS
    bytes_ = np.stack([_unit(color, shift, 8) for shift in (24, 16, 8, 0)], axis=1)
    rgb = bytes_[:, :3]
    if "min_r" in header.elements["chunk"].properties:
        rgb = _in_range(path, chunks, chunk, "{}_r {}_g {}_b", rgb)
    with np.errstate(divide="ignore", over="ignore"):
        logits = np.log(bytes_[:, 3]) - np.log1p(-bytes_[:, 3])
        sh_dc = ((rgb - 0.5) / SH_C0).astype(np.float32)
    return StoredGaussians(
        means=_in_range(path, chunks, chunk, "{}_x {}_y {}_z", _vectors(position)),
        sh_dc=sh_dc,
        sh_rest=_harmonics(path, header, len(table)),
        opacity_logits=logits.astype(np.float32),
        log_scales=_in_range(path, chunks, chunk, "{}_scale_x {}_scale_y {}_scale_z", _vectors(scale)),
        quats=_rotations(rotation),
    )


def _unit(words: UInt[ndarray, " N"], shift: int, bits: int) -> Float[ndarray, " N"]:
    """A bit field as a number from 0 to 1."""
    limit = (1 << bits) - 1
    return ((words >> np.uint32(shift)) & np.uint32(limit)) / limit


def _vectors(words: UInt[ndarray, " N"]) -> Float[ndarray, "N 3"]:
    """11, 10 and 11 bits from the top, each as a number from 0 to 1."""
    return np.stack((_unit(words, 21, 11), _unit(words, 11, 10), _unit(words, 0, 11)), axis=1)


def _rotations(words: UInt[ndarray, " N"]) -> Float[ndarray, "N 4"]:
    """The index of the largest of wxyz in the top two bits, then the others in order, each from −√½ to √½."""
    others = np.stack([(_unit(words, shift, 10) - 0.5) * np.sqrt(2) for shift in (20, 10, 0)], axis=1)
    return quats_from_smallest(others, words >> np.uint32(30))


def _in_range(
    path: Path, chunks: ndarray, chunk: ndarray, names: str, values: Float[ndarray, "N 3"]
) -> Float[ndarray, "N 3"]:
    """Numbers from 0 to 1 in the ranges of their chunks."""
    low, high = (read_columns(path, chunks, names.format(*3 * (end,)).split()) for end in ("min", "max"))
    low, high = low.astype(np.float64)[chunk], high.astype(np.float64)[chunk]
    with np.errstate(invalid="ignore", over="ignore"):
        return (low * (1 - values) + high * values).astype(np.float32)


def _harmonics(path: Path, header: Header, count: int) -> Float[ndarray, "N K 3"]:
    """Harmonics of the element `sh`, channel by channel, −4 to 4 in 256 steps whose ends are exact."""
    if "sh" not in header.elements:
        return np.zeros((count, 0, 3), np.float32)
    table = read_table(path, header, "sh")
    size = len(header.elements["sh"].properties) // 3
    if size not in (3, 8, 15) or len(table) != count:
        raise InputError(
            f"{path}: expected 9, 24 or 45 harmonics for {count} Gaussians, found {3 * size} for {len(table)}; "
            f"{_ADVICE}"
        )
    steps = read_columns(path, table, [f"f_rest_{index}" for index in range(3 * size)])
    units = np.where(steps == 0, 0.0, np.where(steps == 255, 1.0, (steps + 0.5) / 256))
    return np.ascontiguousarray(((units - 0.5) * 8).reshape(count, 3, size).transpose(0, 2, 1), np.float32)
