"""Threads against a plain `map`: the same results in the same order, few items at a time, the same errors."""

from __future__ import annotations

import threading
import time

import pytest

from ggavatar.io.ordered_map import AHEAD, cores, ordered_map


def test_results_keep_their_order_whoever_is_first() -> None:
    def slow_when_even(number: int) -> int:
        time.sleep(0.003 if number % 2 == 0 else 0.0)
        return number * number

    assert list(ordered_map(slow_when_even, range(40))) == [number * number for number in range(40)]
    assert list(ordered_map(str, [])) == []


def test_only_a_few_items_are_taken_ahead() -> None:
    taken: list[int] = []

    def endless():
        for number in range(10**9):
            taken.append(number)
            yield number

    results = ordered_map(lambda number: number, endless())
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    results.close()
    assert 5 <= len(taken) <= 5 + cores() + AHEAD


@pytest.mark.parametrize(("threads", "ahead"), [(1, 0), (1, 7), (3, 2)])
def test_threads_and_results_ahead_are_bounded(threads: int, ahead: int) -> None:
    lock, started = threading.Lock(), set[int]()

    def slow(number: int) -> int:
        with lock:
            started.add(number)
        time.sleep(0.001 * (number % 3))
        return number

    for place, number in enumerate(ordered_map(slow, range(40), threads, ahead)):
        assert number == place
        with lock:
            assert max(started) < place + threads + ahead


def test_an_error_comes_at_its_items_place_and_threads_end() -> None:
    def picky(number: int) -> int:
        if number == 3:
            raise ValueError("three")
        return number

    before, results = threading.active_count(), ordered_map(picky, range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)
    assert threading.active_count() == before
