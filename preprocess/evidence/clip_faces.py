"""The landmarks of a whole clip, found once and kept for the tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ggavatar.landmarks.tracker import Landmarks


@dataclass(frozen=True)
class ClipFaces:
    """Landmarks by frame.

    Attributes:
        points: Image positions, px; NaN where no face was found or looked for.
        depth: Relative depth, px; NaN likewise.
        blendshapes: Scores in [0, 1]; zeros likewise.
    """

    points: Float[np.ndarray, "T 478 2"]
    depth: Float[np.ndarray, "T 478"]
    blendshapes: Float[np.ndarray, "T 52"]

    @property
    def found(self) -> Bool[np.ndarray, " T"]:
        """Frames with a face."""
        return np.isfinite(self.points).all(axis=(1, 2))

    def at(self, row: int) -> Landmarks | None:
        """The landmarks of one frame, or None."""
        if not np.isfinite(self.points[row]).all():
            return None
        return Landmarks(self.points[row], self.depth[row], self.blendshapes[row], 1.0)

    def rows(self, rows: Sequence[int]) -> ClipFaces:
        """Some frames."""
        index = np.asarray(rows, dtype=np.int64)
        return ClipFaces(self.points[index], self.depth[index], self.blendshapes[index])


def stack_faces(faces: Sequence[Landmarks | None]) -> ClipFaces:
    """Landmarks of consecutive frames as arrays."""
    points, depth = np.full((len(faces), 478, 2), np.nan), np.full((len(faces), 478), np.nan)
    blendshapes = np.zeros((len(faces), 52))
    for row, face in enumerate(faces):
        if face is not None:
            points[row], depth[row], blendshapes[row] = face.points, face.depth, face.blendshapes
    return ClipFaces(points, depth, blendshapes)
