"""Which frames become a capture, on the synthetic subject: blank, faded, repeated frames, other persons.

Reference: what was put into the video. Also covers `preprocess/evidence/faces.py`, `preprocess/evidence/pictures.py`,
`preprocess/evidence/survey.py`, `preprocess/pipeline/face_stage.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggavatar.data.capture import Capture
from ggavatar.errors import GateError, InputError
from ggavatar.io.images import image_header, read_rgb, write_png
from ggavatar.landmarks.tracker import Landmarks, LandmarkTracker
from preprocess.cli.prep import main
from preprocess.evidence.clip_faces import ClipFaces
from preprocess.evidence.pictures import Pictures, join_pictures, reduce_image
from preprocess.evidence.survey import Survey, survey
from preprocess.options import PrepOptions
from preprocess.pipeline import evidence_stage
from preprocess.pipeline.crop_stage import PICTURES
from preprocess.pipeline.face_stage import FACES
from preprocess.pipeline.stage import StageContext
from tests.preprocess.evidence.test_identity import clip_of
from tests.support.synthetic_clip import draw


def run(clip, folder, images, *more):
    return main([str(images), *clip.arguments[1:], "-o", str(folder), *more])


def said(capsys):
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    return " ".join((output.out + output.err).split())


def frames(clip):
    return [draw(clip.head, clip.record, row)[0] for row in range(24)]


def written(folder, images):
    for row, image in enumerate(images):
        write_png(folder / f"{row:05d}.png", np.asarray(image, np.uint8))
    return folder


@pytest.fixture(scope="module")
def faded(clip, tmp_path_factory):
    """Four black frames, then a fade of three."""
    weights = [0.0] * 4 + [0.25, 0.5, 0.75] + [1.0] * 17
    images = [weight * image.astype(float) for weight, image in zip(weights, frames(clip), strict=True)]
    return written(tmp_path_factory.mktemp("faded") / "images", images)


def test_black_and_faded_frames_are_left_out_and_said(clip, faded, tmp_path, capsys):
    assert run(clip, tmp_path / "c", faded) == 0
    output = said(capsys)
    assert "7 of 24 frames are left out: 3 faded in or out (4–6), 4 black (0–3)" in output.replace(
        "4 black (0–3), 3 faded in or out (4–6)", "3 faded in or out (4–6), 4 black (0–3)"
    )
    assert "capture with 17 frames, 7 left out (4 black, 3 faded in or out)" in output
    assert "--fps" not in output and "--keep-faceless keeps" in output
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == tuple(range(7, 24)) and 7 in capture.splits["every-20th"].test
    reasons = ["black"] * 4 + ["faded in or out"] * 3
    assert [dict(item) for item in capture.dropped] == [
        {"frame": row, "reason": reason} for row, reason in enumerate(reasons)
    ]
    assert not capture.image_path("images", 0).exists() and not capture.image_path("masks", 0).exists()
    sheet = read_rgb(tmp_path / "c" / "preview.jpg")
    assert sheet.shape[0] == 3 * 256 + 2 * 24 + 8 and sheet[3 * 256 + 4 :].max() > 200, "a line for each reason"
    np.testing.assert_allclose(capture.tracking.expression, clip.record.expression[7:], atol=1e-6)


def test_keep_faceless_after_all(clip, faded, tmp_path, capsys):
    """The advice, followed: the images of dropped frames are still there."""
    assert run(clip, tmp_path / "c", faded, "--quiet") == 0
    assert run(clip, tmp_path / "c", faded, "--resume", "--keep-faceless") == 0
    assert said(capsys).count(": unchanged") == 3, "reading, cropping and finding faces"
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == tuple(range(24)) and not capture.dropped
    assert capture.image(0).max() == 0 and image_header(tmp_path / "c" / "preview.jpg").height == 3 * 256
    assert run(clip, tmp_path / "c", faded, "--resume", "--quiet") == 0
    assert Capture.open(tmp_path / "c").frames == tuple(range(7, 24))
    assert run(clip, tmp_path / "strict", faded, "--strict", "--quiet") == 3


def test_frozen_frames_are_named_and_dropped_on_request(clip, tmp_path, capsys):
    images = frames(clip)
    images[9:16] = [images[8]] * 7
    folder = written(tmp_path / "still", images)
    assert run(clip, tmp_path / "c", folder) == 0
    output = said(capsys)
    assert "7 of 24 frames repeat the one before: the picture is frozen in frames 9–15" in output
    assert "[ggavatar-prep --resume --drop-repeated]" in output and "rate" not in output
    assert run(clip, tmp_path / "c", folder, "--resume", "--drop-repeated") == 0
    output = said(capsys)
    assert "7 left out (7 repeats the frame before)" in output and "the picture is frozen" not in output
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == (*range(9), *range(16, 24)) and capture.fps == pytest.approx(25 * 17 / 17)


def test_a_lower_rate_is_named_and_mended(clip, tmp_path, capsys):
    """Twelve frames, each shown twice: the clip has half the rate."""
    images = [image for image in frames(clip)[:12] for _ in range(2)]
    folder = written(tmp_path / "doubled", images)
    masks = [draw(clip.head, clip.record, row // 2)[1] for row in range(24)]
    arguments = ("--frame-offset", "0", "--masks", str(written(tmp_path / "masks", masks)))
    assert run(clip, tmp_path / "c", folder, *arguments) == 0
    assert "evenly: the video was converted from a lower frame rate, about 12.5 per second" in said(capsys)
    assert run(clip, tmp_path / "c", folder, "--resume", "--drop-repeated", *arguments) == 0
    assert "repeat the one before" not in said(capsys)
    capture = Capture.open(tmp_path / "c")
    assert capture.frames == tuple(range(0, 24, 2)) and capture.fps == pytest.approx(12.5)


class Notes:
    """A reporter that keeps what it is told."""

    def __init__(self):
        self.said = []

    def advance(self, done, total):
        pass

    def warn(self, message):
        self.said.append(message)

    note = warn


def choose(folder, found, **options):
    """Run the stage on a made-up survey."""
    (folder / ".prep").mkdir(exist_ok=True)
    found.pictures.write(folder / PICTURES)
    found.write_faces(folder / FACES)
    numbers, reporter = list(range(100, 100 + len(found.looked))), Notes()
    results = {"frames": {"numbers": numbers, "fps": 25.0}}
    options_ = PrepOptions(Path("v.mp4"), folder, **options)
    context = StageContext(options_, folder, results, reporter, lambda: pytest.fail("no tracking is given"))
    return evidence_stage.run(context), reporter.said


def made_up(*stretches):
    thumbnails, faces, missing = clip_of(*stretches)
    textured = thumbnails + np.random.default_rng(0).integers(0, 60, thumbnails.shape[1:], dtype=np.uint8)
    return Survey(Pictures(textured, np.zeros(len(missing), bool)), faces, np.ones(len(missing), bool))


def test_another_person_is_refused_and_the_advice_keeps_one(tmp_path):
    found = made_up((1, 20), (2, 30))
    with pytest.raises(InputError, match=r"another person from frame 120 on; .* --resume --cut auto"):
        choose(tmp_path, found)
    result, notes = choose(tmp_path, found, cut="auto")
    assert result["numbers"] == list(range(120, 150)) and result["dropped"][0] == [100, "another part of the clip"]
    assert "20 of 50 frames are left out: 20 another part of the clip (100–119)" in notes[0]
    assert choose(tmp_path, found, cut="1")[0]["numbers"] == list(range(100, 120))
    assert choose(tmp_path, found, cut="all")[0]["numbers"] == list(range(100, 150))


def test_who_leaves_and_comes_back_stays_one_capture(tmp_path):
    """The tracker gets the frames in between, for its sense of time; the capture does not."""
    result, notes = choose(tmp_path, made_up((1, 20), (None, 15), (1, 20), (None, 3)))
    assert result["numbers"] == list(range(100, 155)), "not the last three"
    assert result["dropped"] == [[row, "no face"] for row in (*range(120, 135), 155, 156, 157)]
    assert "18 of 58 frames are left out: 18 no face (120–134, 155–157)" in notes[0]
    with pytest.raises(GateError, match="18 no face"):
        choose(tmp_path, made_up((1, 20), (None, 15), (1, 20), (None, 3)), strict=True)
    result, notes = choose(tmp_path, made_up((1, 20), (None, 15)), keep_faceless=True)
    assert not result["dropped"] and "no face in 15 of 35 frames; their poses are taken from neigh" in notes[0]


def test_a_clip_without_enough_faces_is_refused(tmp_path):
    with pytest.raises(InputError, match="a face in at least 8 frames, found one in 5 of 50"):
        choose(tmp_path, made_up((1, 5), (None, 45)))


def test_too_few_frames_are_named_as_that(clip, tmp_path, capsys):
    images = written(tmp_path / "few", frames(clip)[:5])
    assert main([str(images), "-o", str(tmp_path / "c"), "--crop", "none", "--masks", "grabcut"]) == 2
    assert "too few frames: expected at least 8, and several hundred for a good avatar, found 5" in said(capsys)


class Sighted(LandmarkTracker):
    """Landmarks that are found in frames darker than a limit; keeps what it is asked for."""

    def __init__(self):
        self.asked, self.resets = [], 0

    def landmarks(self, image):
        self.asked.append(int(image[0, 0, 0]))
        seen = image[0, 0, 0] < 200
        return Landmarks(np.ones((478, 2)), np.ones(478), np.zeros(52), 1.0) if seen else None

    def reset(self):
        self.resets += 1


def test_a_search_in_some_frames_finds_every_long_gap():
    """Frames 20 to 39 show no face: found by looking at every eighth and around those without one."""
    images = np.repeat(np.random.default_rng(0).integers(0, 255, (1, 32, 32, 3), dtype=np.uint8), 80, axis=0)
    images[:, 0, 0, 0] = [210 if 20 <= row < 40 else row for row in range(80)]
    eyes, opened = Sighted(), []

    def looked_at(tracker, every_frame):
        def read(rows):
            opened.extend(rows)
            return images[list(rows)]

        return survey(join_pictures(map(reduce_image, images)), read, tracker, every_frame)

    found = looked_at(eyes, False)
    assert [row for row, reason in found.reasons().items() if reason == "no face"] == list(range(20, 40))
    assert len(eyes.asked) == len(opened) < 40, "the other images are not even read"
    assert looked_at(Sighted(), True).reasons() == found.reasons()
    assert looked_at(None, False).reasons() == {}
    images[:60, 0, 0, 0] = 210
    assert not looked_at(Sighted(), False).faces_are_reliable


def test_the_network_forgets_the_face_at_a_cut_between_two_looks():
    """The picture changes by 50 levels at frame 11, where nobody looks; the next look, at 16, begins anew."""
    images = np.repeat(np.random.default_rng(0).integers(0, 190, (1, 32, 32, 3), dtype=np.uint8), 40, axis=0)
    images[11:, :, :, :] += 50
    images[:, 0, 0] = 0
    eyes = Sighted()
    survey(join_pictures(map(reduce_image, images)), lambda rows: images[list(rows)], eyes, every_frame=False)
    assert len(eyes.asked) == 5 and eyes.resets == 1


def test_faces_that_are_hardly_ever_found_are_no_evidence():
    faces = ClipFaces(np.full((20, 478, 2), np.nan), np.full((20, 478), np.nan), np.zeros((20, 52)))
    thumbnails = np.random.default_rng(0).integers(0, 255, (20, 32, 32, 3), dtype=np.uint8)
    found = Survey(Pictures(thumbnails, np.zeros(20, bool)), faces, np.ones(20, bool))
    assert not found.faces_are_reliable and found.reasons() == {}
