"""Videos, read back with PyAV."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from evaluate.figures.video import playback_fps, video_writer, write_side_by_side
from evaluate.scoring.frame_files import frame_file
from ggavatar.errors import InputError
from ggavatar.io.images import write_png


def decoded(path: Path) -> tuple[list[np.ndarray], float]:
    with av.open(str(path)) as container:
        rate = float(container.streams.video[0].average_rate or 0)
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], rate


def test_colors_survive_and_odd_sizes_are_padded(tmp_path: Path) -> None:
    colors = [(200, 40, 30), (20, 180, 60), (250, 250, 250), (0, 0, 0)]
    with video_writer(tmp_path / "v.mp4", 12.5) as append:
        for color in colors:
            append(np.full((33, 47, 3), color, np.uint8))
    images, rate = decoded(tmp_path / "v.mp4")
    assert rate == pytest.approx(12.5) and [image.shape for image in images] == [(34, 48, 3)] * 4
    for image, color in zip(images, colors, strict=True):
        assert np.abs(image.astype(int) - color).max() <= 4
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]


def test_a_failed_video_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="renderer failed"), video_writer(tmp_path / "v.mp4", 25.0) as append:
        append(np.zeros((16, 16, 3), np.uint8))
        raise RuntimeError("the renderer failed")
    with pytest.raises(InputError, match="at least one image"), video_writer(tmp_path / "v.mp4", 25.0):
        pass
    assert list(tmp_path.iterdir()) == []


def test_splits_with_gaps_play_slower() -> None:
    assert playback_fps([7, 8, 9, 12], 25.0) == 25
    assert playback_fps([0, 20, 40], 25.0) == 4
    assert playback_fps([3], 25.0) == 4


def test_side_by_side_has_truth_render_and_error(tmp_path: Path) -> None:
    for frame, level in ((0, 60), (20, 180)):
        write_png(frame_file(tmp_path / "truth", frame), np.full((64, 64, 3), 120, np.uint8))
        write_png(frame_file(tmp_path / "render", frame), np.full((64, 64, 3), level, np.uint8))
    steps: list[int] = []
    write_side_by_side(
        tmp_path / "side.mp4", tmp_path / "render", tmp_path / "truth", progress=lambda done, total: steps.append(done)
    )
    images, rate = decoded(tmp_path / "side.mp4")
    assert len(images) == 2 and rate == 4 and steps == [1, 2] and images[0].shape[1] == 192
    middle = images[1].shape[0] // 2
    assert abs(int(images[1][middle, 32, 0]) - 120) < 6 and abs(int(images[1][middle, 96, 0]) - 180) < 6
    assert int(images[1][middle, 160].sum()) > 300, "an error of 60 of 255 is far up the scale"


ENCODE = """
import sys
from pathlib import Path
import numpy as np
from evaluate.figures.video import video_writer
draw = np.random.default_rng(0)
with video_writer(Path(sys.argv[1]), 4.0) as append:
    for _ in range(6):
        append(np.kron(draw.integers(0, 256, (14, 24, 3)), np.ones((8, 8, 1))).astype(np.uint8)[:107])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs the malloc of glibc")
def test_the_same_images_give_the_same_file_whatever_was_in_memory(tmp_path: Path) -> None:
    for filling in ("0", "170"):  # malloc(3), M_PERTURB: what fresh memory is filled with
        environment = {**os.environ, "MALLOC_PERTURB_": filling, "PYTHONPATH": str(Path(__file__).parents[3])}
        path = tmp_path / f"{filling}.mp4"
        subprocess.run([sys.executable, "-c", ENCODE, str(path)], env=environment, check=True)
    first, second = sorted(tmp_path.glob("*.mp4"))
    assert first.read_bytes() == second.read_bytes()
