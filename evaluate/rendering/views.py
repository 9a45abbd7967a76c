"""Renders a sequence of views to a folder: numbered PNG, straight-alpha PNG, a video and a record of the settings."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from evaluate.figures.video import video_writer
from evaluate.scoring.frame_files import frame_file
from ggavatar.core import Avatar, Camera, Drive, Rasterizer
from ggavatar.data.background import Color
from ggavatar.errors import InputError
from ggavatar.io.atomic import is_partial, remove_partial_files, write_atomically
from ggavatar.io.folder_lock import is_lock_file, lock_folder
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import read_rgb, write_png
from ggavatar.io.json_files import read_json, write_json
from ggavatar.io.ordered_map import ordered_map
from ggavatar.pictures.quantization import to_8_bit

RECORD, VIDEO, FRAMES, RGBA = "render.json", "render.mp4", "frames", "rgba"
ORBIT_FIGURE, DRIVE_FIGURE = FIGURES = "novel_views.png", "reenactment.png"
BATCH = 8
"""Largest number of images in memory: one thread renders while another encodes."""


class View(NamedTuple):
    """One image to render; `number` names its file."""

    number: int
    drive: Drive
    camera: Camera


class RenderedView(NamedTuple):
    """A rendered image on its way to the encoder; `is_new` unless it was read from an earlier call's file."""

    number: int
    image: UInt8[np.ndarray, "H W 3"]
    rgba: UInt8[np.ndarray, "H W 4"] | None = None
    is_new: bool = True


@dataclass(frozen=True)
class Output:
    """Where and what to write.

    Attributes:
        folder: Output folder; created if missing.
        background: sRGB in [0, 1], behind frames and video.
        fps: Frames per second of the video; None for no video.
        alpha: Also write RGBA images with straight alpha.
    """

    folder: Path
    background: Color = (1.0, 1.0, 1.0)
    fps: float | None = 25.0
    alpha: bool = False


@contextlib.contextmanager
def claimed_folder(output: Output, content: dict[str, Any], overwrite: bool, resume: bool) -> Iterator[None]:
    """Hold the output folder: new or empty, or one of an earlier call that may be overwritten or resumed.

    Only files that an earlier call wrote are deleted. A call that has left no image is as good as none.

    Args:
        output: The folder.
        content: Everything that determines the images, as plain values.
        overwrite: Replace earlier images.
        resume: Keep earlier images of the same content.

    Raises:
        InputError: The folder contains earlier output and neither flag is set, output of other options and `resume` is
            set, or other files; `resume` is set and there is nothing; or another process is writing into it.
    """
    wanted = {"schema": "ggavatar-render", "version": 1, "key": _key(content), **content}
    _check_folder(output.folder, wanted["key"], overwrite, resume)
    make_folder(output.folder)
    with lock_folder(output.folder):
        _check_folder(output.folder, wanted["key"], overwrite, resume)  # again: the lock may have been another's
        if not resume:
            _remove_own_files(output.folder)
        remove_partial_files(output.folder, *(output.folder / name for name in (FRAMES, RGBA)))
        write_json(output.folder / RECORD, wanted)  # replaced, never removed: it says that the folder is ours
        yield


