"""Images with digests on disk: kept if their bytes are what was written, made again if not. SHA-256 is hashlib's."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import numpy as np
import pytest

from evaluate.scoring.frame_store import (
    SUMS,
    Filled,
    PredictionTask,
    changed_frames,
    fill_frames,
    folder_digest,
    read_digests,
)
from evaluate.scoring.ground_truth import GroundTruth
from ggavatar.io.images import write_png

FRAMES = (3, 7, 9)
TASK = PredictionTask(FRAMES, GroundTruth((1.0, 1.0, 1.0)), {"method": "gray"})


class Gray:
    """A source of gray images."""

    def image(self, number: int) -> np.ndarray:
        return np.full((4, 6, 3), number, np.uint8)

    def mask(self, number: int) -> np.ndarray:
        return np.full((4, 6), 255, np.uint8)


def fill(folder: Path, expected: dict[int, str] | None = None) -> Filled:
    def write(number: int, size: tuple[int, int]) -> Path:
        path = folder / "predictions" / f"{number:06d}.png"
        write_png(path, np.full((size[1], size[0], 3), 100 + number, np.uint8))
        return path

    return fill_frames(folder, TASK, Gray(), write, expected)


def test_every_image_is_recorded_in_the_format_of_sha256sum(tmp_path: Path) -> None:
    assert fill(tmp_path).written == FRAMES
    lines = (tmp_path / SUMS).read_text().splitlines()
    assert len(lines) == 9 and lines == sorted(lines, key=lambda line: line.split()[1])
    path = tmp_path / "ground_truth" / "000007.png"
    assert f"{hashlib.sha256(path.read_bytes()).hexdigest()}  ground_truth/000007.png" in lines
    checked = subprocess.run(["sha256sum", "-c", SUMS], cwd=tmp_path, capture_output=True, check=False)
    assert checked.returncode == 0


def test_what_matches_is_kept_and_what_does_not_is_made_again(tmp_path: Path) -> None:
    fill(tmp_path)
    assert fill(tmp_path).written == ()
    path = tmp_path / "masks" / "000007.png"
    path.write_bytes(path.read_bytes() + b"x")
    assert changed_frames(read_digests(tmp_path), FRAMES) == {7}
    again = fill(tmp_path)
    assert (again.written, again.changed) == ((7,), (7,))
    (tmp_path / "predictions" / "000009.png").unlink()
    again = fill(tmp_path)
    assert (again.written, again.changed) == ((9,), ()), "a file that is gone was not changed"


def test_a_line_cut_off_by_an_interruption_costs_one_frame(tmp_path: Path) -> None:
    fill(tmp_path)
    text = (tmp_path / SUMS).read_text()
    (tmp_path / SUMS).write_text(text[: text.index("predictions/000009") + 14])
    assert read_digests(tmp_path).keys() >= {("ground_truth", 3), ("predictions", 7)}
    again = fill(tmp_path)
    assert again.written == (9,) and again.changed == ()
    assert (tmp_path / SUMS).read_text() == text


def test_a_path_that_leads_elsewhere_is_no_record(tmp_path: Path) -> None:
    (tmp_path / SUMS).write_text(f"{'0' * 64}  ../secret/000001.png\n{'0' * 64}  /etc/000001.png\n")
    assert read_digests(tmp_path) == {}


def test_predictions_with_another_digest_than_expected_are_replaced(tmp_path: Path) -> None:
    fill(tmp_path)
    known = {number: read_digests(tmp_path)["predictions", number][1] for number in FRAMES}
    assert fill(tmp_path, known).written == ()
    assert fill(tmp_path, {**known, 3: "0" * 64}).written == (3,)


def test_the_digest_of_a_folder_is_that_of_metrics_json(tmp_path: Path) -> None:
    fill(tmp_path)
    files = [tmp_path / "predictions" / f"{number:06d}.png" for number in FRAMES]
    lines = "".join(
        f"{number} {hashlib.sha256(path.read_bytes()).hexdigest()}\n"
        for number, path in zip(FRAMES, files, strict=True)
    )
    assert folder_digest(tmp_path / "predictions", FRAMES) == hashlib.sha256(lines.encode()).hexdigest()
    assert folder_digest(tmp_path / "predictions", (*FRAMES, 11)) is None
    assert folder_digest(tmp_path / "gone", FRAMES) is None


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"nonsense\n"])
def test_a_damaged_record_only_costs_work(tmp_path: Path, content: bytes) -> None:
    fill(tmp_path)
    (tmp_path / SUMS).write_bytes(content)
    assert fill(tmp_path).written == FRAMES
