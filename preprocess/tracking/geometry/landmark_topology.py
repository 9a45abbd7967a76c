"""Index sets of MediaPipe's 478 landmarks, and weights that say which of them are rigid and stable on the skin."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ggavatar.landmarks.bundle import CanonicalFace

MESH_POINTS = 468
"""Number of landmarks on the skin; those after them lie on the irises."""


def _indices(text: str) -> np.ndarray:
    return np.array(text.split(), dtype=np.int64)


# Lid margins from the outer corner over the upper lid to the inner corner, and back along the lower lid.
RIGHT_UPPER_LID = _indices("33 246 161 160 159 158 157 173 133")
RIGHT_LOWER_LID = _indices("33 7 163 144 145 153 154 155 133")
LEFT_UPPER_LID = _indices("263 466 388 387 386 385 384 398 362")
LEFT_LOWER_LID = _indices("263 249 390 373 374 380 381 382 362")
# Margins of the lips from the subject's right to left corner.
UPPER_LIP_MARGIN = _indices("78 191 80 81 82 13 312 311 310 415 308")
LOWER_LIP_MARGIN = _indices("78 95 88 178 87 14 317 402 318 324 308")
OUTER_LIPS = _indices("61 146 91 181 84 17 314 405 321 375 291 409 270 269 267 0 37 39 40 185")
BROWS = _indices("70 63 105 66 107 46 53 52 65 55 300 293 334 296 336 276 283 282 295 285")
EYE_CORNERS = _indices("33 133 362 263")
RIGHT_IRIS, LEFT_IRIS = _indices("468 469 470 471 472"), _indices("473 474 475 476 477")

NOSE_BASE_HEIGHT = -0.012
"""Height of the nose's base in the canonical face, m; landmarks below it move with mouth and jaw."""


def lids() -> np.ndarray:
    """Indices of all landmarks of the four lid margins."""
    return np.unique(np.concatenate((RIGHT_UPPER_LID, RIGHT_LOWER_LID, LEFT_UPPER_LID, LEFT_LOWER_LID)))


def surface_stability(face: CanonicalFace) -> Float[np.ndarray, " 468"]:
    """Weight of each landmark by how well it stays on its point of the skin: 1 in the face's middle, 0.1 at its edge.

    It falls from 5 to 6.5 cm off the midline. The network puts the outermost landmarks where the cheek turns away from
    the camera: they slide when the head nods, which hides a quarter of the pitch
    (docs/experiments/2026-11-22-preparation-round-2.md).
    """
    return 1 - 0.9 * np.clip((np.abs(face.vertices[:, 0]) - 0.05) / 0.015, 0.0, 1.0)


def rigidity(face: CanonicalFace) -> Float[np.ndarray, " 468"]:
    """Weight of each landmark as a point fixed to the skull: 1 on forehead, nose and temples, 0.05 on mouth and jaw."""
    weights = np.where(face.vertices[:, 1] > NOSE_BASE_HEIGHT, 1.0, 0.05)
    weights[lids()] = 0.3
    weights[BROWS] = 0.2
    weights[EYE_CORNERS] = 1.0
    return weights
