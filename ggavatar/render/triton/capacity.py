"""How much memory pairs of Gaussian and tile get, and what renderings report without anyone waiting for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ggavatar.errors import InputError
from ggavatar.jit import device_kernels
from ggavatar.render.checks import FIELDS, VIEW_NAMES

FIRST_GUESS = 8.0
"""Pairs per Gaussian before a rendering has told."""

HEADROOM = 1.5
"""Capacity as a multiple of the pairs of a rendering."""

STEP = 4096
"""Capacities are multiples of this, so that memory is reused when the number of Gaussians changes a little."""

CHECKED = (*(f"gaussians.{name}" for name in FIELDS), *VIEW_NAMES)
"""Names of the tensors that are checked, in the order of the bits in a report."""


@dataclass(frozen=True)
class Report:
    """What a rendering tells when it is done.

    Attributes:
        size: Width and height of the image, px.
        rows: Number of Gaussians.
        capacity: Pairs that there was memory for.
        pairs: Pairs that there were.
        faults: Bits of the inputs that were not finite, in the order of `FIELDS` and `VIEW_NAMES`.
    """

    size: tuple[int, int]
    rows: int
    capacity: int
    pairs: int
    faults: int


class Reports:
    """Reports of renderings; reading them never waits for the device, so that they may arrive some renderings late."""

    def __init__(self) -> None:
        self._travelling: list[tuple[Any, tuple[tuple[int, int], int, int], Tensor]] = []

    def send(self, size: tuple[int, int], rows: int, capacity: int, status: Tensor) -> None:
        """Start to copy a status to the host, unless another copy is under way or a graph is being captured."""
        if self._travelling or (status.is_cuda and device_kernels.is_capturing()):
            return
        copy = status.to("cpu", non_blocking=True)
        event = device_kernels.event_now() if status.is_cuda else None
        self._travelling.append((event, (size, rows, capacity), copy))

    def arrived(self) -> list[Report]:
        """The reports that have arrived; each is returned once."""
        if not all(event is None or _has_happened(event) for event, _, _ in self._travelling):
            return []
        ready, self._travelling = self._travelling, []
        return [Report(*about, *copy.tolist()) for _, about, copy in ready]


def _has_happened(event: Any) -> bool:
    """Whether the device has come to an event; no while a graph is being captured, when asking is forbidden."""
    return not device_kernels.is_capturing() and event.query()


class Capacity:
    """The number of pairs that a rendering gets memory for, from what earlier ones of the same size had."""

    def __init__(self) -> None:
        self._per_gaussian: dict[tuple[int, int], float] = {}

    def of(self, size: tuple[int, int], rows: int) -> int:
        """Capacity for `rows` Gaussians in an image of `size`, at least one pair per Gaussian."""
        wanted = max(1.0, self._per_gaussian.get(size, FIRST_GUESS)) * rows
        return max(1, -(-int(wanted) // STEP)) * STEP

    def learn(self, report: Report) -> None:
        """Follow the number of pairs, if it comes close to the capacity or needs less than half of it."""
        if report.rows and not 0.3 * report.capacity < report.pairs < 0.85 * report.capacity:
            self._per_gaussian[report.size] = HEADROOM * report.pairs / report.rows


class Memory:
    """What a rasterizer remembers: capacities, and the reports that are under way."""

    def __init__(self) -> None:
        self._capacity, self._reports = Capacity(), Reports()

    def settle(self) -> None:
        """Learn from the reports that have arrived, without waiting.

        Raises:
            InputError: A tensor of an earlier rendering held NaN or infinity.
        """
        for report in self._reports.arrived():
            self._capacity.learn(report)
            names = [name for bit, name in enumerate(CHECKED) if report.faults >> bit & 1]
            if names:
                raise InputError(
                    f"{', '.join(names)}: expected finite numbers, found NaN or infinity in an earlier rendering; "
                    "the training diverged or the capture is damaged: lower the learning rates or check the capture"
                )

    def capacity(self, size: tuple[int, int], rows: int) -> int:
        """Capacity for `rows` Gaussians in an image of `size`, width and height in px."""
        return self._capacity.of(size, rows)

    def send(self, size: tuple[int, int], rows: int, capacity: int, status: Tensor) -> None:
        """Start to copy the status of a rendering to the host."""
        self._reports.send(size, rows, capacity, status)
