"""Decoding. Reference: the images that were encoded, whose brightness is their number, and OpenCV."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from preprocess.video.decoding import Video
from preprocess.video.image_folder import ImageFolder
from preprocess.video.selection import Selection, parse_selection
from preprocess.video.sources import open_source
from tests.support.synthetic_clip import write_video


def numbered(count, width=64, height=48, step=4):
    """Images whose brightness tells their number, with a bright upper left corner."""
    images = []
    for number in range(count):
        image = np.full((height, width, 3), 20 + step * number, np.uint8)
        image[: height // 4, : width // 4] = 235
        images.append(image)
    return images


def seen(source, step=4):
    """Numbers, times and decoded numbers of all frames."""
    numbers, times, decoded = [], [], []
    for frame in source.frames():
        image = frame.image
        assert image.shape == (frame.height, frame.width, 3)
        numbers.append(frame.number)
        times.append(frame.time)
        decoded.append(round((float(image[-8:, -8:].mean()) - 20) / step))
    return numbers, times, decoded


def test_every_frame_in_order(tmp_path):
    write_video(tmp_path / "v.mp4", numbered(30), rate=25)
    numbers, times, decoded = seen(Video(tmp_path / "v.mp4"))
    assert numbers == decoded == list(range(30))
    np.testing.assert_allclose(times, np.arange(30) / 25, atol=1e-6)


@pytest.mark.parametrize("rate", [Fraction(30000, 1001), Fraction(24000, 1001), Fraction(50)])
def test_fractional_rates(tmp_path, rate):
    write_video(tmp_path / "v.mp4", numbered(20), rate=rate)
    numbers, times, _ = seen(Video(tmp_path / "v.mp4"))
    assert len(numbers) == 20
    np.testing.assert_allclose(times, np.arange(20) / float(rate), atol=1e-4)


def write_irregular(path, images, ticks):
    """A video with given presentation times in 1/1000 s."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = images[0].shape[1], images[0].shape[0], "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for image, tick in zip(images, ticks, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_silence(container, stream):
    frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
    frame.sample_rate, frame.pts = 44100, 0
    container.mux(stream.encode(frame))
    container.mux(stream.encode())


def test_variable_rate_keeps_every_frame_and_its_time(tmp_path):
    ticks = [0, 40, 80, 200, 240, 500, 540, 1000]
    write_irregular(tmp_path / "v.mp4", numbered(8), ticks)
    numbers, times, decoded = seen(Video(tmp_path / "v.mp4"))
    assert numbers == decoded == list(range(8))
    np.testing.assert_allclose(times, np.array(ticks) / 1000, atol=2e-3)


def test_audio_stream_first(tmp_path):
    path = tmp_path / "v.mkv"
    with av.open(str(path), "w") as container:
        audio = container.add_stream("aac", rate=44100)
        stream = container.add_stream("libx264", rate=25, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        write_silence(container, audio)
        for image in numbered(10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    with av.open(str(path)) as container:
        assert container.streams[0].type == "audio"
    assert seen(Video(path))[2] == list(range(10))


@pytest.mark.parametrize("size", [(63, 47), (33, 49)])
def test_odd_sizes(tmp_path, size):
    path = tmp_path / "v.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = *size, "bgr0"
        for image in numbered(5, *size):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    frames = list(Video(path).frames())
    assert [(frame.width, frame.height) for frame in frames] == [size] * 5
    np.testing.assert_array_equal(frames[3].image, numbered(5, *size)[3])


def with_rotation(source, target, degrees):
    """Copy an mp4 and write a rotation into its track header's matrix, as phones do."""
    data = bytearray(source.read_bytes())
    place = data.index(b"tkhd") + 4 + 40
    unit = 1 << 16
    matrix = {90: (0, unit, -unit, 0), 180: (-unit, 0, 0, -unit), 270: (0, -unit, unit, 0)}[degrees]
    for index, value in zip((0, 1, 3, 4), matrix, strict=True):
        data[place + 4 * index : place + 4 * index + 4] = value.to_bytes(4, "big", signed=True)
    target.write_bytes(data)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_rotation_metadata(tmp_path, degrees):
    """Reference: OpenCV, which turns images by itself."""
    import cv2

    write_video(tmp_path / "v.mp4", numbered(3))
    with_rotation(tmp_path / "v.mp4", tmp_path / "turned.mp4", degrees)
    frame = next(Video(tmp_path / "turned.mp4").frames())
    ok, expected = cv2.VideoCapture(str(tmp_path / "turned.mp4")).read()
    assert ok and frame.image.shape == expected.shape == ((64, 48, 3) if degrees != 180 else (48, 64, 3))
    assert np.abs(frame.image.astype(int) - expected[..., ::-1]).mean() < 3


def test_edit_list_that_lies_about_the_count(tmp_path):
    """A cut without re-encoding keeps frames before the first shown one; the stated count includes them."""
    write_video(tmp_path / "v.mp4", numbered(50), rate=25, g="50")
    with av.open(str(tmp_path / "v.mp4")) as source, av.open(str(tmp_path / "cut.mp4"), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for packet in source.demux(stream):
            if packet.dts is None:
                continue
            packet.pts -= round(0.4 / packet.time_base)
            packet.dts -= round(0.4 / packet.time_base)
            packet.stream = copy
            target.mux(packet)
    with av.open(str(tmp_path / "cut.mp4")) as container:
        stated = container.streams.video[0].frames
        shown = sum(1 for _ in container.decode(video=0))
    video = Video(tmp_path / "cut.mp4")
    numbers, times, _ = seen(video)
    assert len(numbers) == shown <= stated == 50
    assert times[0] == 0 and video.decode_errors() == []


def test_ten_bit_hevc(tmp_path):
    path = tmp_path / "v.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx265", rate=25, options={"crf": "8", "x265-params": "log-level=none"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p10le"
        for image in numbered(6, 64, 64, 30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    numbers, _, decoded = seen(Video(path), 30)
    assert numbers == decoded == list(range(6))


def test_interlaced_images_lose_their_combs(tmp_path):
    """A bright bar moves between the fields of a frame; after decoding, neighboring rows agree again."""
    path = tmp_path / "v.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg2video", rate=25, options={"flags": "+ildct+ilme", "b": "4M"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        graph = av.filter.Graph()
        source = graph.add_buffer(width=64, height=64, format="yuv420p", time_base=Fraction(1, 25))
        graph.link_nodes(source, graph.add("setfield", "tff"), graph.add("buffersink")).configure()
        for number in range(8):
            image = np.full((64, 64, 3), 40, np.uint8)
            image[0::2, 2 * number + 8 : 2 * number + 20] = 220
            image[1::2, 2 * number + 16 : 2 * number + 28] = 220
            frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            graph.push(frame)
            container.mux(stream.encode(graph.pull()))
        container.mux(stream.encode())
    with av.open(str(path)) as container:
        raw = [frame.to_ndarray(format="rgb24")[..., 1] for frame in container.decode(video=0)]
        flagged = container.streams.video[0]
        assert flagged.codec_context.name == "mpeg2video"
    comb = np.mean([np.abs(np.diff(image.astype(int), axis=0)).mean() for image in raw])
    frames = list(Video(path).frames())
    assert len(frames) == 8 and comb > 20
    left = np.mean([np.abs(np.diff(frame.image[..., 1].astype(int), axis=0)).mean() for frame in frames[2:6]])
    assert left < 0.5 * comb


def test_truncated_video_keeps_what_decodes_and_says_so(tmp_path):
    write_video(tmp_path / "v.mp4", numbered(50), rate=25, movflags="faststart", g="10")
    path = tmp_path / "whole.mkv"
    write_video(path, numbered(50), rate=25, g="10")
    data = path.read_bytes()
    (tmp_path / "cut.mkv").write_bytes(data[: len(data) * 3 // 5])
    video = Video(tmp_path / "cut.mkv")
    numbers, _, decoded = seen(video)
    assert 5 < len(numbers) < 50 and decoded[:-3] == numbers[:-3]
    assert (
        len(video.decode_errors()) == 1
        and "probably truncated" in video.decode_errors()[0]
        and str(len(numbers)) in video.decode_errors()[0]
    )
    whole = Video(path)
    assert len(seen(whole)[0]) == 50 and whole.decode_errors() == []


def test_truncated_mp4_without_index(tmp_path):
    write_video(tmp_path / "v.mp4", numbered(30))
    data = (tmp_path / "v.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"cut\.mp4: not a video that can be decoded, or truncated"):
        Video(tmp_path / "cut.mp4")


def test_audio_only(tmp_path):
    with av.open(str(tmp_path / "a.m4a"), "w") as container:
        write_silence(container, container.add_stream("aac", rate=44100))
    with pytest.raises(InputError, match=r"no video in this file, only audio"):
        Video(tmp_path / "a.m4a")


def test_playlists_are_no_videos(tmp_path):
    """Playlists and scripts could make a decoder open other files."""
    write_video(tmp_path / "v.mp4", numbered(3))
    (tmp_path / "p.m3u8").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nv.mp4\n#EXT-X-ENDLIST\n")
    (tmp_path / "c.txt").write_text("ffconcat version 1.0\nfile v.mp4\n")
    for name in ("p.m3u8", "c.txt"):
        with pytest.raises(InputError, match="not a video"):
            Video(tmp_path / name)


def test_selection():
    frames = [(number, number / 25) for number in range(100)]

    class Given:
        def frames(self):
            from preprocess.video.frame import DecodedFrame

            for number, time in frames:
                yield DecodedFrame(number, time, 4, 4, lambda: np.zeros((4, 4, 3), np.uint8))

    def kept(*arguments):
        return [frame.number for frame in parse_selection(*arguments).keep(Given().frames())]

    assert kept(None, 0.0, None, ":") == list(range(100))
    assert kept(None, 0.0, None, "10:20:3") == [10, 13, 16, 19]
    assert kept(None, 1.0, 2.0, ":") == list(range(25, 51))
    assert kept(5.0, 0.0, None, ":") == list(range(0, 100, 5))
    assert kept(25.0, 0.0, None, ":") == list(range(100))
    assert len(kept(10.0, 0.0, None, ":")) == 40
    assert kept(60.0, 0.0, None, ":20") == list(range(20))
    assert Selection().numbers == slice(None)


@pytest.mark.parametrize(
    "arguments",
    [
        (0.0, 0.0, None, ":"),
        (None, -1.0, None, ":"),
        (None, 2.0, 1.0, ":"),
        (None, 0.0, None, "1:2:0"),
        (None, 0.0, None, "x"),
    ],
)
def test_senseless_selections(arguments):
    with pytest.raises(InputError, match="--"):
        parse_selection(*arguments)


def test_image_folders(tmp_path):
    for number, image in enumerate(numbered(12), start=1):
        write_png(tmp_path / f"{number}.png", image)
    (tmp_path / "notes.txt").write_text("x")
    folder = ImageFolder(tmp_path, 10.0)
    numbers, times, decoded = seen(folder)
    assert numbers == list(range(1, 13)) and decoded == list(range(12)), "by number, not by spelling"
    assert times[-1] == pytest.approx(1.1)
    write_png(tmp_path / "13.png", numbered(1, 32, 32)[0])
    with pytest.raises(InputError, match=r"13\.png: expected 64×48 px"):
        seen(ImageFolder(tmp_path, 10.0))


def test_nothing_there(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        open_source(tmp_path / "absent.mp4")
    with pytest.raises(InputError, match="no images"):
        open_source(tmp_path)
    (tmp_path / "empty.mp4").write_bytes(b"")
    with pytest.raises(InputError, match="not a video"):
        open_source(tmp_path / "empty.mp4")


def test_real_clips_have_the_right_number_of_frames(data_folder):
    """Reference: the list that comes with the clips."""
    counts = {"greenscreen_512": 78, "wide_700": 135, "longhair_512": 448}
    for name, count in counts.items():
        video = Video(data_folder / "clips" / f"{name}.mp4")
        assert sum(1 for _ in video.frames()) == count
        assert video.decode_errors() == []
