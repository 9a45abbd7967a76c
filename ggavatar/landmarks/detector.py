"""Detection of the most prominent face of a frame, with the short-range detector of the face landmarker bundle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.landmarks.bundle import load_network

INPUT_SIZE = 128
"""Side of the network's input, px."""

MINIMUM_SCORE = 0.5
"""Detections with a lower score are discarded."""

MINIMUM_OVERLAP = 0.3
"""Intersection over union from which detections are averaged with the best one."""

MAXIMUM_FACES = 8
"""Most faces that are told apart in one frame."""

WINDOW_FRACTIONS = (0.5, 0.28)
"""Sides of the windows in which small faces are searched, as fractions of the frame's longer side.

The network detects faces from about an eighth of its input on.
"""


@dataclass(frozen=True)
class FaceBox:
    """A detected face.

    Attributes:
        center: Center (x, y) of the box, px.
        side: Longer side of the box, px.
        roll: Angle from the image's x axis to the line from the subject's right to left eye, rad.
        score: Confidence in [0, 1].
    """

    center: tuple[float, float]
    side: float
    roll: float
    score: float

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the box, px."""
        (x, y), half = self.center, self.side / 2
        return float(x - half), float(y - half), float(x + half), float(y + half)


class FaceDetector:
    """The detector network. Not thread-safe: OpenCV networks store their input."""

    def __init__(self, path: Path) -> None:
        """Load the network from the face landmarker bundle or from a file of its own."""
        self._network = load_network(path, "detector")
        self._anchors = _anchors()

    def detect(self, frame: UInt8[np.ndarray, "H W 3"], near: tuple[float, float] | None = None) -> FaceBox | None:
        """The best face of an RGB frame, or None.

        Args:
            frame: The frame.
            near: If several faces are found, the one nearest to this place (px) is returned; None returns the most
                prominent one.
        """
        faces = self.detect_all(frame)
        if near is not None and faces:
            return min(faces, key=lambda face: np.hypot(face.center[0] - near[0], face.center[1] - near[1]))
        return faces[0] if faces else None

    def detect_all(self, frame: UInt8[np.ndarray, "H W 3"]) -> list[FaceBox]:
        """All faces of an RGB frame, the most prominent one first.

        The whole frame is searched first; if no face is found, overlapping windows are searched for small ones.
        """
        found = self._in_window(frame, (0, 0, frame.shape[1], frame.shape[0]))
        for fraction in WINDOW_FRACTIONS:
            if found:
                return found
            windows = _windows(frame.shape[1], frame.shape[0], fraction)
            found = _distinct([face for window in windows for face in self._in_window(frame, window)])
        return found

    def _in_window(self, frame: np.ndarray, window: tuple[int, int, int, int]) -> list[FaceBox]:
        left, top, width, height = window
        scale = INPUT_SIZE / max(width, height)
        cut = frame[top : top + height, left : left + width]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        canvas = np.zeros((INPUT_SIZE, INPUT_SIZE, 3), np.uint8)
        canvas[: size[1], : size[0]] = cv2.resize(cut, size, interpolation=cv2.INTER_AREA)
        found = []
        for score, box, eyes in self._detections(canvas):
            low, high = box[:2] / scale, box[2:] / scale
            across = eyes[1] - eyes[0]
            center = (low + high) / 2
            roll = float(np.arctan2(across[1], across[0]))
            found.append(FaceBox((left + center[0], top + center[1]), float(max(high - low)), roll, score))
        return found

    def _detections(self, canvas: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Score, box (two corners) and eye positions of every face, in px of the network's input, the best first.

        Box and eyes are averaged over all detections that overlap with the best one of the face.
        """
        blob = cv2.dnn.blobFromImage(canvas, 1 / 127.5, mean=(127.5, 127.5, 127.5))
        self._network.setInput(blob)
        logits, offsets = self._network.forward(("classificators", "regressors"))
        scores = 1 / (1 + np.exp(-np.clip(logits.reshape(-1), -50, 50)))
        offsets = offsets.reshape(-1, 16)
        likely = np.flatnonzero(scores >= MINIMUM_SCORE)
        center, half = self._anchors[likely] + offsets[likely, :2], offsets[likely, 2:4] / 2
        boxes = np.concatenate((center - half, center + half), axis=1)
        eyes = offsets[likely, 4:8].reshape(-1, 2, 2) + self._anchors[likely, None]
        left = scores[likely].copy()
        found: list[tuple[float, np.ndarray, np.ndarray]] = []
        while len(found) < MAXIMUM_FACES and left.max(initial=0.0) > 0:
            top = int(np.argmax(left))
            weights = left * (_overlap(boxes[top], boxes) > MINIMUM_OVERLAP)
            score = float(left[top])
            left[weights > 0] = 0.0
            left[top] = 0.0
            weights /= weights.sum()
            found.append((score, weights @ boxes, np.einsum("n,nij->ij", weights, eyes)))
        return found


def _anchors() -> Float[np.ndarray, "896 2"]:
    """Centers that the regressed offsets refer to, px: two per cell of a 16 × 16 grid, then six of an 8 × 8 grid."""
    rows = []
    for cells, repeats in ((16, 2), (8, 6)):
        y, x = np.mgrid[:cells, :cells]
        centers = (np.stack((x, y), axis=-1).reshape(-1, 2) + 0.5) * (INPUT_SIZE / cells)
        rows.append(np.repeat(centers, repeats, axis=0))
    return np.concatenate(rows)


def _overlap(box: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Intersection over union of one box with others."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    common = np.clip(high - low, 0, None).prod(axis=1)
    return common / (np.prod(box[2:] - box[:2]) + (others[:, 2:] - others[:, :2]).prod(axis=1) - common)


def _distinct(faces: list[FaceBox]) -> list[FaceBox]:
    """Faces found in overlapping windows, each once, the largest and most confident first.

    A window's border may cut a face; the part that is found there has its center in the whole one.
    """
    kept: list[FaceBox] = []
    for face in sorted(faces, key=lambda each: -each.score * each.side):
        centers = np.array([other.center for other in kept]).reshape(-1, 2)
        sides = np.array([other.side for other in kept])
        if not (np.abs(centers - face.center).max(axis=1, initial=0) < (sides + face.side) / 4).any():
            kept.append(face)
    return kept


def _windows(width: int, height: int, fraction: float) -> list[tuple[int, int, int, int]]:
    """Square windows (left, top, width, height) that cover the frame with half overlap.

    Their side is `fraction` of the frame's longer side, at most the shorter one.
    """
    side = max(1, min(round(max(width, height) * fraction), width, height))

    def starts(length: int) -> list[int]:
        count = max(1, int(np.ceil((length - side) / (side / 2))) + 1)
        return [round(start) for start in np.linspace(0, length - side, count)]

    return [(left, top, side, side) for top in starts(height) for left in starts(width)]
