"""Exact, streaming video decoding with PyAV: every frame, upright, in presentation order, with its timestamp."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.images import MAX_PIXELS
from preprocess.video.frame import DecodedFrame

# Containers only: playlists and concatenation scripts could make the decoder open other files or URLs.
_CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,flv,ogg,asf,mxf,gif,ivf,h264,hevc,m4v,nut"


class Video:
    """One video file. We open it ourselves, so the decoder uses no protocol other than reading that file.

    Raises:
        InputError: Not a video that can be decoded, or larger than the limit.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._decode_errors: list[str] = []
        with path.open("rb") as file, self._container(file) as container:
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
            InputError: The frame size changes within the video.
        """
        self._decode_errors = []
        with self.path.open("rb") as file, self._container(file) as container:
            stream = self._stream(container)
            stream.thread_type = "AUTO"
            number, zero, size, last = 0, None, None, 0.0
            for frame in _deinterlaced(stream, self._decoded(container, stream)):
                seconds = frame.time if frame.time is not None else number / float(stream.average_rate or 25)
                zero = seconds if zero is None else zero
                width, height = _upright_size(frame)
                size = size or (width, height)
                if (width, height) != size:
                    raise InputError(
                        f"{self.path}: expected {size[0]}×{size[1]} px in every frame, found {width}×{height} px in "
                        f"frame {number}; cut the video there"
                    )
                last = seconds
                yield DecodedFrame(number, seconds - zero, width, height, partial(_upright, frame))
                number += 1
            self._compare_length(container, stream, number, last)

    def _decoded(self, container: Any, stream: Any) -> Iterator[Any]:
        """Frames of all packets; a damaged packet costs only its own frame."""
        damaged = 0
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
                yield from packet.decode()
            except (av.error.FFmpegError, ValueError):
                damaged += 1
        if damaged:
            self._decode_errors.append(f"{damaged} damaged packets were skipped")

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


def _upright(frame: Any) -> np.ndarray:
    """8-bit RGB, rotated as the container's metadata states."""
    image = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(image, round(frame.rotation / 90) % 4))


def _upright_size(frame: Any) -> tuple[int, int]:
    """Width and height after rotation."""
    turned = round(frame.rotation / 90) % 2
    return (frame.height, frame.width) if turned else (frame.width, frame.height)


def _deinterlaced(stream: Any, frames: Iterator[Any]) -> Iterator[Any]:
    """Deinterlaced frames; progressive frames pass unchanged."""
    graph = None
    for frame in frames:
        if graph is None and not frame.interlaced_frame:
            yield frame
            continue
        graph = graph or _field_filter(stream)
        graph.push(frame)
        yield from _pulled(graph)
    if graph is not None:
        graph.push(None)
        yield from _pulled(graph)


def _field_filter(stream: Any) -> Any:
    """A filter graph that gives one frame per frame and changes only those marked as interlaced."""
    graph = av.filter.Graph()
    graph.link_nodes(
        graph.add_buffer(template=stream),
        graph.add("bwdif", "mode=send_frame:deint=interlaced"),
        graph.add("buffersink"),
    ).configure()
    return graph


def _pulled(graph: Any) -> Iterator[Any]:
    while True:
        try:
            yield graph.pull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return


def _error_text(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error)
