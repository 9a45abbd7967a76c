"""How strongly pictures speak about each correction: mean Gauss–Newton information of a few frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from ggavatar.data.capture import Tracking
from preprocess.refinement.corrections import Corrections
from preprocess.refinement.objective import robust_factor, whitened
from preprocess.refinement.short_avatar import ShortAvatar

STEP = 0.5
"""Of the finite differences, in units of the corrections."""


@torch.no_grad()
def mean_information(
    avatar: ShortAvatar,
    tracking: Tracking,
    corrections: Corrections,
    values: Float[np.ndarray, "T C"],
    places: Sequence[int],
) -> Float[np.ndarray, "C C"]:
    """Information matrix of a frame about its corrections, averaged over some pictures.

    One average serves all frames: the same person is seen at about the same size, and a frame's own matrix would cost
    a drawing for each number.

    Args:
        avatar: Draws the frames.
        tracking: As tracked.
        corrections: What is changed.
        values: Corrections to differentiate at.
        places: Among the avatar's pictures.
    """
    total = np.zeros((corrections.count, corrections.count))
    for place in places:
        row = avatar.pictures.rows[place]
        one, now = tracking.rows(slice(row, row + 1)), values[row : row + 1]
        own = corrections.at(row)
        colors, coverage, weights = avatar.pictures.picture(place)
        drawn = avatar.draw(own.moved(one, now), 0)
        base, factor = whitened(drawn, colors, coverage, weights), robust_factor(drawn, colors, coverage).sqrt()
        columns = []
        for column in range(corrections.count):
            step = np.zeros_like(now)
            step[:, column] = STEP
            there = whitened(avatar.draw(own.moved(one, now + step), 0), colors, coverage, weights)
            columns.append(((there - base) * factor / STEP).flatten())
        jacobian = torch.stack(columns).double().numpy()
        total += jacobian @ jacobian.T
    return total / len(places)
