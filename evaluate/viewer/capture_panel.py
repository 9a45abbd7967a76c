"""The panel of a capture: which frame, which view of it, and what was said about the capture."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

from evaluate.viewer.capture_scene import ALL, LANDMARKS, MODES, CaptureScene, at
from evaluate.viewer.findings import dropped_frames, findings
from evaluate.viewer.playback import Playback
from evaluate.viewer.server import Windows, by_user
from evaluate.viewer.texts import bullets, lines


class CapturePanel:
    """Builds the controls of a `CaptureScene` and keeps them in step with it."""

    def __init__(self, server: Windows, scene: CaptureScene) -> None:
        self._scene = scene
        gui = server.viser.gui
        capture = scene.capture
        gui.add_html(lines(f"{len(capture.frames)} frames of {capture.width}×{capture.height}, {capture.fps:g} fps",
                           f"head {capture.head_version}"))  # fmt: skip
        known = capture.tracking.landmarks is not None
        mode = gui.add_dropdown("picture", tuple(one for one in MODES if known or one != LANDMARKS), initial_value=ALL)
        back = gui.add_button("whole picture")
        with gui.add_folder("Clip"):
            self._play = gui.add_checkbox("play", False)
            self._position = gui.add_slider("position", 0, max(len(capture.frames) - 1, 1), 1, 0)
            self._frame = gui.add_html("")
        with gui.add_folder("Doctor"):
            gui.add_html(bullets("", *findings(capture.folder)))
        with gui.add_folder("Left out"):
            gui.add_html(bullets("", dropped_frames(capture.dropped), "no frame was left out"))
        mode.on_update(by_user(lambda e: scene.update(lambda shown: dataclasses.replace(shown, mode=e.target.value))))
        back.on_click(by_user(lambda event: server.look_ahead(event.client)))
        self._play.on_update(by_user(self._start_or_stop))
        self._position.on_update(by_user(lambda event: self._goto(scene.shown.clip.at(int(event.target.value)))))
        self._goto(scene.shown.clip)

    def _start_or_stop(self, event: Any) -> None:
        now = time.monotonic()
        if event.target.value:
            self._scene.update(lambda shown: at(shown, shown.clip.playing(now)))
        else:
            self._goto(self._scene.shown.clip.resting(now))

    def _goto(self, clip: Playback) -> None:
        """Rest at a frame."""
        self._scene.update(lambda shown: at(shown, clip))
        self._play.value = False
        self._position.value = clip.start
        self._frame.content = lines(f"frame {clip.frames[clip.start]} of the video")
