"""Masks from the alpha channel of the source, where the user gave none."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.images import write_png
from ggavatar.io.ordered_map import ordered_map
from preprocess.pipeline.read_stage import selection_of
from preprocess.pipeline.stage import StageContext
from preprocess.video.crop import Crop, crop_from_json
from preprocess.video.frame import DecodedFrame
from preprocess.video.sources import open_source

NAME = "alpha"
"""Name of these masks in the records and in capture.json."""


def alpha_masks(context: StageContext) -> Iterator[tuple[int, np.ndarray]]:
    """Decode again and write `masks/%06d.png` from the alpha channel; gives each frame's number and its mask.

    Raises:
        InputError: A frame without an alpha channel between others.
    """
    options = context.options
    crop = crop_from_json(dict(context.results["crop"]["crop"]))
    frames = selection_of(options).keep(open_source(options.input, options.fps).frames())

    def write(each: tuple[int, np.ndarray]) -> tuple[int, np.ndarray]:
        return each[0], _write(context.folder / "masks", crop, *each)

    return iter(ordered_map(write, ((frame.number, _alpha(options.input, frame)) for frame in frames)))


def _alpha(source: Path, frame: DecodedFrame) -> np.ndarray:
    if frame.alpha is None:
        raise InputError(
            f"{source}: frame {frame.number} has no alpha channel and others have one; choose other masks, for example "
            "--masks selfie"
        )
    return frame.alpha()


def _write(folder: Path, crop: Crop, number: int, alpha: np.ndarray) -> np.ndarray:
    mask = crop.image(alpha)
    write_png(folder / f"{number:06d}.png", mask)
    return mask
