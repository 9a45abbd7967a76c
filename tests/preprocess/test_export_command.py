"""ggavatar-export CAPTURE: others' layouts, written whole, read back by their importers to the same pixels."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ggavatar.cli.export import main as export
from ggavatar.data.capture import Capture
from ggavatar.formats.capture_layouts import capture_formats
from preprocess import export as exporters
from preprocess.cli.prep import main as prepare
from preprocess.formats.importers import metrical_tracker, vhap
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.tracking.geometry.projection import posed_vertices, project
from tests.support.synthetic_clip import as_tracking, ball_head, make_clip


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    clip = make_clip(tmp_path_factory.mktemp("export"), count=8)
    folder = tmp_path_factory.mktemp("capture") / "alice"
    assert prepare([*clip.arguments, "-o", str(folder)]) == 0
    return Capture.open(folder)


def pixels(record: TrackingRecord, row: int) -> np.ndarray:
    record = dataclasses.replace(record, expression=record.expression[:, :4], eyelids=0 * record.eyelids)
    posed = posed_vertices(ball_head(), as_tracking(record), row)
    return project(posed, record.intrinsics[row], record.world_to_camera[row])[0]


def test_layouts_are_found_by_their_names() -> None:
    assert {"vhap", "flash-avatar"} <= set(capture_formats())


def test_vhap_round_trip(capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "ga"
    assert export([str(capture.folder), "--format", "vhap", "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert f"wrote {out} (8 frames)" in shown and "not FLAME" in shown and "next: in GaussianAvatars" in shown
    found, expected = vhap.read(out), exporters.center_principal_point(exporters.to_tracking_record(capture))[0]
    for row in range(8):
        np.testing.assert_allclose(pixels(found, row), pixels(expected, row), atol=1e-3)
    assert len(list((out / "images").iterdir())) == 8


def test_flash_avatar_round_trip(
    capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "fa"
    arguments = [str(capture.folder), "--format", "flash-avatar", "-o", str(out)]
    assert export(arguments) == 2 and "512 × 512" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [], "a refusal leaves nothing behind"
    monkeypatch.setattr(exporters, "FLASH_AVATAR_SIDE", 96)
    monkeypatch.setattr(exporters, "FLASH_AVATAR_TEST_FRAMES", 5)
    assert export(arguments) == 0 and "parsing" in capsys.readouterr().out
    found, expected = (
        metrical_tracker.read(out / "checkpoint"),
        exporters.center_principal_point(exporters.to_tracking_record(capture))[0],
    )
    for row in range(8):
        np.testing.assert_allclose(pixels(found, row), pixels(expected, row), atol=1e-3)


def test_output_beside_the_capture_and_overwriting(capture: Capture, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(capture.folder), "--format", "vhap"]
    assert export(arguments) == 0
    out = capture.folder.with_name("alice-vhap")
    assert (out / "transforms.json").is_file()
    assert export(arguments) == 2 and "--overwrite" in capsys.readouterr().err
    (out / "transforms.json").unlink()
    assert export([*arguments, "--overwrite"]) == 0 and (out / "transforms.json").is_file()
    (out / "notes.txt").write_text("mine")
    assert export([*arguments, "--overwrite"]) == 2 and (out / "notes.txt").read_text() == "mine"
    assert not list(out.parent.glob(".*"))


def test_a_disk_that_fills_leaves_nothing(capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exporters, "write_png", full)
    assert export([str(capture.folder), "--format", "vhap", "-o", str(tmp_path / "ga")]) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_run_folder_is_no_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export([str(tmp_path), "--format", "vhap"]) == 2 and "capture.json" in capsys.readouterr().err
