"""Exact, streaming video decoding with PyAV: every frame in order, upright sRGB, with its timestamp."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.images import MAX_PIXELS
from ggavatar.io.regular_files import open_regular
from preprocess.video.alpha_stream import alpha_decoder, has_alpha
from preprocess.video.frame import DecodedFrame
from preprocess.video.frame_conversion import (
    FrameColors,
    FrameConversion,
    frame_colors,
    frame_conversion,
    stated_peak,
)

# Containers only: playlists and concatenation scripts could make the decoder open other files or URLs.
_CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,flv,ogg,asf,mxf,gif,ivf,h264,hevc,m4v,nut"

_SHAPE_TOLERANCE = 0.01
"""Deviation of width by height that a video may show when its size changes midway."""


class Video:
    """One video file. We open it ourselves, so the decoder uses no protocol other than reading that file.

    Raises:
        InputError: Not a video that can be decoded, or larger than the limit.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._decode_errors: list[str] = []
        self._conversions: list[str] = []
        with open_regular(path, "a video") as file, self._container(file) as container:
            self._stream(container)

    def _container(self, file: Any) -> Any:
        try:
            return av.open(file, options={"format_whitelist": _CONTAINERS})
        except (av.error.FFmpegError, ValueError, OSError) as error:
            raise InputError(
                f"{self.path}: not a video that can be decoded, or truncated before its index ({_error_text(error)}); "
                "copy it again or convert it with ffmpeg"
            ) from error

    def _stream(self, container: Any) -> Any:
        """The first video stream that is not cover art, after checking its size."""
        streams = [stream for stream in container.streams.video if not _is_cover(stream)]
        if not streams:
            kinds = sorted({stream.type for stream in container.streams}) or ["nothing"]
            raise InputError(
                f"{self.path}: no video in this file, only {', '.join(kinds)}; give a file with a video stream"
            )
        context = streams[0].codec_context
        if context is None:
            raise InputError(f"{self.path}: unknown codec; convert the video to H.264 with ffmpeg")
        if context.width * context.height > MAX_PIXELS:
            raise InputError(
                f"{self.path}: expected at most {MAX_PIXELS // 1_000_000} megapixels, found "
                f"{context.width}×{context.height} px; scale the video down with ffmpeg"
            )
        return streams[0]

    def frames(self) -> Iterator[DecodedFrame]:
        """Decode from the first frame on; damaged parts are skipped and counted (see `decode_errors`).

        Raises:
            InputError: Frames that cannot be made upright sRGB, or whose shape changes within the video.
        """
        self._decode_errors, self._conversions = [], []
        with open_regular(self.path, "a video") as file, self._container(file) as container:
            stream = self._stream(container)
            stream.thread_type = "AUTO"
            kinds = _FrameKinds(self.path, stream, self._conversions)
            number, zero, last = 0, None, 0.0
            for frame in self._deinterlaced(self._decoded(container, stream)):
                seconds = frame.time if frame.time is not None else number / float(stream.average_rate or 25)
                zero = seconds if zero is None else zero
                kind, size = kinds.of(frame, number)
                last = seconds
                alpha = partial(_at_size, kind.alpha, frame, size) if has_alpha(frame) else None
                yield DecodedFrame(number, seconds - zero, *size, partial(_at_size, kind.image, frame, size), alpha)
                number += 1
            self._compare_length(container, stream, number, last)

    def _decoded(self, container: Any, stream: Any) -> Iterator[Any]:
        """Frames of all packets; a damaged packet costs only its own frame."""
        damaged, decoder = 0, self._alpha_decoder(stream)
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                break
            except (av.error.FFmpegError, ValueError) as error:
                self._decode_errors.append(f"reading stopped early: {_error_text(error)}")
                break
            try:
                yield from packet.decode() if decoder is None else decoder.decode(packet)
            except (av.error.FFmpegError, ValueError):
                damaged += 1
        if damaged:
            self._decode_errors.append(f"{damaged} damaged packets were skipped")

    def _alpha_decoder(self, stream: Any) -> Any:
        """The decoder that gives the stream's alpha, if the usual one does not."""
        try:
            return alpha_decoder(stream)
        except ValueError as error:
            self._conversions.append(f"{error}; it is ignored")
            return None

    def _deinterlaced(self, frames: Iterator[Any]) -> Iterator[Any]:
        """Deinterlaced frames; progressive frames pass unchanged."""
        graph: Any = None
        kind = None
        for frame in frames:
            if graph is None and not frame.interlaced_frame:
                yield frame
                continue
            if graph is None:
                self._conversions.append("interlaced frames are deinterlaced (bwdif)")
            if kind != (kind := (frame.format.name, frame.width, frame.height)):
                if graph is not None:
                    yield from _drained(graph)
                graph = _field_filter(frame)
            graph.push(frame)
            yield from _pulled(graph)
        if graph is not None:
            yield from _drained(graph)

    def _compare_length(self, container: Any, stream: Any, count: int, last: float) -> None:
        """Record an error if the stream ends before its stated duration; edit lists falsify stated frame counts."""
        stated = _stated_seconds(container, stream)
        if stated is None or count == 0:
            return
        start, step = float((stream.start_time or 0) * stream.time_base), 1 / float(stream.average_rate or 25)
        missing = start + stated - (last + step)
        if missing > max(0.5, 2.5 * step):
            self._decode_errors.append(
                f"expected {stated:.1f} s of video as the file states, but it ends {missing:.1f} s earlier after "
                f"{count} frames; it is probably truncated"
            )

    def decode_errors(self) -> list[str]:
        """Descriptions of what could not be decoded; complete once `frames` is exhausted."""
        return list(self._decode_errors)

    def conversions(self) -> list[str]:
        """What was found and done to bring frames to upright 8-bit sRGB; complete once `frames` is exhausted."""
        return list(self._conversions)


