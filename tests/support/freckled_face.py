"""Pictures of a face whose freckles are fixed to its skin."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import Delaunay

FRECKLE = 0.0025
"""Size of a freckle, m."""


def freckled(
    face: Float[np.ndarray, "N 3"], pixels: Float[np.ndarray, "T N 2"], size: int, light: Float[np.ndarray, " T"]
) -> list[np.ndarray]:
    """RGB pictures of `size` px: triangle by triangle of `face` (m), whose points lie at `pixels`, under some light."""
    side, per_metre = 256, 1000
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((side, side)), FRECKLE * per_metre)
    texture = np.clip(140 + 60 * noise / noise.std(), 0, 255).astype(np.float32)
    flat = side / 2 + face[:, :2] * [per_metre, -per_metre]
    triangles = Delaunay(flat).simplices
    pictures = []
    for points, brightness in zip(pixels, light, strict=True):
        picture = np.full((size, size), 230, np.float32)
        for triangle in triangles:
            _draw(picture, texture, flat[triangle], points[triangle])
        pictures.append(np.repeat(np.clip(brightness * picture, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    return pictures


def _draw(picture: np.ndarray, texture: np.ndarray, source: np.ndarray, target: np.ndarray) -> None:
    """One triangle of the texture at its place in the picture; coordinates are px from the corner."""
    left, top = np.maximum(np.floor(target.min(axis=0)).astype(int) - 1, 0)
    right, bottom = np.minimum(np.ceil(target.max(axis=0)).astype(int) + 1, picture.shape[0])
    if left >= right or top >= bottom:
        return
    here = target - [left, top] - 0.5
    inside = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillConvexPoly(inside, np.round(here * 16).astype(np.int32), 1, shift=4)
    matrix = cv2.getAffineTransform((source - 0.5).astype(np.float32), here.astype(np.float32))
    box = picture[top:bottom, left:right]
    box[inside > 0] = cv2.warpAffine(texture, matrix, inside.shape[::-1])[inside > 0]
