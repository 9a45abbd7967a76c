"""The pool that compiled kernels run on, and their cache."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from ggavatar.jit import kernels, threads


@pytest.fixture(autouse=True)
def _two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("count", [0, 1, 2, 100])
def test_every_piece_is_done_once(count: int) -> None:
    done = np.zeros(count, int)

    def task(index: int) -> None:
        done[index] += 1

    threads.run(task, count)
    assert (done == 1).all()


@pytest.mark.parametrize("place", ["caller", "helper"])
def test_what_a_task_raises_is_raised(place: str) -> None:
    caller = threading.get_ident()

    def task(index: int) -> None:
        time.sleep(0.01)
        if (threading.get_ident() == caller) == (place == "caller"):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        threads.run(task, 50)
    threads.run(lambda index: None, 4)


def test_callers_do_not_wait_for_each_other() -> None:
    """One caller keeps the only helper busy; another one gets its work done meanwhile."""
    release, entered = threading.Event(), threading.Event()

    def slow(index: int) -> None:
        entered.set()
        assert release.wait(30)

    first = threading.Thread(target=lambda: threads.run(slow, 2))
    first.start()
    assert entered.wait(30)
    done: list[int] = []
    threads.run(done.append, 10)
    assert sorted(done) == list(range(10))
    release.set()
    first.join()


def test_run_workers_gives_every_worker_a_number_and_every_piece_once() -> None:
    seen: list[tuple[int, int]] = []

    def kernel(tickets: np.ndarray, offset: int) -> None:
        worker, tickets[1] = tickets[1], tickets[1] + 1
        while tickets[0] < 10:
            piece, tickets[0] = tickets[0], tickets[0] + 1
            seen.append((int(worker), int(piece) + offset))

    torch.set_num_threads(1)
    threads.run_workers(kernel, 10, 100)
    assert seen == [(0, 100 + piece) for piece in range(10)]


def test_an_announcement_is_made_once(capsys: pytest.CaptureFixture[str]) -> None:
    kernels.announce("something for this test")
    kernels.announce("something for this test")
    assert capsys.readouterr().err.count("something for this test") == 1