def _stated_seconds(container: Any, stream: Any) -> float | None:
    """The stated duration of the video stream, s; Matroska stores it in a tag, or only for the whole file."""
    if stream.duration:
        return float(stream.duration * stream.time_base)
    tag = re.fullmatch(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    if tag:
        return 3600 * int(tag[1]) + 60 * int(tag[2]) + float(tag[3])
    alone = all(other.type == "video" for other in container.streams)
    return container.duration / 1e6 if container.duration and alone else None


def _is_cover(stream: Any) -> bool:
    """Whether a stream is cover art, a single attached image."""
    return bool(stream.disposition & av.stream.Disposition.attached_pic)


class _FrameKinds:
    """The conversions of a video's frames; made once for every kind of frame, and noted once."""

    def __init__(self, path: Path, stream: Any, notes: list[str]) -> None:
        self._path, self._stream, self._notes = path, stream, notes
        self._known: dict[Any, FrameConversion] = {}
        self._size: tuple[int, int] | None = None
        self._peak: float | None = None

    def of(self, frame: Any, number: int) -> tuple[FrameConversion, tuple[int, int]]:
        """The conversion of a frame, and the size of the whole video: that of its first frame.

        Raises:
            InputError: A frame that cannot be converted, or of another shape than the first.
        """
        colors = frame_colors(frame, self._stream.codec_context)
        aspect = Fraction(self._stream.sample_aspect_ratio or 1)
        # Side data is read only for a new kind of frame: PyAV keeps every frame whose side data was looked at alive
        # until the next garbage collection, which costs 40 % of the decoding speed.
        key = (frame.format.name, frame.width, frame.height, getattr(frame, "rotation", 0), colors, aspect)
        if key not in self._known:
            self._known[key] = self._new(frame, number, colors, aspect)
        return self._known[key], self._size or self._known[key].size

    def _new(self, frame: Any, number: int, colors: FrameColors, aspect: Fraction) -> FrameConversion:
        # The peak may be stated anew in every scene; the curve must not change.
        self._peak = self._peak or stated_peak(frame)
        kind = frame_conversion(self._path, frame, colors, aspect, self._peak)
        self._size = self._size or kind.size
        (width, height), (first_width, first_height) = kind.size, self._size
        notes = list(kind.notes)
        if abs(width * first_height - height * first_width) > _SHAPE_TOLERANCE * width * first_height:
            raise InputError(
                f"{self._path}: expected {first_width}×{first_height} px in every frame, found {width}×{height} px "
                f"from frame {number} on; keep what comes before with --frames :{number}"
            )
        if kind.size != self._size:
            notes.append(
                f"frames of {width}×{height} px, from frame {number} on, are resampled to "
                f"{first_width}×{first_height} px, the size of the first frame"
            )
        self._notes.extend(note for note in notes if note not in self._notes)
        return kind


def _at_size(convert: Callable[[Any], np.ndarray], frame: Any, size: tuple[int, int]) -> np.ndarray:
    """A converted frame, resampled where the video changes its size."""
    image = convert(frame)
    if image.shape[1::-1] == size:
        return image
    import cv2

    shrinking = size[0] < image.shape[1]
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LANCZOS4)


def _field_filter(frame: Any) -> Any:
    """A filter graph that gives one frame per frame and changes only those marked as interlaced."""
    graph = av.filter.Graph()
    graph.link_nodes(
        graph.add_buffer(width=frame.width, height=frame.height, format=frame.format.name, time_base=frame.time_base),
        graph.add("bwdif", "mode=send_frame:deint=interlaced"),
        graph.add("buffersink"),
    ).configure()
    return graph


def _drained(graph: Any) -> Iterator[Any]:
    graph.push(None)
    yield from _pulled(graph)


def _pulled(graph: Any) -> Iterator[Any]:
    while True:
        try:
            yield graph.pull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return


def _error_text(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error)
