"""Evaluating a run: predict, score, reuse what is up to date, redo what is not. The run is a toy of two Gaussians.

Also covers `evaluate/scoring/evaluation_job.py`, `evaluate/scoring/touched.py` and `evaluate/scoring/run_setup.py`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.options import Options, Override
from evaluate.protocols.protocol import protocol_by_name
from evaluate.protocols.results import read_results
from evaluate.scoring import run as run_evaluation
from evaluate.scoring.region_masks import frame_regions, write_region_masks
from evaluate.scoring.run import evaluate_run
from evaluate.scoring.run_setup import perceptual_features, setup_of_run
from evaluate.scoring.scored_frames import for_capture
from evaluate.scoring.touched import require_untouched
from ggavatar.errors import InputError
from ggavatar.io.digests import sha256_of
from ggavatar.io.folder_lock import lock_folder
from ggavatar.io.images import read_gray, read_rgb, write_png
from ggavatar.training import registry
from ggavatar.training.plan import preset
from ggavatar.training.run_folder import Run, RunConfig
from tests.support.silent_reporter import SilentReporter
from tests.support.toy_run import HEIGHT, WIDTH, head, toy_run

OPTIONS = Options(no_learned=True, quiet=True, device="cpu")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The toy run, opened for any folder."""
    made = toy_run(tmp_path)
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: made)
    monkeypatch.setattr(run_evaluation, "read_config", lambda folder: made.config)
    return made


silent = SilentReporter()


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
    trained = dataclasses.replace(run, step=8, sha256="01")
    with torch.no_grad():
        trained.avatar.colors.fill_(0.5)
    monkeypatch.setattr(run_evaluation, "open_run", lambda folder, device: trained)
    second, _ = evaluate_run(run.folder, OPTIONS, silent)
    assert second.provenance["checkpoint"]["step"] == 8
    assert second.hashes["predictions"] != first.hashes["predictions"]
    assert second.hashes["ground_truth"] == first.hashes["ground_truth"]
    assert (home / "mine.txt").read_text() == "keep"


def test_a_second_evaluation_is_refused_by_name(run: Run) -> None:
    first, _ = evaluate_run(run.folder, OPTIONS, silent)
    home = run.folder / "eval" / first.protocol.id
    with lock_folder(home), pytest.raises(InputError, match=rf"process {os.getpid()} on .* is writing here"):
        evaluate_run(run.folder, OPTIONS, silent)
    assert evaluate_run(run.folder, OPTIONS, silent)[0] == first
    assert not [path.name for path in home.rglob(".*")]


@pytest.mark.parametrize("left", ["nothing", "lock", "summary", "partial", "half removed", "removed to the summary"])
def test_an_evaluation_that_was_killed_is_continued(run: Run, left: str) -> None:
    whole, _ = evaluate_run(run.folder, OPTIONS, silent)
    home = run.folder / "eval" / whole.protocol.id
    if left in ("nothing", "lock", "summary"):
        summary = (home / "predict.json").read_text().replace('"complete": true', '"complete": false')
        shutil.rmtree(home)
        home.mkdir()
        if left == "lock":
            (home / ".lock").touch()
        if left == "summary":
            (home / "predict.json").write_text(summary)
    if left == "partial":
        (home / "predictions" / ".abc.png.part").write_bytes(b"half")
        (home / ".abc.json.part").write_bytes(b"half")
    if left == "half removed":
        next((home / "predictions").iterdir()).unlink()
    if left == "removed to the summary":
        for path in home.iterdir():
            if path.name != "predict.json":
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert evaluate_run(run.folder, OPTIONS, silent)[0].values == whole.values
    assert not [path.name for path in home.rglob(".*")]


