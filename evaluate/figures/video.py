"""H.264 video from 8-bit images, and the side-by-side video of an evaluation."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from jaxtyping import UInt8

from evaluate.figures.contact_sheet import font_size
from evaluate.figures.error_map import error_colors, shared_limit
from evaluate.figures.text import MUTED_COLOR, TEXT_COLOR, text_band
from evaluate.metrics.pixels import absolute_error, psnr
from evaluate.scoring.frame_files import common_frames, frame_files
from ggavatar.errors import InputError
from ggavatar.io.atomic import partial_file
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import read_rgb

CRF = 18
ENCODER = {"preset": "veryfast", "x264-params": "mbtree=0"}
"""Options of x264. Its macroblock tree reads memory that it has not written, with sizes such as 192×108 and 96×96: two
calls of a command would then write different videos of the same images."""


@contextlib.contextmanager
def video_writer(path: Path, fps: float, crf: int = CRF) -> Iterator[Callable[[np.ndarray], None]]:
    """Open a video; yields a function that appends 8-bit RGB images of one size.

    H.264, 4:2:0, BT.709, playable in browsers; odd sizes are padded by repeating the last row or column. The file
    appears under its name once complete; an exception leaves nothing behind.

    Args:
        path: File to write, .mp4.
        fps: Frames per second.
        crf: Quality, 0 (lossless) to 51; 18 is visually lossless.
    """
    make_folder(path.parent)
    partial = partial_file(path)
    try:
        with av.open(str(partial), "w", format="mp4", options={"movflags": "faststart"}) as container:
            stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
            stream.options = {**ENCODER, "crf": str(crf)}
            stream.pix_fmt = "yuv420p"
            count = 0

            def append(image: np.ndarray) -> None:
                nonlocal count
                if count == 0:
                    _describe(
                        stream.codec_context, image.shape[1] + image.shape[1] % 2, image.shape[0] + image.shape[0] % 2
                    )
                container.mux(stream.encode(_converted(image, count)))
                count += 1

            yield append
            if count:
                container.mux(stream.encode(None))
        if not count:
            raise InputError(f"{path}: expected at least one image for the video, found none")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _describe(context: av.VideoCodecContext, width: int, height: int) -> None:
    """Set size and color metadata, so that players convert back with the matrix that was used."""
    context.width, context.height = width, height
    context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
    context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.IEC61966_2_1


def _converted(image: UInt8[np.ndarray, "H W 3"], index: int) -> av.VideoFrame:
    even = cv2.copyMakeBorder(image, 0, image.shape[0] % 2, 0, image.shape[1] % 2, cv2.BORDER_REPLICATE)
    frame = av.VideoFrame.from_ndarray(even, format="rgb24").reformat(
        format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
    )
    frame.pts = index
    return frame


def playback_fps(frames: Sequence[int], fps: float) -> float:
    """Playback rate of a split: that of the source if its frames are consecutive, else at most 4 frames per second."""
    steps = np.diff(sorted(frames))
    return fps if len(steps) and np.median(steps) == 1 else min(fps, 4.0)


def write_side_by_side(
    path: Path,
    predictions: Path,
    truth: Path,
    fps: float = 25.0,
    name: str = "Prediction",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write ground truth, prediction and error side by side, with frame number and PSNR, for all common frames.

    Args:
        path: File to write, .mp4.
        predictions: Folder of predictions.
        truth: Folder of ground truth.
        fps: Frame rate of the source; a split with gaps plays slower (`playback_fps`).
        name: Heading of the predictions.
        progress: Called with (done, total) after every frame.
    """
    frames = common_frames([predictions, truth])
    predicted, truths = frame_files(predictions), frame_files(truth)
    sampled = frames[:: max(1, len(frames) // 20)]
    limit = shared_limit(absolute_error(read_rgb(predicted[frame]), read_rgb(truths[frame])) for frame in sampled)
    with video_writer(path, playback_fps(frames, fps)) as append:
        for done, frame in enumerate(frames, start=1):
            append(_panel(frame, read_rgb(predicted[frame]), read_rgb(truths[frame]), name, limit))
            if progress:
                progress(done, len(frames))


def _panel(
    frame: int, prediction: np.ndarray, truth: np.ndarray, name: str, limit: float
) -> UInt8[np.ndarray, "H W 3"]:
    """One frame of the video: headings, three images, captions."""
    errors = error_colors(absolute_error(prediction, truth), limit)
    images = np.concatenate((truth, prediction, errors), axis=1)
    widths, size = [truth.shape[1]] * 3, font_size(truth.shape[1])
    head = text_band(["Ground truth", name, f"Error, 0 to {limit:g}"], widths, size, TEXT_COLOR, bold=True)
    quality = psnr(prediction, truth)
    foot = text_band(
        [f"frame {frame}", "identical" if np.isinf(quality) else f"{quality:.2f} dB", ""],
        widths,
        size * 0.85,
        MUTED_COLOR,
    )
    return np.concatenate((head, images, foot))
