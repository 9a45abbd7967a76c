"""Faces found by networks that OpenCV runs: landmark distance, landmark jitter and likeness. No torch."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from evaluate.weights import NO_WEIGHTS, VARIABLE, first_file, sha256_of
from ggavatar.errors import InputError

DETECTORS = ("face_detection_yunet_2023mar.onnx", "yunet_n_320_320.onnx")
"""YuNet (Wu et al. 2023), five landmarks: eyes, tip of the nose, corners of the mouth."""

RECOGNISERS = ("face_recognition_sface_2021dec.onnx",)
"""SFace (Zhong et al. 2021), 128 numbers of a face aligned to 112×112 px."""

SIDE, CONFIDENCE = 320, 0.6
Image = UInt8[np.ndarray, "H W 3"]
Landmarks = Float[np.ndarray, "5 2"]


class FaceValues(NamedTuple):
    """What the faces of one pair say.

    Attributes:
        values: Metrics by name; absent where no face was found in one of the two, never zero.
        landmark_error: Render minus truth, in distances between the truth's eyes; None without both faces.
    """

    values: dict[str, float]
    landmark_error: Landmarks | None


class FaceMetrics:
    """The metrics of faces that a protocol asks for, loaded once and used for every pair from any thread.

    Attributes:
        missing: Metrics that cannot be measured, with the reason.
        hashes: SHA-256 of the network files by name.
    """

    def __init__(self, names: Sequence[str], folders: Sequence[Path]) -> None:
        detector, recogniser = first_file(folders, DETECTORS), first_file(folders, RECOGNISERS)
        lacking = {name: DETECTORS[0] for name in names if not detector}
        if "identity" in names and not recogniser:
            lacking["identity"] = RECOGNISERS[0]
        self.missing = {
            name: f"{NO_WEIGHTS}: {file} not found; put the file into ${VARIABLE} or name --models"
            for name, file in lacking.items()
        }
        self._names = [name for name in names if name not in self.missing]
        used = [detector] * bool(self._names) + [recogniser] * ("identity" in self._names)
        self.hashes = {f"faces/{path.name}": sha256_of(path) for path in used if path}
        self._detector: Any = _detector(detector) if detector and self._names else None
        self._recogniser: Any = _recogniser(recogniser) if recogniser and "identity" in self._names else None
        self._lock = threading.Lock()

    def measure(self, prediction: Image, truth: Image) -> FaceValues:
        """Values of one pair."""
        if not self._names:
            return FaceValues({}, None)
        with self._lock:
            rows = [self._face(image) for image in (prediction, truth)]
            if rows[0] is None or rows[1] is None:
                return FaceValues({}, None)
            values = {}
            if "identity" in self._names:
                features = [self._feature(*pair) for pair in ((prediction, rows[0]), (truth, rows[1]))]
                values["identity"] = cosine(*features)
        error = landmark_error(landmarks_of(rows[0]), landmarks_of(rows[1]))
        if "landmark_distance" in self._names:
            values["landmark_distance"] = float(np.linalg.norm(error, axis=1).mean())
        return FaceValues(values, error)

    def _face(self, image: Image) -> Float[np.ndarray, "15"] | None:
        """The surest face in px of the image: box, five landmarks, confidence; None if there is none."""
        height, width = image.shape[:2]
        small = cv2.resize(image[..., ::-1], (SIDE, SIDE), interpolation=cv2.INTER_AREA)
        found = self._detector.detect(small)[1]
        if found is None:
            return None
        best = found[np.argmax(found[:, 14])].copy()
        best[0:14:2] *= width / SIDE
        best[1:14:2] *= height / SIDE
        return best

    def _feature(self, image: Image, face: np.ndarray) -> np.ndarray:
        aligned = self._recogniser.alignCrop(np.ascontiguousarray(image[..., ::-1]), face)
        return self._recogniser.feature(aligned).ravel().copy()


def landmarks_of(face: Float[np.ndarray, "15"]) -> Landmarks:
    """The five landmarks of a detected face, px."""
    return face[4:14].reshape(5, 2).astype(np.float64)


def landmark_error(prediction: Landmarks, truth: Landmarks) -> Landmarks:
    """Render minus truth in distances between the truth's eyes, so that near and far heads compare."""
    return (prediction - truth) / max(float(np.linalg.norm(truth[0] - truth[1])), 1e-6)


def jitter(errors: Sequence[Landmarks | None]) -> float | None:
    """|e[t−1] − 2 e[t] + e[t+1]| of three consecutive frames, mean over the landmarks; None if one is missing.

    A render that is merely offset, or drifts evenly, does not jitter (`evaluate.temporal.landmark_jitter`).
    """
    before, now, after = errors
    if before is None or now is None or after is None:
        return None
    return float(np.linalg.norm(before - 2 * now + after, axis=1).mean())


def cosine(first: Float[np.ndarray, " D"], second: Float[np.ndarray, " D"]) -> float:
    """Cosine of the angle between two embeddings, in [-1, 1]."""
    scale = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.dot(first, second)) / scale if scale > 0 else 0.0


def _detector(path: Path) -> Any:
    try:
        return cv2.FaceDetectorYN.create(str(path), "", (SIDE, SIDE), CONFIDENCE)
    except cv2.error as error:
        raise InputError(f"{path}: expected a YuNet face detector that OpenCV reads; get the file again") from error


def _recogniser(path: Path) -> Any:
    try:
        return cv2.FaceRecognizerSF.create(str(path), "")
    except cv2.error as error:
        raise InputError(f"{path}: expected an SFace network that OpenCV reads; get the file again") from error
