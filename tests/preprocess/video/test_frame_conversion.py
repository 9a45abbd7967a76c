"""Video frames become upright, square and sRGB. References: closed forms of what was stored; the standards' formulas.

Also covers `preprocess/video/alpha_stream.py`.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

from ggavatar.errors import InputError
from preprocess.video.decoding import Video
from preprocess.video.frame_conversion import FrameColors, frame_conversion
from preprocess.video.selection import parse_selection
from tests.support.hdr_reference import hdr_to_srgb, pq_signal
from tests.support.pictures import (
    asymmetric,
    patch_values,
    patches,
    planar_frame,
    with_display_matrix,
    write_frames,
    yuv_planes,
)
from tests.support.synthetic_clip import write_video

BT2020 = {"color_primaries": 9, "colorspace": 9, "color_range": 1}
WEIGHTS = {
    1: (0.2126, 0.0722),
    4: (0.30, 0.11),
    5: (0.299, 0.114),
    6: (0.299, 0.114),
    7: (0.212, 0.087),
    9: (0.2627, 0.0593),
}
RIGHT_ANGLES = [(a, b, c, d) for a, d in itertools.product((-1, 1), repeat=2) for b, c in [(0, 0)]] + [
    (0, b, c, 0) for b, c in itertools.product((-1, 1), repeat=2)
]


def rgb_frames(images: list[np.ndarray]) -> list[av.VideoFrame]:
    return [av.VideoFrame.from_ndarray(image, format="rgb24") for image in images]


def first(path: Path) -> tuple[np.ndarray, list[str]]:
    """The first frame and what is said about the video."""
    video = Video(path)
    frame = next(video.frames())
    assert frame.image.shape == (frame.height, frame.width, 3) and frame.image.dtype == np.uint8
    return frame.image, video.conversions()


@pytest.mark.parametrize("linear", RIGHT_ANGLES)
def test_all_eight_display_matrices(tmp_path, linear):
    """ISO/IEC 14496-12: a stored point (p, q) is shown at (a·p + c·q, b·p + d·q), moved to the origin."""
    write_video(tmp_path / "v.mp4", [asymmetric()] * 2, crf="1")
    with_display_matrix(tmp_path / "v.mp4", tmp_path / "turned.mp4", linear)
    (a, b, c, d), (height, width) = linear, (48, 64)
    q, p = np.indices((height, width))
    x, y = a * p + c * q, b * p + d * q
    expected = np.zeros((int(np.ptp(y)) + 1, int(np.ptp(x)) + 1, 3), np.uint8)
    expected[y - y.min(), x - x.min()] = asymmetric()
    found, said = first(tmp_path / "turned.mp4")
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < 4
    assert (said == []) == (linear == (1, 0, 0, 1))


@pytest.mark.parametrize("degrees", [30, 45, 88])
def test_other_angles_are_refused(tmp_path, degrees):
    write_video(tmp_path / "v.mp4", [asymmetric()] * 2)
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    with_display_matrix(tmp_path / "v.mp4", tmp_path / "turned.mp4", (cosine, sine, -sine, cosine))
    with pytest.raises(InputError, match=r"turned\.mp4: .*other than a right angle.*ffmpeg -i \S+turned\.mp4 -crf 12"):
        first(tmp_path / "turned.mp4")


@pytest.mark.parametrize(
    ("aspect", "size"),
    [(Fraction(64, 45), (256, 128)), (Fraction(1, 2), (180, 256)), (Fraction(1001, 1000), (180, 128))],
)
def test_pixel_aspect(tmp_path, aspect, size):
    """A wave in both directions, sampled again at the centers of square pixels; nearly square pixels are left alone."""

    def wave(width: int, height: int) -> np.ndarray:
        x, y = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height
        values = 120 + 50 * np.sin(9 * x)[None] + 50 * np.cos(7 * y)[:, None]
        return np.repeat(values.round().astype(np.uint8)[..., None], 3, axis=2)

    write_frames(
        tmp_path / "v.mkv", rgb_frames([wave(180, 128)]), "libx264rgb", {"qp": "0"}, sample_aspect_ratio=aspect
    )
    found, said = first(tmp_path / "v.mkv")
    assert found.shape == (size[1], size[0], 3)
    assert np.abs(found.astype(int) - wave(*size)).max() <= 3
    assert len(said) == (0 if size == (180, 128) else 1)


def test_pixel_aspect_of_a_turned_video(tmp_path):
    """Pixels twice as wide as high are twice as high as wide after a quarter turn."""
    images = [av.VideoFrame.from_ndarray(asymmetric(), format="rgb24").reformat(format="yuv420p")] * 2
    write_frames(tmp_path / "v.mp4", images, "libx264", {"crf": "1"}, sample_aspect_ratio=Fraction(2))
    with_display_matrix(tmp_path / "v.mp4", tmp_path / "turned.mp4", (0, 1, -1, 0))
    found, said = first(tmp_path / "turned.mp4")
    assert found.shape == (128, 48, 3) and len(said) == 2
    assert np.abs(found[::2].astype(int) - np.rot90(asymmetric(), -1)).mean() < 8


def test_impossible_pixels_are_refused(tmp_path):
    write_frames(tmp_path / "v.mkv", rgb_frames([asymmetric()]), "libx264rgb", sample_aspect_ratio=Fraction(20))
    with pytest.raises(InputError, match=r"pixels of 20:1.*setsar=1"):
        first(tmp_path / "v.mkv")


@pytest.mark.parametrize(("pixels", "bits"), [("yuv444p", 8), ("yuv444p10le", 10)])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("matrix", WEIGHTS)
def test_matrices_and_ranges(pixels, bits, full, matrix):
    """Y'CbCr of chosen colors, by BT.601, BT.709, BT.2020 and their ranges; swscale's own error is 3 levels."""
    colors = np.random.default_rng(2).uniform(0.15, 0.85, (3, 4, 3))
    frame = planar_frame(yuv_planes(patches(colors), *WEIGHTS[matrix], bits, full), pixels)
    frame.colorspace, frame.color_range = matrix, 2 if full else 1
    conversion = frame_conversion(Path("v"), frame, FrameColors(matrix, full, 1, 1), Fraction(1))
    assert np.abs(patch_values(conversion.image(frame)) - 255 * colors).max() <= 3.7
    assert (conversion.notes == ()) == (bits == 8)


def hdr_video(
    path: Path, signal: np.ndarray, transfer: int, codec: str = "ffv1", options: dict[str, str] | None = None
) -> None:
    frame = planar_frame(yuv_planes(signal, *WEIGHTS[9], 10, False), "yuv444p10le")
    write_frames(path, [frame], codec, options, color_trc=transfer, **BT2020)


@pytest.mark.parametrize("transfer", [16, 18])
def test_hdr_video(tmp_path, transfer):
    colors = np.random.default_rng(5).uniform(0.1, 0.75, (6, 8, 3))
    hdr_video(tmp_path / "v.mkv", patches(colors), transfer)
    found, said = first(tmp_path / "v.mkv")
    expected = np.array([[hdr_to_srgb(color, transfer) for color in row] for row in colors])
    # A level of 10 bits is up to three levels of 8 in saturated dark colors.
    error = np.abs(patch_values(found) - 255 * expected)
    assert error.mean() < 0.7 and error.max() < 6
    assert len(said) == 1 and "tone-mapped" in said[0] and ("HLG" in said[0]) == (transfer == 18)


def test_hdr_with_a_stated_peak(tmp_path):
    """MaxCLL of 203 cd/m²: nothing is compressed; reference white becomes white."""
    signal = np.full((64, 64, 3), pq_signal(203))
    options = {"x265-params": "log-level=none:hdr10=1:max-cll=203,100:lossless=1"}
    hdr_video(tmp_path / "v.mkv", signal, 16, "libx265", options)
    found, said = first(tmp_path / "v.mkv")
    assert found.min() >= 253 and "peak 203" in said[0]


def test_wide_gamut_without_hdr(tmp_path):
    """A color of BT.709 inside BT.2020: linear light through BT.2087's matrix."""
    matrix = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
    colors = np.random.default_rng(6).uniform(0.2, 0.9, (3, 4, 3))
    light = ((colors + 0.055) / 1.055) ** 2.4 @ matrix.T
    signal = 1.055 * light ** (1 / 2.4) - 0.055
    hdr_video(tmp_path / "v.mkv", patches(signal), 14)
    found, said = first(tmp_path / "v.mkv")
    assert np.abs(patch_values(found) - 255 * colors).max() < 4
    assert said == ["colors with BT.2020 primaries are converted to sRGB"]


