"""Matrices from linear RGB of other primaries to that of sRGB (which has the primaries of BT.709)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Chromaticities = tuple[float, ...]
"""The xy of red, green, blue and white: eight numbers."""

_D65, _C = (0.3127, 0.3290), (0.310, 0.316)
BT709 = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, *_D65)
BT2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65)

PRIMARIES: dict[int, tuple[str, Chromaticities]] = {
    1: ("BT.709", BT709),
    4: ("BT.470 M", (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, *_C)),
    5: ("BT.601 (625 lines)", (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_D65)),
    6: ("BT.601 (525 lines)", (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65)),
    7: ("SMPTE 240M", (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65)),
    8: ("film", (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *_C)),
    9: ("BT.2020", BT2020),
    11: ("DCI-P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351)),
    12: ("Display P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65)),
    22: ("EBU 3213-E", (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *_D65)),
}
"""Name and chromaticities by the code points of ITU-T H.273, table 2, which videos and PNG use."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def rgb_to_xyz(chromaticities: Chromaticities) -> Float[np.ndarray, "3 3"]:
    """The matrix from linear RGB to CIE XYZ, white at Y = 1 (SMPTE RP 177).

    Raises:
        ValueError: The primaries do not span a triangle, or no chromaticities at all.
    """
    x, y = np.array(chromaticities, dtype=np.float64).reshape(4, 2).T
    if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.abs(y) > 1e-6).all()):
        raise ValueError(f"no chromaticities: {chromaticities}")
    columns = np.stack((x / y, np.ones(4), (1 - x - y) / y))
    if abs(np.linalg.det(columns[:, :3])) < 1e-6:
        raise ValueError(f"the primaries lie on a line: {chromaticities}")
    return columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3])


def matrix_to_srgb(chromaticities: Chromaticities) -> Float[np.ndarray, "3 3"]:
    """The matrix from linear RGB of these primaries to linear sRGB; another white is adapted (Bradford).

    Raises:
        ValueError: The primaries do not span a triangle.
    """
    source, target = rgb_to_xyz(chromaticities), rgb_to_xyz(BT709)
    white = _BRADFORD @ target.sum(axis=1) / (_BRADFORD @ source.sum(axis=1))
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(white) @ _BRADFORD
    return np.linalg.inv(target) @ adapted @ source


def is_srgb(chromaticities: Chromaticities) -> bool:
    """Whether these are the primaries of sRGB within the rounding of files."""
    return bool(np.abs(np.subtract(chromaticities, BT709)).max() < 0.002)
