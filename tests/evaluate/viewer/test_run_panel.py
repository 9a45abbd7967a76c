"""The controls of a run, moved without a browser. Reference: what the scene shows, and the drives of the capture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluate.viewer.drawing import Drawing
from evaluate.viewer.run_panel import PAGE, RunPanel, grid
from evaluate.viewer.run_scene import BESIDE, RunScene
from ggavatar.errors import InputError
from tests.support.fake_viser import FakeClient, FakeServer
from tests.support.toy_run import toy_run


class Parts:
    """A panel with all that belongs to it."""

    def __init__(self, folder: Path) -> None:
        self.scene = RunScene(toy_run(folder))
        self.server, self.drawing = FakeServer(), Drawing(self.scene)
        self.panel = RunPanel(self.server, self.scene, self.drawing)
        self.gui = self.server.viser.gui


@pytest.fixture
def parts(tmp_path: Path) -> Parts:
    return Parts(tmp_path)


def test_a_slider_takes_over_from_the_clip(parts: Parts) -> None:
    parts.gui.named("play").use(True)
    assert parts.scene.plays()
    parts.gui.named("jaw open (°)").use(10.0)
    shown = parts.scene.shown
    assert not parts.scene.plays() and parts.gui.named("play").value is False
    assert shown.drive is not None and shown.drive.joint_rotations[2, 0].item() == pytest.approx(math.radians(10))
    number = parts.scene.run.split.test[0]
    np.testing.assert_array_equal(shown.drive.expression, parts.scene.run.reader.drive(number).expression)


def test_sliders_stand_where_the_frame_has_them(parts: Parts) -> None:
    parts.gui.named("position").use(1)
    drive = parts.scene.run.reader.drive(parts.scene.run.split.test[1])
    assert parts.gui.named("jaw open (°)").value == pytest.approx(
        math.degrees(float(drive.joint_rotations[2, 0])), abs=0.26
    )
    assert "frame 15" in parts.panel._frame.content
    assert parts.gui.named("position").value == 1


def test_what_the_program_sets_is_no_move_of_a_user(parts: Parts) -> None:
    parts.gui.named("jaw open (°)").use(10.0, client=None)
    assert parts.scene.shown.drive is None


def test_clip_picture_view_and_rest(parts: Parts) -> None:
    parts.gui.named("frames").use("all frames")
    assert parts.scene.shown.clip.frames == parts.scene.run.capture.frames
    assert parts.gui.named("position").max == len(parts.scene.run.capture.frames) - 1
    parts.gui.named("picture").use(BESIDE)
    parts.gui.named("turn beyond training").use(True)
    parts.gui.named("nod (°)").use(12.0)
    shown = parts.scene.shown
    assert shown.mode == BESIDE and shown.free and shown.turn.pitch == pytest.approx(math.radians(12))
    parts.gui.named("view from the front").use(client="me")
    assert parts.server.fronts == ["me"]
    parts.gui.named("face at rest").use()
    assert parts.scene.shown.drive is parts.scene.controls.rest and parts.scene.shown.turn.pitch == 0
    assert parts.gui.named("nod (°)").value == 0


def test_a_method_that_cannot_be_a_page_offers_none(parts: Parts) -> None:
    assert "save as a web page" not in [control.label for control in parts.gui.controls]


@pytest.mark.parametrize("refused", [False, True])
def test_the_page_goes_to_the_browser_that_asked(tmp_path: Path, monkeypatch: Any, refused: bool) -> None:
    monkeypatch.setattr("tests.support.toy_run.ToyAvatar.bound_parts", lambda self: None, raising=False)

    def export(run: Any, options: Any, path: Path, overwrite: bool) -> None:
        if refused:
            raise InputError("licensed head")
        path.write_text("<page>")

    monkeypatch.setattr("evaluate.viewer.run_panel.export_web", export)
    parts, client = Parts(tmp_path), FakeClient()
    parts.gui.named("save as a web page").use(client=client)
    assert not client.notes  # the drawing thread makes it
    parts.drawing.step()
    assert client.files == ([] if refused else [(PAGE, b"<page>")])
    assert ("licensed head" in client.notes[-1][1]) == refused


def test_grids_hold_their_range() -> None:
    assert grid(-0.05, 0.45, "rad") == (-3.0, 26.0, 0.5)
    assert grid(-0.2, 1.234, "") == (-0.2, 1.24, 0.01)
