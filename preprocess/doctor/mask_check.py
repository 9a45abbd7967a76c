"""Whether a capture's masks can be believed, checked before anything is concluded from them; and where faces are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ggavatar.data.capture import Capture, Tracking
from ggavatar.head.model import HeadModel
from preprocess.evidence.faces import faces_in_some, local_landmark_tracker
from preprocess.masks.checks import Fault, describe, find_fault, measure_mask
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.tracking.geometry.rigid import evenly_spaced

FRAMES = 12
"""How many frames are sampled."""
MIN_AGREEMENT = 0.7
"""Fraction of frames in which a head must lie on the face to agree with the images."""
MIN_FACE_HEIGHT, MAX_FACE_HEIGHT = 0.3, 1.1
"""Height of a face relative to that of its head model, which may have a neck and shoulders."""
FLAGS: Mapping[Fault, str] = {
    "inverted": "--resume --invert-masks",
    "empty": "--masks",
    "everywhere": "--masks",
    "elsewhere": "--masks",
}
"""What to change in the ggavatar-prep command."""


def sampled_faces(capture: Capture) -> dict[int, Float[np.ndarray, "N 2"]]:
    """Landmarks by row in some rows, px: those of the tracking, or found now if the networks are on this machine."""
    rows = [int(row) for row in evenly_spaced(len(capture.frames), FRAMES)]
    landmarks = capture.tracking.landmarks
    if landmarks is not None and np.isfinite(landmarks).any():
        return {row: landmarks[row] for row in rows if np.isfinite(landmarks[row]).all()}
    return faces_in_some(local_landmark_tracker(), rows, lambda row: capture.image(capture.frames[row]))


def check_masks(capture: Capture, faces: Mapping[int, np.ndarray]) -> tuple[Fault | None, str, dict[str, Any]]:
    """What is wrong with the masks if they are not credible, the same in words, and the measures.

    Args:
        capture: The capture.
        faces: Landmarks by row, px, from `sampled_faces`.
    """
    rows = sorted({*faces, *(int(row) for row in evenly_spaced(len(capture.frames), FRAMES))})
    measures = [measure_mask(capture.mask(capture.frames[row]), faces.get(row)) for row in rows]
    fault = find_fault(measures)
    seen = [each.face for each in measures if each.face is not None]
    values = {
        "share": float(np.median([each.share for each in measures])),
        "face_covered": float(np.median(seen)) if seen else None,
    }
    return fault, "" if fault is None else describe(fault, measures), values


def lies_on_faces(
    capture: Capture, head: HeadModel, tracking: Tracking, faces: Mapping[int, np.ndarray]
) -> bool | None:
    """Whether the projected head lies where the faces are and has about their size; None without faces.

    It cannot tell a head that turns left from one that turns right, but it needs no masks.
    """
    agreed = []
    for row, face in faces.items():
        vertices = posed_vertices(head, capture.tracking, row) - capture.tracking.translation[row]
        moved = vertices + tracking.translation[row]
        pixels, depth = project(moved, tracking.intrinsics[row], tracking.world_to_camera[row])
        visible = depth > 1e-3
        if not visible.all():
            agreed.append(False)
            continue
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        center, height = (face.min(axis=0) + face.max(axis=0)) / 2, float(np.ptp(face[:, 1]))
        inside = bool(((center > low) & (center < high)).all())
        agreed.append(inside and MIN_FACE_HEIGHT < height / max(high[1] - low[1], 1e-6) < MAX_FACE_HEIGHT)
    return bool(np.mean(agreed) >= MIN_AGREEMENT) if agreed else None
