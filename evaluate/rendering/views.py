"""Draw a sequence of views into a folder: numbered PNG, straight-alpha PNG, video, and a note of what they are."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from evaluate.figures.video import video_writer
from evaluate.scoring.frame_files import frame_file, to_8_bit
from evaluate.scoring.ground_truth import Color
from ggavatar.core import Avatar, Camera, Drive, Rasterizer
from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically
from ggavatar.io.images import read_rgb, write_png

NOTE, VIDEO, FRAMES, CUTOUTS = "render.json", "render.mp4", "frames", "rgba"
BATCH = 8
"""Pictures in memory at most: one thread draws, another encodes what is drawn."""


class View(NamedTuple):
    """One picture to draw; `number` names its file."""

    number: int
    drive: Drive
    camera: Camera


class RenderedView(NamedTuple):
    """A picture that waits for the encoder."""

    number: int
    picture: UInt8[np.ndarray, "H W 3"]
    cutout: UInt8[np.ndarray, "H W 4"] | None = None


@dataclass(frozen=True)
class Output:
    """Where and how to write.

    Attributes:
        folder: Made if missing.
        background: sRGB in [0, 1], behind frames and video.
        fps: Pictures per second of the video; None writes no video.
        alpha: Write RGBA with straight alpha too.
    """

    folder: Path
    background: Color = (1.0, 1.0, 1.0)
    fps: float | None = 25.0
    alpha: bool = False


def claim_folder(output: Output, content: dict[str, Any], overwrite: bool, resume: bool) -> None:
    """Make the output folder ours; refuse one that holds something, unless it may be overwritten or resumed.

    Nothing but files that an earlier render wrote is ever removed.

    Raises:
        InputError: The folder holds a render and neither flag is set, another render and `resume` is, or foreign files.
    """
    note = output.folder / NOTE
    wanted = {"schema": "ggavatar-render", "version": 1, "key": _key(content), **content}
    if output.folder.exists() and (not output.folder.is_dir() or any(output.folder.iterdir())):
        if not note.is_file():
            raise InputError(
                f"{output.folder}: expected a new or empty folder, found other files; choose another with -o"
            )
        if not (overwrite or resume):
            raise InputError(
                f"{output.folder}: exists; pass --resume to go on, --overwrite to begin again, or choose another -o"
            )
        if resume and _read_key(note) != wanted["key"]:
            raise InputError(
                f"{note}: was written by other options; pass --overwrite to begin again, or choose another -o"
            )
        if overwrite:
            _remove_own_files(output.folder)
    text = json.dumps(wanted, indent=1, allow_nan=False) + "\n"
    write_atomically(note, lambda stream: stream.write(text.encode()))


def method_of_renders(folder: Path) -> str:
    """The method that drew a folder; `InputError` if ggavatar-render did not write it."""
    try:
        return str(json.loads((folder / NOTE).read_text(encoding="utf-8"))["method"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: expected a folder written by ggavatar-render, found none ({error!r})") from error


def _key(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _read_key(note: Path) -> object:
    try:
        return json.loads(note.read_text(encoding="utf-8")).get("key")
    except (ValueError, AttributeError):
        return None


def _remove_own_files(folder: Path) -> None:
    numbered = [path for name in (FRAMES, CUTOUTS) for path in (folder / name).glob("[0-9]" * 6 + ".png")]
    for path in [*numbered, *folder.glob("*.png"), folder / VIDEO, folder / NOTE]:
        path.unlink(missing_ok=True)


def render_views(
    avatar: Avatar,
    rasterize: Rasterizer,
    views: Sequence[View],
    output: Output,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Draw every view; those whose files exist are read instead of drawn, so an interrupted call can go on.

    Args:
        avatar: Poses the Gaussians.
        rasterize: Draws them.
        views: In the order of the video.
        output: Folder, background, video and alpha.
        progress: Called with (done, total) after every view.
    """
    with contextlib.ExitStack() as stack:
        append = None
        if output.fps is not None:
            append = stack.enter_context(video_writer(output.folder / VIDEO, output.fps))
        encoder = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="encoder"))
        waiting: deque[Future[None]] = deque()
        stack.callback(lambda: [future.cancel() for future in waiting])
        for done, view in enumerate(views, start=1):
            picture = _existing(output, view.number)
            drawn = (
                RenderedView(view.number, picture) if picture is not None else _draw(avatar, rasterize, view, output)
            )
            waiting.append(encoder.submit(_keep, drawn, output, append, is_new=picture is None))
            if len(waiting) == BATCH:
                waiting.popleft().result()
            if progress:
                progress(done, len(views))
        for future in waiting:
            future.result()


def _existing(output: Output, number: int) -> UInt8[np.ndarray, "H W 3"] | None:
    path = frame_file(output.folder / FRAMES, number)
    whole = path.is_file() and (not output.alpha or frame_file(output.folder / CUTOUTS, number).is_file())
    return read_rgb(path) if whole else None


@torch.no_grad()
def _draw(avatar: Avatar, rasterize: Rasterizer, view: View, output: Output) -> RenderedView:
    gaussians = avatar.gaussians(view.drive)
    rendering = rasterize(gaussians, view.camera, gaussians.means.new_tensor(output.background))
    picture, cutout = to_8_bit(rendering.image.float().cpu().numpy()), None
    if output.alpha:
        straight = straight_alpha(rendering.image, rendering.alpha, rendering.image.new_tensor(output.background))
        cutout = to_8_bit(straight.float().cpu().numpy())
    return RenderedView(view.number, picture, cutout)


def _keep(
    drawn: RenderedView, output: Output, append: Callable[[UInt8[np.ndarray, "H W 3"]], None] | None, is_new: bool
) -> None:
    """Write the files of a picture and append it to the video."""
    if is_new and drawn.cutout is not None:
        write_rgba(frame_file(output.folder / CUTOUTS, drawn.number), drawn.cutout)
    if is_new:
        write_png(frame_file(output.folder / FRAMES, drawn.number), drawn.picture)
    if append:
        append(drawn.picture)


def straight_alpha(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W 1"], background: Float[Tensor, " 3"]
) -> Float[Tensor, "H W 4"]:
    """Colour without the background, and alpha: (I − background·(1 − α)) / α; black where nothing covers a pixel."""
    color = (image - background * (1 - alpha)) / alpha.clamp_min(1e-6)
    return torch.cat((torch.where(alpha > 0.5 / 255, color, torch.zeros_like(color)), alpha), dim=-1).clamp(0, 1)


def write_rgba(path: Path, picture: UInt8[np.ndarray, "H W 4"]) -> None:
    """Write 8-bit RGBA as PNG, atomically."""
    encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA))[1]
    write_atomically(path, lambda stream: stream.write(encoded.tobytes()))
