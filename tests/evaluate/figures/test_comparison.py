"""Error maps, crops, sheets and the comparison figure, against brute force and known layouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluate.figures.comparison import load_comparison_frame, typical_frames, write_comparison
from evaluate.figures.comparison_layout import ComparisonFrame, comparison
from evaluate.figures.contact_sheet import GAP, Row, contact_sheet, resize_to_width
from evaluate.figures.crops import Crop, choose_crops
from evaluate.figures.error_map import error_colors, scale_bar, shared_limit
from evaluate.figures.text import blend_text, fit_text, text_coverage
from evaluate.scoring.frame_files import common_frames, frame_file, frame_files
from ggavatar.errors import InputError
from ggavatar.io.images import read_rgb, write_png


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


def noise(random: np.random.Generator, height: int = 40, width: int = 30) -> np.ndarray:
    return random.integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_one_scale_for_all_maps() -> None:
    small, large = np.full((8, 8), 0.01, np.float32), np.full((8, 8), 0.17, np.float32)
    assert shared_limit([small]) == 0.02 and shared_limit([small, large]) == 0.2 and shared_limit([large * 10]) == 1.0
    brightness = error_colors(np.array([[0.0, 0.1, 0.2, 0.9]], np.float32), 0.2).sum(axis=2)[0]
    assert brightness[0] < 20 and brightness[0] < brightness[1] < brightness[2] == brightness[3]
    bar = scale_bar(4, 100).astype(int).sum(axis=(0, 2))
    assert (np.diff(bar) >= 0).all(), "the scale must rise in brightness"


def test_crops_are_the_worst_squares_by_brute_force(random: np.random.Generator) -> None:
    error = random.random((37, 52)).astype(np.float32)
    (crop,) = choose_crops(error, 1, fraction=0.2)
    means = {
        (top, left): error[top : top + crop.size, left : left + crop.size].mean()
        for top in range(37 - crop.size + 1)
        for left in range(52 - crop.size + 1)
    }
    assert (crop.top, crop.left) == max(means, key=lambda place: means[place]) and crop.size == 7


def test_crops_do_not_overlap_and_stay_inside() -> None:
    error = np.zeros((40, 40), np.float32)
    error[-1, -1], error[0, 0] = 1.0, 0.5
    crops = choose_crops(error, 100, fraction=0.25)
    covered = np.zeros((40, 40), np.uint8)
    for crop in crops:
        part = crop.cut(covered[..., None])
        assert part.shape == (10, 10, 1)
        part += 1
    assert covered.max() == 1 and len(crops) >= 4
    levels = (error * 2).astype(np.uint8)[..., None]
    assert [crop.cut(levels).max() for crop in crops[:3]] == [2, 1, 0]


def test_the_first_crop_is_in_the_focus() -> None:
    error = np.zeros((40, 40), np.float32)
    error[30:, 30:], error[5, 5] = 1.0, 0.2
    focus = np.zeros((40, 40), np.float32)
    focus[:10, :10] = 1.0
    first, second = choose_crops(error, 2, focus=focus)
    assert first.top <= 5 < first.top + 8 and first.left <= 5 < first.left + 8 and second.top >= 25
    assert choose_crops(error, 1, focus=focus * 0)[0].top >= 25, "an empty focus is no focus"


def test_a_crop_enlarged_by_a_whole_factor_repeats_pixels(random: np.random.Generator) -> None:
    image = noise(random)
    crop = Crop(3, 5, 8)
    assert np.array_equal(crop.enlarged(image, 24)[::3, ::3], image[5:13, 3:11])


def test_letters_cover_pixels_and_are_cut_at_the_edge() -> None:
    covered = text_coverage("PSNR 31.2 dB", 20.0)
    assert 0.05 < covered.mean() < 0.6 and covered.max() > 0.95
    assert text_coverage("jgp", 20.0).shape[0] == text_coverage("aou", 20.0).shape[0], "lines of one size align"
    image = np.full((12, 12, 3), 255, np.uint8)
    blend_text(image, covered, -5, -5)
    blend_text(image, covered, 100, 3)
    assert image.min() < 200 and image.shape == (12, 12, 3)
    assert fit_text("a very long name of a method", 20.0, 60).shape[1] <= 60


def test_sheet_keeps_the_pixels_of_its_tiles(random: np.random.Generator) -> None:
    one, two = noise(random), noise(random)
    drawn = contact_sheet([Row([one, None]), Row([None, two], captions=["", "caption"])])
    assert np.array_equal(drawn[GAP : GAP + 40, GAP : GAP + 30], one)
    below = GAP + 40 + GAP
    assert np.array_equal(drawn[below : below + 40, 2 * GAP + 30 : 2 * GAP + 60], two)
    assert (drawn[below : below + 40, GAP : GAP + 30] == 255).all()
    with pytest.raises(ValueError, match="columns"):
        contact_sheet([Row([one, two]), Row([one])])
    assert resize_to_width(one, 15).shape == (20, 15, 3)


def test_frames_are_found_by_the_number_in_their_name(tmp_path: Path, random: np.random.Generator) -> None:
    for name in ("render_0007.png", "render_0012.png"):
        write_png(tmp_path / name, noise(random))
    (tmp_path / "notes.txt").write_text("9")
    assert list(frame_files(tmp_path)) == [7, 12]
    write_png(tmp_path / "b_12.png", noise(random))
    with pytest.raises(InputError, match="one image per frame"):
        frame_files(tmp_path)
    (tmp_path / "empty").mkdir()
    for folder, words in (("empty", "found none"), ("absent", "expected a folder")):
        with pytest.raises(InputError, match=words):
            frame_files(tmp_path / folder)


@pytest.fixture
def folders(tmp_path: Path, random: np.random.Generator) -> dict[str, Path]:
    """Ten frames; method `poor` differs more than `good`, and both more with every frame."""
    for frame in range(0, 100, 10):
        truth = noise(random)
        write_png(frame_file(tmp_path / "truth", frame), truth)
        for name, strength in (("good", 0.1), ("poor", 0.4)):
            share = strength * (frame + 10) / 100
            blended = truth * (1 - share) + 128 * share
            write_png(frame_file(tmp_path / name, frame), blended.round().astype(np.uint8))
    return {name: tmp_path / name for name in ("truth", "good", "poor")}


def test_typical_frames_are_quantiles_of_the_error(folders: dict[str, Path]) -> None:
    methods = {"good": folders["good"], "poor": folders["poor"]}
    assert list(typical_frames(methods, folders["truth"])) == [10, 40, 90]
    assert common_frames([folders["truth"], folders["good"]]) == list(range(0, 100, 10))


def test_comparison_shows_truth_methods_and_errors(folders: dict[str, Path], tmp_path: Path) -> None:
    methods = {"good": folders["good"], "poor": folders["poor"]}
    shown = write_comparison(tmp_path / "figure.png", methods, folders["truth"], frames=[30])
    figure = read_rgb(tmp_path / "figure.png")
    assert shown == [30] and figure.shape[1] > 3 * 240
    frame = load_comparison_frame(30, methods, folders["truth"])
    errors = frame.errors()
    assert errors["poor"].mean() > 2 * errors["good"].mean()
    bare = comparison([ComparisonFrame("", frame.truth, {"same": frame.truth})], crops=0)
    alone = comparison([ComparisonFrame("", frame.truth, {"same": frame.truth})])
    assert bare.shape[1] < alone.shape[1] and bare.shape[0] == alone.shape[0], "one method lies in one row"
    with pytest.raises(ValueError, match="in every frame"):
        comparison([frame, ComparisonFrame("", frame.truth, {"other": frame.truth})])


def test_comparison_refuses_what_does_not_match(folders: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="image of frame 5"):
        load_comparison_frame(5, {"good": folders["good"]}, folders["truth"])
    write_png(frame_file(tmp_path / "small", 30), np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(InputError, match="frame 30 of 30×40 px, found 4×4"):
        load_comparison_frame(30, {"small": tmp_path / "small"}, folders["truth"])
    write_png(frame_file(tmp_path / "other", 31), np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(InputError, match="frames common"):
        write_comparison(tmp_path / "figure.png", {"other": tmp_path / "other"}, folders["truth"])
