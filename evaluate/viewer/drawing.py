"""The drawing thread: the only one that touches what is shown, for all browsers, and only when something has changed.

While something moves, pictures are as large as can be drawn often enough; once it rests, one follows at full size.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import UInt8
from numpy import ndarray

from evaluate.viewer.orbit import Place
from evaluate.viewer.picture_size import PictureSize, resting
from ggavatar.text.terminal import write_err

REST = 0.2
"""Time without a change after which a picture of full size is drawn, s."""
POLL = 1 / 60
"""Time between two looks at a clip that plays, s."""
IDLE = 0.5
"""The same while nothing plays, s."""
NICE = 10
"""The thread gives way to others by this much, where the system knows that."""


@runtime_checkable  # the tests' run-time type checker needs it
class Canvas(Protocol):
    """Where pictures of one browser go. Methods may raise anything once the browser is gone."""

    def place(self) -> Place | None:
        """Window and camera; None before they are known."""
        ...

    def is_ready(self) -> bool:
        """Whether the last picture has arrived, so that another one would not get in its way."""
        ...

    def show(self, image: UInt8[ndarray, "H W 3"], is_final: bool) -> None:
        """Show a picture; the final one rests and should not be lossy."""
        ...


@runtime_checkable
class Scene(Protocol):
    """What is shown."""

    def moment(self, now: float) -> Hashable:
        """What the picture depends on besides a browser's camera: a picture is drawn when it changes."""
        ...

    def plays(self) -> bool:
        """Whether the moment changes by itself."""
        ...

    def picture(self, place: Place, size: tuple[int, int], now: float) -> UInt8[ndarray, "H W 3"]:
        """The picture for a camera and a size, px."""
        ...


@dataclass
class _Drawn:
    """What a canvas shows.

    Attributes:
        key: Moment and place of the last picture.
        changed: When the key changed last.
        drawn: When the last picture was drawn.
        is_final: Whether it was of full size.
    """

    key: Hashable = None
    changed: float = 0.0
    drawn: float = 0.0
    is_final: bool = False


class Drawing:
    """Draws a scene for any number of canvases, one picture after the other."""

    def __init__(self, scene: Scene, clock: Callable[[], float] = time.monotonic) -> None:
        self.scene = scene
        self._clock = clock
        self._size = PictureSize()
        self._canvases: dict[Canvas, _Drawn] = {}
        self._jobs: deque[Callable[[], None]] = deque()
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._ended = False
        self._complaint = ""
        self._thread = threading.Thread(target=self._run, name="drawing", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def stop(self) -> None:
        """Draw no more, and wait for the picture under way."""
        self._ended = True
        self.wake()
        if self._thread.is_alive():
            self._thread.join(10)

    def add(self, canvas: Canvas) -> None:
        """Draw for a canvas from now on."""
        with self._lock:
            self._canvases[canvas] = _Drawn()
        self.wake()

    def remove(self, canvas: Canvas) -> None:
        """Draw for a canvas no more."""
        with self._lock:
            self._canvases.pop(canvas, None)

    def submit(self, job: Callable[[], None]) -> None:
        """Have the thread do something between two pictures."""
        self._jobs.append(job)
        self.wake()

    def wake(self) -> None:
        """Something may have changed."""
        self._wake.set()

    def step(self) -> float:
        """Do the next thing, and return how long to wait after it if nothing changes, s."""
        if self._jobs:
            self._attempt(self._jobs.popleft())
            return 0.0
        now = self._clock()
        with self._lock:
            canvases = {canvas: drawn for canvas, drawn in self._canvases.items() if canvas.is_ready()}
        keys = {canvas: self._key(canvas, now) for canvas in canvases}
        stale = [canvas for canvas, key in keys.items() if key is not None and key != canvases[canvas].key]
        if not stale:
            return self._finish(canvases, now)
        canvas = min(stale, key=lambda one: canvases[one].drawn)
        canvases[canvas].key, canvases[canvas].changed = keys[canvas], now
        self._draw(canvas, False, now)
        return 0.0

    def _finish(self, canvases: dict[Canvas, _Drawn], now: float) -> float:
        """Draw one picture of full size where something has come to rest."""
        rough = [(drawn.changed + REST, canvas) for canvas, drawn in canvases.items() if self._is_rough(drawn)]
        if rough:
            due, canvas = min(rough, key=lambda item: item[0])
            if due > now:
                return min(due - now, POLL if self.scene.plays() else REST)
            self._draw(canvas, True, now)
            return 0.0
        return POLL if self.scene.plays() else IDLE

    def _is_rough(self, drawn: _Drawn) -> bool:
        return drawn.key is not None and not drawn.is_final

    def _key(self, canvas: Canvas, now: float) -> Hashable:
        """What a canvas should show; None if it cannot be said."""
        try:
            place = canvas.place()
            return None if place is None else (self.scene.moment(now), place)
        except Exception as error:
            self._complain(error)
            return None

    def _draw(self, canvas: Canvas, is_final: bool, now: float) -> None:
        """Draw and show; what fails costs this picture only."""
        with self._lock:
            drawn = self._canvases.get(canvas)
        if drawn is None:
            return
        drawn.drawn, drawn.is_final = now, is_final
        self._attempt(lambda: self._show(canvas, is_final, now))

    def _show(self, canvas: Canvas, is_final: bool, now: float) -> None:
        place = canvas.place()
        if place is None:
            return
        began = time.perf_counter()
        whole = resting(place.width, place.height)
        size = whole if is_final else self._size.moving(place.width, place.height)
        canvas.show(self.scene.picture(place, size, now), is_final)
        if not is_final:
            self._size = self._size.after(time.perf_counter() - began)

    @torch.no_grad()
    def _attempt(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Exception as error:
            self._complain(error)

    def _complain(self, error: Exception) -> None:
        """Say on stderr what went wrong, once in a row."""
        text = f"{type(error).__name__}: {error}"
        if text != self._complaint:
            write_err(f"warning: a picture could not be drawn or sent ({text}); the viewer goes on")
        self._complaint = text

    def _run(self) -> None:
        with contextlib.suppress(AttributeError, OSError):  # not on this system
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while not self._ended:
            self._wake.clear()
            wait = self.step()
            if wait:
                self._wake.wait(wait)
