"""What a metric is: its name, its exact definition and how tables present it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A metric: how protocols define it and how tables present it.

    Attributes:
        name: Key in files; a region is appended with `@`, as in `psnr@face`.
        title: Column heading.
        higher_is_better: Direction of improvement.
        digits: Decimals in tables; methods are ranked after rounding to them.
        unit: Unit of the value, or "1" if it has none.
        definition: The exact definition; changing it changes the digest of every protocol that uses the metric.
        tolerance: How much worse the mean of whole images may be under `--compare` when the user names no tolerance.
        relative_tolerance: Whether `tolerance` is a fraction of the earlier mean rather than in the metric's unit.
    """

    name: str
    title: str
    higher_is_better: bool
    digits: int
    unit: str
    definition: str
    tolerance: float
    relative_tolerance: bool = False

    @property
    def arrow(self) -> str:
        """An arrow in the direction of improvement."""
        return "↑" if self.higher_is_better else "↓"
