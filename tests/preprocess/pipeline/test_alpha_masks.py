"""The alpha channel becomes the mask where the user gave none. Reference: the masks that were drawn."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from ggavatar.io.images import read_gray, read_rgb
from preprocess.cli.prep import main
from tests.support.pictures import write_frames
from tests.support.synthetic_clip import Clip, draw, make_clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    made = make_clip(tmp_path_factory.mktemp("clip"))
    drawn = [draw(made.head, made.record, row) for row in range(24)]
    frames = [av.VideoFrame.from_ndarray(np.dstack(pair), format="rgba").reformat(format="argb") for pair in drawn]
    write_frames(made.folder / "alpha.mov", frames, "qtrle")
    return made


def without_masks(clip: Clip, source: Path) -> list[str]:
    _video, *rest = clip.arguments
    place = rest.index("--masks")
    return [str(source), *rest[:place], *rest[place + 2 :]]


def test_alpha_of_a_video(clip, tmp_path, capsys):
    assert main([*without_masks(clip, clip.folder / "alpha.mov"), "-o", str(tmp_path / "c")]) == 0
    output = " ".join(capsys.readouterr().err.split())
    assert output.count("alpha channel is used as masks") == 1 and "--masks selfie" in output
    for row in range(24):
        image, mask = draw(clip.head, clip.record, row)
        np.testing.assert_array_equal(read_gray(tmp_path / "c" / "masks" / f"{row:06d}.png"), mask)
        np.testing.assert_array_equal(read_rgb(tmp_path / "c" / "images" / f"{row:06d}.png"), image)
    assert json.loads((tmp_path / "c" / "capture.json").read_text())["source"]["masks"] == "alpha"


def test_masks_of_the_user_come_first(clip, tmp_path, capsys):
    shutil.copytree(clip.folder / "masks", tmp_path / "masks")
    arguments = [*without_masks(clip, clip.folder / "alpha.mov"), "--masks", str(tmp_path / "masks")]
    assert main([*arguments, "-o", str(tmp_path / "c")]) == 0
    assert "alpha channel" not in capsys.readouterr().err
    assert json.loads((tmp_path / "c" / "capture.json").read_text())["source"]["masks"] == "masks"


def test_alpha_of_images_and_conversions_in_the_record(clip, tmp_path, capsys):
    """Transparent PNG files; every conversion is said once, and recorded."""
    from tests.support.pictures import exif_block, with_png_chunk

    (tmp_path / "frames").mkdir()
    for row in range(24):
        image, mask = draw(clip.head, clip.record, row)
        path = tmp_path / "frames" / f"{row:04d}.png"
        write_rgba(path, np.rot90(np.dstack((image, mask))))
        path.write_bytes(with_png_chunk(path.read_bytes(), b"eXIf", exif_block(6)))
    assert main([*without_masks(clip, tmp_path / "frames"), "-o", str(tmp_path / "c")]) == 0
    output = " ".join(capsys.readouterr().err.split())
    said = "images turned by 90° clockwise, as their EXIF orientation says"
    assert output.count(said) == 1
    assert json.loads((tmp_path / "c" / "capture.json").read_text())["source"]["conversions"] == [said]
    np.testing.assert_array_equal(
        read_gray(tmp_path / "c" / "masks" / "000005.png"), draw(clip.head, clip.record, 5)[1]
    )


def test_opaque_alpha_is_no_mask(clip, tmp_path, capsys):
    (tmp_path / "frames").mkdir()
    for row in range(24):
        image, mask = draw(clip.head, clip.record, row)
        write_rgba(tmp_path / "frames" / f"{row:04d}.png", np.dstack((image, np.full_like(mask, 255))))
    assert main(
        [*without_masks(clip, tmp_path / "frames"), "--masks", "auto", "--offline", "-o", str(tmp_path / "c")]
    ) in (0, 2)
    assert "alpha channel" not in capsys.readouterr().err


def write_rgba(path: Path, image: np.ndarray) -> None:
    import cv2

    ok, encoded = cv2.imencode(".png", np.ascontiguousarray(image[..., [2, 1, 0, 3]]))
    assert ok
    path.write_bytes(encoded.tobytes())
