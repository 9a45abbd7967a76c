"""Face metrics from networks that OpenCV runs: landmark error, expression distance, identity. Needs no torch."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from evaluate.metrics.network_files import NO_WEIGHTS
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.landmarks.blendshapes import NAMES
from ggavatar.landmarks.crop_region import LEFT_EYE_OUTER, RIGHT_EYE_OUTER
from ggavatar.landmarks.tracker import LandmarkTracker
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

BUNDLE = "face_landmarker"
"""MediaPipe's face landmarker, also used by ggavatar-prep: 478 landmarks and 52 expression scores."""

RECOGNIZER = "face_recognition"
"""SFace (Zhong et al. 2021): a 128-dimensional embedding of a face aligned to 112×112 px."""

FIVE_POINTS = ((33, 133), (362, 263), (4,), (61,), (291,))
"""Landmarks whose means are SFace's alignment points: the subject's right and left eye, nose, right and left mouth
corner."""

Image = UInt8[np.ndarray, "H W 3"]
Points = Float[np.ndarray, "L 2"]


class Face(NamedTuple):
    """Landmarks (px) and expression scores of the face in one image."""

    points: Points
    expression: Float[np.ndarray, " E"]


class FaceValues(NamedTuple):
    """Face metrics of one pair of images.

    Attributes:
        values: Values by metric name; absent, never zero, where no face was found in one of the two.
        landmark_error: Prediction minus ground truth, in units of the ground truth's eye distance; None if no face was
            found in one of the two.
    """

    values: dict[str, float]
    landmark_error: Points | None


class FaceMetrics:
    """The face metrics of a protocol: loaded once, usable from any thread.

    Attributes:
        missing: Metrics that cannot be measured, with the reason.
        hashes: SHA-256 of the network files by name.
    """

    def __init__(self, names: Sequence[str], models: ModelFinder) -> None:
        """Load the networks of the metrics `names` that can be found or fetched."""
        bundle, reason = _find(models, BUNDLE)
        self.missing = dict.fromkeys(names, reason) if reason else {}
        recognizer = None
        if "identity" in names and bundle:
            recognizer, reason = _find(models, RECOGNIZER)
            self.missing |= {"identity": reason} if reason else {}
        self._names = [name for name in names if name not in self.missing]
        used = [bundle] * bool(self._names) + [recognizer] * ("identity" in self._names)
        self.hashes = {f"faces/{path.name}": sha256_of(path) for path in used if path}
        self._finder = LandmarkTracker(bundle) if bundle and self._names else None
        self._recognizer: Any = _recognizer(recognizer) if recognizer and "identity" in self._names else None
        self._lock = threading.Lock()

    def measure(self, prediction: Image, truth: Image) -> FaceValues:
        """Face metrics of one pair of images."""
        if not self._names:
            return FaceValues({}, None)
        with self._lock:
            predicted, real = self._face(prediction), self._face(truth)
            if predicted is None or real is None:
                return FaceValues({}, None)
            values = {}
            if "identity" in self._names:
                values["identity"] = cosine(self._feature(prediction, predicted), self._feature(truth, real))
        error = landmark_error(predicted.points, real.points)
        values["landmark_distance"] = float(np.linalg.norm(error, axis=1).mean())
        values["expression_distance"] = float(np.abs(predicted.expression - real.expression).mean())
        return FaceValues({name: value for name, value in values.items() if name in self._names}, error)

    def _face(self, image: Image) -> Face | None:
        """The face in one image, independent of earlier images; None if there is none."""
        assert self._finder is not None
        self._finder.reset()
        found = self._finder.landmarks(image)
        if found is None:
            return None
        return Face(found.points, np.delete(found.blendshapes, NAMES.index("neutral")))

    def _feature(self, image: Image, face: Face) -> np.ndarray:
        aligned = self._recognizer.alignCrop(np.ascontiguousarray(image[..., ::-1]), alignment_row(face.points))
        return self._recognizer.feature(aligned).ravel().copy()


def _find(models: ModelFinder, name: str) -> tuple[Path | None, str]:
    """A network's file, or None and the reason why it cannot be had."""
    try:
        return models.find(name), ""
    except ModelUnavailable as missing:
        return None, f"{NO_WEIGHTS}: {missing}"


def alignment_row(points: Float[np.ndarray, "478 2"]) -> Float[np.ndarray, "15"]:
    """Input of OpenCV's SFace: box (left, top, width, height), five points, confidence; only the points matter."""
    five = [points[list(indices)].mean(axis=0) for indices in FIVE_POINTS]
    low, high = points.min(axis=0), points.max(axis=0)
    return np.concatenate((low, high - low, *five, [1.0])).astype(np.float32)


def landmark_error(prediction: Points, truth: Points) -> Points:
    """Prediction minus ground truth, in units of the ground truth's outer eye-corner distance."""
    eye_distance = float(np.linalg.norm(truth[RIGHT_EYE_OUTER] - truth[LEFT_EYE_OUTER]))
    return (prediction - truth) / max(eye_distance, 1e-6)


def cosine(first: Float[np.ndarray, " D"], second: Float[np.ndarray, " D"]) -> float:
    """Cosine of the angle between two embeddings, in [-1, 1]."""
    scale = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.dot(first, second)) / scale if scale > 0 else 0.0


def _recognizer(path: Path) -> Any:
    try:
        return cv2.FaceRecognizerSF.create(str(path), "")
    except cv2.error as error:
        raise InputError(f"{path}: expected an SFace network that OpenCV can read; download the file again") from error
