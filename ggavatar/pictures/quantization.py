"""From computed images to stored ones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8


def to_8_bit(image: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Values in [0, 1] as 8 bits: clamped, scaled by 255 and rounded to nearest."""
    return np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
