"""A shaded mesh painted over an image, from back to front: for people who check a tracking, not for learning."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

LIGHT = np.array([0.3, 0.5, 0.81])
"""Direction towards the light in world axes."""
SUBPIXEL_BITS = 4
FARTHEST = 1 << 18
"""Corners farther out than this, in sixteenths of a pixel, are those of triangles that pass the camera."""
NEAREST = 1e-3
"""Triangles nearer to the camera than this are not painted, m."""


def mesh_over(
    image: UInt8[np.ndarray, "h w 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    pixels: Float[np.ndarray, "V 2"],
    depth: Float[np.ndarray, " V"],
    opacity: float = 0.65,
) -> UInt8[np.ndarray, "h w 3"]:
    """The image overlaid with a shaded mesh.

    Args:
        image: What lies below.
        vertices: In the world, m.
        faces: Corners, counterclockwise seen from outside.
        pixels: The vertices in the image, px (pixel centers at +0.5).
        depth: The vertices' distance along the camera's axis, m.
        opacity: Of the mesh, from 0 to 1.
    """
    corners = np.round((pixels[faces] - 0.5) * (1 << SUBPIXEL_BITS))
    colors = _face_colors(vertices[faces])
    facing = _signed_areas(corners) < 0
    visible = facing & (depth[faces] > NEAREST).all(axis=1) & (np.abs(corners) < FARTHEST).all(axis=(1, 2))
    painted, covered = image.copy(), np.zeros(image.shape[:2], np.uint8)
    for face in np.flatnonzero(visible)[np.argsort(-depth[faces[visible]].mean(axis=1))]:
        triangle = corners[face].astype(np.int32)
        cv2.fillConvexPoly(painted, triangle, tuple(map(float, colors[face])), cv2.LINE_8, SUBPIXEL_BITS)
        cv2.fillConvexPoly(covered, triangle, 255, cv2.LINE_8, SUBPIXEL_BITS)
    alpha = opacity * (covered[..., None] / 255)
    return np.round(painted * alpha + image * (1 - alpha)).astype(np.uint8)


def _signed_areas(corners: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, " F"]:
    """Twice the signed areas of projected faces; negative where the outside is visible (y points down)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _face_colors(corners: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F 3"]:
    """A color for every face: light blue, darker where the face is turned away from the light."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    brightness = 0.35 + 0.65 * np.clip(normals @ LIGHT, 0, 1)
    return np.trunc(brightness[:, None] * np.array([150.0, 200.0, 255.0]))
