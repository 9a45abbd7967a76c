"""Second stage: chooses one crop for the whole clip and writes the images at their final size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import read_rgb, write_png
from ggavatar.io.ordered_map import ordered_map
from preprocess.evidence.pictures import Pictures, ReducedImage, join_pictures, read_pictures, reduce_image
from preprocess.formats.registry import SWAPPED_SIZE
from preprocess.formats.tracking_record import TrackingRecord
from preprocess.options import PrepOptions
from preprocess.pipeline.read_stage import open_input, selection_of
from preprocess.pipeline.stage import RECORDS, Stage, StageContext, file_state
from preprocess.video.crop import Crop, explicit_crop, parse_rectangle, square_crop, square_crop_around, whole_frame
from preprocess.video.frame import DecodedFrame

PICTURES = f"{RECORDS}/pictures.npz"
HEAD_POINTS = np.array([[x, y, z] for x in (-0.09, 0.09) for y in (-0.12, 0.14) for z in (-0.12, 0.08)])
"""Corners of a box around an adult's head in FLAME's coordinates, m."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """Size, crop and the tracking that the crop depends on.

    Raises:
        InputError: `--size` or `--crop` is malformed or out of range.
    """
    if not 64 <= options.size <= 4096:
        raise InputError(f"--size: expected 64 to 4096 px, found {options.size}")
    if options.crop not in ("auto", "none"):
        parse_rectangle(options.crop)
    return {
        "size": options.size,
        "crop": options.crop,
        "tracking": file_state(options.tracking),
        "format": options.format,
    }


def run(context: StageContext) -> Mapping[str, Any]:
    """Decode again, crop, resample and write `images/%06d.png`, and note what tells their pictures apart.

    Files of an interrupted run are kept.

    Raises:
        InputError: No crop can be chosen, or the source has changed since it was read.
    """
    options, source = context.options, context.results["frames"]
    crop = choose_crop(context)
    folder = context.folder / "images"
    make_folder(folder)
    numbers = list(source["numbers"])
    wanted = selection_of(options).keep(open_input(options).frames())

    def reduced() -> Iterator[ReducedImage]:
        images = ordered_map(lambda each: _write(crop, *each), _missing(folder, wanted))
        for done, image in enumerate(images, start=1):
            context.reporter.advance(done, len(numbers))
            yield image

    pictures = join_pictures(reduced())
    if (done := len(pictures.repeated)) != len(numbers):
        raise InputError(
            f"{options.input}: expected {len(numbers)} frames as before, found {done}; the file has changed while it "
            "was read, start again with --overwrite"
        )
    pictures.write(context.folder / PICTURES)
    return {"crop": crop.json()}


def _missing(folder: Path, frames: Iterator[DecodedFrame]) -> Iterator[tuple[Path, np.ndarray | None]]:
    """The path of each frame's image and its pixels; None in place of the pixels if the file exists."""
    for frame in frames:
        path = folder / f"{frame.number:06d}.png"
        yield path, None if path.exists() else frame.image


def _write(crop: Crop, path: Path, source: np.ndarray | None) -> ReducedImage:
    if source is None:
        return reduce_image(read_rgb(path))
    image = crop.image(source)
    write_png(path, image)
    return reduce_image(image)


def pictures_of(context: StageContext) -> Pictures:
    """What this stage has noted of the images."""
    return read_pictures(context.folder / PICTURES)


def choose_crop(context: StageContext) -> Crop:
    """The crop that `--crop` asks for; with auto, one around the imported tracking or the detected faces."""
    options, source = context.options, context.results["frames"]
    width, height = source["width"], source["height"]
    if options.crop == "none":
        return whole_frame(width, height, options.size)
    if options.crop != "auto":
        return explicit_crop(options.crop, width, height, options.size)
    if options.tracking is not None:
        return _crop_for_tracking(context.tracking_record()[1], width, height, options.size)
    return _crop_for_faces(context, width, height)


def _crop_for_faces(context: StageContext, width: int, height: int) -> Crop:
    """A square around the detected faces."""
    source, size = context.results["frames"], context.options.size
    faces = np.array(source["faces"]).reshape(-1, 4)
    if not len(faces):
        raise InputError(f"{context.options.input}: no face found; give the crop with --crop X,Y,WIDTH,HEIGHT")
    # The detector's box spans brows to chin; a head with hair is about 1.5 times as tall.
    centers, sides = (faces[:, :2] + faces[:, 2:]) / 2, faces[:, 2:] - faces[:, :2]
    heads = np.concatenate((centers - sides * [0.65, 0.85], centers + sides * [0.65, 0.65]), axis=1)
    crop = square_crop_around(heads, width, height, size)
    if width == height and crop.width > 0.8 * width:
        return whole_frame(width, height, size)
    return crop


def tracked_size_fits(record: TrackingRecord, width: int, height: int) -> bool:
    """Whether the tracker saw the whole frame, possibly resampled."""
    return abs(record.width * height - record.height * width) <= 0.01 * record.width * height


def _size_mismatch(record: TrackingRecord, width: int, height: int) -> str:
    """The message for a tracking that was made on images of another shape."""
    found = f"the tracking was made on {record.width}×{record.height} px images, the video has {width}×{height} px"
    if abs(record.height * height - record.width * width) <= 0.01 * record.width * width:
        return f"{found}: width and height are swapped in the tracking; add --fix {SWAPPED_SIZE}"
    return (
        f"{found}: the tracker cropped it. Give the tracker's own images as INPUT "
        "(metrical-tracker: the folder `input` beside `checkpoint`; Pixel3DMM: `cropped` of its preprocessing; "
        "flame-head-tracker: its npz folder; regressors: their crops)"
    )


def _crop_for_tracking(record: TrackingRecord, width: int, height: int, size: int) -> Crop:
    """The whole frame if it is square, else a square around the tracked heads."""
    if not tracked_size_fits(record, width, height):
        raise InputError(_size_mismatch(record, width, height))
    if width == height:
        return whole_frame(width, height, size)
    factor = np.array([width / record.width, height / record.height])
    seen = (
        np.einsum("tij,nj->tni", record.world_to_camera[:, :3, :3], HEAD_POINTS)
        + record.world_to_camera[:, None, :3, 3]
    )
    seen = seen + np.einsum("tij,tj->ti", record.world_to_camera[:, :3, :3], record.translation)[:, None]
    pixels = np.einsum("tij,tnj->tni", record.intrinsics, seen)
    pixels = pixels[..., :2] / np.maximum(pixels[..., 2:], 1e-3) * factor
    boxes = np.concatenate((pixels.min(axis=1), pixels.max(axis=1)), axis=1)
    if (
        not np.isfinite(boxes).all()
        or (boxes[:, 2:] < 0).all()
        or (boxes[:, 0] > width).all()
        or (boxes[:, 1] > height).all()
    ):
        return square_crop((width / 2, height / 2), min(width, height), width, height, size)
    return square_crop_around(boxes, width, height, size)


STAGE = Stage("crop", "Cropping and resampling", inputs, run, outputs=("images", PICTURES), version=4)
