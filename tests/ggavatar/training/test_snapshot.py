"""Snapshots of a training: what they hold, when they are written, and that they disturb nothing.

Reference: the avatar's state, and a clock that the test moves.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from ggavatar.errors import InputError
from ggavatar.training.checkpoint import unpack_avatar
from ggavatar.training.progress import Listener, NullListener
from ggavatar.training.run_folder import create_run_folder, remove_leftovers, write_config
from ggavatar.training.snapshot import INTERVAL, SNAPSHOT, SnapshotListener, read_snapshot, write_snapshot


class Clock:
    """A clock that passes some time whenever it is read."""

    def __init__(self) -> None:
        self.now, self.per_reading = 0.0, 0.0

    def __call__(self) -> float:
        self.now += self.per_reading
        return self.now


class Noting(NullListener):
    def __init__(self) -> None:
        self.events: list[Any] = []

    def step(self, step: int, loss: Callable[[], float], gaussians: int) -> None:
        self.events.append(step)

    def evaluated(self, step: int, psnr: float) -> None:
        self.events.append(psnr)

    def close(self) -> None:
        self.events.append("closed")


def avatar(value: float = 1.0) -> nn.Module:
    made = nn.Linear(3, 2)
    with torch.no_grad():
        made.weight.fill_(value)
    return made


def test_a_snapshot_is_the_avatar_and_nothing_else(tmp_path: Path) -> None:
    write_snapshot(tmp_path, avatar(2.0), 17)
    write_snapshot(tmp_path, avatar(3.0), 18)
    read = read_snapshot(tmp_path)
    assert read is not None and read[1] == 18 and set(read[0]) == {"avatar.weight", "avatar.bias"}
    other = avatar()
    unpack_avatar(other, read[0])
    assert (other.weight == 3.0).all() and [path.name for path in tmp_path.iterdir()] == [SNAPSHOT]


def test_no_snapshot_is_none_and_a_torn_one_is_refused(tmp_path: Path) -> None:
    assert read_snapshot(tmp_path) is None
    write_snapshot(tmp_path, avatar(), 5)
    whole = (tmp_path / SNAPSHOT).read_bytes()
    for torn in (b"", whole[:5], whole[:40], whole[:-1], b"\xff" * 64, whole.replace(b'"step"', b'"stop"')):
        (tmp_path / SNAPSHOT).write_bytes(torn)
        with pytest.raises(InputError, match=SNAPSHOT):
            read_snapshot(tmp_path)


def test_one_is_written_at_once_and_then_every_interval(tmp_path: Path) -> None:
    clock, inner = Clock(), Noting()
    listener = SnapshotListener(inner, avatar(), tmp_path, clock)
    assert isinstance(listener, Listener)
    steps = []
    for step in range(1, 8):
        listener.step(step, lambda: 0.0, 1)
        read = read_snapshot(tmp_path)
        assert read is not None
        steps.append(read[1])
        clock.now += INTERVAL / 2
    assert steps == [1, 1, 3, 3, 5, 5, 7]
    listener.evaluated(7, 30.0)
    listener.close()
    assert inner.events == [*range(1, 8), 30.0, "closed"] and read_snapshot(tmp_path) is None


def test_snapshots_take_a_hundredth_of_the_time_at_most(tmp_path: Path) -> None:
    clock = Clock()
    listener = SnapshotListener(NullListener(), avatar(), tmp_path, clock)
    clock.per_reading = 2.0  # a snapshot takes two seconds
    listener.step(1, lambda: 0.0, 1)
    written = clock.now
    clock.per_reading = 0.0
    for seconds, expected in ((199.0, 1), (201.0, 3)):
        clock.now = written + seconds
        listener.step(2 if expected == 1 else 3, lambda: 0.0, 1)
        read = read_snapshot(tmp_path)
        assert read is not None and read[1] == expected


def test_a_full_disk_does_not_end_the_training(tmp_path: Path, capsys: Any) -> None:
    clock = Clock()
    (tmp_path / SNAPSHOT).mkdir()  # cannot be replaced by a file
    listener = SnapshotListener(NullListener(), avatar(), tmp_path, clock)
    for step in (1, 2):
        listener.step(step, lambda: 0.0, 1)
        clock.now += 2 * INTERVAL
    assert capsys.readouterr().err.count("warning") == 1


def test_the_run_folder_knows_it_as_its_own(tmp_path: Path) -> None:
    from ggavatar.data.splits import Split
    from ggavatar.training.run_folder import RunConfig

    write_config(tmp_path, RunConfig("ggavatar", "capture"), Split((1,), (2,)))
    write_snapshot(tmp_path, avatar(), 1)
    create_run_folder(tmp_path, overwrite=False)  # nothing that could be lost: no checkpoint yet
    assert not (tmp_path / SNAPSHOT).exists()
    write_snapshot(tmp_path, avatar(), 1)
    remove_leftovers(tmp_path)
    assert not (tmp_path / SNAPSHOT).exists()
