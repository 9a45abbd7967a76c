"""Scoring folders: from files to an evaluation and back."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest

from evaluate.metrics import pixels
from evaluate.protocols.protocol import Protocol, protocol_by_name
from evaluate.protocols.results import read_results, write_results
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders
from evaluate.scoring.score import is_flat, learned_metrics, score
from ggavatar.errors import InputError
from ggavatar.pretrained.resolve import ModelFinder
from tests.support.image_pairs import mean_ssim, pair, write, write_folders

LABELS = Labels("Anna", "ours", seed=3)


def plain(**changes: object) -> Protocol:
    """A protocol without learned metrics."""
    return protocol_by_name("folders").override(
        **{"metrics": ("psnr", "ssim"), "table_metrics": ("psnr", "ssim"), **changes}
    )


def test_values_are_those_of_the_single_functions(tmp_path: Path) -> None:
    pairs = pair_folders(*write_folders(tmp_path, [3, 4, 9]))
    found = score(pairs, plain(), LABELS)
    assert found.frames == (3, 4, 9)
    for place, frame in enumerate(found.frames):
        truth, render = pair(shift=frame)
        assert found.values["psnr"][place] == pixels.psnr(render, truth)
        assert found.values["ssim"][place] == pytest.approx(mean_ssim(render, truth), abs=1e-9)
        assert found.values["mse"][place] == pixels.mean_squared_error(render, truth)
    mean = sum(pixels.psnr(pair(shift=n)[1], pair(shift=n)[0]) for n in (3, 4, 9)) / 3
    assert found.summary("psnr").mean == pytest.approx(mean)
    pooled = found.summary("psnr_pooled").mean
    assert pooled is not None
    assert pooled <= mean


def test_an_image_is_flat_if_it_shows_one_color() -> None:
    truth, render = pair()
    assert not is_flat(truth) and not is_flat(render)
    image = np.full((48, 64, 3), (10, 200, 77), np.uint8)
    assert is_flat(image)
    image[5, 5, 1] = 202
    assert is_flat(image)
    image[5, 5, 1] = 203
    assert not is_flat(image)


def test_the_number_of_threads_changes_nothing(tmp_path: Path) -> None:
    pairs = pair_folders(*write_folders(tmp_path, list(range(12))))
    protocol = plain(metrics=("psnr", "ssim", "frame_difference", "flicker"))
    assert score(pairs, protocol, LABELS, threads=1) == score(pairs, protocol, LABELS, threads=4)


def test_hashes_can_be_made_with_sha256sum(tmp_path: Path) -> None:
    pairs = pair_folders(*write_folders(tmp_path, [1, 2]))
    found = score(pairs, plain(), LABELS)
    lines = "".join(f"{p.frame} {hashlib.sha256(p.truth.read_bytes()).hexdigest()}\n" for p in pairs)
    assert found.hashes["ground_truth"] == hashlib.sha256(lines.encode()).hexdigest()
    assert found.hashes["predictions"] != found.hashes["ground_truth"]
    write(pairs[0].prediction, pair(shift=77)[1])
    assert score(pairs, plain(), LABELS).hashes["predictions"] != found.hashes["predictions"]


def test_identical_frames_are_null_and_listed_and_the_file_is_strict_json(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1, 2])
    write(predictions / "frame_0002.png", pair(shift=2)[0])
    found = score(pair_folders(predictions, truth), plain(), LABELS)
    paths = write_results(found, tmp_path / "out")
    text = paths[0].read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    content = json.loads(text)
    assert content["per_frame"]["psnr"][1] is None
    assert content["identical"]["psnr"] == [2]
    assert content["unmeasured"]["psnr"] == []
    assert content["summary"]["psnr"]["identical"] == 1
    assert content["summary"]["psnr"]["mean"] == found.values["psnr"][0]
    assert paths[1].read_text().splitlines()[2].split(",")[2] == "inf"


def test_all_frames_identical(tmp_path: Path) -> None:
    _, truth = write_folders(tmp_path, [1, 2])
    found = score(pair_folders(truth, truth), plain(), LABELS)
    summary = found.as_dict()["summary"]
    assert summary["psnr"]["mean"] is None
    assert summary["psnr"]["identical"] == 2
    assert summary["psnr_pooled"]["mean"] is None
    assert summary["ssim"]["mean"] == 1


def test_results_survive_their_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    predictions, truth = write_folders(tmp_path, [1, 2, 5])
    write(predictions / "frame_0002.png", pair(shift=2)[0])
    write(tmp_path / "masks" / "face" / "1.png", np.zeros((48, 64), np.uint8))
    for frame in (2, 5):
        write(tmp_path / "masks" / "face" / f"{frame}.png", np.full((48, 64), 255, np.uint8))
    pairs = pair_folders(predictions, truth, None, tmp_path / "masks")
    protocol = plain(regions=("face", "mouth"), metrics=("psnr", "ssim", "lpips_vgg", "flicker"))
    labels = Labels("Anna", "ours", 3, {"fps": 12.5}, {"run": "somewhere"}, ("a note",))
    found = score(pairs, protocol, labels, learned_metrics(protocol, ModelFinder()))
    write_results(found, tmp_path / "out")
    assert read_results(tmp_path / "out") == found
    assert read_results(tmp_path / "out" / "metrics.json") == found
    assert found.values["psnr@face"][0] is None
    assert found.values["psnr@face"][1] == math.inf
    assert found.missing["psnr@mouth"] == "no mask shows the region mouth"
    assert "no weights: model file vgg16_features.safetensors" in found.missing["lpips_vgg"]
    assert "psnr@mouth" not in found.values


def test_temporal_metrics_need_consecutive_frames(tmp_path: Path) -> None:
    protocol = plain(metrics=("psnr", "frame_difference"), table_metrics=("psnr",))
    apart = score(pair_folders(*write_folders(tmp_path / "a", [0, 20, 40])), protocol, LABELS)
    assert "consecutive" in apart.missing["frame_difference"]
    close = score(pair_folders(*write_folders(tmp_path / "b", [0, 1, 2, 20])), protocol, LABELS)
    column = close.values["frame_difference"]
    assert [value is None for value in column] == [True, False, False, True]


def test_a_region_protocol_measures_inside_and_paints_outside(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1])
    mask = np.zeros((48, 64), np.uint8)
    mask[10:40, 10:40] = 255
    write(tmp_path / "masks" / "face" / "1.png", mask)
    pairs = pair_folders(predictions, truth, None, tmp_path / "masks")
    protocol = plain(region="face", background="white")
    found = score(pairs, protocol, LABELS)
    clean, render = pair(shift=1)
    weights = (mask / 255).astype(np.float32)
    expected = pixels.masked_psnr(pixels.squared_error(render, clean), weights)
    assert found.values["psnr"][0] == pytest.approx(expected, rel=1e-6)
    painted = [np.where(mask[..., None] > 0, image, np.uint8(255)) for image in (render, clean)]
    assert found.values["ssim"][0] == pytest.approx(mean_ssim(*painted), abs=1e-6)
    with pytest.raises(InputError, match=r"--region-masks DIR"):
        score(pair_folders(predictions, truth), protocol, LABELS)


def test_alpha_is_composited_and_noted(tmp_path: Path) -> None:
    predictions, truth = write_folders(tmp_path, [1])
    clean, render = pair(shift=1)
    write(predictions / "frame_0001.png", np.dstack((render, np.full((48, 64), 128, np.uint8))))
    found = score(pair_folders(predictions, truth), plain(background="black"), LABELS)
    assert any("composited" in note for note in found.notes)
    shown = np.round(render * (128 / 255)).astype(np.uint8)
    assert found.values["psnr"][0] == pytest.approx(pixels.psnr(shown, clean), abs=1e-3)
    with pytest.raises(InputError, match="background"):
        score(pair_folders(predictions, truth), plain(), LABELS)


def test_no_frames_are_refused_and_a_damaged_image_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one frame"):
        score([], plain(), LABELS)
    pairs = pair_folders(*write_folders(tmp_path, [1, 2]))
    pairs[1].prediction.write_bytes(pairs[1].prediction.read_bytes()[:60])
    with pytest.raises(InputError, match=r"frame_0002\.png"):
        score(pairs, plain(), LABELS)


def test_results_of_other_kinds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "metrics.json"
    for text, message in (
        ("{", "not valid JSON"),
        ("[]", "JSON object"),
        ('{"a": NaN}', "NaN"),
        ('{"schema": "ggavatar-evaluation", "version": 99}', "version 99"),
        ('{"schema": "ggavatar-evaluation", "version": 1}', "missing"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_results(path)
    with pytest.raises(InputError, match="no such file"):
        read_results(tmp_path / "absent.json")
    monkeypatch.setattr("evaluate.protocols.results.MAX_BYTES", 10)
    with pytest.raises(InputError, match="of at most 10 bytes"):
        read_results(path)
