"""Images of an avatar as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import UInt8

from ggavatar.api.performances import Performance
from ggavatar.core import Camera, Drive
from ggavatar.data.background import parse_background
from ggavatar.pictures.quantization import to_8_bit
from ggavatar.training.run_folder import Run

Images = UInt8[np.ndarray, "N H W 3"]


def render_frames(
    run: Run, frames: Sequence[int] | None = None, width: int | None = None, background: str | None = None
) -> Images:
    """Render frames of the run's own capture, as `ggavatar-render` does.

    Args:
        run: The avatar.
        frames: Source frame numbers; the test frames if not given.
        width: Of the images, px; the height follows. That of the capture if not given.
        background: white, black, or R,G,B from 0 to 1; that of the training if not given.

    Returns:
        8-bit sRGB.

    Raises:
        InputError: The capture does not have one of the frames.
    """
    numbers = run.split.test if frames is None else frames
    views = ((run.reader.drive(number), run.reader.camera(number)) for number in numbers)
    return _stacked(run, views, width, background)


def render_performance(
    run: Run,
    performance: Performance,
    frames: slice | None = None,
    width: int | None = None,
    background: str | None = None,
) -> Images:
    """Render a performance of `drive`.

    Args:
        run: The avatar.
        performance: What it performs.
        frames: The part to render, such as `slice(0, 100, 2)`; all if not given.
        width: Of the images, px; the height follows.
        background: white, black, or R,G,B from 0 to 1; that of the training if not given.

    Returns:
        8-bit sRGB.
    """
    part = frames or slice(None)
    return _stacked(run, zip(performance.drives[part], performance.cameras[part], strict=True), width, background)


def _stacked(run: Run, views: Iterable[tuple[Drive, Camera]], width: int | None, background: str | None) -> Images:
    images = list(_rendered(run, views, width, background))
    if images:
        return np.stack(images)
    camera = _sized(run.reader.camera(run.capture.frames[0]), width)
    return np.zeros((0, camera.height, camera.width, 3), np.uint8)


def _rendered(
    run: Run, views: Iterable[tuple[Drive, Camera]], width: int | None, background: str | None
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    color = run.background
    if background is not None:
        color = color.new_tensor(parse_background(background))
    for drive, camera in views:
        with torch.no_grad():
            image = run.rasterize(run.avatar.gaussians(drive), _sized(camera, width), color).image
        yield to_8_bit(image.float().cpu().numpy())


def _sized(camera: Camera, width: int | None) -> Camera:
    """The camera of an image of some width, px."""
    return camera if width is None else camera.resized(width, max(1, round(camera.height * width / camera.width)))
