"""A shaded mesh over an image. Reference: a square that is painted where it is, lit by a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from ggavatar.head.mesh_overlay import LIGHT, mesh_over

SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
PIXELS = np.array([[2.0, 10], [10, 10], [10, 2], [2, 2]])  # y points down
DEPTH = np.ones(4)
GRAY = np.full((16, 12, 3), 100, np.uint8)


def test_a_square_is_painted_where_it_is() -> None:
    found = mesh_over(GRAY, SQUARE, FACES, PIXELS, DEPTH, opacity=1.0)
    lit = np.floor((0.35 + 0.65 * LIGHT[2]) * np.array([150, 200, 255]))  # its normal is +z
    np.testing.assert_array_equal(found[3:9, 3:9], np.broadcast_to(lit, (6, 6, 3)))
    np.testing.assert_array_equal(found[12:], GRAY[12:])
    half = mesh_over(GRAY, SQUARE, FACES, PIXELS, DEPTH, opacity=0.5)
    np.testing.assert_array_equal(half[5, 5], np.round((lit + 100) / 2))


@pytest.mark.parametrize(
    ("pixels", "depth"),
    [(PIXELS * [1, -1] + [0, 12], DEPTH), (PIXELS, -DEPTH), (PIXELS * 1e9, DEPTH)],
    ids=["seen from behind", "behind the camera", "past the camera"],
)
def test_what_cannot_be_seen_is_not_painted(pixels: np.ndarray, depth: np.ndarray) -> None:
    np.testing.assert_array_equal(mesh_over(GRAY, SQUARE, FACES, pixels, depth), GRAY)


def test_the_nearer_triangle_covers_the_farther() -> None:
    tilted = SQUARE @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # faces away from the light: darker
    vertices, faces = np.concatenate((SQUARE, tilted)), np.concatenate((FACES + 4, FACES))
    pixels = np.concatenate((PIXELS, PIXELS))
    near = mesh_over(GRAY, vertices, faces, pixels, np.concatenate((DEPTH, 2 * DEPTH)), 1.0)
    far = mesh_over(GRAY, vertices, faces, pixels, np.concatenate((2 * DEPTH, DEPTH)), 1.0)
    np.testing.assert_array_equal(near, mesh_over(GRAY, SQUARE, FACES, PIXELS, DEPTH, 1.0))
    assert (far[5, 5] != near[5, 5]).any()
