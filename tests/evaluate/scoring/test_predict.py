"""Predictions on disk: what is written, what is kept, what is refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.metrics.efficiency import model_megabytes, timing
from evaluate.protocols.protocol import protocol_by_name
from evaluate.scoring.frame_store import PredictionTask
from evaluate.scoring.ground_truth import GroundTruth
from evaluate.scoring.predict import predict_frames, prediction_task
from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb
from ggavatar.io.json_files import sealed
from ggavatar.training.run_folder import Run
from tests.support.toy_run import HEIGHT, WIDTH, toy_run

WHITE = GroundTruth((1.0, 1.0, 1.0))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return toy_run(tmp_path)


def task(*frames: int, truth: GroundTruth = WHITE) -> PredictionTask:
    return PredictionTask(frames, truth, {"method": "toy", "step": 7})


def test_files_are_what_was_rendered_and_composited(run: Run, tmp_path: Path) -> None:
    summary = predict_frames(run, task(10, 15, 12), tmp_path / "out").summary
    for folder in ("predictions", "ground_truth", "masks"):
        assert sorted(path.name for path in (tmp_path / "out" / folder).iterdir()) == [
            "000010.png",
            "000012.png",
            "000015.png",
        ]
    with torch.no_grad():
        drawn = run.rasterize(run.avatar.gaussians(run.reader.drive(12)), run.reader.camera(12), torch.ones(3)).image
    expected = np.rint(drawn.clamp(0, 1).numpy() * 255)
    assert np.array_equal(read_rgb(tmp_path / "out/predictions/000012.png"), expected)
    assert expected.min() < 150, "the avatar is not in the image"
    image, mask = run.capture.image(12).astype(float), run.capture.mask(12)[..., None] / 255
    truth = read_rgb(tmp_path / "out/ground_truth/000012.png")
    assert np.abs(truth - (image * mask + 255 * (1 - mask))).max() <= 0.5 + 1e-4
    assert np.array_equal(read_gray(tmp_path / "out/masks/000012.png"), run.capture.mask(12))
    assert summary["complete"] and summary["frames"] == [10, 12, 15] and summary["gaussians"] == {"median": 2, "max": 2}
    assert summary["timing"]["frames"] == 2 and summary["timing"]["fps"] > 0
    assert json.loads((tmp_path / "out/predict.json").read_text()) == sealed(summary)


def test_background_size_and_binary_mask(run: Run, tmp_path: Path) -> None:
    truth = GroundTruth((0.0, 0.0, 0.0), (WIDTH * 2, HEIGHT * 2), binary_mask=True)
    predict_frames(run, task(11, truth=truth), tmp_path / "out")
    assert read_rgb(tmp_path / "out/predictions/000011.png").shape == (HEIGHT * 2, WIDTH * 2, 3)
    assert read_rgb(tmp_path / "out/predictions/000011.png")[0, 0].tolist() == [0, 0, 0]
    assert set(np.unique(read_gray(tmp_path / "out/masks/000011.png")[:, ::2])) <= {0, 64, 191, 255}
    with pytest.raises(InputError, match="distorted"):
        predict_frames(run, task(11, truth=GroundTruth((1.0, 1.0, 1.0), (64, 64))), tmp_path / "other")


def test_resumes_where_it_was(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = predict_frames(run, task(10, 11, 12), out).summary
    (out / "masks/000011.png").unlink()
    kept = (out / "predictions/000010.png").stat().st_mtime_ns
    steps: list[tuple[int, int]] = []
    second = predict_frames(run, task(10, 11, 12), out, lambda done, total: steps.append((done, total))).summary
    assert steps == [(2, 3), (3, 3)]
    assert (out / "predictions/000010.png").stat().st_mtime_ns == kept and (out / "masks/000011.png").exists()
    assert second["timing"] == first["timing"], "one warm-up frame is no measurement"
    assert predict_frames(run, task(10, 11, 12), out).summary == second


def test_refuses_what_is_not_its_own(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    predict_frames(run, task(10), out)
    with pytest.raises(InputError, match=r"differ from those requested in frames"):
        predict_frames(run, task(10, 11), out)
    with pytest.raises(InputError, match=r"in background"):
        predict_frames(run, task(10, truth=GroundTruth((0.0, 0.0, 0.0))), out)
    with pytest.raises(InputError, match="at least one frame"):
        predict_frames(run, task(), tmp_path / "none")
    (tmp_path / "foreign/predictions").mkdir(parents=True)
    with pytest.raises(InputError, match="unknown origin"):
        predict_frames(run, task(10), tmp_path / "foreign")
    (out / "predict.json").write_text("[1]")
    with pytest.raises(InputError, match="something else"):
        predict_frames(run, task(10), out)


def test_a_protocol_decides_the_task(run: Run) -> None:
    asked = prediction_task(run, protocol_by_name("paper").override(resolution="native", background="black"))
    assert asked.frames == (10, 15) and asked.truth == GroundTruth((0.0, 0.0, 0.0))
    assert asked.identity["checkpoint_sha256"] == "00" and asked.identity["split"] == "every-20th"
    given = prediction_task(run, protocol_by_name("folders"))
    assert given.frames == (10, 15) and given.truth.background == (1.0, 1.0, 1.0) and given.truth.size is None


def test_refuses_test_frames_that_were_trained_on(run: Run) -> None:
    with pytest.raises(InputError, match="among its training frames"):
        prediction_task(run, protocol_by_name("strict").override(split="ratio-0.5"))
    seen = dataclasses.replace(run.split, train=run.capture.frames)
    with pytest.raises(InputError, match="among its training frames"):
        prediction_task(dataclasses.replace(run, split=seen), protocol_by_name("paper"))


def test_model_size_counts_weights_and_buffers(run: Run) -> None:
    assert model_megabytes(run.avatar) == pytest.approx(6 * 4 / 1e6)


def test_speed_is_that_of_the_median_frame() -> None:
    found = timing([0.5, 0.5, 4.0], torch.device("cpu"))
    assert found["fps"] == 2.0 and found["seconds_median"] == 0.5 and found["frames"] == 3
    assert found["seconds_mean"] == pytest.approx(5 / 3)
