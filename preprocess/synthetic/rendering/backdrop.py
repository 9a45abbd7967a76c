"""Backgrounds: a softly lit wall, or a room out of focus."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray


def backdrop(kind: str, size: int, color: tuple[float, float, float], seed: int) -> Float[ndarray, "H W 3"]:
    """Image of the background in sRGB, the same in every frame.

    Args:
        kind: "plain" or "busy".
        size: Width and height, px.
        color: Color of the wall, sRGB.
        seed: Seed of the room's furniture.
    """
    y, x = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    glow = 1.06 - 0.42 * ((x - 0.34) ** 2 + 0.8 * (y - 0.30) ** 2)
    wall = np.asarray(color)[None, None] * glow[..., None]
    image = wall if kind == "plain" else _furnish(wall, size, np.random.default_rng([seed, 8]))
    return np.clip(image, 0, 1).astype(np.float32)


def _furnish(wall: ndarray, size: int, generator: np.random.Generator) -> ndarray:
    """Shelves with books, a window, a plant and a lamp, blurred by a wide aperture."""
    canvas = wall.astype(np.float32).copy()
    _window(canvas, size)
    for shelf in (0.18, 0.38, 0.58, 0.78):
        _books(canvas, size, shelf, generator)
    for _ in range(70):
        center = (int(size * generator.normal(0.86, 0.07)), int(size * generator.normal(0.62, 0.13)))
        axes = (max(1, int(size * 0.045)), max(1, int(size * 0.014)))
        green = np.array([0.10, 0.28, 0.12]) * generator.uniform(0.5, 1.5)
        cv2.ellipse(canvas, center, axes, float(generator.uniform(0, 180)), 0, 360, tuple(float(c) for c in green), -1)
    cv2.circle(canvas, (int(0.72 * size), int(0.16 * size)), max(1, int(0.05 * size)), (1.6, 1.35, 0.95), -1)
    blurred = cv2.GaussianBlur(canvas, (0, 0), 0.016 * size)
    return (
        blurred
        + 0.010
        * cv2.GaussianBlur(generator.standard_normal((size, size, 1)).astype(np.float32), (0, 0), 0.7)[..., None]
    )


def _window(canvas: ndarray, size: int) -> None:
    """A bright window with a cross bar on the right."""
    left, right, top, bottom = (int(size * share) for share in (0.74, 0.98, 0.06, 0.52))
    canvas[top:bottom, left:right] = (1.25, 1.32, 1.40)
    bar = max(1, size // 60)
    canvas[top:bottom, (left + right - bar) // 2 : (left + right + bar) // 2] = (0.35, 0.32, 0.30)
    canvas[(top + bottom - bar) // 2 : (top + bottom + bar) // 2, left:right] = (0.35, 0.32, 0.30)


def _books(canvas: ndarray, size: int, shelf: float, generator: np.random.Generator) -> None:
    """One board of a bookshelf on the left."""
    base = int(size * shelf)
    canvas[base : base + max(1, size // 50), : int(0.42 * size)] = (0.30, 0.20, 0.13)
    place = 0
    while place < 0.40 * size:
        width = int(size * generator.uniform(0.012, 0.035)) + 1
        height = int(size * generator.uniform(0.09, 0.16))
        if generator.uniform() < 0.85:
            canvas[max(0, base - height) : base, place : place + width] = generator.uniform(0.05, 0.75, 3) ** 1.2
        place += width
