"""The user's masks on their way into a capture: read, checked, and what the messages advise.

Reference: the same capture with right masks. Also covers `preprocess/masks/user_masks.py`.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.io.images import read_gray, write_png
from preprocess.cli.prep import main
from preprocess.doctor import diagnosis
from preprocess.synthetic.demo import write_demo
from preprocess.synthetic.settings import DemoSettings
from tests.support.synthetic_clip import draw


def run(clip, folder, masks, *more):
    arguments = [
        str(masks) if before == "--masks" else now
        for before, now in zip(["", *clip.arguments[:-1]], clip.arguments, strict=True)
    ]
    return main([*arguments, "-o", str(folder), *more])


def said(capsys):
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    return " ".join((output.out + output.err).split())


def written(folder, masks):
    for row, mask in enumerate(masks):
        write_png(folder / f"{row:05d}.png", mask)
    return folder


@pytest.fixture(scope="module")
def masks(clip):
    return [draw(clip.head, clip.record, row)[1] for row in range(24)]


def test_inverted_masks_are_named_and_the_advice_helps(clip, masks, tmp_path, capsys):
    folder = written(tmp_path / "inverted", [255 - mask for mask in masks])
    assert run(clip, tmp_path / "c", folder) == 2
    message = said(capsys)
    assert "the masks are inverted" in message and "add --resume --invert-masks" in message and "--fix" not in message
    assert run(clip, tmp_path / "c", folder, "--resume", "--invert-masks") == 0
    assert "doctor: healthy" in said(capsys)
    for row in (0, 11, 23):
        np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(row), masks[row])


def test_inverting_right_masks_is_named_and_the_advice_helps(clip, tmp_path, capsys):
    masks = clip.folder / "masks"
    assert run(clip, tmp_path / "c", masks, "--invert-masks") == 2
    assert "with --invert-masks they cover the background; add --resume and leave --invert-masks out" in said(capsys)
    assert run(clip, tmp_path / "c", masks, "--resume", "--quiet") == 0
    assert run(clip, tmp_path / "d", "auto", "--invert-masks") == 2
    assert "--invert-masks is for a folder of masks" in said(capsys) and not (tmp_path / "d").exists()


def test_class_indices_become_masks(clip, masks, tmp_path, capsys):
    folder = written(
        tmp_path / "classes",
        [np.where(mask > 0, 1 + np.indices(mask.shape)[0] // 10, 0).astype(np.uint8) for mask in masks],
    )
    assert run(clip, tmp_path / "c", folder) == 0
    output = said(capsys)
    assert "class indices 0, " in output and "0 is taken as the background" in output and "healthy" in output
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(9), masks[9])


def test_white_masks_are_refused(clip, masks, tmp_path, capsys):
    folder = written(tmp_path / "white", [np.full_like(mask, 255) for mask in masks])
    assert run(clip, tmp_path / "c", folder) == 2
    assert "255 (white) everywhere" in said(capsys)


def test_masks_at_another_size_are_resized(clip, masks, tmp_path, capsys):
    folder = written(
        tmp_path / "half", [cv2.resize(mask, (192, 192), interpolation=cv2.INTER_NEAREST) for mask in masks]
    )
    assert run(clip, tmp_path / "c", folder) == 0
    assert "masks of 192×192 px are resized to the video's 96×96 px" in said(capsys)
    np.testing.assert_array_equal(read_gray(tmp_path / "c" / "masks" / "000004.png"), masks[4])


def test_empty_masks_drop_their_frames(clip, masks, tmp_path, capsys):
    holed = [np.zeros_like(mask) if row in (9, 10) else mask for row, mask in enumerate(masks)]
    folder = written(tmp_path / "holed", holed)
    (folder / "00013.png").unlink()
    assert run(clip, tmp_path / "c", folder) == 0
    assert "1 of 24 frames have no mask and 2 of 24 frames have an empty mask and are left out" in said(capsys)
    assert [dict(item) for item in Capture.open(tmp_path / "c").dropped] == [
        {"frame": 9, "reason": "empty mask"},
        {"frame": 10, "reason": "empty mask"},
        {"frame": 13, "reason": "no mask"},
    ]
    assert run(clip, tmp_path / "strict", folder, "--strict", "--quiet") == 3


def test_the_doctor_concludes_nothing_from_masks_that_are_not_credible(clip, masks, tmp_path, monkeypatch):
    """A capture made elsewhere: its tracking is right, so no flag that changes the tracking may be named."""
    from ggavatar.head.files import load_head

    assert run(clip, tmp_path / "c", clip.folder / "masks", "--quiet") == 0
    capture = Capture.open(tmp_path / "c")
    for row in capture.frames:
        write_png(capture.image_path("masks", row), 255 - masks[row])
    monkeypatch.setattr(diagnosis, "rank_hypotheses", lambda *_: pytest.fail("the ranking was consulted"))
    monkeypatch.setattr(diagnosis, "photometric_alternative", lambda *_: pytest.fail("the ranking was consulted"))
    found = diagnosis.examine(capture, load_head(capture.head_path))
    faults = [finding for finding in found.findings if finding.severity == "fault"]
    assert [(finding.code, finding.flag) for finding in faults] == [("masks-inverted", "--resume --invert-masks")]


def test_masks_are_paired_by_number_across_gaps(clip, masks, tmp_path, capsys):
    """VHAP's names, timesteps 3 to 9 missing."""
    folder = tmp_path / "gap"
    for row in (0, 1, 2, *range(10, 24)):
        write_png(folder / f"{row:05d}_00.png", masks[row])
    assert run(clip, tmp_path / "c", folder) == 0
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == (0, 1, 2, *range(10, 24))
    assert "7 of 24 frames have no mask and are left out" in said(capsys)
    for row in (2, 10, 23):
        np.testing.assert_array_equal(capture.mask(row), masks[row])


