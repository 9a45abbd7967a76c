"""The expression axes of a tracked head that have names and are the same for every subject."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.procedural.blendshapes import BLENDSHAPES
from ggavatar.head.procedural.model import procedural_names
from ggavatar.landmarks.blendshapes import NAMES


def axis_scores(blendshapes: Float[np.ndarray, "T 52"]) -> Float[np.ndarray, "T A"]:
    """The scores that belong to `TRACKED_AXES`."""
    return blendshapes[:, [NAMES.index(name) for name in TRACKED_AXES]]


def score(blendshapes: Float[np.ndarray, "T 52"], name: str) -> Float[np.ndarray, " T"]:
    """One score by name."""
    return blendshapes[:, NAMES.index(name)]


def generic_mixture() -> Float[np.ndarray, "G A"]:
    """Amount of each of the procedural head's expressions in each of `TRACKED_AXES`."""
    names, _ = procedural_names()
    mixture = np.zeros((len(names), len(TRACKED_AXES)))
    for column, axis in enumerate(TRACKED_AXES):
        for name, amount in BLENDSHAPES.get(axis, ()):
            mixture[names.index(name), column] = amount
    return mixture
