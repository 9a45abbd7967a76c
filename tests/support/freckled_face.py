"""Images of a face whose freckles are fixed to its skin."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import Delaunay

FRECKLE = 0.0025
"""Standard deviation of a freckle, m."""


def freckled(
    face: Float[np.ndarray, "N 3"], pixels: Float[np.ndarray, "T N 2"], size: int, light: Float[np.ndarray, " T"]
) -> list[np.ndarray]:
    """RGB images of a textured face.

    Args:
        face: Points of the face, m.
        pixels: Their image positions in every frame, px.
        size: Side of the images, px.
        light: Brightness of every frame.
    """
    side, per_meter = 256, 1000
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((side, side)), FRECKLE * per_meter)
    texture = np.clip(140 + 60 * noise / noise.std(), 0, 255).astype(np.float32)
    flat = side / 2 + face[:, :2] * [per_meter, -per_meter]
    triangles = Delaunay(flat).simplices
    images = []
    for points, brightness in zip(pixels, light, strict=True):
        image = np.full((size, size), 230, np.float32)
        for triangle in triangles:
            _draw(image, texture, flat[triangle], points[triangle])
        images.append(np.repeat(np.clip(brightness * image, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    return images


def _draw(image: np.ndarray, texture: np.ndarray, source: np.ndarray, target: np.ndarray) -> None:
    """Draw one triangle of the texture at its position in the image; coordinates are px from the corner."""
    left, top = np.maximum(np.floor(target.min(axis=0)).astype(int) - 1, 0)
    right, bottom = np.minimum(np.ceil(target.max(axis=0)).astype(int) + 1, image.shape[0])
    if left >= right or top >= bottom:
        return
    here = target - [left, top] - 0.5
    inside = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillConvexPoly(inside, np.round(here * 16).astype(np.int32), 1, shift=4)
    matrix = cv2.getAffineTransform((source - 0.5).astype(np.float32), here.astype(np.float32))
    box = image[top:bottom, left:right]
    box[inside > 0] = cv2.warpAffine(texture, matrix, inside.shape[::-1])[inside > 0]
