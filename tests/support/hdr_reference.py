"""HDR to sRGB for one color, in plain Python: the formulas of BT.2100-2, BT.2390-8 (5.4.1) and IEC 61966-2-1.

Written from the standards' text, apart from the code under test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

M1, M2, C1, C2, C3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
BT2020_TO_BT709 = (
    (1.660491, -0.587641, -0.072850),
    (-0.124550, 1.132900, -0.008349),
    (-0.018151, -0.100579, 1.118730),
)


def pq_signal(luminance: float) -> float:
    power = (max(luminance, 0.0) / 10000) ** M1
    return ((C1 + C2 * power) / (1 + C3 * power)) ** M2


def pq_luminance(signal: float) -> float:
    power = signal ** (1 / M2)
    return 10000 * (max(power - C1, 0) / (C2 - C3 * power)) ** (1 / M1)


def hlg_luminance(signal: Sequence[float]) -> list[float]:
    """Light of a display of 1000 cd/m²."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    scene = [e * e / 3 if e <= 0.5 else (math.exp((e - c) / a) + b) / 12 for e in signal]
    y = 0.2627 * scene[0] + 0.6780 * scene[1] + 0.0593 * scene[2]
    return [1000 * y**0.2 * e for e in scene]


def eetf(luminance: float, peak: float, target: float = 203.0) -> float:
    """BT.2390's electrical-electrical transfer function for black at 0."""
    top = pq_signal(peak)
    e1, most = min(pq_signal(luminance) / top, 1), pq_signal(target) / top
    start = 1.5 * most - 0.5
    if e1 >= start:
        t = (e1 - start) / (1 - start)
        e1 = (2 * t**3 - 3 * t**2 + 1) * start + (t**3 - 2 * t**2 + t) * (1 - start) + (-2 * t**3 + 3 * t**2) * most
    return pq_luminance(e1 * top)


def hdr_to_srgb(signal: Sequence[float], transfer: int, peak: float = 1000.0) -> list[float]:
    """R'G'B' in BT.2020, PQ (16) or HLG (18), as sRGB in [0, 1]; 203 cd/m² are sRGB's white before the curve."""
    light = hlg_luminance(signal) if transfer == 18 else [pq_luminance(e) for e in signal]
    light = [sum(weight * part for weight, part in zip(row, light, strict=True)) for row in BT2020_TO_BT709]
    largest = max(light)
    gain = eetf(largest, peak) / largest if largest > 0 else 1.0
    linear = [min(max(gain * part / 203, 0), 1) for part in light]
    return [12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055 for v in linear]
