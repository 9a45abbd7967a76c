"""From a video with another tracker's output to a capture, on a synthetic subject with known ground truth.

Also covers `preprocess/pipeline/pack_stage.py`, `preprocess/pipeline/read_stage.py`,
`preprocess/pipeline/tracking_stage.py`.
"""

from __future__ import annotations

import dataclasses
import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.io.folder_lock import is_lock_file, lock_folder
from ggavatar.io.images import write_png
from preprocess.cli.doctor import main as doctor
from preprocess.cli.prep import main
from preprocess.formats.importers import metrical_tracker
from preprocess.options import PrepOptions
from preprocess.pipeline import pipeline
from tests.support.synthetic_clip import draw, make_clip, write_video


@pytest.fixture(scope="module")
def capture(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("road") / "capture"
    assert main([*clip.arguments, "-o", str(folder)]) == 0
    return Capture.open(folder)


def test_capture_has_the_known_tracking(capture, clip):
    assert capture.frames == tuple(range(24))
    assert (capture.width, capture.height, capture.fps) == (96, 96, 25.0)
    np.testing.assert_allclose(capture.tracking.intrinsics, clip.record.intrinsics, rtol=1e-6)
    np.testing.assert_allclose(capture.tracking.world_to_camera, clip.record.world_to_camera, atol=1e-6)
    np.testing.assert_allclose(capture.tracking.expression, clip.record.expression, atol=1e-6)
    np.testing.assert_allclose(capture.tracking.joint_rotations, clip.record.joint_rotations, atol=1e-6)


def test_capture_has_the_known_pixels(capture, clip):
    for number in (0, 11, 23):
        image, mask = draw(clip.head, clip.record, number)
        np.testing.assert_array_equal(capture.mask(number), mask)
        assert np.abs(capture.image(number).astype(int) - image).mean() < 6


def test_the_doctor_waits_for_nobody_and_reads_what_it_may_not_write(capture, monkeypatch, capsys):
    """Another writer is named; a read-only capture is examined with the flag that the message names."""
    from preprocess.doctor import diagnosis

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied", str(capture.folder))

    with lock_folder(capture.folder):
        assert doctor([str(capture.folder)]) == 2 and "is writing here" in capsys.readouterr().err
        assert doctor([str(capture.folder), "--dry-run"]) == 0, "a reader takes no lock"
    monkeypatch.setattr(diagnosis, "write_report", refuse)
    assert doctor([str(capture.folder)]) == 1
    error = capsys.readouterr().err
    assert "cannot be written (Permission denied); add --dry-run" in error and " -o" not in error
    assert doctor([str(capture.folder), "--dry-run"]) == 0


def run(clip, folder, *more, **replaced):
    """Exit code of ggavatar-prep on the clip, with some arguments replaced (None leaves one out)."""
    more = more if replaced.pop("loud", False) else (*more, "--quiet")
    arguments = dict(zip(clip.arguments[1::2], clip.arguments[2::2], strict=True))
    arguments |= {"--" + name.replace("_", "-"): value for name, value in replaced.items() if name != "video"}
    flags = [part for name, value in arguments.items() if value is not None for part in (name, str(value))]
    return main([str(replaced.get("video", clip.arguments[0])), *flags, "-o", str(folder), *more])


def said(capsys):
    """What was said, checked to be no traceback."""
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    return " ".join((output.out + output.err).split())


def test_unchanged_stages_are_skipped_and_changed_ones_run(clip, tmp_path, capsys):
    folder = tmp_path / "c"
    assert run(clip, folder, loud=True) == 0
    assert ": unchanged" not in said(capsys)
    before = (folder / "images" / "000005.png").stat().st_mtime_ns
    assert run(clip, folder, "--resume", loud=True) == 0
    assert said(capsys).count(": unchanged") == 9
    assert run(clip, folder, "--resume", "--split", "last-5", loud=True) == 0
    assert said(capsys).count(": unchanged") == 7
    assert (folder / "images" / "000005.png").stat().st_mtime_ns == before
    assert len(Capture.open(folder).splits["last-5"].test) == 5
    assert run(clip, folder, "--resume", "--split", "last-5", size=64, loud=True) == 0
    assert said(capsys).count(": unchanged") == 1
    assert Capture.open(folder).width == 64


def test_the_imported_tracking_is_read_once(clip, tmp_path, monkeypatch):
    """Reading thousands of files takes seconds, and crop and tracking both need them."""
    reads, read = [], metrical_tracker.read
    monkeypatch.setattr(metrical_tracker, "read", lambda path: reads.append(path) or read(path))
    assert run(clip, tmp_path / "c") == 0
    assert len(reads) == 1


def messages(text):
    """The lines of the summary that report a warning or an assumption."""
    return [line for line in text.splitlines() if line.startswith(("warning: ", "note: "))]


def test_what_skipped_stages_assumed_is_said_again(clip, tmp_path, capsys):
    """Masks with levels 0 and 1 are scaled (a note of the mask stage), a frame has no tracking (a warning)."""
    masks, tracking, folder = tmp_path / "masks", tmp_path / "tracking", tmp_path / "c"
    for row in range(24):
        write_png(masks / f"{row:05d}.png", draw(clip.head, clip.record, row)[1] // 255)
    shutil.copytree(clip.folder / "tracking", tracking)
    (tracking / "00011.frame").unlink()
    assert run(clip, folder, masks=masks, tracking=tracking, loud=True) == 0
    first = messages(capsys.readouterr().err)
    assert any("levels 0 (background) and 1 (person)" in line for line in first)
    assert any("1 frames have no tracking" in line for line in first)
    for more, unchanged in (((), 9), (("--split", "last-5"), 7)):
        assert run(clip, folder, "--resume", *more, masks=masks, tracking=tracking, loud=True) == 0
        text = capsys.readouterr().err
        assert text.count(": unchanged") == unchanged and messages(text) == first


@pytest.mark.parametrize("flags", [("--tracker.focal", "900"), ("--tracker.no-smooth",)])
def test_options_that_an_imported_tracking_ignores_are_refused(clip, tmp_path, capsys, flags):
    assert run(clip, tmp_path / "c", *flags) == 2
    assert "leave it out" in said(capsys) and not (tmp_path / "c").exists()


@pytest.mark.slow
def test_interrupted_runs_continue(clip, tmp_path, monkeypatch, capsys):
    """Killed in the middle of each stage: no capture is left that opens; the same command finishes it, or --resume."""
    from preprocess.pipeline import crop_stage, mask_stage

    whole = tmp_path / "whole"
    assert run(clip, whole) == 0
    for module, flags in ((crop_stage, ()), (mask_stage, ("--resume",))):
        folder = tmp_path / module.__name__
        calls = 0
        write = module.write_png

        def stopping(path, image, write=write):
            nonlocal calls
            calls += 1
            if calls == 7:
                raise KeyboardInterrupt
            write(path, image)

        with monkeypatch.context() as patch:
            patch.setattr(module, "write_png", stopping)
            assert run(clip, folder) == 130
        with pytest.raises(InputError, match="--resume"):
            Capture.open(folder)
        assert run(clip, folder, *flags) == 0
        assert Capture.open(folder).digest() == Capture.open(whole).digest()
        noted = [(each / crop_stage.PICTURES).read_bytes() for each in (folder, whole)]
        assert noted[0] == noted[1], "images that were there already count as well"
    assert pipeline.STAGES[0].name == "frames"


def test_a_finished_capture_that_lost_an_image_is_not_called_finished(clip, tmp_path, capsys):
    folder = tmp_path / "c"
    assert run(clip, folder) == 0
    (folder / "masks" / "000007.png").unlink()
    assert run(clip, folder, "--resume") == 2
    message = said(capsys)
    assert "000007.png" in message and "--overwrite" in message
    assert run(clip, folder, "--overwrite") == 0


def test_a_second_command_is_refused_by_name(clip, tmp_path, capsys):
    folder = tmp_path / "c"
    folder.mkdir()
    with lock_folder(folder):
        for flags in ((), ("--resume",)):
            assert run(clip, folder, *flags) == 2
            text = said(capsys)
            assert f"{folder}: " in text and f"(process {os.getpid()} on " in text
        assert all(map(is_lock_file, folder.iterdir()))


def test_resume_of_nothing_is_a_typo(clip, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for name in ("nowhere", "empty"):
        assert run(clip, tmp_path / name, "--resume") == 2
        assert "--resume found no capture to continue here; check -o" in said(capsys)
    assert not (tmp_path / "nowhere").exists() and not list((tmp_path / "empty").iterdir())


@pytest.mark.parametrize("left", [".lock", ".lock.json", ".prep/", ".prep/.abc.json.part", ".prep/frames.json"])
@pytest.mark.parametrize("flag", ["", "resume", "overwrite"])
def test_a_start_that_was_killed_early_blocks_nothing(tmp_path, left, flag):
    """Checked without the stages, which would take the time of 15 captures."""
    folder = tmp_path / "c"
    path = folder / left
    path.parent.mkdir(parents=True)
    if left.endswith("/"):
        path.mkdir()
    else:
        path.write_text("{" if "part" in left or "lock" in left else '{"fingerprint": "another"}')
    options = PrepOptions(tmp_path / "video.mp4", folder, **({flag: True} if flag else {}))
    pipeline.check_folder(options, pipeline.STAGES[0], "wanted")
    pipeline._begin(options, pipeline.STAGES)
    assert not list(folder.rglob("*.part"))


def test_a_wrong_argument_does_not_block_the_corrected_command(clip, tmp_path, capsys):
    folder, masks = tmp_path / "c", tmp_path / "masks"
    for row in range(24):
        write_png(masks / f"{row:05d}.png", np.zeros((50, 40), np.uint8))
    assert run(clip, folder, masks=masks) == 2 and said(capsys)
    images = [path.stat().st_mtime_ns for path in sorted((folder / "images").iterdir())]
    write_video(tmp_path / "other.mp4", [np.full((96, 96, 3), 90 + row, np.uint8) for row in range(24)])
    assert run(clip, folder, video=tmp_path / "other.mp4") == 2, "another video may not replace what was begun"
    assert "exists already" in said(capsys)
    assert run(clip, folder) == 0
    assert images == [path.stat().st_mtime_ns for path in sorted((folder / "images").iterdir())]


def test_overwriting_loses_neither_the_capture_nor_what_others_put_beside_it(clip, tmp_path, capsys):
    """The video cannot be read: the earlier capture stays. It can: the user's notes stay."""
    folder = tmp_path / "c"
    assert run(clip, folder) == 0
    digest = Capture.open(folder).digest()
    (folder / "notes.txt").write_text("years of work")
    (tmp_path / "text.mp4").write_text("no video")
    assert run(clip, folder, "--overwrite", video=tmp_path / "text.mp4") == 2
    assert Capture.open(folder).digest() == digest
    assert run(clip, folder, "--overwrite", size=64) == 0
    assert Capture.open(folder).width == 64 and (folder / "notes.txt").read_text() == "years of work"
    (folder / ".prep" / "tracking.json").write_text('{"fing')
    assert run(clip, folder, "--resume", size=64) == 0, "a damaged record: its stage runs again"


def test_a_folder_that_is_removed_meanwhile_does_not_come_back(clip, tmp_path, monkeypatch, capsys):
    from preprocess.pipeline import mask_stage

    write, folder, calls = mask_stage.write_png, tmp_path / "c", []

    def removing(path, image):
        calls.append(path)
        if len(calls) == 5:
            shutil.rmtree(folder)
        write(path, image)

    monkeypatch.setattr(mask_stage, "write_png", removing)
    assert run(clip, folder) == 1
    assert f"{folder}: the folder was removed or renamed while it was written" in said(capsys)
    assert not folder.exists()


def test_existing_folders_are_safe(clip, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("years of work")
    for flags in ((), ("--overwrite",), ("--resume",)):
        assert run(clip, mine, *flags) == 2
        assert "was not made by ggavatar-prep" in said(capsys)
    assert (mine / "thesis.txt").read_text() == "years of work" and len(list(mine.iterdir())) == 1
    folder = tmp_path / "c"
    assert run(clip, folder) == 0 and run(clip, folder) == 2 and run(clip, folder, "--overwrite", size=64) == 0
    assert Capture.open(folder).width == 64
    assert run(clip, folder, "--overwrite", "--resume") == 2
    assert run(clip, clip.folder) == 2
    assert "choose another folder" in said(capsys)


def test_nothing_is_written_for_bad_input(clip, tmp_path, capsys):
    for message, replaced in (
        ("no such file", {"video": tmp_path / "absent.mp4"}),
        ("no such file", {"masks": tmp_path / "absent"}),
        ("no such file", {"tracking": tmp_path / "absent"}),
        ("no such head model file", {"head_model": tmp_path / "absent.npz"}),
        ("--size", {"size": 7}),
        ("--crop", {"crop": "1,2,3"}),
        ("needs --head-model", {"head_model": None}),
    ):
        assert run(clip, tmp_path / "out", **replaced) == 2
        assert message in said(capsys)
        assert not (tmp_path / "out").exists()


def test_what_fails_at_the_video_leaves_room_for_another_try(clip, tmp_path, capsys):
    """A folder that holds records and nothing else is as good as none."""
    folder = tmp_path / "out"
    assert run(clip, folder, frames="a:b") == 2 and "--frames" in said(capsys)
    assert [entry.name for entry in folder.iterdir()] == [".prep"]
    assert run(clip, folder) == 0 and Capture.open(folder).frames == tuple(range(24))


def test_bad_videos(clip, tmp_path, capsys):
    images = [np.full((96, 96, 3), 90, np.uint8)]
    write_video(tmp_path / "one.mp4", images)
    (tmp_path / "text.mp4").write_text("no video")
    assert run(clip, tmp_path / "a", video=tmp_path / "one.mp4") == 2
    assert "only one frame" in said(capsys)
    assert run(clip, tmp_path / "b", video=tmp_path / "text.mp4") == 2
    assert "not a video" in said(capsys)
    assert run(clip, tmp_path / "c", "--start", "99") == 2
    assert "no frame" in said(capsys)


@pytest.mark.parametrize("name", ["with space", "ünïcödé 頭", "-dash"])
def test_odd_paths(clip, tmp_path, name, monkeypatch):
    place = tmp_path / name
    shutil.copytree(clip.folder, place)
    monkeypatch.chdir(tmp_path)
    moved = dataclasses.replace(clip, folder=Path(f"./{name}"))
    assert run(moved, f"{name} out") == 0
    assert len(Capture.open(tmp_path / f"{name} out").frames) == 24


def test_read_only_input(clip, tmp_path):
    place = tmp_path / "locked"
    shutil.copytree(clip.folder, place)
    files = [*place.rglob("*"), place]
    try:
        for path in files:
            path.chmod(0o555 if path.is_dir() else 0o444)
        assert run(dataclasses.replace(clip, folder=place), tmp_path / "out") == 0
    finally:
        for path in files:
            path.chmod(0o755)


def test_selection_keeps_source_numbers(clip, tmp_path):
    assert run(clip, tmp_path / "c", "--frames", "4:20:2") == 0
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == tuple(range(4, 20, 2))
    np.testing.assert_allclose(capture.tracking.expression, clip.record.expression[4:20:2], atol=1e-6)


def test_numbers_from_one(clip, tmp_path, capsys):
    """FlashAvatar's pairing: images and masks counted from 1, `.frame` files from 0."""
    images, masks = tmp_path / "images", tmp_path / "masks"
    for row in range(24):
        image, mask = draw(clip.head, clip.record, row)
        write_png(images / f"{row + 1:05d}.png", image)
        write_png(masks / f"{row + 1:05d}.png", mask)
    assert run(clip, tmp_path / "c", video=images, masks=masks) == 0
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == tuple(range(1, 25)) and capture.source["tracking"]["offset"] == 1
    np.testing.assert_allclose(capture.tracking.expression, clip.record.expression, atol=1e-6)


def test_masks_counted_from_one(clip, tmp_path):
    masks = tmp_path / "masks"
    for row in range(24):
        write_png(masks / f"mask_{row + 1:05d}.png", draw(clip.head, clip.record, row)[1])
    assert run(clip, tmp_path / "c", masks=masks) == 0
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").mask(9), draw(clip.head, clip.record, 9)[1])


def test_lost_frames_are_dropped_with_a_reason(clip, tmp_path, capsys):
    place = tmp_path / "clip"
    shutil.copytree(clip.folder, place)
    (place / "masks" / "00007.png").unlink()
    (place / "tracking" / "00011.frame").unlink()
    holed = dataclasses.replace(clip, folder=place)
    assert run(holed, tmp_path / "c") == 0
    capture = Capture.open(tmp_path / "c")
    assert [dict(item) for item in capture.dropped] == [
        {"frame": 7, "reason": "no mask"},
        {"frame": 11, "reason": "no tracking"},
    ]
    assert not capture.image_path("images", 7).exists() and len(capture.frames) == 22
    assert "left out" in said(capsys)
    assert run(holed, tmp_path / "strict", "--strict") == 3


def test_mask_of_wrong_size_is_named(clip, tmp_path, capsys):
    place = tmp_path / "clip"
    shutil.copytree(clip.folder, place)
    write_png(place / "masks" / "00007.png", np.zeros((50, 40), np.uint8))
    assert run(dataclasses.replace(clip, folder=place), tmp_path / "c") == 2
    assert "00007.png: expected 96×96 px" in said(capsys)


def test_other_size_scales_the_camera(clip, tmp_path):
    assert run(clip, tmp_path / "c", size=64) == 0
    capture = Capture.open(tmp_path / "c")
    expected = clip.record.intrinsics * np.array([[64 / 96], [64 / 96], [1]])
    np.testing.assert_allclose(capture.tracking.intrinsics, expected, rtol=1e-6)
    assert capture.mask(0).shape == (64, 64)


def test_swapped_size_of_an_oblong_video_is_named_and_mended(tmp_path, capsys):
    clip = make_clip(tmp_path / "clip", size=(128, 96))
    wrong = dataclasses.replace(clip.record, width=96, height=128)
    shutil.rmtree(tmp_path / "clip" / "tracking")
    metrical_tracker.write(tmp_path / "clip" / "tracking", wrong)
    assert run(clip, tmp_path / "c") == 2
    assert "width and height are swapped in the tracking; add --fix swapped-size" in said(capsys)
    assert run(clip, tmp_path / "d", "--fix", "swapped-size", "--crop", "none") == 0
    capture = Capture.open(tmp_path / "d")
    assert (capture.width, capture.height) == (96, 72)
    np.testing.assert_allclose(
        capture.tracking.intrinsics[0], np.diag([0.75, 0.75, 1]) @ clip.record.intrinsics[0], rtol=1e-6
    )


def test_cropped_tracking_is_explained(clip, tmp_path, capsys):
    place = make_clip(tmp_path / "clip", size=(128, 96))
    assert run(place, tmp_path / "c", tracking=clip.folder / "tracking") == 2
    assert "the tracker cropped it" in said(capsys)


def test_flame_versions_never_mix(clip, tmp_path, capsys):
    from tests.support.flame_files import flame_values, write_model

    write_model(tmp_path / "flame2023.pkl", flame_values())
    assert run(clip, tmp_path / "c", head_model=tmp_path / "flame2023.pkl") == 2
    assert "not interchangeable" in said(capsys)
    write_model(tmp_path / "generic_model.pkl", flame_values())
    assert run(clip, tmp_path / "d", head_model=tmp_path / "generic_model.pkl") == 0
    assert Capture.open(tmp_path / "d").head_version == "flame2020"


def test_full_disk(clip, tmp_path, monkeypatch, capsys):
    from ggavatar.io import atomic

    original, left = atomic.os.replace, 30

    def replace(source, target):
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, "No space left on device", str(target))
        original(source, target)

    monkeypatch.setattr(atomic.os, "replace", replace)
    assert run(clip, tmp_path / "c") == 1
    assert "free some space" in said(capsys)
    assert not list((tmp_path / "c").rglob("*.part"))
    monkeypatch.undo()
    assert run(clip, tmp_path / "c", "--resume") == 0


def test_offline_without_models_names_everything(clip, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("GGAVATAR_MODELS", raising=False)
    monkeypatch.setenv("GGAVATAR_CACHE", str(tmp_path / "cache"))
    assert run(clip, tmp_path / "c", "--offline", masks=None) == 2
    message = said(capsys)
    assert "selfie_segmentation.tflite" in message and "https://" in message and str(tmp_path / "cache") in message


def test_summary_for_machines(clip, tmp_path, capsys):
    import json

    assert main([*clip.arguments, "-o", str(tmp_path / "c"), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert shown["frames"] == 24 and shown["dropped"] == 0 and shown["doctor"]["schema"] == "ggavatar-doctor"
