"""Evaluating a run: predict, score, reuse what is up to date, redo what is not. The run is a toy of two Gaussians."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.options import Options, Override
from evaluate.protocols.protocol import protocol_by_name
from evaluate.scoring import run as run_evaluation
from evaluate.scoring.region_masks import frame_regions, write_region_masks
from evaluate.scoring.run import at_capture_resolution, evaluate_run
from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb, write_png
from ggavatar.training.run_folder import Run
from tests.support.toy_run import HEIGHT, WIDTH, head, toy_run

OPTIONS = Options(no_learned=True, quiet=True, device="cpu")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The toy run, opened for any folder."""
    made = toy_run(tmp_path)
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: made)
    monkeypatch.setattr(run_evaluation, "read_config", lambda folder: made.config)
    return made


def silent(title: str) -> None:
    """No progress."""


def test_a_run_is_rendered_scored_and_labelled(run: Run) -> None:
    found, files = evaluate_run(run.folder, OPTIONS, silent)
    home = run.folder / "eval" / f"paper-v1+resolution={WIDTH}x{HEIGHT}"
    assert files == [home / "metrics.json", home / "per_frame.csv"]
    assert found.frames == run.split.test
    assert (found.subject, found.method, found.seed) == ("toy", "toy", run.config.seed)
    assert found.efficiency["gaussians"] == 2
    assert found.provenance["checkpoint"]["step"] == 7
    assert set(found.hashes) == {"predictions", "ground_truth", "masks/foreground"}
    for frame, value in zip(found.frames, found.values["mse"], strict=True):
        images = [read_rgb(home / name / f"{frame:06d}.png") / 255.0 for name in ("predictions", "ground_truth")]
        assert value == pytest.approx(np.square(images[0] - images[1]).mean())
    assert found.missing["lpips_alex"] == "learned metrics were switched off"


def test_results_that_are_up_to_date_are_not_made_again(run: Run) -> None:
    first, _ = evaluate_run(run.folder, OPTIONS, silent)
    image = run.folder / "eval" / first.protocol.id / "predictions" / f"{first.frames[0]:06d}.png"
    before = image.stat().st_mtime_ns
    assert evaluate_run(run.folder, OPTIONS, silent)[0] == first
    assert image.stat().st_mtime_ns == before
    assert evaluate_run(run.folder, dataclasses.replace(OPTIONS, again=True), silent)[0].values == first.values
    assert image.stat().st_mtime_ns > before


def test_another_checkpoint_replaces_the_images_and_nothing_else(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    first, _ = evaluate_run(run.folder, OPTIONS, silent)
    home = run.folder / "eval" / first.protocol.id
    (home / "mine.txt").write_text("keep")
    (run.folder / "checkpoints" / "step-000000008.json").write_text('{"sha256": "01"}')
    trained = dataclasses.replace(run, step=8)
    with torch.no_grad():
        trained.avatar.colors.fill_(0.5)
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: trained)
    second, _ = evaluate_run(run.folder, OPTIONS, silent)
    assert second.provenance["checkpoint"]["step"] == 8
    assert second.hashes["predictions"] != first.hashes["predictions"]
    assert second.hashes["ground_truth"] == first.hashes["ground_truth"]
    assert (home / "mine.txt").read_text() == "keep"


def test_damaged_results_are_made_again(run: Run) -> None:
    first, files = evaluate_run(run.folder, OPTIONS, silent)
    files[0].write_text("{")
    assert evaluate_run(run.folder, OPTIONS, silent)[0] == first
    json.loads(files[0].read_text())


def test_test_frames_that_were_trained_on_are_refused(run: Run) -> None:
    with pytest.raises(InputError, match="has not seen the test frames"):
        evaluate_run(run.folder, dataclasses.replace(OPTIONS, override=Override(split="ratio-0.5")), silent)


def test_a_run_with_a_list_of_its_own_is_scored_on_that_list(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = dataclasses.replace(run, config=dataclasses.replace(run.config, split="file:/some where/split.json"))
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: listed)
    monkeypatch.setattr(run_evaluation, "read_config", lambda folder: listed.config)
    found, _ = evaluate_run(run.folder, OPTIONS, silent)
    assert found.protocol.id == f"paper-v1+resolution={WIDTH}x{HEIGHT},split=file"
    assert found.frames == run.split.test
    lineage, _ = evaluate_run(run.folder, dataclasses.replace(OPTIONS, protocol="gaussian-avatars"), silent)
    assert lineage.protocol.split == "file"


@pytest.mark.parametrize(
    ("split", "protocol"),
    [("every-20th", "paper"), ("last-350", "insta-350"), ("last-500", "flash-500"), ("ratio-0.8", "strict")],
)
def test_the_protocol_follows_the_split_of_the_run(split: str, protocol: str) -> None:
    assert OPTIONS.base_protocol(split).id == f"{protocol}-v1"
    assert OPTIONS.base_protocol("every-10").id == "paper-v1+split=every-10"


def test_truth_is_never_enlarged_nor_distorted(run: Run) -> None:
    paper = protocol_by_name("paper")
    assert at_capture_resolution(paper, run).id == f"paper-v1+resolution={WIDTH}x{HEIGHT}"
    halved = paper.override(resolution=f"{WIDTH // 2}x{HEIGHT // 2}")
    assert at_capture_resolution(halved, run) == halved
    assert at_capture_resolution(paper.override(resolution="16x16"), run).size == (WIDTH, HEIGHT)
    assert at_capture_resolution(paper.override(resolution="native"), run).size is None


def test_regions_are_drawn_from_the_tracked_mesh(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    regions = {"face": torch.tensor([0, 1, 3]), "lips": torch.tensor([0, 2, 3]), "scalp": torch.tensor([1, 2, 3])}
    model = dataclasses.replace(head(), regions=regions)
    monkeypatch.setattr("evaluate.scoring.region_masks.load_head", lambda path: model)
    number = run.split.test[0]
    person = np.full((HEIGHT, WIDTH), 255, np.uint8)
    write_png(tmp_path / "masks" / f"{number:06d}.png", person)
    drawn = write_region_masks(run, tmp_path, [number], ["foreground", "face", "mouth", "eyes", "hair"])
    assert drawn == ["face", "hair", "mouth"]
    mouth = read_gray(tmp_path / "regions" / "mouth" / f"{number:06d}.png")
    face = read_gray(tmp_path / "regions" / "face" / f"{number:06d}.png")
    direct = frame_regions(model, run.reader.drive(number), run.reader.camera(number), person)
    np.testing.assert_array_equal(face, direct["face"])
    assert 0 < (mouth > 0).sum() < (face > 0).sum() < face.size
    assert (face[mouth > 0] == 255).all()
    assert not ((direct["hair"] > 0) & (face > 0)).any()
    assert write_region_masks(run, tmp_path, [number], ["foreground", "boundary"]) == []
