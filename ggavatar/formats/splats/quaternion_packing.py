"""Quaternions of which a file stores all components but the largest, as compressed PLY, SOG and SPZ do."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray


def quats_from_smallest(others: Float[ndarray, "N 3"], largest: Integer[ndarray, " N"]) -> Float[ndarray, "N 4"]:
    """Unit quaternions from three components in order and the index of the fourth, which is not negative.

    Components that are longer than a unit vector together are shortened to one, so that the fourth is zero.
    """
    others = others / np.linalg.norm(others, axis=1, keepdims=True).clip(1, None)
    whole = np.sqrt((1 - (others**2).sum(axis=1)).clip(0, None))
    columns, index = np.arange(4)[None], largest.astype(np.int64)[:, None]
    taken = np.take_along_axis(np.pad(others, ((0, 0), (0, 1))), columns - (columns > index), axis=1)
    return np.where(columns == index, whole[:, None], taken).astype(np.float32)