@pytest.mark.parametrize(
    "tags",
    [{"colorspace": 14, "color_trc": 16}, {"colorspace": 1, "color_trc": 9}, {"colorspace": 1, "color_primaries": 10}],
)
def test_colors_that_cannot_be_converted_are_refused(tmp_path, tags):
    frame = planar_frame(yuv_planes(np.full((32, 32, 3), 0.5), *WEIGHTS[1], 8, False), "yuv444p")
    write_frames(tmp_path / "v.mkv", [frame], "ffv1", color_range=1, **tags)
    with pytest.raises(InputError, match=r"v\.mkv: the video states .*code point (14|9|10) .*zscale"):
        first(tmp_path / "v.mkv")


def test_dolby_vision_without_a_base_picture_is_refused():
    """No encoder here writes it: a frame such as PyAV gives for profile 5 stands in."""

    class SideData(list):
        get = staticmethod(lambda name: None)

    part = SimpleNamespace(type=SimpleNamespace(name="DOVI_METADATA"))
    frame = SimpleNamespace(width=64, height=48, side_data=SideData([part]), format=None)
    with pytest.raises(InputError, match=r"me\.mov: Dolby Vision .*export the video as SDR or HLG"):
        frame_conversion(Path("me.mov"), frame, FrameColors(2, True, 2, 2), Fraction(1))


