"""The room's lights, the key light's shadow map, and sky visibility (ambient occlusion)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from preprocess.synthetic.rendering import room
from preprocess.synthetic.rendering.mesh import rasterize
from preprocess.synthetic.rendering.shading import Lights, Shadow

_SHADOW_SIZE, _SHADOW_SPAN = 704, 0.56
_SHADOW_CENTER = np.array([0.0, -0.03, -0.02])
_FAR = 10.0


def room_lights() -> Lights:
    """A key light from the upper left, a weak fill from the right, a rim light from behind, cool sky, warm ground."""
    directions = np.array([(-0.52, 0.50, 0.72), (0.80, 0.12, 0.60), (0.62, 0.42, -0.66)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Lights(
        directions=directions.astype(np.float32),
        colors=np.array([(1.42, 1.31, 1.18), (0.20, 0.22, 0.26), (0.55, 0.56, 0.60)], np.float32),
        sky=np.array([0.27, 0.295, 0.33], np.float32),
        ground=np.array([0.17, 0.145, 0.13], np.float32),
        camera=room.camera_position().astype(np.float32),
    )


def _map_towards(direction: ndarray, size: int, span: float, center: ndarray) -> Float[ndarray, "3 4"]:
    """Affine map from the room to column, row and depth of an orthographic view along a light's direction."""
    right = np.cross((0.0, 1.0, 0.0), direction)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(direction, right)
    scale = size / span
    rows = np.stack((right * scale, -up * scale, -direction))
    offset = np.array([size / 2, size / 2, _FAR]) - rows @ center
    return np.column_stack((rows, offset)).astype(np.float32)


def shadow_map(points: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], lights: Lights) -> Shadow:
    """Shadow map of the key light."""
    to_map = _map_towards(lights.directions[0].astype(np.float64), _SHADOW_SIZE, _SHADOW_SPAN, _SHADOW_CENTER)
    seen = points @ to_map[:, :3].T + to_map[:, 3]
    depth = rasterize(seen.astype(np.float32), faces, _SHADOW_SIZE, _SHADOW_SIZE).depth
    return Shadow(depth, to_map)


def sky_visibility(
    points: Float[ndarray, "V 3"], normals: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], directions: int = 56
) -> Float[ndarray, " V"]:
    """Cosine-weighted fraction of the hemisphere above every vertex that is not occluded (ambient occlusion).

    Args:
        points: Vertices, m.
        normals: Unit normals.
        faces: Triangles that occlude.
        directions: Number of directions to sample on the sphere.
    """
    index = np.arange(directions) + 0.5
    height = 1 - 2 * index / directions
    angle = np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    total, visible = np.full(len(points), 1e-6), np.zeros(len(points))
    for direction in np.stack((flat * np.cos(angle), height, flat * np.sin(angle)), axis=1):
        to_map = _map_towards(direction, 288, 0.60, _SHADOW_CENTER)
        lifted = points + 0.0015 * normals
        seen = lifted @ to_map[:, :3].T + to_map[:, 3]
        depth = rasterize((points @ to_map[:, :3].T + to_map[:, 3]).astype(np.float32), faces, 288, 288).depth
        column, row = (np.clip(seen[:, axis].astype(int), 0, 287) for axis in (0, 1))
        cosine = np.clip(normals @ direction, 0, None)
        total += cosine
        visible += cosine * (seen[:, 2] < depth[row, column] + 0.003)
    return visible / total
