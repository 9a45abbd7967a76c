"""One Gauss–Newton step of all frames at once: the pictures' information, priors about the tracking, smoothness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preprocess.tracking.geometry.rigid import solve_smoothed
from preprocess.tracking.geometry.smoothing import penalty


@dataclass(frozen=True)
class Regularity:
    """What is known of corrections before a picture is seen.

    Attributes:
        prior: Inverse variance of each number about zero.
        metric: Penalty on second differences.
    """

    prior: Float[np.ndarray, " C"]
    metric: Float[np.ndarray, "C C"]


def regularity(
    information: Float[np.ndarray, "C C"], stds: Float[np.ndarray, " C"], cutoffs: Float[np.ndarray, " C"], fps: float
) -> Regularity:
    """Priors, and penalties that halve a correction that moves at its cutoff (Hz) where a frame has `information`."""
    factors = np.sqrt([penalty(float(cutoff), fps) for cutoff in cutoffs])
    prior = 1 / stds**2
    return Regularity(prior, factors[:, None] * (information + np.diag(prior)) * factors)


def smooth_step(
    values: Float[np.ndarray, "T C"],
    information: Float[np.ndarray, "T C C"],
    gradient: Float[np.ndarray, "T C"],
    known: Regularity,
) -> Float[np.ndarray, "T C"]:
    """The step that minimizes the quadratic model of misfit, priors and roughness.

    Args:
        values: Corrections now.
        information: Of each frame's picture about them; zero for a frame without one, which smoothness fills.
        gradient: Of the misfit with respect to them.
        known: Priors and smoothness.
    """
    rough = np.zeros_like(values)
    if len(values) >= 3:
        second = np.diff(values, n=2, axis=0) @ known.metric
        rough[:-2] += second
        rough[1:-1] -= 2 * second
        rough[2:] += second
    downhill = -gradient - known.prior * values - rough
    return solve_smoothed(information + np.diag(known.prior), downhill, known.metric)
