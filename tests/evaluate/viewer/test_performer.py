"""A performer: what is carried over, when, and that nothing ends the viewer.

Also covers `evaluate/viewer/live_panel.py` and `evaluate/viewer/moving_pictures.py`. Reference: the order of calls with
stand-ins for the landmark network and the transfer, videos written here, and a clock that the test moves.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from evaluate.figures.video import video_writer
from evaluate.motion.live import Look
from evaluate.viewer import moving_pictures, performance, performer
from evaluate.viewer.live_panel import LivePanel
from evaluate.viewer.moving_pictures import MOST_SIDE, camera_pictures, paced, pictures_of, reduced
from evaluate.viewer.performer import MOST_HEIGHT, POINT_COLOR, REST_LOOKS, Performer, small
from evaluate.viewer.run_scene import AVATAR, BESIDE, RunScene
from ggavatar.core import Camera, Drive
from ggavatar.errors import InputError
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from tests.support.fake_viser import FakeServer
from tests.support.toy_run import camera, head, toy_run

FACE = Landmarks(np.full((478, 2), 5.0), np.zeros(478), np.zeros(52), 1.0)
BLANK = np.zeros((20, 30, 3), np.uint8)


class Tracker(LandmarkTracker):
    """Finds a face unless the picture is bright."""

    def __init__(self) -> None:
        self.resets = 0

    def landmarks(self, frame: np.ndarray) -> Landmarks | None:
        return None if frame.max() > 100 else FACE

    def reset(self) -> None:
        self.resets += 1


class Listening:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.drives: list[Drive] = []
        self.waits, self.texts = 0, [""]

    def performed(self, drive: Drive, camera: Camera, picture: np.ndarray) -> None:
        self.drives.append(drive)

    def waiting(self, picture: np.ndarray) -> None:
        self.waits += 1

    def said(self, text: str) -> None:
        if text != self.texts[-1]:
            self.texts.append(text)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Look, Look]]:
    """Looks whose first score counts up, and the pairs (now, at rest) that are carried over."""
    made: list[tuple[Look, Look]] = []
    count = iter(range(10_000))

    def look(*_: Any) -> Look:
        return Look(np.full(51, float(next(count))), np.zeros(3), np.array([0.0, 0, 1]))

    monkeypatch.setattr(performer, "look_of", look)
    return made


def watched(audience: Any, pictures: Any, calls: list[tuple[Look, Look]]) -> Performer:
    def carry(look: Look, rest: Look, size: tuple[int, int]) -> tuple[Drive, Camera]:
        assert size == (30, 20)
        calls.append((look, rest))
        return head().neutral_drive(), camera()

    return Performer(lambda: iter(pictures), Tracker(), lambda: carry, audience)  # type: ignore[arg-type,return-value]


def test_rest_is_seen_first_and_again_when_asked_for(calls: list[tuple[Look, Look]]) -> None:
    audience = Listening()
    watching = watched(audience, [], calls)
    watching._transfer = watching._learn()
    for index in range(REST_LOOKS + 4):
        watching.see(BLANK, index / 25)
    assert audience.waits == REST_LOOKS - 1 and len(audience.drives) == 5
    first = calls[0][1].scores[0]
    assert all(rest.scores[0] == first for _, rest in calls)
    watching.calibrate()
    for index in range(REST_LOOKS):
        watching.see(BLANK, 1 + index / 25)
    assert calls[-1][1].scores[0] > first and audience.waits == 2 * (REST_LOOKS - 1)


def test_no_face_is_said_and_leaves_the_avatar_as_it_is(calls: list[tuple[Look, Look]]) -> None:
    audience = Listening()
    watching = watched(audience, [], calls)
    watching._transfer = watching._learn()
    watching.see(BLANK + 255, 0.0)
    assert audience.texts[-1] == "no face in view" and not audience.drives and audience.waits == 1


def wait_until(condition: Any) -> None:
    end = time.monotonic() + 30
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_a_video_begins_again(calls: list[tuple[Look, Look]]) -> None:
    audience = Listening()
    watching = watched(audience, [BLANK] * 3, calls)
    watching.start()
    wait_until(lambda: len(audience.drives) > 2)
    watching.stop()
    assert audience.texts[1] == "measuring the avatar's own face"


def test_a_camera_that_fails_is_said(calls: list[tuple[Look, Look]], capsys: Any) -> None:
    silent = Listening()
    watching = watched(silent, [], calls)
    watching.start()
    wait_until(lambda: silent.texts[-1] == "no pictures come from the camera")
    audience = Listening()

    def broken() -> Iterator[np.ndarray]:
        yield BLANK
        raise InputError("the film broke")

    failing = watched(audience, [], calls)
    failing._play = broken
    failing.start()
    wait_until(lambda: "the film broke" in audience.texts[-1])
    wait_until(lambda: not failing._thread.is_alive())
    assert "the film broke" in capsys.readouterr().err


def test_the_panel_moves_the_avatar_until_it_is_let_go(tmp_path: Path) -> None:
    scene, server = RunScene(toy_run(tmp_path)), FakeServer()
    panel = LivePanel(server, scene)
    asked: list[bool] = []
    panel.performer = SimpleNamespace(calibrate=lambda: asked.append(True))
    gui = server.viser.gui
    scene.update(lambda shown: dataclasses.replace(shown, mode=BESIDE))
    drive = head().neutral_drive()
    panel.performed(drive, camera(), BLANK)
    assert scene.shown.drive is drive and scene.shown.mode == AVATAR and scene.beside is BLANK
    gui.named("this is my neutral face").use()
    panel.said("<b>hold still</b>")
    assert asked == [True] and "&lt;b&gt;hold" in panel._status.content
    gui.named("move the avatar").use(False)
    assert scene.beside is None
    panel.performed(scene.controls.rest, camera(), BLANK)
    panel.waiting(BLANK)
    assert scene.shown.drive is drive and scene.beside is None
    gui.named("move the avatar").use(True)
    panel.waiting(BLANK)
    assert scene.beside is BLANK


def test_the_performer_is_shown_small_with_landmarks() -> None:
    large = np.zeros((2 * MOST_HEIGHT, 1000, 3), np.uint8)
    found = small(large, FACE)
    assert found.shape == (MOST_HEIGHT, 500, 3) and tuple(found[2, 2]) == POINT_COLOR and not large.any()
    assert small(BLANK, None).shape == BLANK.shape


def test_pictures_come_in_time_and_late_ones_are_left_out() -> None:
    now, slept = [0.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    timed = ((index / 10, np.full((1, 1, 3), index, np.uint8)) for index in range(10))
    shown = []
    for image in paced(timed, lambda: now[0], sleep):
        shown.append((int(image[0, 0, 0]), round(now[0], 6)))
        now[0] += 0.25  # the performer's face takes so long
    assert shown == [(0, 0.0), (2, 0.25), (5, 0.5), (7, 0.75), (9, 1.0)]
    assert not slept or min(slept) > 0


def test_videos_are_decoded_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    path = tmp_path / "me.mp4"
    with video_writer(path, 25.0) as append:
        for index in range(4):
            append(np.full((32, 48, 3), 60 * index, np.uint8))
    play = pictures_of(str(path))
    for _ in range(2):
        found = [image for _, image in moving_pictures._decoded(path)]
        np.testing.assert_allclose([image.mean() for image in found], [0, 60, 120, 180], atol=4)
        assert next(play()).shape == (32, 48, 3)


@pytest.mark.parametrize(
    "content", [b"", b"no video", b"ffconcat version 1.0\nfile '/etc/passwd'\n", b"#EXTM3U\n/a.ts\n"]
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "playlist.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"playlist\.mp4"):
        pictures_of(str(path))
    with pytest.raises(InputError, match="no such file"):
        pictures_of(str(tmp_path / "none.mp4"))


def test_cameras_go_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[int] = []

    class Camera:
        def __init__(self, number: int) -> None:
            opened.append(number)
            self.left = 2

        def isOpened(self) -> bool:
            return opened[-1] != 7

        def set(self, *_: Any) -> None: ...

        def read(self) -> tuple[bool, np.ndarray]:
            self.left -= 1
            return self.left >= 0, np.dstack([np.full((2, 3), value, np.uint8) for value in (1, 2, 3)])  # BGR

    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    found = list(pictures_of("3")())
    assert opened == [3] and len(found) == 2 and found[0][0, 0].tolist() == [3, 2, 1]
    with pytest.raises(InputError, match="--webcam 7"):
        pictures_of("7")
    assert next(iter(camera_pictures(Camera(9)))).flags.c_contiguous


def test_a_performance_learns_from_training_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(performance.ModelFinder, "find", lambda self, name: seen.append(name) or tmp_path)
    monkeypatch.setattr(performance, "LandmarkTracker", lambda path: Tracker())
    monkeypatch.setattr(performance, "pictures_of", lambda source: lambda: iter([BLANK]))
    monkeypatch.setattr(performance, "measured_scores", lambda capture, frames, finder: seen.append(frames))
    scene = RunScene(toy_run(tmp_path))
    made = performance.performer_of("0", FakeServer(), scene)
    with pytest.raises(InputError, match="measured"):
        made._learn()  # no scores in this stand-in
    assert seen == ["face_landmarker", scene.run.split.train]
    made._learn = lambda: lambda look, rest, size: (head().neutral_drive(), camera())  # type: ignore[assignment,return-value]
    made.calibrate()
    made.start()
    wait_until(lambda: scene.beside is not None)
    made.stop()


def test_large_pictures_are_reduced() -> None:
    assert reduced(np.zeros((1080, 1920, 3), np.uint8)).shape == (720, MOST_SIDE, 3)
    assert reduced(BLANK) is BLANK
