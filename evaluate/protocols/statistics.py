"""Statistics: summaries over frames, deviation over seeds, and paired differences with confidence intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

Value = float | None

WORST_FRACTION = 0.05
RESAMPLES = 10_000
BLOCK_SPAN = 25
"""Source frames over which errors are considered correlated, about one second."""


@dataclass(frozen=True)
class Summary:
    """One metric over the frames of one evaluation.

    Attributes:
        mean: Mean over the frames with a finite value.
        median: Median over the same frames.
        worst_5_percent: Mean over the worst 5 % of the frames, at least one.
        std_over_frames: Sample deviation between frames; neither the deviation between seeds nor an error of the mean.
        count: Frames with a finite value.
        identical: Frames with an infinite value (identical images), excluded from all of the above.
    """

    mean: Value
    median: Value
    worst_5_percent: Value
    std_over_frames: Value
    count: int
    identical: int


def summarize(values: Sequence[Value], higher_is_better: bool) -> Summary:
    """Summary of one metric; None (not measured) is skipped, infinite values (identical images) are only counted."""
    known = [value for value in values if value is not None]
    finite = sorted(value for value in known if math.isfinite(value))
    identical = len(known) - len(finite)
    if not finite:
        return Summary(None, None, None, None, 0, identical)
    worst = finite if higher_is_better else finite[::-1]
    tail = worst[: max(1, math.ceil(len(finite) * WORST_FRACTION))]
    deviation = statistics.stdev(finite) if len(finite) > 1 else None
    mean = math.fsum(finite) / len(finite)
    return Summary(mean, statistics.median(finite), math.fsum(tail) / len(tail), deviation, len(finite), identical)


@dataclass(frozen=True)
class Difference:
    """Mean of paired differences with a bootstrap interval.

    Attributes:
        mean: Mean of first − second over the frames that both have.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        frames: Number of pairs.
        block: Number of consecutive scored frames resampled together.
        resamples: Number of bootstrap samples.
    """

    mean: float
    low: float
    high: float
    frames: int
    block: int
    resamples: int

    @property
    def is_significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def block_length(frames: Sequence[int]) -> int:
    """Scored frames per block: those within `BLOCK_SPAN` source frames, at most a quarter of all."""
    if len(frames) < 2:
        return 1
    spacing = statistics.median(b - a for a, b in pairwise(frames))
    return max(1, min(round(BLOCK_SPAN / spacing), len(frames) // 4))


def paired_bootstrap(groups: Sequence[tuple[Sequence[int], Sequence[float]]], seed: int = 0) -> Difference | None:
    """Circular block bootstrap of paired differences, stratified by subject.

    Errors of neighboring frames are correlated, so whole blocks are resampled; resampling single frames would make the
    interval of a video far too narrow (Politis & Romano 1992). Subjects have equal weight, as in the table's mean row.

    Args:
        groups: For each subject the ascending frame numbers and the differences of the two methods at them.
        seed: Seed of the resampling.

    Returns:
        The mean over subjects of their mean differences, with its 95 % percentile interval; None without any frame.
    """
    filled = [(frames, np.asarray(values, np.float64)) for frames, values in groups if len(values)]
    if not filled:
        return None
    generator = np.random.default_rng(seed)
    blocks = [block_length(frames) for frames, _ in filled]
    means = [_resampled_means(values, block, generator) for (_, values), block in zip(filled, blocks, strict=True)]
    low, high = np.quantile(np.mean(means, axis=0), (0.025, 0.975))
    center = float(np.mean([values.mean() for _, values in filled]))
    count = sum(len(values) for _, values in filled)
    return Difference(center, float(low), float(high), count, max(blocks), RESAMPLES)


def _resampled_means(values: Float[np.ndarray, " T"], block: int, generator: np.random.Generator) -> np.ndarray:
    """Means of `RESAMPLES` series assembled from blocks that start anywhere and wrap around."""
    count = len(values)
    draws = math.ceil(count / block)
    # Precomputed block sums: each sample then adds a few numbers instead of all frames.
    wrapped = np.concatenate((values, values[: block - 1]))
    sums = np.convolve(wrapped, np.ones(block), mode="valid")
    starts = generator.integers(0, count, (RESAMPLES, draws))
    return sums[starts].sum(axis=1) / (draws * block)


def deviation_over_seeds(means: Sequence[float]) -> float | None:
    """Sample deviation of the means of runs with different seeds; None for a single run."""
    return statistics.stdev(means) if len(means) > 1 else None
