"""Networks that find landmarks in a crop region: the bundle's one for all 478, or two for skin and irises."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.landmarks.bundle import load_network
from ggavatar.landmarks.crop_region import CropRegion

SKIN_POINTS = 468
"""Number of landmarks on the skin; those of the irises follow them."""

EYE_MARGIN = 2.3
"""Ratio of the side of an eye's region to the distance of the eye's corners."""

EYE_CORNERS = ((33, 133), (362, 263))
"""Landmarks at the corners of the right and the left eye, from the subject's right to left."""


class RawLandmarks(NamedTuple):
    """A network's output for a crop region.

    Attributes:
        points: Image positions, px.
        depth: Relative depth in px of the image; smaller is nearer.
        presence: Confidence in [0, 1] that the region shows a face.
    """

    points: Float[np.ndarray, "478 2"]
    depth: Float[np.ndarray, " 478"]
    presence: float


class LandmarkNetwork(Protocol):
    """Finds the landmarks of the one face in a region."""

    def predict(self, frame: UInt8[np.ndarray, "H W 3"], region: CropRegion) -> RawLandmarks:
        """The landmarks, whatever the region shows."""
        ...


@dataclass(frozen=True)
class FaceNetworkFiles:
    """Files of single networks, from the mediapipe wheel, for use without the bundle.

    Attributes:
        detector: Short-range face detector.
        skin: Network for the 468 landmarks on the skin.
        iris: Network for the iris of one eye.
    """

    detector: Path
    skin: Path
    iris: Path


class BundleNetwork:
    """One network for all 478 landmarks, with an input of 256² px."""

    SIZE = 256

    def __init__(self, bundle: Path) -> None:
        self._network = load_network(bundle, "landmarks")

    def predict(self, frame: UInt8[np.ndarray, "H W 3"], region: CropRegion) -> RawLandmarks:
        """The landmarks, whatever the region shows."""
        self._network.setInput(cv2.dnn.blobFromImage(region.crop(frame, self.SIZE), 1 / 255))
        values, logit = self._network.forward(("Identity", "Identity_1"))
        values = values.reshape(478, 3).astype(np.float64)
        points = region.to_image(values[:, :2], self.SIZE)
        return RawLandmarks(points, values[:, 2] * (region.side / self.SIZE), _probability(logit))


class SeparateNetworks:
    """A network for 468 landmarks (input 192² px), and one for the iris of one eye at a time (input 64² px)."""

    SIZE, EYE_SIZE = 192, 64

    def __init__(self, skin: Path, iris: Path) -> None:
        self._skin, self._iris = load_network(skin, "skin"), load_network(iris, "iris")

    def predict(self, frame: UInt8[np.ndarray, "H W 3"], region: CropRegion) -> RawLandmarks:
        """The landmarks, whatever the region shows; irises get the mean depth of their eye's corners."""
        self._skin.setInput(cv2.dnn.blobFromImage(region.crop(frame, self.SIZE), 1 / 255))
        values, logit = self._skin.forward(("conv2d_21", "conv2d_31"))
        values = values.reshape(SKIN_POINTS, 3).astype(np.float64)
        points, depth = region.to_image(values[:, :2], self.SIZE), values[:, 2] * (region.side / self.SIZE)
        irises = [self._iris_points(frame, points[list(corners)]) for corners in EYE_CORNERS]
        depths = [np.full(5, depth[list(corners)].mean()) for corners in EYE_CORNERS]
        return RawLandmarks(np.concatenate((points, *irises)), np.concatenate((depth, *depths)), _probability(logit))

    def _iris_points(self, frame: np.ndarray, corners: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "5 2"]:
        """Center and contour of one iris, px of the image."""
        across, middle = corners[1] - corners[0], corners.mean(axis=0)
        side = max(1.0, EYE_MARGIN * float(np.hypot(*across)))
        region = CropRegion((float(middle[0]), float(middle[1])), side, float(np.arctan2(*across[::-1])))
        if not np.isfinite(corners).all():
            return np.full((5, 2), np.nan)
        self._iris.setInput(cv2.dnn.blobFromImage(region.crop(frame, self.EYE_SIZE), 1 / 255))
        values = self._iris.forward("output_iris").reshape(5, 3).astype(np.float64)
        return region.to_image(values[:, :2], self.EYE_SIZE)


def _probability(logit: np.ndarray) -> float:
    return float(1 / (1 + np.exp(-np.clip(logit.reshape(()), -50, 50))))
