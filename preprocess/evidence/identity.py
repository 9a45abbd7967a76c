"""Whether the faces in two parts of a clip are of one person, judged by the shape of forehead, eyes and nose.

Landmarks with the network's depth are aligned to the average face; their mean deviation over a part is the person's
shape. In six real clips, parts of one person differ by 0.1 to 1.6 mm and different persons by 1.3 to 4.7 mm, so the
background decides which limit holds: a person who comes back in the same room may look another way.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from ggavatar.landmarks.average_face import average_face

MIN_FRAMES = 5
"""Fewest faces from which a shape is taken."""
MAX_FRAMES = 60
"""Most faces that are averaged."""
LIMIT_NEW_SCENE, LIMIT_SAME_SCENE = 1.3e-3, 1.8e-3
"""Root mean square difference of shapes, m, above which faces are of different persons."""
LOWEST, WIDEST = -0.012, 0.055
"""Landmarks above the nose's base (m) and this close to the midline (m) hardly move with mouth and jaw."""


@lru_cache(maxsize=1)
def _reference() -> tuple[Float[np.ndarray, "468 3"], Bool[np.ndarray, " 468"]]:
    """The average face, and which of its points count."""
    vertices = average_face().vertices.astype(np.float64)
    return vertices, (vertices[:, 1] > LOWEST) & (np.abs(vertices[:, 0]) < WIDEST)


def face_shape(
    points: Float[np.ndarray, "T 478 2"], depth: Float[np.ndarray, "T 478"]
) -> Float[np.ndarray, "K 3"] | None:
    """Mean deviation from the average face, m, without size and pose; None of fewer than `MIN_FRAMES` faces.

    Args:
        points: Landmarks, px.
        depth: The network's relative depth, px.
    """
    if len(points) < MIN_FRAMES:
        return None
    chosen = np.unique(np.linspace(0, len(points) - 1, min(MAX_FRAMES, len(points))).round().astype(int))
    vertices, counted = _reference()
    target = vertices[counted] - vertices[counted].mean(axis=0)
    shapes = np.concatenate((points[chosen], depth[chosen, :, None]), axis=2)[:, :468][:, counted]
    return np.mean([_aligned(shape * [1.0, -1.0, -1.0], target) - target for shape in shapes], axis=0)


def _aligned(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Points moved, turned and scaled to lie closest to a centered target (Umeyama 1991)."""
    centered = points - points.mean(axis=0)
    left, singular, right = np.linalg.svd(centered.T @ target)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = (singular * signs).sum() / (centered**2).sum()
    return scale * centered @ (left * signs) @ right


def is_same_person(first: Float[np.ndarray, "K 3"], second: Float[np.ndarray, "K 3"], same_scene: bool) -> bool:
    """Whether two shapes are of one person.

    Args:
        first: One shape.
        second: The other one.
        same_scene: Whether the background is the same.
    """
    return shape_distance(first, second) <= (LIMIT_SAME_SCENE if same_scene else LIMIT_NEW_SCENE)


def shape_distance(first: Float[np.ndarray, "K 3"], second: Float[np.ndarray, "K 3"]) -> float:
    """Root mean square distance of corresponding points, m."""
    return float(np.sqrt(((first - second) ** 2).sum(axis=1).mean()))
