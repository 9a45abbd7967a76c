"""Tracking with the user's FLAME file: writes the fit as a capture's arrays and head model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ggavatar.data.capture import Tracking
from ggavatar.errors import InputError
from ggavatar.head.flame import is_flame, load_flame
from ggavatar.landmarks.bundle import CanonicalFace
from preprocess.options import TrackingOptions
from preprocess.tracking.face.clip_fit import ClipLandmarks, estimate_camera
from preprocess.tracking.face.flame_fit import FlameFit, fit_flame, read_flame
from preprocess.tracking.face.gaze import CLOSED_LID, conjugate_gaze, eye_rotations
from preprocess.tracking.geometry.landmark_topology import LEFT_IRIS, RIGHT_IRIS
from preprocess.tracking.geometry.smoothing import penalty, pose_jitter, smooth
from preprocess.tracking.head.personal_head import EYEBALL_RADIUS
from preprocess.tracking.sequence import TrackedSequence

FACE_CUTOFF = 6.0
"""Fastest motion of expression, jaw and lids that is kept, Hz."""


def track_flame(clip: ClipLandmarks, face: CanonicalFace, path: Path, settings: TrackingOptions) -> TrackedSequence:
    """Fit a FLAME file to a clip.

    Args:
        clip: Landmarks.
        face: Canonical face.
        path: `generic_model.pkl`, `flame2023.pkl` or an npz with the same keys.
        settings: Focal length, number of expressions, smoothing.

    Raises:
        InputError: Not a FLAME file.
    """
    if not path.is_file() or not is_flame(path):
        raise InputError(
            f"{path}: expected a FLAME model (generic_model.pkl, flame2023.pkl or npz) for the built-in tracker to "
            "fit; omit --head-model to create a head model of the subject, or pass --tracking"
        )
    estimate = estimate_camera(clip, face, settings.focal, settings.smooth)
    flame = read_flame(path, face, settings.expressions)
    fit = fit_flame(clip, flame, face, estimate)
    head = flame.embedding.on_head(load_flame(path, fit.identity, expressions=settings.expressions))
    joints = (head.joint_regressor @ head.template).numpy().astype(np.float64)
    report = {
        "tracker": "built-in, FLAME",
        "focal_px": round(fit.camera.intrinsics.focal, 1),
        "reprojection_px": {"median": round(fit.residual, 3)},
        "jitter": {name: round(value, 4) for name, value in pose_jitter(fit.camera.poses).items()},
        "warnings": ["FLAME has no torso of its own: shoulders follow the head"],
    }
    return TrackedSequence(_tracking(clip, fit, joints[3:5], settings.smooth), head, report)


def _tracking(clip: ClipLandmarks, fit: FlameFit, eyes: np.ndarray, smoothed: bool) -> Tracking:
    """The fit as the arrays of a capture, in FLAME's joint order."""
    count, weights = len(clip.points), clip.found.astype(float)
    strength = penalty(FACE_CUTOFF, clip.fps) if smoothed else 0.0
    irises = clip.points[:, [LEFT_IRIS[0], RIGHT_IRIS[0]]]
    rotations = eye_rotations(irises, fit.camera.intrinsics, fit.camera.poses, eyes, EYEBALL_RADIUS)
    joints = np.zeros((count, 5, 3))
    joints[:, 2, :2] = smooth(fit.motion.jaw, weights, strength)
    coefficients = smooth(fit.motion.coefficients, weights, strength)
    visible = weights * (coefficients[:, -2:].max(axis=1) < CLOSED_LID)
    joints[:, 3:] = conjugate_gaze(rotations, visible, clip.fps, smoothed)
    return Tracking(
        intrinsics=np.tile(fit.camera.intrinsics.matrix(), (count, 1, 1)),
        world_to_camera=fit.camera.poses.matrices(),
        expression=coefficients[:, :-2],
        joint_rotations=joints,
        eyelids=np.clip(coefficients[:, -2:], 0.0, 1.0),
        translation=np.zeros((count, 3)),
        shape=fit.identity,
        landmarks=np.where(clip.found[:, None, None], clip.points, np.nan),
    )
