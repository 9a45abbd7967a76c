"""Conversion of RGB in any tagged color space to 8-bit sRGB, with one table per curve.

High dynamic range (PQ, HLG) becomes light on a display (BT.2100), is brought to the primaries of sRGB, tone-mapped by
the curve of BT.2390 so that reference white (203 cd/m², BT.2408) keeps its place in the range, and encoded as sRGB. The
curve is applied to the largest of the three channels and scales all of them, so that hue and saturation stay.

Pictures and video in standard dynamic range with the curves of BT.709, BT.601, BT.2020 or sRGB are shown alike by every
player and browser: their values are taken as sRGB values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from ggavatar.pictures.gamut import BT709, BT2020, PRIMARIES, Chromaticities, is_srgb, matrix_to_srgb, rgb_to_xyz
from ggavatar.pictures.tone_mapping import WHITE, tone_mapped
from ggavatar.pictures.transfer import (
    HLG_GAMMA,
    HLG_PEAK,
    PQ_PEAK,
    hlg_to_scene,
    linear_to_srgb,
    pq_to_luminance,
    srgb_to_linear,
)

_LEVELS = 1 << 16
_STRIP = 64
"""Rows that are converted at a time."""
_PQ, _HLG = 16, 18
_AS_SRGB = frozenset({0, 1, 2, 3, 6, 7, 11, 12, 13, 14, 15})
_GAMMAS = {4: 2.2, 5: 2.8, 8: 1.0}
_UNKNOWN_PEAK = 1000.0
"""Peak of PQ content that does not state it, cd/m²: that of the reference display in BT.2100's table 1, note 3."""


class UnsupportedColorError(ValueError):
    """A color space that cannot be converted; the message names it."""


@dataclass(frozen=True)
class ColorSpace:
    """How RGB values are meant.

    Attributes:
        transfer: Code point of ITU-T H.273, table 3; 2 if not stated.
        chromaticities: The xy of red, green, blue and white.
        gamma: Exponent of a pure power law, in place of `transfer`.
        peak: Peak luminance of PQ content, cd/m²; None if not stated.
    """

    transfer: int = 2
    chromaticities: Chromaticities = BT709
    gamma: float | None = None
    peak: float | None = None

    @property
    def is_hdr(self) -> bool:
        """Whether the values are PQ or HLG."""
        return self.transfer in (_PQ, _HLG)


def tagged_color_space(primaries: int, transfer: int, peak: float | None = None) -> ColorSpace:
    """The color space of H.273 code points, which video streams and PNG's cICP share.

    HDR without stated primaries is BT.2020, anything else BT.709.

    Raises:
        UnsupportedColorError: Primaries or a transfer curve that cannot be converted.
    """
    if transfer not in _AS_SRGB | _GAMMAS.keys() | {_PQ, _HLG}:
        raise UnsupportedColorError(f"the transfer curve with code point {transfer} of ITU-T H.273")
    hdr = transfer in (_PQ, _HLG)
    if primaries in (0, 2, 3):
        return ColorSpace(transfer, BT2020 if hdr else BT709, None, peak)
    if primaries not in PRIMARIES:
        raise UnsupportedColorError(f"the primaries with code point {primaries} of ITU-T H.273")
    return ColorSpace(transfer, PRIMARIES[primaries][1], None, peak)


@lru_cache(maxsize=16)
def conversion_to_srgb(space: ColorSpace) -> ColorConversion | None:
    """The conversion of a color space to sRGB; None where the values are sRGB values already.

    Raises:
        UnsupportedColorError: Primaries that span no triangle.
    """
    try:
        matrix = matrix_to_srgb(space.chromaticities)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise UnsupportedColorError(str(error)) from error
    power = space.gamma or _GAMMAS.get(space.transfer)
    if is_srgb(space.chromaticities) and power is None and not space.is_hdr:
        return None
    return ColorConversion(space, tuple(map(tuple, matrix.tolist())))


