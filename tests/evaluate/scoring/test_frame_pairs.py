"""Folders are paired by frame number or refused, never by order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluate.scoring.frame_pairs import pair_folders
from ggavatar.errors import InputError
from tests.support.image_pairs import pair, write, write_folders


def test_names_may_differ_and_order_is_numeric(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [2, 10, 100])
    pairs = pair_folders(predictions, truth)
    assert [(p.frame, p.prediction.name, p.truth.name) for p in pairs] == [
        (2, "frame_0002.png", "000002.png"),
        (10, "frame_0010.png", "000010.png"),
        (100, "frame_0100.png", "000100.png"),
    ]


def test_names_with_a_camera_and_a_year(tmp_path: Path) -> None:
    """VHAP's `%05d_%02d`, and a year before the number; several cameras are not mixed."""
    image = pair()[0]
    for frame in (2, 10, 100):
        write(tmp_path / "truth" / f"{frame:05d}_00.png", image)
        write(tmp_path / "predictions" / f"2026_take_{frame}.png", image)
    pairs = pair_folders(tmp_path / "predictions", tmp_path / "truth")
    assert [(p.frame, p.truth.name) for p in pairs] == [
        (2, "00002_00.png"),
        (10, "00010_00.png"),
        (100, "00100_00.png"),
    ]
    for frame in (2, 10, 100):
        write(tmp_path / "truth" / f"{frame:05d}_01.png", image)
    with pytest.raises(InputError, match="those of cameras 0, 1; evaluate one camera at a time"):
        pair_folders(tmp_path / "predictions", tmp_path / "truth")


def test_missing_and_extra_renders_are_named(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1, 2, 3])
    (predictions / "frame_0002.png").unlink()
    with pytest.raises(InputError, match=r"no prediction for 1 frames: 2 \(for example 000002.png\)"):
        pair_folders(predictions, truth)
    write(predictions / "frame_0002.png", pair()[1])
    write(predictions / "frame_0007.png", pair()[1])
    with pytest.raises(InputError, match="no ground truth for 1 frames: 7"):
        pair_folders(predictions, truth)
    assert [p.frame for p in pair_folders(predictions, truth, frames=[3, 1])] == [1, 3]
    with pytest.raises(InputError, match="no prediction for 1 frames: 9"):
        pair_folders(predictions, truth, frames=[9])


def test_sizes_that_differ_are_refused_before_anything_is_measured(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1, 2])
    write(predictions / "frame_0002.png", pair(24, 64)[1])
    with pytest.raises(InputError, match=r"frame 2: .* is 64x24 px and .* is 64x48 px"):
        pair_folders(predictions, truth)


def test_masks_and_regions_are_found_by_frame_and_must_be_complete(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1, 2])
    for frame in (1, 2):
        write(tmp_path / "masks" / f"{frame}.png", np.full((48, 64), 255, np.uint8))
        write(tmp_path / "regions" / "face" / f"{frame}.png", np.zeros((48, 64), np.uint8))
    pairs = pair_folders(predictions, truth, tmp_path / "masks", tmp_path / "regions")
    assert [sorted(p.masks) for p in pairs] == [["face", "foreground"]] * 2
    (tmp_path / "regions" / "face" / "2.png").unlink()
    with pytest.raises(InputError, match="no mask for 1 frames: 2"):
        pair_folders(predictions, truth, tmp_path / "masks", tmp_path / "regions")
    with pytest.raises(InputError, match="one folder of masks per region"):
        pair_folders(predictions, truth, None, tmp_path / "masks")


def test_empty_and_absent_folders_are_refused(tmp_path: Path) -> None:
    predictions, _ = write_folders(tmp_path, [1])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="named by frame number"):
        pair_folders(predictions, tmp_path / "empty")
    with pytest.raises(InputError, match="expected a folder"):
        pair_folders(predictions, tmp_path / "absent")


def test_paths_with_spaces_unicode_and_leading_dashes(tmp_path: Path) -> None:
    folder = tmp_path / "-ein Ordner für Bilder ☃"
    pairs = pair_folders(*write_folders(folder, [5]))
    assert pairs[0].frame == 5
