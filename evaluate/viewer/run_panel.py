"""The panel of a run: clip, picture, sliders for face and head, and the page to take along."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from pathlib import Path
from typing import Any

from evaluate.viewer.drawing import Drawing
from evaluate.viewer.playback import Playback
from evaluate.viewer.posing import Turn, value_of, with_value
from evaluate.viewer.run_scene import AVATAR, CLIPS, RunScene, Shown
from evaluate.viewer.server import Windows, by_user, notify
from evaluate.viewer.texts import lines
from ggavatar.errors import InputError
from ggavatar.formats.web.controls import Slider
from ggavatar.formats.web.export import export_web
from ggavatar.formats.web.options import WebOptions
from ggavatar.io.regular_files import read_file

DEGREE_STEP, PLAIN_STEP = 0.5, 0.01
"""Steps of sliders for angles, degrees, and for plain numbers."""
PAGE = "avatar.html"
MAX_PAGE_BYTES = 1 << 28
TURN_LABELS = {"yaw": "turn", "pitch": "nod", "roll": "tilt"}


def grid(low: float, high: float, unit: str) -> tuple[float, float, float]:
    """Least and most value and step of a slider, in degrees for rad: multiples of the step that hold the range."""
    step = DEGREE_STEP if unit == "rad" else PLAIN_STEP
    factor = math.degrees(1.0) if unit == "rad" else 1.0
    return round(step * math.floor(low * factor / step), 4), round(step * math.ceil(high * factor / step), 4), step


class RunPanel:
    """Builds the controls of a `RunScene` and keeps them in step with it."""

    def __init__(self, server: Windows, scene: RunScene, drawing: Drawing) -> None:
        self._server, self._scene, self._drawing = server, scene, drawing
        self._gui = server.viser.gui
        self._sliders: list[tuple[Any, Slider, float]] = []
        self._turns: dict[str, Any] = {}
        self.about = self._gui.add_html("")
        self.status = self._gui.add_html("")
        self._add_picture()
        self._add_clip()
        self._add_face()
        self._add_saving()
        self.describe()

    def describe(self, note: str = "") -> None:
        """Say what is shown."""
        run = self._scene.run
        self.about.content = lines(
            f"{run.method}, step {run.step:,}",
            f"{self._scene.gaussians:,} Gaussians" if self._scene.gaussians else "",
            note,
        )

    def _add_picture(self) -> None:
        mode = self._gui.add_dropdown("picture", self._scene.modes, initial_value=AVATAR)
        free = self._gui.add_checkbox("turn beyond training", False)
        back = self._gui.add_button("view from the front")

        def choose(event: Any) -> None:
            self._scene.update(lambda shown: dataclasses.replace(shown, mode=event.target.value))

        mode.on_update(by_user(choose))
        free.on_update(
            by_user(lambda e: self._scene.update(lambda shown: dataclasses.replace(shown, free=e.target.value)))
        )
        back.on_click(by_user(lambda event: self._server.look_ahead(event.client)))

    def _add_clip(self) -> None:
        scene = self._scene
        names = tuple(name for name in CLIPS if scene.frames_of(name))
        with self._gui.add_folder("Clip"):
            clip = self._gui.add_dropdown("frames", names, initial_value=names[0])
            self._play = self._gui.add_checkbox("play", False)
            self._position = self._gui.add_slider("position", 0, max(len(scene.shown.clip.frames) - 1, 1), 1, 0)
            self._frame = self._gui.add_html("")

        def choose(event: Any) -> None:
            self._position.max = max(len(scene.frames_of(event.target.value)) - 1, 1)
            self._goto(scene.clip_of(event.target.value))

        def play(event: Any) -> None:
            now = time.monotonic()
            if event.target.value:
                scene.update(lambda shown: dataclasses.replace(shown, clip=shown.clip.playing(now), drive=None))
            else:
                self._goto(scene.shown.clip.resting(now))

        clip.on_update(by_user(choose))
        self._play.on_update(by_user(play))
        self._position.on_update(by_user(lambda event: self._goto(scene.shown.clip.at(int(event.target.value)))))
        self._show_frame()

    def _goto(self, clip: Playback) -> None:
        """Rest at a frame of the clip, with the sliders where they stand for it."""
        self._scene.update(lambda shown: dataclasses.replace(shown, clip=clip, drive=None))
        self._play.value = False
        self.show_drive()

    def _add_face(self) -> None:
        controls = self._scene.controls
        with self._gui.add_folder("Head"):
            for name, (low, high) in controls.turns().items():
                handle = self._gui.add_slider(f"{TURN_LABELS[name]} (°)", *grid(low, high, "rad"), 0.0)
                self._turns[name] = handle
                handle.on_update(by_user(lambda _: self._turn()))
            rest = self._gui.add_button("face at rest")
        rest.on_click(by_user(lambda _: self.put_to_rest()))
        for group in dict.fromkeys(slider.group for slider in controls.sliders):
            with self._gui.add_folder(group, expand_by_default=group == "Face"):
                for slider in controls.sliders:
                    if slider.group == group:
                        self._add_slider(slider)
        self.show_drive()

    def _add_slider(self, slider: Slider) -> None:
        unit = math.degrees(1.0) if slider.unit == "rad" else 1.0
        label = f"{slider.label} (°)" if slider.unit == "rad" else slider.label
        low, high, step = grid(slider.low, slider.high, slider.unit)
        handle = self._gui.add_slider(label, low, high, step, min(max(0.0, low), high))
        self._sliders.append((handle, slider, unit))
        handle.on_update(by_user(lambda event: self._move(slider, float(event.target.value) / unit)))

    def _move(self, slider: Slider, value: float) -> None:
        """Take over from the clip, from where it stands."""
        now = time.monotonic()
        reader = self._scene.run.reader

        def change(shown: Shown) -> Shown:
            drive, camera = shown.drive, shown.camera
            if drive is None:
                number = shown.clip.frame(now)
                drive, camera = reader.drive(number), reader.camera(number)
            moved = with_value(drive, slider, value)
            return dataclasses.replace(shown, clip=shown.clip.resting(now), drive=moved, camera=camera)

        self._scene.update(change)
        self._play.value = False

    def _turn(self) -> None:
        angles = {name: math.radians(handle.value) for name, handle in self._turns.items()}
        self._scene.update(lambda shown: dataclasses.replace(shown, turn=Turn(**angles)))

    def put_to_rest(self) -> None:
        """No expression, the head straight."""
        now = time.monotonic()
        for handle in self._turns.values():
            handle.value = 0.0
        rest = self._scene.controls.rest
        self._scene.update(
            lambda shown: dataclasses.replace(
                shown, clip=shown.clip.resting(now), drive=rest, camera=None, turn=Turn()
            )
        )  # fmt: skip
        self._play.value = False
        self.show_drive()

    def show_drive(self) -> None:
        """Set the sliders to the drive that is shown."""
        shown = self._scene.shown
        drive = shown.drive or self._scene.run.reader.drive(shown.clip.frame(time.monotonic()))
        for handle, slider, unit in self._sliders:
            value = handle.step * round(value_of(drive, slider) * unit / handle.step)
            if abs(handle.value - value) > handle.step / 2:
                handle.value = round(min(max(value, handle.min), handle.max), 4)
        self._show_frame()

    def _show_frame(self) -> None:
        clip = self._scene.shown.clip
        self._position.value = min(clip.start, int(self._position.max))
        self._frame.content = lines(f"frame {clip.frames[clip.start]} of the video")

    def _add_saving(self) -> None:
        if getattr(self._scene.run.avatar, "bound_parts", None) is None:
            return
        button = self._gui.add_button("save as a web page", hint="One file that shows and moves the avatar offline")
        button.on_click(by_user(lambda event: self._drawing.submit(lambda: self._save(event.client))))

    def _save(self, client: Any) -> None:
        """Make the page and hand it to the browser that asked for it; runs in the drawing thread."""
        notify(client, "Making the page", "Pictures pause for some seconds.")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / PAGE
            try:
                export_web(self._scene.run, WebOptions(), path, overwrite=False)
            except InputError as error:
                notify(client, "No page", f"{error} (ggavatar-export --format web)", "red")
                return
            client.send_file_download(PAGE, read_file(path, MAX_PAGE_BYTES, "a page"), save_immediately=True)
        notify(client, "Saved", f"{PAGE}: open it in any browser; it needs no network.")
