"""How many pairs get memory, by hand-computed numbers, and reports that arrive late."""

from __future__ import annotations

import pytest
import torch

from ggavatar.jit import device_kernels
from ggavatar.render.triton.capacity import Capacity, Report, Reports

SIZE = 512, 512


def test_the_first_capacity_is_eight_pairs_a_gaussian_in_whole_steps() -> None:
    assert Capacity().of(SIZE, 10_000) == 20 * 4096  # 80,000 pairs
    assert Capacity().of(SIZE, 1) == 4096


def test_capacity_follows_the_pairs_of_its_image_size() -> None:
    capacity = Capacity()
    capacity.learn(Report(SIZE, 10_000, 81_920, 200_000, 0))
    assert capacity.of(SIZE, 10_000) == 74 * 4096  # 1.5 times as many, rounded up
    assert capacity.of(SIZE, 20_000) == 147 * 4096  # more Gaussians, as many pairs each
    assert capacity.of((256, 256), 10_000) == 20 * 4096
    capacity.learn(Report(SIZE, 10_000, 303_104, 250_000, 0))  # 82 %: still enough
    assert capacity.of(SIZE, 10_000) == 74 * 4096
    capacity.learn(Report(SIZE, 10_000, 303_104, 30_000, 0))  # a tenth: memory is given back
    assert capacity.of(SIZE, 10_000) == 11 * 4096


def test_there_is_a_place_for_every_gaussian() -> None:
    """Gradients need one a Gaussian if the pairs overflow."""
    capacity = Capacity()
    capacity.learn(Report(SIZE, 100_000, 819_200, 0, 0))
    assert capacity.of(SIZE, 100_000) == 25 * 4096


def test_reports_arrive_once() -> None:
    reports = Reports()
    assert reports.arrived() == []
    reports.send(SIZE, 7, 4096, torch.tensor([12, 5], dtype=torch.int32))
    reports.send(SIZE, 8, 4096, torch.tensor([13, 0], dtype=torch.int32))  # one at a time
    assert reports.arrived() == [Report(SIZE, 7, 4096, pairs=12, faults=5)]
    assert reports.arrived() == []


class Event:
    """An event of a device that has not come to it at first."""

    happened = False

    def query(self) -> bool:
        return self.happened


def test_a_report_that_is_under_way_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_kernels, "is_capturing", lambda: False)
    reports, event = Reports(), Event()
    reports._travelling.append((event, (SIZE, 7, 4096), torch.tensor([1, 0])))
    assert reports.arrived() == []
    event.happened = True
    with monkeypatch.context() as during_capture:  # when not even asking is allowed
        during_capture.setattr(device_kernels, "is_capturing", lambda: True)
        assert reports.arrived() == []
    assert reports.arrived() == [Report(SIZE, 7, 4096, 1, 0)]
