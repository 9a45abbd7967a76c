"""The demo folder: video, mattes and tracking, and a manifest of the files so that only they are ever replaced."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.io.atomic import is_partial, partial_file, remove_partial_files
from ggavatar.io.folder_lock import is_lock_file
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import write_png
from ggavatar.io.json_files import read_json, write_json

MANIFEST, VIDEO = "demo.json", "video.mp4"


class DemoFolder:
    """Writer of one demo; a context manager, which completes the video if nothing fails."""

    def __init__(self, folder: Path, size: int, fps: int) -> None:
        self.folder = folder
        for name in ("tracking", "masks"):
            make_folder(folder / name)
        partial = str(partial_file(folder / VIDEO))
        self._video = av.open(partial, "w", format="mp4", options={"movflags": "+faststart"})
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
        partial = partial_file(self.folder / VIDEO)
        try:
            for packet in self._stream.encode():
                self._video.mux(packet)
            self._video.close()
            if kind is None:
                partial.replace(self.folder / VIDEO)
        finally:
            partial.unlink(missing_ok=True)

    def add(self, index: int, image: UInt8[ndarray, "H W 3"], alpha: Float[ndarray, "H W"]) -> None:
        """Append one frame to the video and write its matte."""
        frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        frame.pts = index
        for packet in self._stream.encode(frame):
            self._video.mux(packet)
        write_png(self.mask(index), np.round(np.clip(alpha, 0, 1) * 255).astype(np.uint8))

    def mask(self, index: int) -> Path:
        """Path of a frame's matte."""
        return self.folder / "masks" / f"{index:05d}.png"

    def tracking(self, index: int) -> Path:
        """Path of a frame's tracking file."""
        return self.folder / "tracking" / f"{index:05d}.frame"


def prepare_demo_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that a demo may be written to the folder, then delete the files of an earlier or unfinished demo there.

    Only files that the manifest lists are deleted. An unfinished demo is replaced without `overwrite`.

    Raises:
        InputError: The path is not a folder, contains files without a manifest, or a demo and `overwrite` is false.
    """
    check_demo_folder(folder, overwrite=overwrite)
    for name in _listed(folder):
        path = folder / name
        if name != MANIFEST and path.resolve().is_relative_to(folder.resolve()) and path.is_file():
            path.unlink()
    remove_partial_files(folder, folder / "masks", folder / "tracking")


def check_demo_folder(folder: Path, *, overwrite: bool) -> None:
    """The checks of `prepare_demo_folder`; nothing is changed."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the demo, found a file; choose another path with -o")
    entries = list(folder.iterdir()) if folder.exists() else []
    others = [path for path in entries if not is_lock_file(path) and not is_partial(path)]
    if not others:
        return
    manifest = _manifest(folder)
    if not manifest:
        raise InputError(
            f"{folder}: expected a new or empty folder, or a demo, found other files ({min(others).name}); choose "
            "another with -o"
        )
    if manifest.get("complete", True) and not overwrite:
        raise InputError(
            f"{folder}: expected a new or empty folder, found a demo; choose another with -o or pass --overwrite"
        )


def _listed(folder: Path) -> list[str]:
    """The files that the manifest lists."""
    files = _manifest(folder).get("files")
    return [name for name in files if isinstance(name, str)] if isinstance(files, list) else []


def _manifest(folder: Path) -> dict[str, Any]:
    """The manifest; empty if there is none."""
    return read_json(folder / MANIFEST) if (folder / MANIFEST).is_file() else {}


def write_manifest(folder: Path, settings: Mapping[str, Any], frames: int, *, complete: bool) -> None:
    """Write the manifest: the files of this demo, its settings, and whether all of the files are there."""
    files = [VIDEO, "head.npz", "truth.npz", "README.txt", MANIFEST]
    files += [f"masks/{k:05d}.png" for k in range(frames)] + [f"tracking/{k:05d}.frame" for k in range(frames)]
    write_json(folder / MANIFEST, {"settings": dict(settings), "files": files, "complete": complete})
