"""Tracking of 478 face landmarks: the crop region follows the face, and the detector finds it when it is lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.landmarks.blendshapes import NAMES, BlendshapeNetwork
from ggavatar.landmarks.crop_region import FACE_MARGIN, CropRegion, face_region
from ggavatar.landmarks.detector import FaceDetector
from ggavatar.landmarks.networks import BundleNetwork, FaceNetworkFiles, LandmarkNetwork, RawLandmarks, SeparateNetworks

MINIMUM_PRESENCE = 0.5
"""Confidence below which a region is taken to show no face."""


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of one frame.

    Attributes:
        points: Image positions, px (pixel centers at +0.5).
        depth: The network's estimate of relative depth in px of the image; smaller is nearer. It assumes weak
            perspective and is only a hint.
        blendshapes: Scores in [0, 1] in the order of `blendshapes.NAMES`; zeros without the blendshape network.
        presence: Confidence in [0, 1] that the region shows a face.
    """

    points: Float[np.ndarray, "478 2"]
    depth: Float[np.ndarray, " 478"]
    blendshapes: Float[np.ndarray, " 52"]
    presence: float

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box of the landmarks: left, top, right and bottom, px."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


class LandmarkTracker:
    """Landmarks of a video, frame by frame. Keeps the region of the last frame; call `reset` at a cut.

    Not thread-safe: OpenCV networks store their input.
    """

    def __init__(self, files: Path | FaceNetworkFiles) -> None:
        """Load the networks from the face landmarker bundle, or from single files without blendshape scores."""
        self._network: LandmarkNetwork
        if isinstance(files, FaceNetworkFiles):
            self._detector, self._blendshapes = FaceDetector(files.detector), None
            self._network = SeparateNetworks(files.skin, files.iris)
        else:
            self._detector, self._blendshapes = FaceDetector(files), BlendshapeNetwork(files)
            self._network = BundleNetwork(files)
        self._region: CropRegion | None = None
        self._near: tuple[float, float] | None = None

    def follow(self, place: tuple[float, float] | None) -> None:
        """Follow the face nearest to a place, px, where several are in view; None follows the most prominent one."""
        self._near = place

    @property
    def has_blendshapes(self) -> bool:
        """Whether blendshape scores are computed."""
        return self._blendshapes is not None

    def reset(self) -> None:
        """Forget the region of the last frame."""
        self._region = None

    def landmarks(self, frame: UInt8[np.ndarray, "H W 3"]) -> Landmarks | None:
        """The landmarks of the next RGB frame, or None if no face is found."""
        found = self._tracked(frame) or self._detected(frame)
        self._region = None if found is None else face_region(found.points)
        if found is None:
            return None
        if self._near is not None:
            center = (found.points.min(axis=0) + found.points.max(axis=0)) / 2
            self._near = (float(center[0]), float(center[1]))
        scores = np.zeros(len(NAMES)) if self._blendshapes is None else self._blendshapes.scores(found.points)
        return Landmarks(found.points, found.depth, scores, found.presence)

    def _tracked(self, frame: np.ndarray) -> RawLandmarks | None:
        return None if self._region is None else self._in_region(frame, self._region)

    def _detected(self, frame: np.ndarray) -> RawLandmarks | None:
        """Detect the face and find its landmarks twice, the second time in the region that tracking would choose."""
        face = self._detector.detect(frame, self._near)
        if face is None:
            return None
        first = self._in_region(frame, CropRegion(face.center, face.side * FACE_MARGIN, face.roll))
        return first and (self._in_region(frame, face_region(first.points)) or first)

    def _in_region(self, frame: np.ndarray, region: CropRegion) -> RawLandmarks | None:
        """The landmarks in the region, or None if it shows no face."""
        found = self._network.predict(frame, region)
        is_finite = np.isfinite(found.points).all() and np.isfinite(found.depth).all()
        return found if found.presence >= MINIMUM_PRESENCE and is_finite else None
