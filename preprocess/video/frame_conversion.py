"""What makes a decoded video frame upright, with square pixels, in 8-bit sRGB; or the reason why nothing does."""

from __future__ import annotations

import shlex
import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.image_header import MAX_PIXELS
from ggavatar.pictures.color import ColorConversion, UnsupportedColorError, conversion_to_srgb, tagged_color_space
from ggavatar.pictures.orientation import UPRIGHT, Orientation, matrix_orientation

_UNSTATED = 2
_BT601, _BT709 = 5, 1
_SWSCALE_MATRICES = {0: _BT601, 1: _BT709, 2: _BT601, 4: 4, 5: _BT601, 6: _BT601, 7: 7, 9: 9}
"""swscale's name of the Y'CbCr matrix by code point of ITU-T H.273, table 4; unstated is BT.601, as in ffmpeg."""
_FULL_RANGE = 2
_ASPECT_TOLERANCE = 0.005
"""Deviation from square pixels that is left alone: 1 in 200 comes from rounded display sizes, not from a squeeze."""
_SQUEEZES = (Fraction(1, 8), Fraction(8))


class FrameColors(NamedTuple):
    """What a video states about its colors, as code points of ITU-T H.273.

    Attributes:
        matrix: From R'G'B' to Y'CbCr.
        full_range: Whether black is 0; None if not stated.
        primaries: Primaries.
        transfer: Transfer curve.
    """

    matrix: int
    full_range: bool | None
    primaries: int
    transfer: int


@dataclass(frozen=True)
class FrameConversion:
    """How frames of one kind are converted.

    Attributes:
        orientation: What makes the stored pixels upright.
        turned: Width and height once upright, px.
        size: Width and height with square pixels, px.
        matrix: swscale's name of the Y'CbCr matrix.
        full_range: Whether black is stated to be 0; None if nothing is stated.
        color: The conversion to sRGB; None where the values are sRGB values.
        notes: What is found and what is done, in words.
    """

    orientation: Orientation
    turned: tuple[int, int]
    size: tuple[int, int]
    matrix: int
    full_range: bool | None
    color: ColorConversion | None
    notes: tuple[str, ...]

    def image(self, frame: Any) -> UInt8[np.ndarray, "H W 3"]:
        """Upright 8-bit sRGB with square pixels."""
        if self.color is None:
            return self._square(self._rgb(frame, "rgb24"))
        return self._square(self.color.apply(self._rgb(frame, "rgb48le")))

    def alpha(self, frame: Any) -> UInt8[np.ndarray, "H W"]:
        """The alpha channel of a frame that has one, upright with square pixels."""
        return self._square(self._rgb(frame, "rgba")[..., 3])

    def _rgb(self, frame: Any, pixels: str) -> np.ndarray:
        """Stored pixels as full-range RGB.

        Older PyAV ignores matrix and range unless the destination's matrix differs from the source's; RGB has none, so
        that the name given here changes nothing else.
        """
        range_ = {} if self.full_range is None else {"src_color_range": 2 if self.full_range else 1}
        other = _BT601 if self.matrix == _BT709 else _BT709
        return frame.to_ndarray(
            format=pixels, src_colorspace=self.matrix, dst_colorspace=other, dst_color_range=_FULL_RANGE, **range_
        )

    def _square(self, stored: np.ndarray) -> np.ndarray:
        image = self.orientation.apply(stored)
        if self.size == self.turned:
            return image
        import cv2

        return cv2.resize(image, self.size, interpolation=cv2.INTER_LANCZOS4)


def frame_conversion(
    path: Path, frame: Any, colors: FrameColors, aspect: Fraction, peak: float | None = None
) -> FrameConversion:
    """The conversion that a frame needs.

    Args:
        path: The video, for messages.
        frame: The decoded frame.
        colors: What is stated about its colors.
        aspect: Width of a stored pixel by its height.
        peak: Peak luminance of PQ content, cd/m²; None if not stated.

    Raises:
        InputError: An orientation, a pixel shape or colors that cannot be converted.
    """
    orientation = _orientation(path, _display_matrix(frame))
    turned = orientation.size(frame.width, frame.height)
    size = _square_size(path, turned, 1 / aspect if orientation.transposed else aspect)
    color = _color(path, frame, colors, peak)
    notes = []
    if orientation != UPRIGHT:
        notes.append(f"frames are {orientation.words}, as the video's display matrix says")
    if size != turned:
        notes.append(
            f"pixels of shape {aspect.numerator}:{aspect.denominator} are made square: frames of "
            f"{turned[0]}×{turned[1]} px become {size[0]}×{size[1]} px"
        )
    if color is not None:
        notes.append(color.words)
    elif max((part.bits for part in frame.format.components), default=8) > 8:
        notes.append("samples of more than 8 bits are rounded to 8")
    matrix = _SWSCALE_MATRICES[colors.matrix]
    return FrameConversion(orientation, turned, size, matrix, colors.full_range, color, tuple(notes))