@dataclass(frozen=True)
class ColorConversion:
    """A conversion to 8-bit sRGB; from `conversion_to_srgb`.

    Attributes:
        space: What the values mean.
        matrix: From linear RGB of that space to linear sRGB, row by row.
    """

    space: ColorSpace
    matrix: tuple[tuple[float, ...], ...]

    @property
    def words(self) -> str:
        """What is found and what is done, for a message."""
        known = {chromaticities: name for name, chromaticities in PRIMARIES.values()}
        name = known.get(self.space.chromaticities, "other")
        if self.space.is_hdr:
            curve = "HLG" if self.space.transfer == _HLG else "PQ"
            return (
                f"HDR ({curve}, {name} primaries, peak {self._peak:.0f} cd/m²) is tone-mapped to sRGB "
                f"(BT.2390, white at {WHITE:.0f} cd/m²)"
            )
        power = self.space.gamma or _GAMMAS.get(self.space.transfer)
        curve = "" if power is None else f" and gamma {power:.3g}"
        return f"colors with {name} primaries{curve} are converted to sRGB"

    def apply(self, rgb: UInt8[np.ndarray, "H W 3"] | UInt16[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """Full-range RGB of 8 or 16 bits as 8-bit sRGB; what sRGB cannot show is clipped."""
        converted = np.empty(rgb.shape, np.uint8)
        for top in range(0, len(rgb), _STRIP):
            converted[top : top + _STRIP] = self._strip(rgb[top : top + _STRIP])
        return converted

    def _strip(self, rgb: UInt8[np.ndarray, "H W 3"] | UInt16[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """Some rows, few enough to stay in the cache."""
        light = self._tables[rgb.dtype.itemsize - 1][rgb]
        if self.space.transfer == _HLG:
            light *= self._system_gamma(light)[..., None]
        light = light @ np.array(self.matrix, np.float32).T
        if self.space.is_hdr:
            light *= self._tone_gain(light.max(axis=2))[..., None]
        np.clip(light, 0.0, 1.0, out=light)
        return _srgb_table()[np.rint(light * np.float32(_LEVELS - 1)).astype(np.uint16)]

    @property
    def _peak(self) -> float:
        """Peak of the content, cd/m²."""
        if self.space.transfer == _HLG:
            return HLG_PEAK
        return min(max(self.space.peak or _UNKNOWN_PEAK, WHITE), PQ_PEAK)

    @cached_property
    def _tables(self) -> tuple[Float32[np.ndarray, " A"], Float32[np.ndarray, " B"]]:
        """Linear light by 8-bit and by 16-bit value; white is 1, for HLG scene light."""
        curve: Callable[[np.ndarray], np.ndarray] = srgb_to_linear
        power = self.space.gamma or _GAMMAS.get(self.space.transfer)
        if power is not None:

            def curve(signal: np.ndarray) -> np.ndarray:
                return signal**power

        elif self.space.transfer == _HLG:
            curve = hlg_to_scene
        elif self.space.transfer == _PQ:

            def curve(signal: np.ndarray) -> np.ndarray:
                return pq_to_luminance(signal) / WHITE

        eight, sixteen = (curve(np.linspace(0, 1, count)).astype(np.float32) for count in (256, _LEVELS))
        return eight, sixteen

    def _system_gamma(self, scene: Float32[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "H W"]:
        """What takes HLG's scene light to a display of 1000 cd/m², in units of white: BT.2100's OOTF."""
        weights = rgb_to_xyz(self.space.chromaticities)[1].astype(np.float32)
        return np.float32(HLG_PEAK / WHITE) * (scene @ weights) ** np.float32(HLG_GAMMA - 1)

    @cached_property
    def _gains(self) -> Float32[np.ndarray, " N"]:
        """The tone curve's factor by the square root of the largest channel, which is 1 at the peak."""
        light = np.linspace(0, 1, _LEVELS) ** 2 * self._peak
        light[0] = light[1]
        return (tone_mapped(light, self._peak) / light).astype(np.float32)

    def _tone_gain(self, largest: Float32[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W"]:
        top = np.float32(self._peak / WHITE)
        inside = np.clip(largest, 0.0, top)
        gain = self._gains[np.rint(np.sqrt(inside / top) * np.float32(_LEVELS - 1)).astype(np.uint16)]
        # Beyond the peak, as a wider gamut may give, the curve stays at white.
        return gain * inside / np.maximum(largest, np.float32(1e-9))


@lru_cache(maxsize=1)
def _srgb_table() -> UInt8[np.ndarray, " N"]:
    return np.rint(255 * linear_to_srgb(np.linspace(0, 1, _LEVELS))).astype(np.uint8)
