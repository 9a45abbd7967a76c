"""Inputs made after public bug reports ($GGAVATAR_TEST_DATA/cases): the right result, or the true cause and the remedy.

References: the same input without the fault, and what was put into it.
"""

from __future__ import annotations

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from preprocess.cli.prep import main

pytestmark = pytest.mark.weights


@pytest.fixture(scope="module")
def cases(data_folder, models_folder):
    if not (data_folder / "cases").is_dir():
        pytest.skip("needs the folder cases in $GGAVATAR_TEST_DATA")
    return data_folder / "cases"


def masked(cases, masks, folder, *more):
    """Prepare embedded subject 2 with a folder of masks."""
    tracking = ["--tracking", str(cases / "subject_2_tracking"), "--head-model", str(cases / "subject_2_head.npz")]
    flags = ["--frames", ":24", "--size", "128", "--offline", "-o", str(folder), *more]
    return main([str(cases / "subject_2.mp4"), "--masks", str(cases / masks), *tracking, *flags])


def said(capsys):
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    return " ".join((output.out + output.err).split())


@pytest.fixture(scope="module")
def right(cases, tmp_path_factory):
    folder = tmp_path_factory.mktemp("right") / "c"
    assert masked(cases, "subject_2_masks", folder, "--quiet") == 0
    return Capture.open(folder)


def test_masks_inverted(cases, right, tmp_path, capsys):
    assert masked(cases, "masks_inverted", tmp_path / "c") == 2
    message = said(capsys)
    assert "the masks are inverted" in message and "add --resume --invert-masks" in message and "--fix" not in message
    assert masked(cases, "masks_inverted", tmp_path / "c", "--resume", "--invert-masks") == 0
    assert "doctor: healthy" in said(capsys)
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(11), right.mask(11))


def test_masks_0_1(cases, right, tmp_path, capsys):
    assert masked(cases, "masks_0_1", tmp_path / "c") == 0
    assert "levels 0 (background) and 1 (person) are scaled to 0 and 255" in said(capsys)
    found = Capture.open(tmp_path / "c").mask(11).astype(int)
    assert np.abs((found > 127).astype(int) - (right.mask(11) > 127)).mean() < 0.01


def test_masks_gap(cases, right, tmp_path, capsys):
    assert masked(cases, "masks_gap_00000_00", tmp_path / "c") == 0
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == (0, 1, 2, *range(10, 24)) and "7 left out (7 no mask)" in said(capsys)
    np.testing.assert_array_equal(capture.mask(10), right.mask(10))


@pytest.mark.slow
def test_black_start(cases, tmp_path, capsys):
    flags = ["--size", "128", "--offline", "-o", str(tmp_path / "c")]
    assert main([str(cases / "black_start.mp4"), *flags]) == 0
    output = said(capsys)
    assert "16 black (0–15)" in output and "7 faded in or out (16–22)" in output and "--fps" not in output
    assert Capture.open(tmp_path / "c").frames == tuple(range(23, 75))


@pytest.mark.slow
def test_cut_to_another_person(cases, tmp_path, capsys):
    flags = ["--size", "128", "--offline", "-o", str(tmp_path / "c")]
    assert main([str(cases / "cut_to_another_person.mp4"), *flags]) == 2
    assert "another person from frame 30 on" in said(capsys)
    assert main([str(cases / "cut_to_another_person.mp4"), *flags, "--resume", "--cut", "auto"]) == 0
    assert ": unchanged" in said(capsys) and Capture.open(tmp_path / "c").frames == tuple(range(30))
    assert main([str(cases / "cut_to_another_person.mp4"), *flags, "--overwrite", "--frames", "0:30", "--quiet"]) == 0
    assert Capture.open(tmp_path / "c").frames == tuple(range(30))


def test_emoca_codes_have_an_assumed_camera(cases, tmp_path, capsys):
    """Weak perspective is read as a field of view of 3°, which is no fault and cannot be mended by --tracker.focal."""
    inputs = ["--tracking", str(cases / "emoca_codes"), "--head-model", str(cases / "subject_2_head.npz")]
    flags = ["--masks", str(cases / "subject_2_masks"), "--frames", ":24", "--size", "128", "--offline"]
    assert main([str(cases / "subject_2.mp4"), *inputs, *flags, "-o", str(tmp_path / "c")]) == 0
    message = said(capsys)
    assert "the field of view of 3° is assumed" in message and "implausible" not in message
    assert "--tracker.focal" not in message and "distance and focal length are assumed" in message
