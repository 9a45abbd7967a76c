"""The eight ways in which pictures and video frames are stored turned or mirrored."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_ORIENTATION_TAG = 0x0112
_TOLERANCE = math.sin(math.radians(1.0))
_WORDS = {
    (False, False, False): "upright",
    (False, True, False): "mirrored",
    (False, True, True): "turned by 180°",
    (False, False, True): "flipped upside down",
    (True, False, False): "transposed",
    (True, True, False): "turned by 90° clockwise",
    (True, False, True): "turned by 90° counterclockwise",
    (True, True, True): "transposed along the other diagonal",
}


@dataclass(frozen=True)
class Orientation:
    """What makes the stored pixels upright: first transposing, then mirroring.

    Attributes:
        transposed: Rows become columns.
        flip_x: The left and the right side are exchanged, after transposing.
        flip_y: Top and bottom are exchanged, after transposing.
    """

    transposed: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @property
    def words(self) -> str:
        """What is done to the stored pixels, as a participle."""
        return _WORDS[self.transposed, self.flip_x, self.flip_y]

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of the upright picture from the stored ones."""
        return (height, width) if self.transposed else (width, height)

    def apply(self, stored: np.ndarray) -> np.ndarray:
        """The upright picture `[H, W, ...]`, contiguous."""
        image = stored.swapaxes(0, 1) if self.transposed else stored
        image = image[::-1] if self.flip_y else image
        return np.ascontiguousarray(image[:, ::-1] if self.flip_x else image)


UPRIGHT = Orientation()

EXIF = {
    1: UPRIGHT,
    2: Orientation(flip_x=True),
    3: Orientation(flip_x=True, flip_y=True),
    4: Orientation(flip_y=True),
    5: Orientation(transposed=True),
    6: Orientation(transposed=True, flip_x=True),
    7: Orientation(transposed=True, flip_x=True, flip_y=True),
    8: Orientation(transposed=True, flip_y=True),
}
"""Orientations by the value of EXIF's tag 0x0112 (CIPA DC-008, section 4.6.5.1)."""


def exif_orientation(block: bytes) -> Orientation:
    """The orientation in an EXIF block, from its TIFF header on; upright if it has none or is damaged."""
    try:
        order = {b"II*\0": "<", b"MM\0*": ">"}[block[:4]]
        (directory,) = struct.unpack_from(order + "I", block, 4)
        (count,) = struct.unpack_from(order + "H", block, directory)
        for index in range(count):
            tag, kind, values, value = struct.unpack_from(order + "HHIH", block, directory + 2 + 12 * index)
            if tag == _ORIENTATION_TAG and kind == 3 and values == 1:
                return EXIF.get(value, UPRIGHT)
    except (KeyError, struct.error):
        pass
    return UPRIGHT


def matrix_orientation(matrix: Sequence[int]) -> Orientation | None:
    """The orientation in a video's display matrix; None if it does more than turn by right angles and mirror.

    Args:
        matrix: The nine numbers `a b u c d v x y w` of ISO/IEC 14496-12, section 6.2.2: a stored point (p, q) is shown
            at (a·p + c·q + x, b·p + d·q + y). Translation and scale do not matter here. A matrix of zeros, which some
            programs write, is taken as upright.
    """
    a, b, c, d = (float(matrix[place]) for place in (0, 1, 3, 4))
    first, second = math.hypot(a, b), math.hypot(c, d)
    if first == 0 and second == 0:
        return UPRIGHT
    if first == 0 or second == 0 or matrix[2] != 0 or matrix[5] != 0:
        return None
    a, b, c, d = a / first, b / first, c / second, d / second
    if max(abs(b), abs(c)) <= _TOLERANCE:
        return Orientation(False, a < 0, d < 0)
    if max(abs(a), abs(d)) <= _TOLERANCE:
        return Orientation(True, c < 0, b < 0)
    return None
