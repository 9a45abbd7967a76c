"""A performer before a camera or in a video: seen, measured and carried over to the avatar, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from evaluate.motion.live import LiveTransfer, Look, LookFilter, look_of, mean_look
from evaluate.viewer.moving_pictures import Picture
from ggavatar.core import Camera, Drive
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from ggavatar.text.terminal import write_err

REST_LOOKS = 10
"""Looks whose mean is the performer at rest."""
LONGEST_PAUSE = 0.5
"""Time between two looks after which the filter begins again, s."""
MOST_HEIGHT = 480
"""Height to which the performer's picture is reduced, px."""
POINT_COLOR = (90, 220, 255)


@runtime_checkable  # the tests' run-time type checker needs it
class Audience(Protocol):
    """Who is told what a performer does."""

    def performed(self, drive: Drive, camera: Camera, picture: Picture) -> None:
        """The avatar shall do this; the picture shows the performer."""
        ...

    def waiting(self, picture: Picture) -> None:
        """Nothing to be carried over is seen in the picture."""
        ...

    def said(self, text: str) -> None:
        """How it goes."""
        ...


class Performer:
    """Watches moving pictures until it is stopped; a video begins again at its end."""

    def __init__(
        self,
        play: Callable[[], Iterator[Picture]],
        tracker: LandmarkTracker,
        learn: Callable[[], LiveTransfer],
        audience: Audience,
    ) -> None:
        """Prepare to watch.

        Args:
            play: The pictures, from the beginning.
            tracker: Of the performer's face; used by one thread only.
            learn: The way to the avatar; may take a while.
            audience: Is told.
        """
        self._play, self._tracker, self._learn, self._audience = play, tracker, learn, audience
        self._transfer: LiveTransfer | None = None
        self._filter, self._last = LookFilter(), 0.0
        self._looks: list[Look] = []
        self._rest: Look | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="performer", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def stop(self) -> None:
        """Watch no more."""
        self._ended.set()

    def calibrate(self) -> None:
        """Take what is seen next as the performer's face at rest."""
        self._looks, self._rest = [], None

    def see(self, picture: Picture, now: float) -> None:
        """Carry over what one picture shows, `now` being its moment, s."""
        found = self._tracker.landmarks(picture)
        size = (picture.shape[1], picture.shape[0])
        look = None if found is None else look_of(found.blendshapes, found.points, size)
        if found is None or look is None:
            self._audience.said("no face in view")
            self._audience.waiting(small(picture, None))
            return
        if now - self._last > LONGEST_PAUSE:
            self._filter = LookFilter()
        look, self._last = self._filter(look, now - self._last), now
        rest = self._at_rest(look)
        if rest is None or self._transfer is None:
            self._audience.said("hold still with a neutral face, towards the camera")
            self._audience.waiting(small(picture, found))
            return
        drive, camera = self._transfer(look, rest, size)
        self._audience.performed(drive, camera, small(picture, found))
        self._audience.said("")

    def _at_rest(self, look: Look) -> Look | None:
        """The performer at rest; None while too little has been seen."""
        if self._rest is None:
            self._looks.append(look)
            if len(self._looks) >= REST_LOOKS:
                self._rest = mean_look(self._looks)
        return self._rest

    def _run(self) -> None:
        try:
            self._audience.said("measuring the avatar's own face")
            self._transfer = self._learn()
            while not self._ended.is_set() and self._watch():
                self._tracker.reset()
                self._last = 0.0
        except Exception as error:  # the viewer goes on without a performer
            self._audience.said(f"no performance: {error}")
            write_err(f"warning: the performance has ended: {error}")

    def _watch(self) -> bool:
        """Watch until the pictures end; False if there were none."""
        has_seen = False
        for picture in self._play():
            if self._ended.is_set():
                return False
            has_seen = True
            self.see(picture, time.monotonic())
        if not has_seen:
            self._audience.said("no pictures come from the camera")
        return has_seen


def small(picture: Picture, found: Landmarks | None) -> Picture:
    """The picture, reduced, with the landmarks that were found in it."""
    factor = min(1.0, MOST_HEIGHT / picture.shape[0])
    size = (max(1, round(picture.shape[1] * factor)), max(1, round(picture.shape[0] * factor)))
    drawn = np.ascontiguousarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if factor < 1 else picture)
    if found is None:
        return drawn
    drawn = drawn.copy()
    for x, y in found.points * factor:
        cv2.circle(drawn, (int(x), int(y)), 1, POINT_COLOR, cv2.FILLED)
    return drawn
