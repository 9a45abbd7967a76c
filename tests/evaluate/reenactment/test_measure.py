"""A reenactment is rendered, seen and measured: the wiring, with faces that are made up.

Also covers `evaluate/rendering/driven.py`, `evaluate/reenactment/pairs.py` and `evaluate/reenactment/table.py`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from evaluate.options import Options
from evaluate.reenactment import measure, pairs
from evaluate.reenactment.measure import SeenFaces, measure_reenactment, measured_rows, render_small
from evaluate.reenactment.table import reenactment_table, write_reenactments
from evaluate.rendering import driven
from ggavatar.errors import InputError
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.training.run_folder import Run
from tests.support.toy_run import COUNT, toy_run, write_capture


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return toy_run(tmp_path)


@pytest.fixture
def faces(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Faces whose scores are the brightness of the images; how many images each call has seen."""
    seen: list[int] = []

    def see(images: Iterable[np.ndarray], bundle: Path, report: object) -> SeenFaces:
        levels = np.array([image.mean() / 255 for image in images])
        seen.append(len(levels))
        points = np.zeros((len(levels), 478, 2))
        points[:, 33] = 10.0
        return SeenFaces(levels[:, None] * np.ones(52), points, np.repeat(np.eye(3)[None], len(levels), 0))

    monkeypatch.setattr(measure, "see_faces", see)
    monkeypatch.setattr(ModelFinder, "find", lambda self, name: Path(name))
    monkeypatch.setattr(driven, "measured_scores", lambda *_: None)
    return seen


def test_an_avatar_follows_its_own_frames(run: Run, faces: list[int]) -> None:
    found = measure_reenactment(run, None, ModelFinder(offline=True))
    assert found.is_own and found.frames == len(run.split.test) and faces == [found.frames] * 2
    assert found.lost == 0 and found.pose_distance == 0


def test_another_performance_is_carried_over(run: Run, faces: list[int], tmp_path: Path) -> None:
    other = write_capture(tmp_path / "other")
    found = measure_reenactment(run, other.folder, ModelFinder(offline=True))
    assert not found.is_own and found.frames == COUNT and found.driver == other.subject
    assert json.loads(json.dumps(found.as_dict()))["scores"]["jawOpen"]["driver_deviation"] >= 0
    with pytest.raises(InputError, match="expected a capture folder"):
        measure_reenactment(run, other.folder / "tracking.npz", ModelFinder(offline=True))


def test_long_performances_are_measured_in_groups_of_consecutive_frames() -> None:
    assert measured_rows(tuple(range(150))).tolist() == list(range(150))
    rows = measured_rows(tuple(range(5000)))
    assert len(rows) == 200 and rows[0] == 0 and rows[-1] == 4999
    assert (np.diff(rows) == 1).sum() == 160


def test_images_have_the_width_that_is_measured(run: Run) -> None:
    from evaluate.motion.driving_sequence import driving_sequence_of

    images = list(render_small(run, driving_sequence_of(run.capture).rows(slice(0, 2))))
    assert len(images) == 2 and images[0].shape == (192, 256, 3) and images[0].dtype == np.uint8


def test_every_run_is_driven_by_itself_and_by_all_others(
    run: Run, faces: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_capture(tmp_path / "other")
    monkeypatch.setattr(pairs, "holds_run", lambda folder: True)
    monkeypatch.setattr(pairs, "open_run", lambda folder, device: run)
    options = Options(runs=(tmp_path,), reenact=(other.folder, run.capture.folder))
    found = pairs.measure_pairs(options, lambda title: nullcontext(None))
    assert [one.is_own for one in found] == [True, False]
    table = reenactment_table([*found, found[1]])
    assert [row.label.split("← ")[-1] for row in table.rows] == [
        "itself",
        other.subject,
        other.subject,
        "mean over others",
    ]
    files = write_reenactments(found, tmp_path / "tables")
    content = json.loads(files[0].read_text())
    assert content["schema"] == "ggavatar-reenactment" and len(content["reenactments"]) == 2
    assert "correlation" in files[1].read_text() and files[2].read_text().count("\n") > 2
    monkeypatch.setattr(pairs, "holds_run", lambda folder: False)
    with pytest.raises(InputError, match="--reenact drives avatars"):
        pairs.measure_pairs(options, lambda title: nullcontext(None))
