"""Bilinear interpolation in stacks of 8-bit maps, with derivatives."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, Int8


def bilinear(
    maps: Int8[np.ndarray, "T H W"], frames: Int[np.ndarray, " K"], positions: Float[np.ndarray, "K P 2"]
) -> tuple[Float[np.ndarray, "K P"], Float[np.ndarray, "K P 2"], Bool[np.ndarray, "K P"]]:
    """Interpolated values and their derivatives with respect to position.

    Args:
        maps: One per frame.
        frames: Which maps are read.
        positions: x and y in px of the maps, pixel centers at +0.5.

    Returns:
        Values, extrapolated outside of the map; their derivatives with respect to x and y, per px of the map; and
        whether the position lies between pixel centers.
    """
    height, width = maps.shape[1:]
    centered = positions - 0.5
    corner = np.floor(centered).astype(int)
    within = np.all((corner >= 0) & (corner < [width - 1, height - 1]), axis=-1)
    x, y = np.clip(corner[..., 0], 0, width - 2), np.clip(corner[..., 1], 0, height - 2)
    u, v = (centered[..., 0] - x).astype(np.float32), (centered[..., 1] - y).astype(np.float32)
    rows = frames[:, None]
    upper, upper_right = maps[rows, y, x].astype(np.float32), maps[rows, y, x + 1].astype(np.float32)
    lower, lower_right = maps[rows, y + 1, x].astype(np.float32), maps[rows, y + 1, x + 1].astype(np.float32)
    top, bottom = upper + u * (upper_right - upper), lower + u * (lower_right - lower)
    across = (1 - v) * (upper_right - upper) + v * (lower_right - lower)
    return top + v * (bottom - top), np.stack((across, bottom - top), axis=-1), within
