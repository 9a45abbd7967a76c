"""Whether masks can be those of the person in the images: their share of the picture, its border, and the face.

Everything that is concluded from masks (conventions of a tracking, for example) is wrong where these checks fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

MIN_SHARE = 0.002
"""Share of the picture below which a mask is empty."""
MAX_SHARE = 0.99
"""Share of the picture above which a mask is the whole picture."""
MIN_FACE = 0.5
"""Coverage of the face below which masks are not those of its person; masks of skin leave eyes and lips out."""
MIN_INVERTED_FACE = 0.7
"""Coverage of the face by the inverted masks from which these are those of its person."""
CORNER, STRIP = 0.08, 0.03
"""Side of the two upper corners, and height of the upper border, as fractions of the picture."""

Fault = Literal["empty", "everywhere", "inverted", "elsewhere"]


@dataclass(frozen=True)
class MaskMeasures:
    """What one mask covers, each as a fraction in [0, 1].

    Attributes:
        share: Of the picture.
        corners: Of the two upper corners, where a person hardly ever is.
        border: Of the least covered side of the picture.
        middle: Of the middle of the picture, where a person usually is.
        face: Of the face; None where none was found.
    """

    share: float
    corners: float
    border: float
    middle: float
    face: float | None = None


def measure_mask(mask: UInt8[np.ndarray, "H W"], face: Float[np.ndarray, "N 2"] | None = None) -> MaskMeasures:
    """Measure one mask.

    Args:
        mask: Coverage of the person, 0 to 255.
        face: Points of the face, px: landmarks, or the corners of its box.
    """
    inside = mask > 127
    height, width = inside.shape
    high, wide = max(1, round(CORNER * height)), max(1, round(CORNER * width))
    strip = max(1, round(STRIP * min(height, width)))
    sides = (inside[:strip], inside[-strip:], inside[:, :strip], inside[:, -strip:])
    middle = inside[height * 2 // 5 : height * 3 // 5 + 1, width * 2 // 5 : width * 3 // 5 + 1]
    return MaskMeasures(
        share=float(inside.mean()),
        corners=float((inside[:high, :wide].mean() + inside[:high, -wide:].mean()) / 2),
        border=min(float(side.mean()) for side in sides),
        middle=float(middle.mean()),
        face=None if face is None else _covered_face(inside, face),
    )


def _covered_face(inside: np.ndarray, face: Float[np.ndarray, "N 2"]) -> float | None:
    """The covered fraction of an ellipse within the face's box; None where that lies outside of the picture."""
    low, high = np.nanmin(face, axis=0), np.nanmax(face, axis=0)
    center, half = (low + high) / 2, np.maximum(0.35 * (high - low), 1.0)
    top, left = (int(max(0, np.floor(center[axis] - half[axis]))) for axis in (1, 0))
    bottom, right = (int(np.ceil(center[axis] + half[axis])) for axis in (1, 0))
    part = inside[top : max(top, bottom), left : max(left, right)]
    if not part.size:
        return None
    rows, columns = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]] + 0.5
    within = ((rows - center[1]) / half[1]) ** 2 + ((columns - center[0]) / half[0]) ** 2 <= 1
    return float(part[within].mean()) if within.any() else None


def is_empty(mask: UInt8[np.ndarray, "H W"]) -> bool:
    """Whether a mask shows nobody."""
    return int(np.count_nonzero(mask > 127)) < MIN_SHARE * mask.size


def find_fault(measures: Sequence[MaskMeasures]) -> Fault | None:
    """What is wrong with the masks of a clip, from measures of some of them; None if they can be a person's.

    The face decides if it was found in at least a third of the frames; without it only what the border and the middle
    of the picture tell.
    """
    share, corners, border, middle = (
        float(np.median([getattr(each, name) for each in measures]))
        for name in ("share", "corners", "border", "middle")
    )
    faces = [each.face for each in measures if each.face is not None]
    face = float(np.median(faces)) if 3 * len(faces) >= len(measures) and faces else None
    if share < MIN_SHARE:
        return "empty"
    if share > MAX_SHARE or (border > 0.8 and corners > 0.9 and (middle if face is None else face) > 0.9):
        return "everywhere"
    if face is None:
        return "inverted" if middle < 0.2 and corners > 0.8 else None
    if face < 1 - MIN_INVERTED_FACE and corners >= 0.4:
        return "inverted"
    return "elsewhere" if face < MIN_FACE else None


def describe(fault: Fault, measures: Sequence[MaskMeasures]) -> str:
    """A fault in words, as a clause with the masks as subject."""
    faces = [each.face for each in measures if each.face is not None]
    seen = f" and {np.median(faces):.0%} of the face" if faces else ""
    share = f"{np.median([each.share for each in measures]):.0%} of the picture"
    return {
        "empty": f"the masks are empty: they cover {share}",
        "everywhere": f"the masks cover {share} and all of its border, so they separate nothing",
        "inverted": f"the masks are inverted: they cover the background ({share}{seen})",
        "elsewhere": f"the masks do not cover the person: {share}, but only{seen.removeprefix(' and')}",
    }[fault]