def alpha_of(path: Path, expected: np.ndarray, tolerance: int) -> np.ndarray:
    video = Video(path)
    frames = list(video.frames())
    assert len(frames) == 3 and frames[0].alpha is not None
    assert np.abs(frames[0].alpha().astype(int) - expected).max() <= tolerance
    return frames[0].image


def rgba(width: int = 64, height: int = 48) -> np.ndarray:
    alpha = np.zeros((height, width, 1), np.uint8)
    alpha[16:32, 8:40] = 255
    alpha[40:, 48:] = 128
    return np.concatenate((asymmetric(width, height), alpha), axis=2)


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "tolerance"),
    [
        ("a.mov", "qtrle", "argb", 0),
        ("b.mov", "png", "rgba", 0),
        ("c.mov", "prores_ks", "yuva444p10le", 1),
        ("d.mkv", "ffv1", "yuva420p", 1),
    ],
)
def test_alpha_channels(tmp_path, name, codec, pixels, tolerance):
    frame = av.VideoFrame.from_ndarray(rgba(), format="rgba").reformat(format=pixels)
    write_frames(tmp_path / name, [frame] * 3, codec)
    image = alpha_of(tmp_path / name, rgba()[..., 3], tolerance)
    assert np.abs(image.astype(int) - rgba()[..., :3]).mean() < 4


@pytest.mark.parametrize("codec", ["libvpx", "libvpx-vp9"])
def test_alpha_of_webm(tmp_path, codec):
    """The alpha of WebM is a second stream, which only libvpx decodes."""
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV has no {codec}")
    frame = av.VideoFrame.from_ndarray(rgba(), format="rgba").reformat(format="yuva420p")
    options = {"auto-alt-ref": "0", "crf": "4", "b": "2M"}
    try:
        write_frames(tmp_path / "v.webm", [frame] * 3, codec, options)
    except (av.error.FFmpegError, ValueError):
        pytest.skip(f"this PyAV's {codec} cannot encode alpha")
    with av.open(str(tmp_path / "v.webm")) as container:
        if container.streams.video[0].metadata.get("alpha_mode") != "1":
            pytest.skip(f"this PyAV's {codec} encodes no alpha")
    image = alpha_of(tmp_path / "v.webm", rgba()[..., 3], 60)
    assert np.abs(image.astype(int) - rgba()[..., :3]).mean() < 8


def test_alpha_is_turned_like_the_image(tmp_path):
    frame = av.VideoFrame.from_ndarray(rgba(), format="rgba").reformat(format="argb")
    write_frames(tmp_path / "v.mov", [frame] * 3, "qtrle")
    with_display_matrix(tmp_path / "v.mov", tmp_path / "turned.mov", (0, 1, 1, 0))
    frame = next(Video(tmp_path / "turned.mov").frames())
    np.testing.assert_array_equal(frame.alpha(), rgba()[..., 3].T)
    np.testing.assert_array_equal(frame.image, rgba()[..., :3].transpose(1, 0, 2))


def h264(path: Path, image: np.ndarray, count: int) -> bytes:
    write_video(path, [image] * count, bf="0")
    return path.read_bytes()


def test_a_size_that_changes_midway_is_evened_out(tmp_path):
    """As recordings of web calls do: two streams with their own headers, one behind the other."""
    smooth = np.repeat(np.linspace(30, 220, 128)[None, :, None], 96, axis=0).repeat(3, axis=2).round().astype(np.uint8)
    parts = [h264(tmp_path / "a.h264", smooth, 5), h264(tmp_path / "b.h264", smooth[::2, ::2].copy(), 5)]
    (tmp_path / "v.h264").write_bytes(b"".join(parts))
    video = Video(tmp_path / "v.h264")
    images = [frame.image for frame in video.frames()]
    assert len(images) == 10 and {image.shape for image in images} == {(96, 128, 3)}
    assert np.abs(images[0].astype(int) - images[-1]).mean() < 4
    assert video.conversions() == [
        "frames of 64×48 px, from frame 5 on, are resampled to 128×96 px, the size of the first frame"
    ]


def test_a_shape_that_changes_midway_is_refused_and_the_advice_works(tmp_path):
    parts = [h264(tmp_path / "a.h264", asymmetric(128, 96), 5), h264(tmp_path / "b.h264", asymmetric(96, 128), 5)]
    (tmp_path / "v.h264").write_bytes(b"".join(parts))
    with pytest.raises(
        InputError, match=r"expected 128×96 px in every frame, found 96×128 px from frame 5 on.*--frames :5"
    ):
        list(Video(tmp_path / "v.h264").frames())
    kept = parse_selection(None, 0.0, None, ":5").keep(Video(tmp_path / "v.h264").frames())
    assert [frame.number for frame in kept] == [0, 1, 2, 3, 4]


def test_plain_video_says_nothing(tmp_path):
    write_video(tmp_path / "v.mp4", [asymmetric()] * 3)
    video = Video(tmp_path / "v.mp4")
    assert all(frame.alpha is None for frame in video.frames()) and video.conversions() == []