def _check_folder(folder: Path, key: str, overwrite: bool, resume: bool) -> None:
    """The checks of `claimed_folder`; nothing is changed."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder to render into, found a file; choose another with -o")
    entries = list(folder.iterdir()) if folder.exists() else []
    if resume and not entries:
        raise InputError(f"{folder}: --resume found nothing to continue here; check -o, or omit --resume to start")
    record = folder / RECORD
    if not record.is_file():
        others = [path for path in entries if not is_lock_file(path) and not is_partial(path)]
        if others:
            raise InputError(
                f"{folder}: expected a new or empty folder, found other files ({min(others).name}); choose another "
                "with -o"
            )
        return
    if not (overwrite or resume) and _own_files(folder):
        raise InputError(
            f"{folder}: exists; pass --resume to continue, --overwrite to start over, or choose another -o"
        )
    if resume and _read_key(record) != key:
        raise InputError(
            f"{record}: was written with other options, or from a run or a capture that has changed since; pass "
            "--overwrite to start over, or choose another -o"
        )


def method_of_output(folder: Path) -> str:
    """The method of an output folder; `InputError` if ggavatar-render did not write it."""
    try:
        return str(read_json(folder / RECORD)["method"])
    except (InputError, KeyError) as error:
        raise InputError(
            f"{folder}: expected an output folder of ggavatar-render, found another one ({error})"
        ) from error


def _key(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _read_key(record: Path) -> object:
    """The key of a record; None if the file is damaged."""
    try:
        return read_json(record).get("key")
    except InputError:
        return None


def _own_files(folder: Path) -> list[Path]:
    """What earlier calls have written, besides the record."""
    numbered = [path for name in (FRAMES, RGBA) for path in (folder / name).glob("[0-9]" * 6 + ".png")]
    named = [path for name in (*FIGURES, VIDEO) if (path := folder / name).is_file()]
    return [*numbered, *named]


def _remove_own_files(folder: Path) -> None:
    for path in _own_files(folder):
        path.unlink(missing_ok=True)


def render_views(
    avatar: Avatar,
    rasterize: Rasterizer,
    views: Sequence[View],
    output: Output,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Render every view; those whose files exist are read instead, so an interrupted call can be resumed.

    Args:
        avatar: Poses the Gaussians.
        rasterize: Renders the Gaussians.
        views: Views in the order of the video.
        output: Folder, background, video and alpha.
        progress: Called with (done, total) after every view that is written.
    """
    with contextlib.ExitStack() as stack:
        append = None
        if output.fps is not None:
            append = stack.enter_context(video_writer(output.folder / VIDEO, output.fps))
        rendered = _rendered(avatar, rasterize, views, output)
        # A single encoding thread, since the frames of a video must arrive in order.
        written = ordered_map(lambda view: _write(view, output, append), rendered, threads=1, ahead=BATCH - 1)
        stack.enter_context(contextlib.closing(written))  # the encoder has stopped before the video is closed
        for done, _ in enumerate(written, start=1):
            if progress:
                progress(done, len(views))


def _rendered(avatar: Avatar, rasterize: Rasterizer, views: Sequence[View], output: Output) -> Iterator[RenderedView]:
    """The views one by one, read from the folder or rendered."""
    for view in views:
        image = _existing(output, view.number)
        if image is None:
            yield _render(avatar, rasterize, view, output)
        else:
            yield RenderedView(view.number, image, is_new=False)


def _existing(output: Output, number: int) -> UInt8[np.ndarray, "H W 3"] | None:
    path = frame_file(output.folder / FRAMES, number)
    complete = path.is_file() and (not output.alpha or frame_file(output.folder / RGBA, number).is_file())
    return read_rgb(path) if complete else None


@torch.no_grad()
def _render(avatar: Avatar, rasterize: Rasterizer, view: View, output: Output) -> RenderedView:
    gaussians = avatar.gaussians(view.drive)
    rendering = rasterize(gaussians, view.camera, gaussians.means.new_tensor(output.background))
    image, rgba = to_8_bit(rendering.image.float().cpu().numpy()), None
    if output.alpha:
        straight = straight_alpha(rendering.image, rendering.alpha, rendering.image.new_tensor(output.background))
        rgba = to_8_bit(straight.float().cpu().numpy())
    return RenderedView(view.number, image, rgba)


def _write(view: RenderedView, output: Output, append: Callable[[UInt8[np.ndarray, "H W 3"]], None] | None) -> None:
    """Write the files of a view and append it to the video."""
    if view.is_new and view.rgba is not None:
        write_rgba(frame_file(output.folder / RGBA, view.number), view.rgba)
    if view.is_new:
        write_png(frame_file(output.folder / FRAMES, view.number), view.image)
    if append:
        append(view.image)


def straight_alpha(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], background: Float[Tensor, " 3"]
) -> Float[Tensor, "H W 4"]:
    """Color without the background, and alpha: (I − background·(1 − α)) / α; black where nothing covers a pixel."""
    color = (image - background * (1 - alpha)) / alpha.clamp_min(1e-6)
    return torch.cat((torch.where(alpha > 0.5 / 255, color, torch.zeros_like(color)), alpha), dim=-1).clamp(0, 1)


def write_rgba(path: Path, image: UInt8[np.ndarray, "H W 4"]) -> None:
    """Write 8-bit RGBA as PNG, atomically."""
    encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA))[1]
    write_atomically(path, lambda stream: stream.write(encoded.tobytes()))
