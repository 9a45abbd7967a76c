"""The drawing thread without a browser: what is drawn, for whom, how large, and that nothing ends it.

Also covers `evaluate/viewer/picture_size.py` and `evaluate/viewer/playback.py`. Reference: the order of calls, written
out, under a clock that the test moves.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Hashable
from typing import Any

import numpy as np
import pytest

from evaluate.viewer.drawing import IDLE, POLL, REST, Drawing
from evaluate.viewer.orbit import Place, resting_place
from evaluate.viewer.picture_size import LEAST_HEIGHT, SECONDS, PictureSize, resting
from evaluate.viewer.playback import Playback

PLACE = resting_place(np.array([0.0, 0.0, 1.0]), 1000, 800)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class Numbers:
    """A scene that shows a number."""

    number, is_playing, fails = 0, False, False

    def moment(self, now: float) -> Hashable:
        return self.number

    def plays(self) -> bool:
        return self.is_playing

    def picture(self, place: Place, size: tuple[int, int], now: float) -> np.ndarray:
        if self.fails:
            raise RuntimeError("torn")
        return np.full((size[1], size[0], 3), self.number, np.uint8)


class Window:
    """A browser that notes what it is shown, until it dies."""

    def __init__(self, place: Place | None = PLACE) -> None:
        self.where, self.shown, self.is_dead, self.is_busy = place, [], False, False

    def is_ready(self) -> bool:
        return not self.is_busy

    def place(self) -> Place | None:
        if self.is_dead:
            raise AssertionError
        return self.where

    def show(self, image: np.ndarray, is_final: bool) -> None:
        if self.is_dead:
            raise ConnectionError("gone")
        self.shown.append((int(image[0, 0, 0]), image.shape[0], is_final))


@pytest.fixture
def parts() -> tuple[Drawing, Numbers, Clock]:
    clock, scene = Clock(), Numbers()
    return Drawing(scene, clock), scene, clock


def steps(drawing: Drawing, count: int) -> list[float]:
    return [drawing.step() for _ in range(count)]


def test_a_change_is_drawn_small_and_then_once_at_full_size(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, scene, clock = parts
    window = Window()
    drawing.add(window)
    assert drawing.step() == 0.0 and window.shown == [(0, 400, False)]
    assert drawing.step() == pytest.approx(REST) and len(window.shown) == 1
    clock.now += REST
    assert steps(drawing, 3) == [0.0, IDLE, IDLE]
    assert window.shown[1:] == [(0, 800, True)]
    scene.number = 7
    drawing.step()
    assert window.shown[2][0] == 7 and not window.shown[2][2]


def test_a_moved_camera_is_a_change_for_its_window_only(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, _, clock = parts
    first, second = Window(), Window()
    for window in (first, second):
        drawing.add(window)
    steps(drawing, 2)
    clock.now += REST
    steps(drawing, 2)
    assert [shown[2] for shown in first.shown + second.shown] == [False, True] * 2
    first.where = dataclasses.replace(PLACE, position=(0.1, 0.0, 1.0))
    steps(drawing, 2)
    assert (len(first.shown), len(second.shown)) == (3, 2)


def test_two_windows_take_turns(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, scene, clock = parts
    windows = [Window(), Window()]
    for window in windows:
        drawing.add(window)
    for number in range(1, 21):
        scene.number = number
        clock.now += 0.01
        drawing.step()  # time for one picture a change
    assert abs(len(windows[0].shown) - len(windows[1].shown)) <= 1


def test_a_dying_window_ends_nothing(parts: tuple[Drawing, Numbers, Clock], capsys: Any) -> None:
    drawing, scene, clock = parts
    dying, living = Window(), Window()
    for window in (dying, living):
        drawing.add(window)
    steps(drawing, 2)
    dying.is_dead = True
    for number in range(1, 6):
        scene.number = number
        clock.now += 0.01
        steps(drawing, 2)
    assert [shown[0] for shown in living.shown] == [0, 1, 2, 3, 4, 5]
    assert capsys.readouterr().err.count("the viewer goes on") == 1
    drawing.remove(dying)


def test_a_picture_that_fails_ends_nothing(parts: tuple[Drawing, Numbers, Clock], capsys: Any) -> None:
    drawing, scene, _ = parts
    window = Window()
    drawing.add(window)
    scene.fails = True
    drawing.step()
    scene.fails, scene.number = False, 1
    drawing.step()
    assert [shown[0] for shown in window.shown] == [1]
    assert "torn" in capsys.readouterr().err


def test_jobs_come_first_and_may_fail(parts: tuple[Drawing, Numbers, Clock], capsys: Any) -> None:
    drawing, _, _ = parts
    window, done = Window(), []
    drawing.add(window)
    drawing.submit(lambda: done.append(1 // 0))
    drawing.submit(lambda: done.append(2))
    steps(drawing, 2)
    assert done == [2] and not window.shown and "ZeroDivisionError" in capsys.readouterr().err


def test_waits_are_short_while_a_clip_plays(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, scene, _ = parts
    assert drawing.step() == IDLE
    scene.is_playing = True
    assert drawing.step() == POLL


def test_a_slow_window_gets_the_newest_picture_when_it_is_ready(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, scene, clock = parts
    window = Window()
    drawing.add(window)
    drawing.step()
    window.is_busy = True
    for number in range(1, 9):
        scene.number = number
        clock.now += 1.0
        steps(drawing, 2)
    assert len(window.shown) == 1
    window.is_busy = False
    drawing.step()
    assert [shown[0] for shown in window.shown] == [0, 8]


def test_a_window_that_is_not_known_yet_waits(parts: tuple[Drawing, Numbers, Clock]) -> None:
    drawing, _, _ = parts
    drawing.add(Window(None))
    assert drawing.step() == IDLE


def test_the_thread_draws_and_stops() -> None:
    scene, window = Numbers(), Window()
    drawing = Drawing(scene)
    drawing.add(window)
    drawing.start()
    end = time.monotonic() + 20
    while not any(is_final for _, _, is_final in window.shown) and time.monotonic() < end:
        time.sleep(0.01)
    drawing.stop()
    assert [is_final for _, _, is_final in window.shown] == [False, True]


def test_sizes_settle_at_the_time_a_picture_may_take() -> None:
    # Time by area, 0.4 s at full size: in time for 15 a second at a scale of sqrt(1 / 6).
    size = PictureSize(1.0)
    for _ in range(40):
        size = size.after(0.4 * size.scale**2)
    assert size.scale == pytest.approx((SECONDS / 0.4) ** 0.5, rel=1e-3)
    for _ in range(40):
        size = size.after(0.001)
    assert size.scale == 1.0


def test_sizes_have_limits() -> None:
    assert PictureSize(0.05).moving(1600, 800) == (2 * LEAST_HEIGHT, LEAST_HEIGHT)
    assert resting(800, 600) == (800, 600)
    assert resting(3840, 2160) == (1920, 1080)
    assert PictureSize(1.0).moving(60, 40) == (60, 40)


def test_a_clip_plays_by_the_clock_and_begins_again() -> None:
    clip = Playback((10, 20, 30), 10.0)
    assert clip.frame(5.0) == 10 and not clip.is_playing
    playing = clip.playing(5.0)
    assert [playing.frame(5.0 + seconds) for seconds in (0.05, 0.15, 0.25, 0.35)] == [10, 20, 30, 10]
    stopped = playing.resting(5.25)
    assert stopped.frame(99.0) == 30 and stopped.playing(100.0).frame(100.15) == 10
    assert clip.at(99).frame(0.0) == 30 and clip.at(-1).frame(0.0) == 10