def test_removing_an_evaluation_can_be_interrupted_anywhere(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever has been removed when the process is killed, what is left is known as ours."""
    whole, _ = evaluate_run(run.folder, OPTIONS, silent)
    plain, count, again = Path.unlink, 0, dataclasses.replace(OPTIONS, again=True)

    def killed(self: Path, missing_ok: bool = False) -> None:
        nonlocal count
        count -= 1
        if count == 0:
            raise ProcessLookupError("killed")
        plain(self, missing_ok=missing_ok)

    for stop in range(1, 14):
        count = stop
        with monkeypatch.context() as patch, contextlib.suppress(ProcessLookupError):
            patch.setattr(Path, "unlink", killed)
            evaluate_run(run.folder, again, silent)
        assert evaluate_run(run.folder, OPTIONS, silent)[0].values == whole.values


def test_a_run_that_is_removed_meanwhile_does_not_come_back(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def removing(*arguments: object, **more: object) -> None:
        shutil.rmtree(run.folder)
        write_png(*arguments, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("evaluate.scoring.predict.write_png", removing)
    with pytest.raises(FileNotFoundError, match="removed or renamed"):
        evaluate_run(run.folder, OPTIONS, silent)
    assert not run.folder.exists()


def test_damaged_results_are_made_again(run: Run) -> None:
    first, files = evaluate_run(run.folder, OPTIONS, silent)
    files[0].write_text("{")
    assert evaluate_run(run.folder, OPTIONS, silent)[0] == first
    json.loads(files[0].read_text())


@pytest.mark.parametrize("name", ["metrics.json", "per_frame.csv", "predict.json"])
def test_a_changed_number_is_noticed_and_made_again(run: Run, name: str) -> None:
    """A digit of something that was measured."""
    first, files = evaluate_run(run.folder, OPTIONS, silent)
    path = files[0].parent / name
    before = path.read_text()
    digit = {
        "metrics.json": r'"mse": \[0\.\d\d(\d)',
        "per_frame.csv": r",0\.\d\d(\d)",
        "predict.json": r'"median": (\d)',
    }
    found = re.search(digit[name], before)
    assert found is not None
    place = found.start(1)
    path.write_text(f"{before[:place]}{(int(before[place]) + 1) % 10}{before[place + 1 :]}")
    listener = SilentReporter()
    again, _ = evaluate_run(run.folder, OPTIONS, listener)
    assert again.values == first.values and listener.warnings
    if name != "predict.json":
        assert path.read_text() == before and name in listener.warnings[0]


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
    assert for_capture(paper, run.capture).id == f"paper-v1+resolution={WIDTH}x{HEIGHT}"
    halved = paper.override(resolution=f"{WIDTH // 2}x{HEIGHT // 2}")
    assert for_capture(halved, run.capture) == halved
    assert for_capture(paper.override(resolution="16x16"), run.capture).size == (WIDTH, HEIGHT)
    assert for_capture(paper.override(resolution="native"), run.capture).size is None


def test_a_region_that_no_capture_has_is_refused_before_anything_is_rendered(run: Run) -> None:
    wanted = protocol_by_name("paper").override(regions=("face", "eye"))
    with pytest.raises(InputError, match=r"unknown region 'eye' \(did you mean eyes\?\); those of a capture are fore"):
        for_capture(wanted, run.capture)


def test_regions_are_drawn_from_the_tracked_mesh(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    regions = {"face": torch.tensor([0, 1, 3]), "lips": torch.tensor([0, 2, 3]), "scalp": torch.tensor([1, 2, 3])}
    model = dataclasses.replace(head(), regions=regions)
    monkeypatch.setattr("evaluate.scoring.region_masks.load_head", lambda path: model)
    number = run.split.test[0]
    person = np.full((HEIGHT, WIDTH), 255, np.uint8)
    write_png(tmp_path / "masks" / f"{number:06d}.png", person)
    drawn = write_region_masks(
        run.capture, run.reader, tmp_path, [number], ["foreground", "face", "mouth", "eyes", "hair"]
    )
    assert drawn == ["face", "hair", "mouth"]
    mouth = read_gray(tmp_path / "regions" / "mouth" / f"{number:06d}.png")
    face = read_gray(tmp_path / "regions" / "face" / f"{number:06d}.png")
    direct = frame_regions(model, run.reader.drive(number), run.reader.camera(number), person)
    np.testing.assert_array_equal(face, direct["face"])
    assert 0 < (mouth > 0).sum() < (face > 0).sum() < face.size
    assert (face[mouth > 0] == 255).all()
    assert not ((direct["hair"] > 0) & (face > 0)).any()
    assert write_region_masks(run.capture, run.reader, tmp_path, [number], ["foreground", "boundary"]) == []


def home_of(run: Run) -> Path:
    return run.folder / "eval" / f"paper-v1+resolution={WIDTH}x{HEIGHT}"


def black(path: Path) -> None:
    """Paint an image black."""
    pixels = read_rgb(path)
    write_png(path, np.zeros_like(pixels))


@pytest.mark.parametrize("folder", ["predictions", "ground_truth", "masks"])
def test_an_image_painted_black_is_noticed_and_made_again(run: Run, folder: str) -> None:
    first, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    path = home_of(run) / folder / "000015.png"
    original = path.read_bytes()
    black(path)
    reporter = SilentReporter()
    assert evaluate_run(run.folder, OPTIONS, reporter)[0] == first
    assert path.read_bytes() == original
    assert any("images of 1 frame (15) changed after they were written" in line for line in reporter.warnings)
    reporter = SilentReporter()
    evaluate_run(run.folder, OPTIONS, reporter)
    assert reporter.warnings == []


def test_a_painted_prediction_that_is_recorded_as_ours_is_scored_again(run: Run) -> None:
    """Whoever updates SHA256SUMS too gets the scores of the new image, not the old scores."""
    first, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    home, old = home_of(run), (home_of(run) / "predictions/000015.png")
    before = sha256_of(old)
    black(old)
    sums = home / "SHA256SUMS"
    sums.write_text(sums.read_text().replace(before, sha256_of(old)))
    reporter = SilentReporter()
    second, _ = evaluate_run(run.folder, OPTIONS, reporter)
    assert second.values["psnr"][1] < first.values["psnr"][1]
    assert any("scored again, because predictions changed" in line for line in reporter.warnings)


def test_a_changed_capture_renews_the_ground_truth_and_is_said(run: Run) -> None:
    run.provenance["capture_sha256"] = run.capture.digest()
    first, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    assert first.provenance["capture_sha256"] == run.capture.digest()
    assert first.provenance["capture_changed_since_training"] is False and first.notes == ()
    black(run.capture.folder / "images" / "000015.png")
    reporter = SilentReporter()
    second, _ = evaluate_run(run.folder, OPTIONS, reporter)
    assert second.hashes["ground_truth"] != first.hashes["ground_truth"]
    assert second.hashes["predictions"] == first.hashes["predictions"]
    assert second.provenance["capture_sha256"] == run.capture.digest() != first.provenance["capture_sha256"]
    assert second.provenance["training_capture_sha256"] == first.provenance["capture_sha256"]
    assert second.provenance["capture_changed_since_training"] is True
    assert any("made again, because the capture changed" in line for line in reporter.warnings)
    assert any("the capture has changed since the training" in line for line in reporter.warnings)
    assert any("the capture has changed since the training" in note for note in second.notes)
    again = SilentReporter()
    assert evaluate_run(run.folder, OPTIONS, again)[0] == second
    assert len(again.warnings) == 1 and "since the training" in again.warnings[0], "said at every reuse"


def test_stored_scores_whose_images_changed_are_refused(run: Run) -> None:
    found, (file, _) = evaluate_run(run.folder, OPTIONS, SilentReporter())
    require_untouched(read_results(file), file.parent)
    black(file.parent / "predictions" / "000010.png")
    with pytest.raises(InputError, match=r"found others \(SHA-256\) in predictions: images of 1 frame \(10\)"):
        require_untouched(found, file.parent)
    (file.parent / "predictions" / "000010.png").unlink()
    with pytest.raises(InputError, match="in predictions"):
        require_untouched(found, file.parent)
    shutil.rmtree(file.parent / "predictions")
    require_untouched(found, file.parent)  # scores without their images are still what they were


def test_a_changed_region_mask_is_noticed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    model = dataclasses.replace(head(), regions={"face": torch.tensor([0, 1, 3])})
    monkeypatch.setattr("evaluate.scoring.region_masks.load_head", lambda path: model)
    first, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    path = home_of(run) / "regions" / "face" / "000015.png"
    write_png(path, np.full((HEIGHT, WIDTH), 255, np.uint8))
    reporter = SilentReporter()
    assert evaluate_run(run.folder, OPTIONS, reporter)[0] == first
    assert any("regions/face changed" in line for line in reporter.warnings)


def test_predictions_of_an_earlier_version_have_no_digests_and_are_made_again(run: Run) -> None:
    first, _ = evaluate_run(run.folder, OPTIONS, SilentReporter())
    (home_of(run) / "SHA256SUMS").unlink()
    black(home_of(run) / "predictions" / "000015.png")
    assert evaluate_run(run.folder, OPTIONS, SilentReporter())[0] == first


def test_the_setup_says_how_the_run_was_trained(run: Run) -> None:
    plan = dataclasses.replace(preset("fast", "cpu"), steps=300, max_gaussians=500)
    config = dataclasses.replace(run.config, method="ggavatar", preset="fast", training=plan)
    fast = dataclasses.asdict(registry.load("ggavatar").config("fast"))
    trained = dataclasses.replace(config, method_config={**fast, "latent": 3, "perceptual_features": "vgg16"})
    told = dataclasses.replace(run, config=trained, provenance={"perceptual_loss": "vgg16"})
    setup = setup_of_run(told)
    assert (setup.origin, setup.method, setup.preset, setup.steps) == ("run", "ggavatar", "fast", run.step)
    assert setup.changed == {"max_gaussians": 500, "latent": 3}
    assert setup.describe() == "preset fast, 7 steps, perceptual loss vgg16, max_gaussians=500, latent=3"
    assert setup_of_run(dataclasses.replace(run, provenance={"file": "x.ply"})).describe() == (
        "a file of Gaussians, rendered here"
    )


def test_the_setup_says_whether_the_tracking_was_refined(run: Run) -> None:
    """As the capture's `source` has it; captures of earlier versions do not say."""

    def setup(source):
        return setup_of_run(dataclasses.replace(run, capture=dataclasses.replace(run.capture, source=source)))

    refined = setup({"refinement": {"refined": True, "pictures": 200}})
    assert refined.tracking == "refined" and "refined tracking" in refined.describe()
    assert setup({"refinement": {"refined": False, "reason": "--no-refine"}}).tracking == "as tracked"
    for unknown in ({}, {"refinement": None}, {"refinement": {}}):
        assert setup(unknown).tracking is None and "tracking" not in setup(unknown).describe()


@pytest.mark.parametrize(
    ("provenance", "settings", "shown"),
    [
        ({"perceptual_loss": "random"}, {"perceptual_weight": 0.1, "perceptual_features": "vgg16"}, "random"),
        ({"notes": {"perceptual_loss": "vgg16-relu2_2"}}, {}, "vgg16-relu2_2"),
        ({"notes": {}}, {"perceptual_weight": 0.1, "perceptual_features": "vgg16"}, "vgg16"),
        ({"notes": {}}, {"perceptual_weight": 0.0, "perceptual_features": "vgg16"}, "none"),
        ({}, {}, "none"),
    ],
)
def test_features_are_those_that_the_training_recorded(
    provenance: dict[str, object], settings: dict[str, object], shown: str
) -> None:
    wanted = RunConfig("ggavatar", "capture", method_config=settings).perceptual_features
    assert perceptual_features(provenance, wanted) == shown
