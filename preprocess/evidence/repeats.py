"""Frames that repeat the one before: a frozen picture, a lower frame rate than the file states, or neither."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool

from preprocess.evidence.blank import runs

FROZEN = 5
"""Consecutive repeats from which the picture is frozen, unless the whole clip repeats as often."""
MAX_VARIATION = 0.35
"""Variation (standard deviation over mean) of the distance between repeats in a clip of a lower rate."""
MIN_REGULAR = 0.9
"""Fraction of the frames that must be shown equally long, give or take one repeat, in a clip of a lower rate."""

Kind = Literal["rate", "frozen", "irregular"]


def kind_of_repeats(repeated: Bool[np.ndarray, " T"]) -> Kind:
    """Why frames repeat: evenly over the clip ("rate"), for a while at once ("frozen"), or here and there."""
    if _is_even(repeated):
        return "rate"
    return "frozen" if frozen_runs(repeated) else "irregular"


def frozen_runs(repeated: Bool[np.ndarray, " T"]) -> list[tuple[int, int]]:
    """First and last repeat of every stretch in which the picture stands still."""
    return [(first, last) for first, last in runs(repeated) if last - first + 1 >= FROZEN]


def _is_even(repeated: np.ndarray) -> bool:
    """Whether repeats are as even as in a conversion to a higher rate, which shows every frame m or m + 1 times."""
    shown = np.diff(np.flatnonzero(~repeated))
    if len(shown) < 4 or repeated.sum() < 4:
        return False
    least = int(np.floor(shown.mean()))
    if np.isin(shown, (least, least + 1)).mean() < MIN_REGULAR:
        return False
    if shown.mean() >= 1.5:
        return True
    spacing = np.diff([first for first, _ in runs(repeated)])
    return len(spacing) >= 3 and bool(spacing.std() <= MAX_VARIATION * spacing.mean())


def rate_without_repeats(fps: float, repeated: Bool[np.ndarray, " T"]) -> float:
    """Frames per second once repeats are dropped; where the picture is frozen, no time passes."""
    counted = np.ones(len(repeated), bool)
    if kind_of_repeats(repeated) != "rate":
        for first, last in frozen_runs(repeated):
            counted[first : last + 1] = False
    return fps * float(1 - repeated[counted].mean()) if counted.any() else fps
