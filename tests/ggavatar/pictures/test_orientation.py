"""Orientations. References: Pillow for EXIF, and the definition of the display matrix, point by point."""

from __future__ import annotations

import io
import itertools
import math

import numpy as np
import pytest
from PIL import Image, ImageOps

from ggavatar.pictures.orientation import EXIF, UPRIGHT, exif_orientation, matrix_orientation
from tests.support.pictures import asymmetric, exif_block


@pytest.mark.parametrize("value", range(1, 9))
def test_exif_is_undone_as_pillow_does(value):
    stored = asymmetric()
    file = io.BytesIO()
    Image.fromarray(stored).save(file, "PNG", exif=b"Exif\0\0" + exif_block(value))
    expected = np.array(ImageOps.exif_transpose(Image.open(io.BytesIO(file.getvalue()))))
    np.testing.assert_array_equal(EXIF[value].apply(stored), expected)
    assert EXIF[value].size(64, 48) == expected.shape[1::-1]


def test_all_eight_differ():
    pictures = [EXIF[value].apply(asymmetric(48, 48)).tobytes() for value in EXIF]
    assert len(set(pictures)) == 8 and len({turn.words for turn in EXIF.values()}) == 8


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("value", range(1, 9))
def test_exif_in_both_byte_orders(value, order):
    assert exif_orientation(exif_block(value, order)) == EXIF[value]


def test_damaged_exif_is_upright():
    block = exif_block(6)
    for damaged in (b"", b"II", block[:9], block[:20], b"XX" + block[2:], exif_block(0), exif_block(9)):
        assert exif_orientation(damaged) == UPRIGHT
    assert exif_orientation(b"II*\0\xff\xff\xff\xff") == UPRIGHT


def shown(stored: np.ndarray, a: int, b: int, c: int, d: int) -> np.ndarray:
    """Every pixel where the display matrix puts it; the picture is moved to the origin."""
    height, width = stored.shape[:2]
    places = {(p, q): (a * p + c * q, b * p + d * q) for p in range(width) for q in range(height)}
    left, top = (min(place[axis] for place in places.values()) for axis in (0, 1))
    right, bottom = (max(place[axis] for place in places.values()) for axis in (0, 1))
    image = np.zeros((bottom - top + 1, right - left + 1, 3), np.uint8)
    for (p, q), (x, y) in places.items():
        image[y - top, x - left] = stored[q, p]
    return image


ORTHOGONAL = [
    (a, b, c, d)
    for a, b, c, d in itertools.product((-1, 0, 1), repeat=4)
    if abs(a * d - b * c) == 1 and a * c + b * d == 0 and abs(a) + abs(b) == 1
]


@pytest.mark.parametrize("linear", ORTHOGONAL)
def test_display_matrices_show_every_pixel_where_they_say(linear):
    a, b, c, d = linear
    for scale in (1 << 16, 1 << 17):
        matrix = (a * scale, b * scale, 0, c * scale, d * scale, 0, 123 << 16, -5 << 16, 1 << 30)
        found = matrix_orientation(matrix)
        assert found is not None
        np.testing.assert_array_equal(found.apply(asymmetric()), shown(asymmetric(), *linear))


def test_there_are_eight_of_them():
    assert len(ORTHOGONAL) == 8


def rotated(degrees: float) -> tuple[int, ...]:
    cosine, sine = (round(f(math.radians(degrees)) * 65536) for f in (math.cos, math.sin))
    return (cosine, sine, 0, -sine, cosine, 0, 0, 0, 1 << 30)


def test_other_angles_and_distortions_are_none():
    assert matrix_orientation(rotated(90.4)) == EXIF[6]
    assert matrix_orientation(rotated(30)) is None and matrix_orientation(rotated(92)) is None
    assert matrix_orientation((65536, 0, 0, 20000, 65536, 0, 0, 0, 1 << 30)) is None
    assert matrix_orientation((65536, 0, 5, 0, 65536, 0, 0, 0, 1 << 30)) is None
    assert matrix_orientation((65536, 0, 0, 0, 0, 0, 0, 0, 1 << 30)) is None
    assert matrix_orientation((0,) * 9) == UPRIGHT
