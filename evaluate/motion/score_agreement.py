"""How one table of scores follows another, column by column."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SMALLEST_DEVIATION = 1e-6


@dataclass(frozen=True)
class Agreement:
    """How the columns of a second table follow those of a first.

    Attributes:
        correlations: Pearson correlation of each column; 0 where one does not vary.
        slopes: Slope of each column's regression on the first; 0 likewise.
        weights: Standard deviation of each of the first's columns.
    """

    correlations: Float[np.ndarray, " S"]
    slopes: Float[np.ndarray, " S"]
    weights: Float[np.ndarray, " S"]

    @property
    def correlation(self) -> float:
        """Mean correlation with the weights."""
        return self._mean(self.correlations)

    @property
    def slope(self) -> float:
        """Mean slope with the weights."""
        return self._mean(self.slopes)

    def _mean(self, values: Float[np.ndarray, " S"]) -> float:
        return float((self.weights * values).sum() / max(float(self.weights.sum()), SMALLEST_DEVIATION))


def agreement(first: Float[np.ndarray, "T S"], second: Float[np.ndarray, "T S"]) -> Agreement:
    """How the columns of the second table follow those of the first."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    weights = a.std(axis=0)
    covariance = (a * b).mean(axis=0)
    correlations = covariance / np.maximum(weights * b.std(axis=0), SMALLEST_DEVIATION**2)
    return Agreement(correlations, covariance / np.maximum(weights, SMALLEST_DEVIATION) ** 2, weights)
