"""Alpha channels of videos: decoders that give one, and frames that have one."""

from __future__ import annotations

from typing import Any

import av

_LIBVPX = {"vp8": "libvpx", "vp9": "libvpx-vp9"}
"""Decoders of WebM's alpha, which is a second stream beside each frame; ffmpeg's own decoders ignore it."""


def alpha_decoder(stream: Any) -> Any:
    """A decoder that gives the alpha of a VP8 or VP9 stream; None where the usual decoder gives what there is.

    Raises:
        ValueError: The stream has alpha, and this build of PyAV lacks the decoder.
    """
    wanted = _LIBVPX.get(stream.codec_context.name)
    if wanted is None or stream.metadata.get("alpha_mode") != "1":
        return None
    try:
        decoder = av.CodecContext.create(wanted, "r")
    except (av.error.FFmpegError, ValueError) as error:
        raise ValueError(f"the alpha channel needs the decoder {wanted}, which this PyAV lacks") from error
    decoder.thread_type = "AUTO"
    return decoder


def has_alpha(frame: Any) -> bool:
    """Whether a frame has an alpha channel; the palettes of GIFs are decoded with one."""
    return any(component.is_alpha for component in frame.format.components)
