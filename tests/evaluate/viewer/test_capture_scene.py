"""What is shown of a capture, and its panel. Reference: the files of the capture, and the head projected by hand.

Also covers `evaluate/viewer/capture_panel.py` and `evaluate/viewer/findings.py`.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from evaluate.viewer.capture_panel import CapturePanel
from evaluate.viewer.capture_scene import (
    ALL,
    FRAME,
    GRAY,
    LANDMARKS,
    MASK,
    MESH,
    PERSON,
    POINT_COLOR,
    CaptureScene,
    at,
    zoomed,
)  # fmt: skip
from evaluate.viewer.findings import MOST, dropped_frames, findings, ranges
from evaluate.viewer.orbit import resting_place
from ggavatar.data.capture import Capture
from tests.support.fake_viser import FakeServer
from tests.support.toy_run import COUNT, HEIGHT, WIDTH, write_capture

HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    return write_capture(tmp_path / "capture")


@pytest.fixture
def scene(capture: Capture) -> CaptureScene:
    points = np.full((COUNT, 3, 2), np.nan)
    points[1, 0], points[1, 1] = [5.5, 7.5], [1e9, 3.0]
    tracking = dataclasses.replace(capture.tracking, landmarks=points)
    return CaptureScene(dataclasses.replace(capture, tracking=tracking))


def test_frames_masks_and_persons_are_those_of_the_files(scene: CaptureScene) -> None:
    image, mask = scene.capture.image(11), scene.capture.mask(11)
    np.testing.assert_array_equal(scene.view(11, FRAME), image)
    np.testing.assert_array_equal(scene.view(11, MASK)[..., 1], mask)
    person = scene.view(11, PERSON)
    np.testing.assert_array_equal(person[:, : WIDTH // 2], image[:, : WIDTH // 2])
    assert (person[:, WIDTH // 2 + 1 :] == 255).all()


def test_landmarks_are_where_they_were_found(scene: CaptureScene) -> None:
    found = scene.view(11, LANDMARKS)
    assert tuple(found[7, 5]) == POINT_COLOR
    changed = (found != scene.capture.image(11)).any(axis=2)
    assert 0 < changed.sum() < 20
    np.testing.assert_array_equal(scene.view(12, LANDMARKS), scene.capture.image(12))


def test_the_mesh_covers_what_the_head_covers(scene: CaptureScene) -> None:
    tracking = scene.capture.tracking
    vertices = scene.head.vertices(scene._drives[1]).numpy()
    seen = vertices @ tracking.world_to_camera[1, :3, :3].T + tracking.world_to_camera[1, :3, 3]
    pixels = (seen @ tracking.intrinsics[1].T)[:, :2] / seen[:, 2:]
    covered = (scene.view(11, MESH) != scene.capture.image(11)).any(axis=2)
    ys, xs = np.nonzero(covered)
    found = np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1])
    np.testing.assert_allclose(found, [*pixels.min(0), *pixels.max(0)], atol=1.01)


def test_pictures_hold_one_view_or_four(scene: CaptureScene) -> None:
    place = resting_place(scene.pivot, 2 * WIDTH, 2 * HEIGHT)
    four = scene.picture(place, (2 * WIDTH, 2 * HEIGHT), 0.0)
    np.testing.assert_array_equal(four[:HEIGHT, :WIDTH], scene.view(10, FRAME))
    np.testing.assert_array_equal(four[HEIGHT:, WIDTH:], scene.view(10, MESH))
    scene.update(lambda shown: at(dataclasses.replace(shown, mode=MASK), shown.clip.at(2)))
    np.testing.assert_array_equal(scene.picture(place, (WIDTH, HEIGHT), 0.0), scene.view(12, MASK))
    assert scene.moment(0.0) == (2, MASK) and not scene.plays()


def test_coming_nearer_enlarges_the_middle() -> None:
    picture = np.zeros((40, 40, 3), np.uint8)
    picture[15:25, 15:25] = 200
    rest = resting_place(CaptureScene.pivot, 40, 40)
    assert zoomed(picture, rest) is picture
    near = zoomed(picture, dataclasses.replace(rest, position=(0.0, 0.0, 0.5)))
    assert (near[11:29, 11:29] == 200).all() and not near[5, 5].any()
    aside = zoomed(picture, dataclasses.replace(rest, position=(5.0, 0.0, 1.0)))  # what is shown moves to the left
    assert (aside == GRAY).all()


def test_the_panel_moves_the_scene(scene: CaptureScene) -> None:
    server = FakeServer()
    CapturePanel(server, scene)
    gui = server.viser.gui
    gui.named("picture").use(MESH)
    gui.named("position").use(3)
    assert scene.moment(0.0) == (3, MESH) and "frame 13" in [c for c in gui.controls if c.kind == "html"][1].content
    gui.named("play").use(True)
    assert scene.plays()
    gui.named("play").use(False)
    assert not scene.plays()
    gui.named("whole picture").use(client="me")
    assert server.fronts == ["me"] and gui.named("picture").options[-1] == ALL


def test_without_landmarks_none_are_offered(capture: Capture) -> None:
    server = FakeServer()
    CapturePanel(server, CaptureScene(capture))
    assert LANDMARKS not in server.viser.gui.named("picture").options


def test_the_panel_says_what_the_doctor_said(capture: Capture) -> None:
    report = {"findings": [{"code": "x", "severity": "fault", "message": HOSTILE, "flag": "--masks"}]}
    (capture.folder / "doctor.json").write_text(json.dumps(report))
    dropped = ({"frame": 3, "reason": "blank"}, {"frame": 4, "reason": "blank"}, {"frame": 9, "reason": HOSTILE})
    server = FakeServer()
    CapturePanel(server, CaptureScene(dataclasses.replace(capture, dropped=dropped)))
    texts = "".join(control.content for control in server.viser.gui.controls if control.kind == "html")
    assert "fault: &lt;img" in texts and "(--masks)" in texts and "blank: 3-4" in texts and "<img" not in texts


@pytest.mark.parametrize(
    ("text", "said"),
    [(None, "run ggavatar-doctor"), ("{", "damaged"), ('{"findings": [1]}', "damaged"), ('{"findings": []}', "nothing"),
     ('{"findings": {"a": 1}}', "damaged"), ('{"other": []}', "damaged")],
)  # fmt: skip
def test_reports_of_any_kind_are_read(tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "doctor.json").write_text(text)
    found, otherwise = findings(tmp_path)
    assert not found and said in otherwise


def test_numbers_in_words() -> None:
    assert ranges([5, 3, 4, 9]) == "3-5, 9"
    assert ranges(range(0, 40, 2)).endswith("and 12 more")
    many = dropped_frames({"frame": index, "reason": f"reason {index}"} for index in range(MOST + 3))
    assert len(many) == MOST + 1 and many[-1] == "… and 3 more"
