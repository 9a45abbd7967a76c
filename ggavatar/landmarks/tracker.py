"""478 face landmarks a frame: the region follows the face from frame to frame.

And the detector finds it again when it is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.landmarks.blendshapes import NAMES, BlendshapeNetwork
from ggavatar.landmarks.crop_region import FACE_MARGIN, LEFT_EYE_OUTER, RIGHT_EYE_OUTER, Region, face_region
from ggavatar.landmarks.detector import FaceDetector
from ggavatar.landmarks.networks import BundleNetwork, FaceFiles, LandmarkNetwork, SeenFace, SeparateNetworks

__all__ = ["LEFT_EYE_OUTER", "RIGHT_EYE_OUTER", "LandmarkTracker", "Landmarks"]

MINIMUM_PRESENCE = 0.5


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of one frame.

    Attributes:
        points: Image positions, px (pixel centers at +0.5).
        depth: The network's guess of relative depth in px of the image, smaller is nearer; weak-perspective, so a hint
            only.
        blendshapes: Scores in [0, 1] in the order of `blendshapes.NAMES`; zeros without their network.
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


class LandmarkTracker:
    """Landmarks of a video, frame after frame. Holds the region of the last frame; `reset` forgets it at a cut."""

    def __init__(self, files: Path | FaceFiles) -> None:
        """Load the networks from the face landmarker bundle, or from single files, which give no scores."""
        self._network: LandmarkNetwork
        if isinstance(files, FaceFiles):
            self._detector, self._blendshapes = FaceDetector(files.detector), None
            self._network = SeparateNetworks(files.skin, files.iris)
        else:
            self._detector, self._blendshapes = FaceDetector(files), BlendshapeNetwork(files)
            self._network = BundleNetwork(files)
        self._region: Region | None = None

    @property
    def scored(self) -> bool:
        """Whether blendshape scores are to be had."""
        return self._blendshapes is not None

    def reset(self) -> None:
        """Forget where the face was."""
        self._region = None

    def landmarks(self, frame: UInt8[np.ndarray, "H W 3"]) -> Landmarks | None:
        """The landmarks of the next RGB frame, or None where no face is seen."""
        found = self._tracked(frame) or self._detected(frame)
        self._region = None if found is None else face_region(found.points)
        if found is None:
            return None
        scores = np.zeros(len(NAMES)) if self._blendshapes is None else self._blendshapes.scores(found.points)
        return Landmarks(found.points, found.depth, scores, found.presence)

    def _tracked(self, frame: np.ndarray) -> SeenFace | None:
        return None if self._region is None else self._in_region(frame, self._region)

    def _detected(self, frame: np.ndarray) -> SeenFace | None:
        """Detection, then landmarks twice: the second pass sees the region as tracking would choose it."""
        face = self._detector.detect(frame)
        if face is None:
            return None
        first = self._in_region(frame, Region(face.center, face.side * FACE_MARGIN, face.roll))
        return first and (self._in_region(frame, face_region(first.points)) or first)

    def _in_region(self, frame: np.ndarray, region: Region) -> SeenFace | None:
        """What the network sees; None when that is no face."""
        seen = self._network.see(frame, region)
        good = seen.presence >= MINIMUM_PRESENCE and np.isfinite(seen.points).all() and np.isfinite(seen.depth).all()
        return seen if good else None
