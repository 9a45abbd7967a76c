"""Color maps of per-pixel errors on a shared scale."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from jaxtyping import Float, UInt8

LIMITS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)
"""Possible upper ends of the color scale."""
COLORMAP = "inferno"


def shared_limit(errors: Iterable[Float[np.ndarray, "H W"]], quantile: float = 0.98) -> float:
    """Upper end of a shared color scale: the smallest of `LIMITS` above that quantile of every map."""
    highest = max((float(np.quantile(error, quantile)) for error in errors), default=0.0)
    return next((limit for limit in LIMITS if limit >= highest), LIMITS[-1])


def error_colors(error: Float[np.ndarray, "H W"], limit: float) -> UInt8[np.ndarray, "H W 3"]:
    """Errors as colors of a perceptually uniform scale: 0 is black, `limit` and above the brightest."""
    indices = np.clip(error / limit * 255.0 + 0.5, 0, 255).astype(np.uint8)
    return _palette()[indices]


def scale_bar(height: int, width: int) -> UInt8[np.ndarray, "H W 3"]:
    """The color scale as a horizontal bar with zero at the left."""
    return np.repeat(error_colors(np.linspace(0, 1, width, dtype=np.float32)[None], 1.0), height, axis=0)


@cache
def _palette() -> UInt8[np.ndarray, "256 3"]:
    """The 256 colors of the scale, read-only because cached."""
    import matplotlib  # half a second that a viewer without an error map can do without

    palette = (matplotlib.colormaps[COLORMAP](np.arange(256))[:, :3] * 255).round().astype(np.uint8)
    palette.setflags(write=False)
    return palette
