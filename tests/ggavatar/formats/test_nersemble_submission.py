"""A submission to NeRSemble's benchmark, checked as its own reader does: names, size, every frame, what can be decoded.

Reference: nersemble-benchmark, data/submission_data.py: `SubmissionDataReader.get_file_overview` and
`validate_submission`, which reads the videos with PyAV.
"""

from __future__ import annotations

import io
import re
import zipfile

import av
import numpy as np
import pytest

from ggavatar.cli.export import main
from ggavatar.errors import InputError
from ggavatar.formats.nersemble_submission import write_submission
from ggavatar.io.images import write_png


def render(folder, count=3, side=512, first=0):
    for number in range(first, first + count):
        image = np.full((side, side, 3), 40 + 30 * number, np.uint8)
        image[100:300, 100:300] = [200, 90, 60]
        write_png(folder / f"{number:06d}.png", image)


@pytest.fixture
def renderings(tmp_path):
    render(tmp_path / "out" / "393" / "FREE" / "cam_222200037" / "frames")
    render(tmp_path / "out" / "393" / "FREE" / "cam_222200046")
    return tmp_path / "out"


def test_the_benchmarks_reader_accepts_it(renderings, tmp_path, capsys):
    assert main([str(renderings), "--format", "nersemble-submission"]) == 0
    assert "2 videos, 6 frames" in (said := capsys.readouterr().out) and "78 more" in said
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        names = archive.namelist()
        assert all(re.fullmatch(r"(\d+)/([\w\d\-_+]+)/cam_(\w+)\.mp4", name) for name in names) and len(names) == 2
        with av.open(io.BytesIO(archive.read("393/FREE/cam_222200046.mp4"))) as video:
            assert float(video.streams.video[0].average_rate) == pytest.approx(24.3)
            frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == 3 and frames[0].shape == (512, 512, 3)
    for number, frame in enumerate(frames):
        assert np.abs(frame[350:, 350:].astype(int) - (40 + 30 * number)).mean() < 3
        assert np.abs(frame[150:250, 150:250].astype(int) - [200, 90, 60]).mean() < 4
    assert main([str(renderings), "--format", "nersemble-submission"]) == 2


@pytest.mark.parametrize(
    ("place", "options", "said"),
    [
        ("393/FREE/cam_222200039", {"count": 2}, "expected 3 frames"),
        ("393/FREE/cam_222200039", {"side": 256}, "--width 512"),
        ("393/FREE/cam_222200039", {"first": 1}, "no frame 0"),
        ("393/FREE/cam_999", {}, "cam_999"),
        ("393/FREEE/cam_222200037", {}, "FREE"),
        ("100/FREE/cam_222200037", {}, "393, 404"),
    ],
)
def test_what_the_benchmark_would_refuse(renderings, tmp_path, place, options, said):
    render(renderings / place, **options)
    with pytest.raises(InputError, match=said):
        write_submission(renderings, tmp_path / "x.zip")
    assert not (tmp_path / "x.zip").exists()


def test_an_empty_folder(tmp_path):
    with pytest.raises(InputError, match=r"393/FREE/cam_222200037, found none"):
        write_submission(tmp_path, tmp_path / "x.zip")
