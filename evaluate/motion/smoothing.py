"""Temporal smoothing: the One-Euro filter (causal, for live input) and Savitzky–Golay (for recorded input)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

METHODS = ("none", "one-euro", "savgol")


def one_euro(
    values: Float[np.ndarray, "T D"], fps: float, min_cutoff: float = 1.5, beta: float = 0.5, speed_cutoff: float = 1.0
) -> Float[np.ndarray, "T D"]:
    """Causal low-pass filter whose cutoff rises with speed: steady at rest, little lag in motion.

    Args:
        values: One row per frame.
        fps: Frames per second.
        min_cutoff: Cutoff at rest, Hz; lower is steadier.
        beta: Increase of the cutoff with speed, Hz per unit per second; the unit is each column's standard deviation.
        speed_cutoff: Cutoff of the speed estimate, Hz.

    References:
        Casiez, Roussel and Vogel 2012, "1€ filter", Algorithm 1.
    """
    deviation = values.std(axis=0)
    smooth = OneEuro(np.where(deviation > 1e-12, deviation, 1.0), min_cutoff, beta, speed_cutoff)
    return np.array([smooth(row, 1 / fps) for row in values]).reshape(values.shape)


class OneEuro:
    """The filter of `one_euro`, fed value by value."""

    def __init__(
        self, unit: Float[np.ndarray, " D"], min_cutoff: float = 1.5, beta: float = 0.5, speed_cutoff: float = 1.0
    ) -> None:
        """Begin without a value.

        Args:
            unit: In which the speed of every column is measured.
            min_cutoff: As in `one_euro`.
            beta: As in `one_euro`.
            speed_cutoff: As in `one_euro`.
        """
        self._unit, self._cutoffs, self._beta = unit, (min_cutoff, speed_cutoff), beta
        self._speed = np.zeros(len(unit))
        self._value: Float[np.ndarray, " D"] | None = None

    def __call__(self, value: Float[np.ndarray, " D"], seconds: float) -> Float[np.ndarray, " D"]:
        """The filtered value.

        Args:
            value: The newest.
            seconds: Time since the one before, s.
        """
        if self._value is None:
            self._value = value.astype(np.float64)
            return self._value
        fps = 1 / max(seconds, 1e-3)
        change = (value - self._value) * fps / self._unit
        self._speed = self._speed + _smoothing_factor(self._cutoffs[1], fps) * (change - self._speed)
        factor = _smoothing_factor(self._cutoffs[0] + self._beta * np.abs(self._speed), fps)
        self._value = self._value + factor * (value - self._value)
        return self._value


def _smoothing_factor(cutoff: float | np.ndarray, fps: float) -> float | np.ndarray:
    """Weight of the newest value in an exponential filter with a cutoff in Hz."""
    radians = 2 * np.pi * cutoff / fps
    return radians / (1 + radians)


def savgol(values: Float[np.ndarray, "T D"], window: int = 5, order: int = 2) -> Float[np.ndarray, "T D"]:
    """Least-squares polynomial in a sliding window (Savitzky and Golay 1964): no lag, exact for polynomials of `order`.

    Short clips use the largest odd window that fits; clips too short for that are returned unchanged.
    """
    window = min(window, len(values) - 1 + len(values) % 2)
    if window <= order:
        return values.astype(np.float64)
    return savgol_filter(values, window, order, axis=0, mode="interp")


def smoothed(values: Float[np.ndarray, "T D"], method: str, fps: float) -> Float[np.ndarray, "T D"]:
    """Values filtered by one of `METHODS`; `ValueError` for any other name."""
    if method == "none" or not values.shape[1]:
        return values
    if method == "one-euro":
        return one_euro(values, fps)
    if method == "savgol":
        return savgol(values)
    raise ValueError(f"expected a smoothing method of {METHODS}, got {method!r}")


def interpolated(values: Float[np.ndarray, "T D"]) -> Float[np.ndarray, "T D"]:
    """Values with the rows that are not finite filled linearly from those around them."""
    known = np.isfinite(values).all(axis=1)
    if known.all() or not known.any():
        return values
    rows = np.arange(len(values))
    return np.stack([np.interp(rows, rows[known], column[known]) for column in values.T], axis=1)