def test_one_of_three_cameras(clip, masks, tmp_path, capsys):
    folder = tmp_path / "cameras"
    for row, mask in enumerate(masks):
        for camera in range(3):
            write_png(folder / f"{row:05d}_{camera:02d}.png", mask if camera == 1 else np.roll(mask, 20, axis=1))
    assert run(clip, tmp_path / "c", folder, "--camera", "5") == 2
    assert "no camera 5 in the names, only 0, 1, 2; choose with --camera" in said(capsys)
    assert run(clip, tmp_path / "c", folder, "--resume", "--camera", "0") in (0, 2)
    said(capsys)
    assert run(clip, tmp_path / "c", folder, "--resume", "--camera", "1") == 0
    assert "of cameras 0, 1, 2, camera 1 is used" in said(capsys)
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(9), masks[9])


def test_masks_without_numbers_need_one_for_every_frame(clip, masks, tmp_path, capsys):
    folder = tmp_path / "letters"
    for row, mask in enumerate(masks):
        write_png(folder / f"{chr(97 + row)}.png", mask)
    assert run(clip, tmp_path / "c", folder) == 0
    assert "alphabetical order" in said(capsys)
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(9), masks[9])
    (folder / "c.png").unlink()
    assert run(clip, tmp_path / "d", folder) == 2
    assert "no numbers in the names of the 23 masks" in said(capsys)


@pytest.mark.slow
def test_masks_that_cannot_be_used_are_left_out_as_the_message_says(tmp_path, capsys, models_folder):
    """White masks are refused; the same command without --masks ends in a right capture, where it left off."""
    subject = tmp_path / "subject"
    for _ in write_demo(subject, DemoSettings(identity=2, frames=12, size=192)):
        pass
    right = [read_gray(path) for path in sorted((subject / "masks").glob("*.png"))]
    white = written(tmp_path / "white", [np.full_like(mask, 255) for mask in right])
    given = [str(subject / "video.mp4"), "--tracking", str(subject / "tracking"), "--head-model"]
    given += [str(subject / "head.npz"), "--size", "192", "--models", str(models_folder), "-o", str(tmp_path / "c")]
    assert main([*given, "--masks", str(white)]) == 2
    assert "255 (white) everywhere" in (message := said(capsys)) and "leave --masks out" in message
    assert main(given) == 0
    assert "doctor: healthy" in said(capsys)
    capture = Capture.open(tmp_path / "c")
    for row, truth in enumerate(right):
        found, wanted = capture.mask(row) / 255, truth / 255
        assert np.minimum(found, wanted).sum() > 0.95 * np.maximum(found, wanted).sum()
