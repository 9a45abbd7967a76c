"""The panel of a live performance: how it goes, a neutral face, and the avatar moved by it."""

from __future__ import annotations

import dataclasses
from typing import Any

from evaluate.viewer.moving_pictures import Picture
from evaluate.viewer.run_scene import AVATAR, RunScene
from evaluate.viewer.server import Windows, by_user
from evaluate.viewer.texts import lines
from ggavatar.core import Camera, Drive


class LivePanel:
    """Builds the controls of a performance, and passes on to a scene what a performer does."""

    def __init__(self, server: Windows, scene: RunScene) -> None:
        self._scene = scene
        self.performer: Any = None
        gui = server.viser.gui
        with gui.add_folder("Performer"):
            self._follows = gui.add_checkbox("move the avatar", True)
            neutral = gui.add_button("this is my neutral face")
            self._status = gui.add_html("")
        self._said = ""
        neutral.on_click(by_user(lambda _: self.performer.calibrate()))
        self._follows.on_update(by_user(lambda _: self._let_go()))

    def performed(self, drive: Drive, camera: Camera, picture: Picture) -> None:
        """Have the avatar do it, beside the performer."""
        if not self._follows.value:
            return
        self._scene.beside = picture
        self._scene.update(
            lambda shown: dataclasses.replace(shown, drive=drive, camera=camera, mode=AVATAR)
        )  # fmt: skip

    def waiting(self, picture: Picture) -> None:
        """Show the performer beside the avatar as it is."""
        if self._follows.value:
            self._scene.beside = picture
            self._scene.update(lambda shown: shown)

    def said(self, text: str) -> None:
        """Say how it goes, if it has changed."""
        if text != self._said:
            self._said = text
            self._status.content = lines(text)

    def _let_go(self) -> None:
        """Leave the avatar to the sliders."""
        if not self._follows.value:
            self._scene.beside = None
            self._scene.update(lambda shown: shown)
