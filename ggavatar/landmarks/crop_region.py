"""Square regions of an image, rotated so that the eyes are level: the input of the face networks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

RIGHT_EYE_OUTER, LEFT_EYE_OUTER = 33, 263
"""Landmarks at the outer corners of the subject's eyes."""

FACE_MARGIN = 1.5
"""Ratio of the side of a face's region to the longer side of its bounding box."""


@dataclass(frozen=True)
class CropRegion:
    """A rotated square of the image.

    Attributes:
        center: Center (x, y), px.
        side: Side length, px.
        roll: Angle from the image's x axis to the square's upper edge, rad.
    """

    center: tuple[float, float]
    side: float
    roll: float

    def matrix(self, size: int) -> Float[np.ndarray, "2 3"]:
        """Affine map from continuous image coordinates to continuous coordinates of a `size` × `size` px input."""
        scale = size / self.side
        cosine, sine = scale * np.cos(self.roll), scale * np.sin(self.roll)
        linear = np.array([[cosine, sine], [-sine, cosine]])
        return np.column_stack((linear, size / 2 - linear @ np.array(self.center)))

    def to_image(self, points: Float[np.ndarray, "N 2"], size: int) -> Float[np.ndarray, "N 2"]:
        """Image positions of points in px of a `size` × `size` px input."""
        back = cv2.invertAffineTransform(self.matrix(size))
        return points @ back[:, :2].T + back[:, 2]

    def crop(self, frame: UInt8[np.ndarray, "H W 3"], size: int) -> UInt8[np.ndarray, "S S 3"]:
        """Resample the region to `size` × `size` px, replicating the image's border.

        A much larger region is first reduced by area, since bilinear sampling would alias. Only the part of the frame
        around the region is read.
        """
        reach = int(np.ceil(self.side * 0.75)) + 2
        low = [int(np.clip(np.floor(middle) - reach, 0, length - 1)) for middle, length in self._axes(frame)]
        high = [int(np.clip(np.ceil(middle) + reach, 1, length)) for middle, length in self._axes(frame)]
        part = frame[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1)]
        matrix = self.matrix(size)
        matrix = np.column_stack((matrix[:, :2], matrix[:, 2] + matrix[:, :2] @ low))
        reduction = int(self.side // (2 * size)) + 1
        if reduction > 1:
            reduced = (max(1, part.shape[1] // reduction), max(1, part.shape[0] // reduction))
            factors = np.array([part.shape[1] / reduced[0], part.shape[0] / reduced[1]])
            part = cv2.resize(part, reduced, interpolation=cv2.INTER_AREA)
            matrix = np.column_stack((matrix[:, :2] * factors, matrix[:, 2]))
        # OpenCV has pixel centers at integers, so both sides are shifted by half a pixel.
        shift = np.array([0.5, 0.5])
        moved = np.column_stack((matrix[:, :2], matrix[:, 2] + matrix[:, :2] @ shift - shift))
        return cv2.warpAffine(part, moved, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _axes(self, frame: np.ndarray) -> tuple[tuple[float, int], tuple[float, int]]:
        """Center of the region and length of the frame, along x and y."""
        return (self.center[0], frame.shape[1]), (self.center[1], frame.shape[0])


def face_region(points: Float[np.ndarray, "N 2"]) -> CropRegion:
    """The region for the next frame: a square around the landmarks' bounding box, enlarged by half, eyes level."""
    low, high = points.min(axis=0), points.max(axis=0)
    across = points[LEFT_EYE_OUTER] - points[RIGHT_EYE_OUTER]
    center = (low + high) / 2
    return CropRegion(
        (float(center[0]), float(center[1])), float(max(high - low)) * FACE_MARGIN, float(np.arctan2(*across[::-1]))
    )
