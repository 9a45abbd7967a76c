"""Square parts of a picture, turned so that the eyes are level: what the face networks look at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

RIGHT_EYE_OUTER, LEFT_EYE_OUTER = 33, 263
FACE_MARGIN = 1.5
"""Side of a face's region over its longer side."""


@dataclass(frozen=True)
class Region:
    """A square of the image.

    Attributes:
        center: px of the image.
        side: px of the image.
        roll: Angle of its upper edge against the image's x axis, rad.
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

    def cut(self, frame: UInt8[np.ndarray, "H W 3"], size: int) -> UInt8[np.ndarray, "S S 3"]:
        """The region as input of `size` × `size` px. One much larger than that is first reduced by area.

        Since bilinear sampling would alias. Only the part of the frame around the region is looked at.
        """
        reach = int(np.ceil(self.side * 0.75)) + 2
        low = [int(np.clip(np.floor(place) - reach, 0, length - 1)) for place, length in self._places(frame)]
        high = [int(np.clip(np.ceil(place) + reach, 1, length)) for place, length in self._places(frame)]
        part = frame[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1)]
        matrix = self.matrix(size)
        matrix = np.column_stack((matrix[:, :2], matrix[:, 2] + matrix[:, :2] @ low))
        reduction = int(self.side // (2 * size)) + 1
        if reduction > 1:
            reduced = (max(1, part.shape[1] // reduction), max(1, part.shape[0] // reduction))
            factors = np.array([part.shape[1] / reduced[0], part.shape[0] / reduced[1]])
            part = cv2.resize(part, reduced, interpolation=cv2.INTER_AREA)
            matrix = np.column_stack((matrix[:, :2] * factors, matrix[:, 2]))
        # OpenCV puts pixel centers at whole numbers, so both sides are shifted by half a pixel.
        shift = np.array([0.5, 0.5])
        moved = np.column_stack((matrix[:, :2], matrix[:, 2] + matrix[:, :2] @ shift - shift))
        return cv2.warpAffine(part, moved, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _places(self, frame: np.ndarray) -> tuple[tuple[float, int], tuple[float, int]]:
        """Center and length of the frame along x and y."""
        return (self.center[0], frame.shape[1]), (self.center[1], frame.shape[0])


def face_region(points: Float[np.ndarray, "N 2"]) -> Region:
    """The region for the next frame: the box of the landmarks, made square, half as large again, eyes level."""
    low, high = points.min(axis=0), points.max(axis=0)
    across = points[LEFT_EYE_OUTER] - points[RIGHT_EYE_OUTER]
    center = (low + high) / 2
    return Region(
        (float(center[0]), float(center[1])), float(max(high - low)) * FACE_MARGIN, float(np.arctan2(*across[::-1]))
    )
