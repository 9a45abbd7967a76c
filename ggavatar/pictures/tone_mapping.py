"""The tone curve from a bright display to a dark one: the EETF of Report ITU-R BT.2390, section 5.4.1."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ggavatar.pictures.transfer import luminance_to_pq, pq_to_luminance

WHITE = 203.0
"""Luminance that becomes white in sRGB, cd/m²: reference white of HDR in Report ITU-R BT.2408, table 1."""


def tone_mapped(luminance: Float[np.ndarray, "*N"], peak: float, target: float = WHITE) -> Float[np.ndarray, "*N"]:
    """Luminance on a display with the peak `target`, from luminance on one with the peak `peak`; all in cd/m².

    Up to the knee nothing changes; above it a Hermite spline in the PQ domain leads to the target's peak. Black is 0 on
    both displays. What is brighter than `peak` is shown as `peak`.
    """
    if peak <= target:
        return np.minimum(luminance, target)
    top, lower = luminance_to_pq(np.array([peak, target]))
    signal = np.minimum(luminance_to_pq(luminance) / top, 1.0)
    highest = lower / top
    knee = 1.5 * highest - 0.5
    t = np.clip((signal - knee) / (1 - knee), 0.0, 1.0)
    spline = (2 * t**3 - 3 * t**2 + 1) * knee + (t**3 - 2 * t**2 + t) * (1 - knee) + (-2 * t**3 + 3 * t**2) * highest
    return pq_to_luminance(np.where(signal < knee, signal, spline) * top)
