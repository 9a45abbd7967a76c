"""Motion of the clothes on the chest in the image, by optical flow."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

TRACKING_WIDTH = 256
"""Width to which frames are downscaled, px."""
MAXIMUM_CORNERS, MINIMUM_CORNERS = 120, 12
"""Corners that are tracked at most, and without which the torso is not tracked."""


class TorsoTracker:
    """Tracks the texture of the torso frame by frame, relative to a reference frame.

    The reference is kept as long as it can be tracked; then the current frame becomes the new one.
    """

    def __init__(self) -> None:
        self._reference: np.ndarray | None = None
        self._corners = np.zeros((0, 1, 2), np.float32)
        self._flow = np.zeros((0, 1, 2), np.float32)
        self._base = np.eye(3)
        self._last = np.eye(3)

    def motion(
        self, frame: UInt8[np.ndarray, "H W 3"], mask: UInt8[np.ndarray, "H W"], points: Float[np.ndarray, "N 2"] | None
    ) -> Float[np.ndarray, "3 3"] | None:
        """Similarity from the first frame's pixels to this frame's, or None where the torso could not be tracked.

        Args:
            frame: RGB.
            mask: Foreground, 255 = person.
            points: Landmarks, px; None where no face was found.
        """
        scale = TRACKING_WIDTH / frame.shape[1]
        small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        gray = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
        found = self._track(gray)
        if found is None and points is not None:
            self._restart(
                gray, _torso_region(cv2.resize(mask, gray.shape[::-1], interpolation=cv2.INTER_AREA), points * scale)
            )
        self._last = self._last if found is None else found @ self._base
        if found is None and len(self._corners) < MINIMUM_CORNERS:
            return None
        zoom = np.diag([scale, scale, 1.0])
        return np.linalg.inv(zoom) @ self._last @ zoom

    def _track(self, gray: np.ndarray) -> np.ndarray | None:
        """Similarity from the reference frame to this one."""
        if self._reference is None or len(self._corners) < MINIMUM_CORNERS:
            return None
        options: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 2, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            self._reference, gray, self._corners, self._corners + self._flow, **options
        )
        kept = status.ravel() > 0
        if kept.sum() < MINIMUM_CORNERS:
            return None
        matrix, inliers = cv2.estimateAffinePartial2D(self._corners[kept], moved[kept], ransacReprojThreshold=1.0)
        if matrix is None or inliers.sum() < max(MINIMUM_CORNERS, 0.4 * len(self._corners)):
            return None
        self._flow = cv2.transform(self._corners, matrix).astype(np.float32) - self._corners
        return np.vstack((matrix, (0, 0, 1)))

    def _restart(self, gray: np.ndarray, region: np.ndarray) -> None:
        """Make this frame the reference; its motion is assumed to be the last one known."""
        corners = cv2.goodFeaturesToTrack(gray, MAXIMUM_CORNERS, 0.01, 4, mask=region.astype(np.uint8))
        self._corners = np.zeros((0, 1, 2), np.float32) if corners is None else corners
        self._flow = np.zeros_like(self._corners)
        self._reference, self._base = gray, self._last


def _torso_region(mask: np.ndarray, points: np.ndarray) -> Bool[np.ndarray, "H W"]:
    """Foreground pixels well below the chin."""
    low, high = points.min(axis=0), points.max(axis=0)
    rows = np.arange(mask.shape[0])[:, None]
    return (mask > 200) & (rows > high[1] + 0.22 * (high[1] - low[1]))
