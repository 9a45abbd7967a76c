"""Transfer curves: how numbers in a picture become light, in float64.

Sources: IEC 61966-2-1 (sRGB); Recommendation ITU-R BT.2100-2, table 4 (PQ, also SMPTE ST 2084) and table 5 (HLG).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_M1, _M2 = 2610 / 16384, 2523 / 4096 * 128
_C1, _C2, _C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
PQ_PEAK = 10_000.0
"""Luminance of the PQ signal 1, cd/m²."""

_A = 0.17883277
_B, _C = 1 - 4 * _A, 0.5 - _A * np.log(4 * _A)
HLG_PEAK = 1000.0
"""Nominal peak luminance of an HLG display, cd/m²; the system gamma is 1.2 there."""
HLG_GAMMA = 1.2


def srgb_to_linear(signal: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Relative luminance in [0, 1] of sRGB values in [0, 1]."""
    return np.where(signal <= 0.04045, signal / 12.92, ((np.maximum(signal, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """The sRGB values in [0, 1] of relative luminance in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def pq_to_luminance(signal: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Luminance in cd/m² of PQ values in [0, 1]: the EOTF."""
    power = np.maximum(signal, 0.0) ** (1 / _M2)
    return PQ_PEAK * (np.maximum(power - _C1, 0.0) / (_C2 - _C3 * power)) ** (1 / _M1)


def luminance_to_pq(luminance: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """PQ values in [0, 1] of luminance in cd/m²: the inverse EOTF."""
    power = (np.maximum(luminance, 0.0) / PQ_PEAK) ** _M1
    return ((_C1 + _C2 * power) / (1 + _C3 * power)) ** _M2


def hlg_to_scene(signal: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Scene light in [0, 1] of HLG values in [0, 1]: the inverse OETF."""
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((np.maximum(signal, 0.5) - _C) / _A) + _B) / 12)
