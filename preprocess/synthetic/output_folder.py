"""The demo folder: video, mattes and tracking, and a manifest of the files so that only they are ever replaced."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.io.json_files import read_json, write_json

MANIFEST = "demo.json"


class DemoFolder:
    """Writer of one demo; a context manager, which completes the video on exit."""

    def __init__(self, folder: Path, size: int, fps: int) -> None:
        self.folder = folder
        for name in ("tracking", "masks"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        self._video = av.open(str(folder / "video.mp4"), "w", options={"movflags": "+faststart"})
        self._stream = self._video.add_stream("libx264", rate=Fraction(fps))
        self._stream.width = self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.thread_count = 1
        self._stream.options = {
            "crf": "11",
            "preset": "medium",
            "x264-params": "colorprim=bt709:transfer=bt709:colormatrix=bt709",
        }
        self._stream.codec_context.color_range = 1
        self._stream.codec_context.colorspace = 1

    def __enter__(self) -> DemoFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for packet in self._stream.encode():
            self._video.mux(packet)
        self._video.close()

    def add(self, index: int, image: UInt8[ndarray, "H W 3"], alpha: Float[ndarray, "H W"]) -> None:
        """Append one frame to the video and write its matte."""
        frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        frame.pts = index
        for packet in self._stream.encode(frame):
            self._video.mux(packet)
        path = self.mask(index)
        if not cv2.imwrite(str(path), np.round(np.clip(alpha, 0, 1) * 255).astype(np.uint8)):
            raise OSError(f"could not write {path}")

    def mask(self, index: int) -> Path:
        """Path of a frame's matte."""
        return self.folder / "masks" / f"{index:05d}.png"

    def tracking(self, index: int) -> Path:
        """Path of a frame's tracking file."""
        return self.folder / "tracking" / f"{index:05d}.frame"


def prepare_demo_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that a demo may be written to the folder; with `overwrite`, first delete an earlier demo's files.

    Only files that the manifest lists are deleted.

    Raises:
        InputError: The path is not a folder, or the folder contains files and `overwrite` is false.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the demo, found a file; choose another path with -o")
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not overwrite:
        raise InputError(
            f"{folder}: expected a new or empty folder, found files; choose another with -o or pass --overwrite"
        )
    listed = folder / MANIFEST
    names = read_json(listed).get("files", []) if listed.is_file() else []
    for name in names:
        path = folder / name
        if path.resolve().is_relative_to(folder.resolve()) and path.is_file():
            path.unlink()


def write_manifest(folder: Path, settings: dict, frames: int) -> None:
    """Write the manifest: the files of this demo and its settings."""
    files = ["video.mp4", "head.npz", "truth.npz", "README.txt", MANIFEST]
    files += [f"masks/{k:05d}.png" for k in range(frames)] + [f"tracking/{k:05d}.frame" for k in range(frames)]
    write_json(folder / MANIFEST, {"settings": settings, "files": files})