def frame_colors(frame: Any, context: Any) -> FrameColors:
    """What a frame states about its colors, else what its stream states.

    Args:
        frame: The decoded frame.
        context: The codec context of the stream in the container.
    """
    matrix, primaries, transfer = (
        _stated(frame, context, name) for name in ("colorspace", "color_primaries", "color_trc")
    )
    range_ = frame.color_range or context.color_range
    return FrameColors(matrix, (range_ == _FULL_RANGE) if range_ in (1, 2) else None, primaries, transfer)


def _display_matrix(frame: Any) -> bytes | None:
    """The display matrix of a frame: nine 32-bit integers in this machine's byte order, or None."""
    found = frame.side_data.get("DISPLAYMATRIX")
    return None if found is None else bytes(found)


def _stated(frame: Any, context: Any, name: str) -> int:
    """A code point of the frame or, where it is not stated, of the stream; older PyAV has some only there."""
    found = getattr(frame, name, _UNSTATED)
    return int(getattr(context, name, _UNSTATED) if found == _UNSTATED else found)


def stated_peak(frame: Any) -> float | None:
    """The peak that PQ content states, cd/m²: its brightest pixel (MaxCLL), else its mastering display."""
    light = frame.side_data.get("CONTENT_LIGHT_LEVEL")
    if light is not None and len(bytes(light)) >= 4:
        brightest = float(struct.unpack_from("=I", bytes(light))[0])
        if brightest > 0:
            return brightest
    mastering = frame.side_data.get("MASTERING_DISPLAY_METADATA")
    if mastering is not None and len(bytes(mastering)) >= 88:
        # AVMasteringDisplayMetadata: eight rationals of chromaticities, then those of least and greatest luminance.
        *_, numerator, denominator, _primaries, has_luminance = struct.unpack_from("=22i", bytes(mastering))
        if has_luminance and numerator > 0 and denominator > 0:
            return numerator / denominator
    return None


def _orientation(path: Path, matrix: bytes | None) -> Orientation:
    if matrix is None or len(matrix) < 36:
        return UPRIGHT
    found = matrix_orientation(struct.unpack_from("=9i", matrix))
    if found is None:
        raise InputError(
            f"{path}: the video's display matrix turns it by other than a right angle, or distorts it; make it upright "
            f"with: ffmpeg -i {shlex.quote(str(path))} -crf 12 upright.mp4"
        )
    return found


def _square_size(path: Path, turned: tuple[int, int], aspect: Fraction) -> tuple[int, int]:
    """The size with square pixels; the squeezed side is enlarged, so that no detail is lost."""
    if not _SQUEEZES[0] <= aspect <= _SQUEEZES[1]:
        raise InputError(
            f"{path}: the video states pixels of {aspect.numerator}:{aspect.denominator}, which cannot be; if they are "
            f"square, run: ffmpeg -i {shlex.quote(str(path))} -vf setsar=1 -crf 12 square.mp4"
        )
    if abs(aspect - 1) <= _ASPECT_TOLERANCE:
        return turned
    width, height = turned
    size = (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(
            f"{path}: expected at most {MAX_PIXELS // 1_000_000} megapixels, found {size[0]}×{size[1]} px with square "
            "pixels; scale the video down with ffmpeg"
        )
    return size


def _color(path: Path, frame: Any, colors: FrameColors, peak: float | None) -> ColorConversion | None:
    """The conversion to sRGB, after checking that swscale can undo the matrix."""
    dolby = any(str(part.type.name).startswith("DOVI") for part in frame.side_data)
    if dolby and colors.transfer == _UNSTATED:
        raise InputError(
            f"{path}: Dolby Vision without an HDR10 or HLG picture (profile 5), which cannot be converted; record or "
            "export the video as SDR or HLG"
        )
    try:
        if colors.matrix not in _SWSCALE_MATRICES:
            raise UnsupportedColorError(f"the Y'CbCr matrix with code point {colors.matrix} of ITU-T H.273")
        return conversion_to_srgb(tagged_color_space(colors.primaries, colors.transfer, peak))
    except UnsupportedColorError as error:
        raise InputError(
            f"{path}: the video states {error}, which cannot be converted to sRGB; convert it with an ffmpeg that has "
            f"zscale: ffmpeg -i {shlex.quote(str(path))} -vf "
            "zscale=matrix=709:primaries=709:transfer=709,format=yuv420p -crf 12 converted.mp4"
        ) from error
