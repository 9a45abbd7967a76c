"""478 face landmarks a frame: the region follows the face from frame to frame.

And the detector finds it again when it is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.face.blendshapes import BlendshapeNetwork
from ggavatar.face.bundle import load_network
from ggavatar.face.detector import FaceDetector

INPUT_SIZE = 256
REGION_MARGIN = 1.5
MINIMUM_PRESENCE = 0.5
RIGHT_EYE_OUTER, LEFT_EYE_OUTER = 33, 263


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of one frame.

    Attributes:
        points: Image positions, px (pixel centres at +0.5).
        depth: The network's guess of relative depth in px of the image, smaller is nearer; weak-perspective, so a hint
            only.
        blendshapes: Scores in [0, 1] in the order of `ggavatar.face.blendshapes.NAMES`.
        presence: Confidence in [0, 1] that the region shows a face.
    """

    points: Float[np.ndarray, "478 2"]
    depth: Float[np.ndarray, " 478"]
    blendshapes: Float[np.ndarray, " 52"]
    presence: float

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the landmarks, px."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


@dataclass(frozen=True)
class Region:
    """A square of the image, turned so that the eyes are level."""

    center: tuple[float, float]
    side: float
    roll: float

    def matrix(self) -> Float[np.ndarray, "2 3"]:
        """Affine map from continuous image coordinates to continuous network coordinates (0 to 256)."""
        scale = INPUT_SIZE / self.side
        cosine, sine = scale * np.cos(self.roll), scale * np.sin(self.roll)
        linear = np.array([[cosine, sine], [-sine, cosine]])
        return np.column_stack((linear, INPUT_SIZE / 2 - linear @ np.array(self.center)))


class LandmarkTracker:
    """Landmarks of a video, frame after frame. Holds the region of the last frame; `reset` forgets it at a cut."""

    def __init__(self, bundle: Path) -> None:
        self._detector = FaceDetector(bundle)
        self._network = load_network(bundle, "landmarks")
        self._blendshapes = BlendshapeNetwork(bundle)
        self._region: Region | None = None

    def reset(self) -> None:
        """Forget where the face was."""
        self._region = None

    def landmarks(self, frame: UInt8[np.ndarray, "H W 3"]) -> Landmarks | None:
        """The landmarks of the next RGB frame, or None where no face is seen."""
        found = self._tracked(frame) or self._detected(frame)
        self._region = None if found is None else _region_around(found[0])
        if found is None:
            return None
        points, depth, presence = found
        return Landmarks(points, depth, self._blendshapes.scores(points), presence)

    def _tracked(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        return None if self._region is None else self._in_region(frame, self._region)

    def _detected(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Detection, then landmarks twice: the second pass sees the region as tracking would choose it."""
        face = self._detector.detect(frame)
        if face is None:
            return None
        first = self._in_region(frame, Region(face.center, face.side * REGION_MARGIN, face.roll))
        return first and (self._in_region(frame, _region_around(first[0])) or first)

    def _in_region(self, frame: np.ndarray, region: Region) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Image points, depth and presence from one pass of the network; None when it sees no face."""
        matrix = region.matrix()
        blob = cv2.dnn.blobFromImage(_cut(frame, region, matrix), 1 / 255)
        self._network.setInput(blob)
        values, logit = self._network.forward(("Identity", "Identity_1"))
        presence = float(1 / (1 + np.exp(-np.clip(logit.reshape(()), -50, 50))))
        values = values.reshape(478, 3).astype(np.float64)
        if presence < MINIMUM_PRESENCE or not np.isfinite(values).all():
            return None
        back = cv2.invertAffineTransform(matrix)
        return values[:, :2] @ back[:, :2].T + back[:, 2], values[:, 2] * (region.side / INPUT_SIZE), presence


def _cut(frame: np.ndarray, region: Region, matrix: np.ndarray) -> np.ndarray:
    """The region as network input. A region much larger than the input is first reduced by area.

    Since bilinear sampling would alias.
    """
    # OpenCV puts pixel centres at whole numbers, so both sides are shifted by half a pixel.
    shift = np.array([0.5, 0.5])
    reduction = int(region.side // (2 * INPUT_SIZE)) + 1
    if reduction > 1:
        size = (max(1, frame.shape[1] // reduction), max(1, frame.shape[0] // reduction))
        factors = np.array([frame.shape[1] / size[0], frame.shape[0] / size[1]])
        frame = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
        matrix = np.column_stack((matrix[:, :2] * factors, matrix[:, 2]))
    moved = np.column_stack((matrix[:, :2], matrix[:, 2] + matrix[:, :2] @ shift - shift))
    flags = cv2.INTER_LINEAR
    return cv2.warpAffine(frame, moved, (INPUT_SIZE, INPUT_SIZE), flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _region_around(points: np.ndarray) -> Region:
    """The region for the next frame: the box of the landmarks, made square, half as large again.

    Turned to level eyes.
    """
    across = points[LEFT_EYE_OUTER] - points[RIGHT_EYE_OUTER]
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    return Region(
        (float(center[0]), float(center[1])),
        float(max(high - low)) * REGION_MARGIN,
        float(np.arctan2(across[1], across[0])),
    )
