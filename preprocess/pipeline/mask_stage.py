"""Third stage: a soft foreground mask for every image, from the user's files, a network or GrabCut."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import GateError, InputError
from ggavatar.io.images import image_header, read_gray, read_rgb, write_png
from ggavatar.io.ordered_map import ordered_map
from preprocess.options import PrepOptions
from preprocess.pipeline.stage import Stage, StageContext, file_state
from preprocess.video.crop import Crop, crop_from_json
from preprocess.video.image_folder import numbered_images

KINDS = ("auto", "selfie", "grabcut")


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The kind of masks, or the state of the files they come from."""
    return {"masks": options.masks if options.masks in KINDS else file_state(Path(options.masks))}


def run(context: StageContext) -> Mapping[str, Any]:
    """Write `masks/%06d.png`; the result lists the frames that have a mask."""
    (context.folder / "masks").mkdir(parents=True, exist_ok=True)
    wanted = context.options.masks
    if wanted not in KINDS and Path(wanted).is_dir():
        return _user_masks(context, Path(wanted))
    return _computed_masks(context, wanted)


def _user_masks(context: StageContext, folder: Path) -> Mapping[str, Any]:
    """The user's masks, paired with the frames by number."""
    from preprocess.masks.pairing import find_mask_offset

    numbers, files = list(context.results["frames"]["numbers"]), numbered_images(folder)
    if not files:
        raise InputError(
            f"{folder}: no masks in this folder; expected PNG or JPEG files with frame numbers in their names"
        )
    crop, size = crop_from_json(dict(context.results["crop"]["crop"])), _source_size(context)

    def image(number: int) -> np.ndarray:
        return read_rgb(context.folder / "images" / f"{number:06d}.png")

    offset = find_mask_offset(numbers, files, image, lambda path: fitted_mask(path, crop, size))
    kept = [number for number in numbers if number + offset in files]

    def write(number: int) -> None:
        target = context.folder / "masks" / f"{number:06d}.png"
        if not target.exists():
            write_png(target, fitted_mask(files[number + offset], crop, size))

    for done, _ in enumerate(ordered_map(write, kept), start=1):
        context.reporter.advance(done, len(kept))
    _report_missing(context, folder, len(numbers), len(kept), offset)
    return {"numbers": kept, "kind": "files", "offset": offset, "name": folder.name}


def _report_missing(context: StageContext, folder: Path, wanted: int, found: int, offset: int) -> None:
    """Warn about an offset and missing masks; raise if most are missing or with `--strict`."""
    if offset:
        context.reporter.warn(f"{folder}: mask k belongs to frame k{-offset:+d}, judging by the edges in the images")
    if found == wanted:
        return
    message = f"{folder}: {wanted - found} of {wanted} frames have no mask"
    if found < 2 or found < wanted // 2:
        raise InputError(f"{message}; expected one PNG or JPEG file per frame with the frame number in its name")
    if context.options.strict:
        raise GateError(f"{message} (--strict)")
    context.reporter.warn(f"{message} and are left out")


def fitted_mask(path: Path, crop: Crop, source_size: tuple[int, int]) -> np.ndarray:
    """A mask at the capture's size: cropped like the images if it has the source's size, else taken as it is.

    Raises:
        InputError: The mask has neither the source's size nor the capture's.
    """
    header = image_header(path)
    found = (header.width, header.height)
    if found == source_size:
        return crop.image(read_gray(path))
    if found == (crop.out_width, crop.out_height):
        return read_gray(path)
    raise InputError(
        f"{path}: expected {source_size[0]}×{source_size[1]} px like the video or "
        f"{crop.out_width}×{crop.out_height} px like the capture, "
        f"found {found[0]}×{found[1]}"
    )


def _source_size(context: StageContext) -> tuple[int, int]:
    return int(context.results["frames"]["width"]), int(context.results["frames"]["height"])


def _computed_masks(context: StageContext, wanted: str) -> Mapping[str, Any]:
    """Masks from a network or GrabCut, frame by frame."""
    from preprocess.masks.matting import open_matting

    numbers = list(context.results["frames"]["numbers"])
    matting = open_matting(wanted, context.options.models, context.options.offline)
    for warning in matting.warnings:
        context.reporter.warn(warning)
    names = [f"{number:06d}.png" for number in numbers]
    masks = matting.masks(ordered_map(lambda name: read_rgb(context.folder / "images" / name), names))

    def write(each: tuple[str, np.ndarray]) -> None:
        write_png(context.folder / "masks" / each[0], each[1])

    for done, _ in enumerate(ordered_map(write, zip(names, masks, strict=True)), start=1):
        context.reporter.advance(done, len(numbers))
    return {"numbers": numbers, "kind": matting.name, "offset": 0, "name": matting.name}


STAGE = Stage("masks", "Masks", inputs, run, outputs=("masks",))
