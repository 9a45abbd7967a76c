"""Writer of `.spz` version 3 (Niantic): one gzip stream of a 16-byte header and six blocks of small integers.

Its axes are x right, y up, z to the viewer, as ours.
"""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
from numpy import ndarray

from ggavatar.formats.splats.stored_gaussians import StoredGaussians
from ggavatar.io.atomic import write_atomically

MAGIC, VERSION, FRACTION_BITS = 0x5053474E, 3, 12
MAX_SPZ_POSITION = float(1 << 23 - FRACTION_BITS)
"""Largest coordinate that 24 bits of fixed point hold, m."""
_HALF_DIAGONAL = np.sqrt(0.5)


def write_spz(path: Path, rows: StoredGaussians) -> None:
    """Write Gaussians given in our axes.

    Positions are multiples of 2⁻¹² m within ±2048 m; opacities, colors and log-scales (−10 to 5.94) are bytes,
    rotations four bytes, harmonics bytes of which 5 bits (degree 1) or 4 bits are used.
    """
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(rows), rows.degree, FRACTION_BITS, 0, 0)
    opacities = 1 / (1 + np.exp(-rows.opacity_logits.astype(np.float64)))
    blocks = (
        _positions(rows.means),
        _byte(opacities * 255),
        _byte(rows.sh_dc.astype(np.float64) * (0.15 * 255) + 127.5),
        _byte((rows.log_scales.astype(np.float64) + 10) * 16),
        _rotations(rows.quats),
        _harmonics(rows.sh_rest),
    )
    content = header + b"".join(block.tobytes() for block in blocks)
    write_atomically(path, lambda stream: stream.write(gzip.compress(content, mtime=0)))


def _byte(values: ndarray) -> ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def _positions(means: ndarray) -> ndarray:
    """Signed 24-bit little-endian fixed point."""
    limit = (1 << 23) - 1
    steps = np.rint(means.astype(np.float64) * (1 << FRACTION_BITS)).clip(-limit - 1, limit).astype("<i4")
    return np.ascontiguousarray(steps).view(np.uint8).reshape(len(means), 3, 4)[..., :3].copy()


def _rotations(quats: ndarray) -> ndarray:
    """The index of the largest component of xyzw in two bits, then sign and 9-bit magnitude of the others in order."""
    xyzw = (quats / np.linalg.norm(quats, axis=1, keepdims=True))[:, [1, 2, 3, 0]].astype(np.float64)
    largest = np.abs(xyzw).argmax(axis=1)
    rows = np.arange(len(xyzw))
    xyzw *= np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    packed = largest.astype(np.uint32)
    for index in range(4):
        magnitude = np.rint(np.abs(xyzw[:, index]) / _HALF_DIAGONAL * 511).clip(0, 511).astype(np.uint32)
        word = (packed << 10) | ((xyzw[:, index] < 0).astype(np.uint32) << 9) | magnitude
        packed = np.where(largest == index, packed, word)
    return packed.astype("<u4")


def _harmonics(rest: ndarray) -> ndarray:
    """Coefficients with the channels innermost, rounded to multiples of 8 (degree 1) or 16 steps of 1/128."""
    bucket = np.where(np.arange(rest.shape[1]) < 3, 8.0, 16.0)[:, None]
    steps = np.rint(rest.astype(np.float64) * 128) + 128
    return _byte(np.floor((steps + bucket / 2) / bucket) * bucket)
