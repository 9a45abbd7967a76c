"""The lists of tiles against lists made by a loop over all Gaussians and tiles."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Tensor

from tests.support.triton_kernels import interpreted

pytestmark = interpreted


def listed_by_loop(boxes: Tensor, depths: Tensor, across: int, down: int) -> list[list[int]]:
    """The Gaussians of every tile, front to back, equal depths in order of rows."""
    order = sorted(range(len(depths)), key=lambda row: float(depths[row]))
    lists: list[list[int]] = []
    for y in range(down):
        for x in range(across):
            spans = [(row, *boxes[row].tolist()) for row in order]
            lists.append([row for row, left, top, w, h in spans if left <= x < left + w and top <= y < top + h])
    return lists


@pytest.mark.parametrize("narrow", [True, False], ids=["16-bit", "32-bit"])
@pytest.mark.parametrize(("across", "down", "count"), [(1, 1, 3), (5, 3, 40), (9, 2, 1)])
def test_lists_equal_those_of_a_loop(
    narrow: bool, across: int, down: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ggavatar.render.triton import stages

    monkeypatch.setattr(stages, "NARROW_TILES", 32_767 if narrow else 0)
    generator = torch.Generator().manual_seed(count)
    corner = torch.stack([torch.randint(size, (count,), generator=generator) for size in (across, down)], 1)
    extent = (torch.tensor([across, down]) - corner) * torch.randint(2, (count, 2), generator=generator)
    boxes, counts = torch.cat((corner, extent), 1).int(), extent.prod(1).int()
    depths = torch.where(counts > 0, torch.randint(4, (count,), generator=generator).float(), torch.inf)
    status = torch.zeros(2, dtype=torch.int32)
    lists = stages.list_pairs((across, down), stages.Placed(depths, boxes, counts), 4096, status)
    starts, entries = lists.starts.tolist(), lists.entries.tolist()
    found = [entries[first:end] for first, end in itertools.pairwise(starts)]
    assert found == listed_by_loop(boxes, depths, across, down)
    assert status.tolist() == [int(counts.sum()), 0] and starts[-1] == counts.sum()
    assert sorted(lists.places.tolist()) == list(range(4096))
