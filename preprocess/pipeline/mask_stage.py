"""Fifth stage: a soft foreground mask for every image: the user's, the video's alpha, a network's or GrabCut's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ggavatar.errors import GateError, InputError
from ggavatar.io.held_folders import make_folder
from ggavatar.io.images import read_gray, read_rgb, write_png
from ggavatar.io.ordered_map import ordered_map
from preprocess.masks.checks import is_empty
from preprocess.masks.user_masks import UserMasks, open_user_masks, require_credible
from preprocess.options import PrepOptions
from preprocess.pipeline.alpha_masks import NAME as ALPHA
from preprocess.pipeline.alpha_masks import alpha_masks
from preprocess.pipeline.evidence_stage import faces_by_frame
from preprocess.pipeline.stage import Stage, StageContext, file_state
from preprocess.video.crop import crop_from_json
from preprocess.video.image_folder import numbered_images

KINDS = ("auto", "selfie", "rvm", "grabcut")
NO_MASK, EMPTY_MASK = "no mask", "empty mask"
"""Reasons in capture.json."""


def inputs(options: PrepOptions) -> Mapping[str, Any]:
    """The kind of masks, or the state of the files they come from and how they are read.

    Raises:
        InputError: No such files, or `--invert-masks` for masks that are computed.
    """
    if options.masks in KINDS:
        if options.invert_masks:
            raise InputError(f"--invert-masks is for a folder of masks, found --masks {options.masks}; leave it out")
        return {"masks": options.masks}
    return {"masks": file_state(Path(options.masks)), "inverted": options.invert_masks, "camera": options.camera}


def run(context: StageContext) -> Mapping[str, Any]:
    """Write `masks/%06d.png`; the result lists the frames that have a mask, and reasons for the others."""
    make_folder(context.folder / "masks")
    wanted = context.options.masks
    if wanted not in KINDS and Path(wanted).is_dir():
        return _user_masks(context, Path(wanted))
    if wanted == "auto" and context.results["frames"]["alpha"]:
        return _alpha_masks(context)
    return _computed_masks(context, wanted)


def _user_masks(context: StageContext, folder: Path) -> Mapping[str, Any]:
    """The user's masks, paired with the frames by number."""
    from preprocess.masks.pairing import find_mask_offset

    numbers, every = (list(context.results[stage]["numbers"]) for stage in ("evidence", "frames"))
    files = _mask_files(context, folder, every)
    crop = crop_from_json(dict(context.results["crop"]["crop"]))
    masks = open_user_masks(folder, files, context.options.invert_masks, crop, _source_size(context))
    offset = find_mask_offset(every, files, lambda number: _image(context, number), masks.fitted)
    pairs = {number: files[number + offset] for number in numbers if number + offset in files}
    _require_enough(context, folder, len(numbers), len(pairs))
    for note in (masks.levels.note, masks.size_note(next(iter(pairs.values())))):
        if note:
            context.reporter.note(f"{folder}: {note}")
    if offset:
        context.reporter.warn(f"{folder}: mask k belongs to frame k{-offset:+d}, judging by the edges in the images")
    require_credible(masks, pairs, faces_by_frame(context))
    kept, dropped = _written(context, masks, pairs)
    if context.options.keep_faceless:
        kept, dropped = list(pairs), {}
    dropped |= {number: NO_MASK for number in numbers if number not in pairs}
    _report_dropped(context, f"{folder}", len(numbers), dropped)
    return {"numbers": kept, "dropped": _listed(dropped), "kind": "files", "offset": offset, "name": folder.name}


def _mask_files(context: StageContext, folder: Path, numbers: Sequence[int]) -> Mapping[int, Path]:
    """The mask files by their own numbers; by position only if every frame has one."""
    found = numbered_images(folder, context.options.camera)
    if not found.files:
        raise InputError(
            f"{folder}: no masks in this folder; expected PNG or JPEG files with frame numbers in their names"
        )
    for note in found.notes:
        context.reporter.note(note)
    if not found.by_position:
        return found.files
    if len(found.files) != len(numbers):
        raise InputError(
            f"{folder}: no numbers in the names of the {len(found.files)} masks, so it cannot be told which of the "
            f"{len(numbers)} frames they belong to; rename them to the frames' numbers, such as {numbers[0]:06d}.png"
        )
    return dict(zip(numbers, found.files.values(), strict=True))


def _image(context: StageContext, number: int) -> np.ndarray:
    return read_rgb(context.folder / "images" / f"{number:06d}.png")


def _written(context: StageContext, masks: UserMasks, pairs: Mapping[int, Path]) -> tuple[list[int], dict[int, str]]:
    """Write the masks; the frames with a mask, and those whose mask shows nobody."""

    def write(number: int) -> bool:
        target = context.folder / "masks" / f"{number:06d}.png"
        mask = read_gray(target) if target.exists() else masks.fitted(pairs[number])
        if not target.exists():
            write_png(target, mask)
        return is_empty(mask)

    kept, dropped = [], {}
    for done, (number, empty) in enumerate(zip(pairs, ordered_map(write, pairs), strict=True), start=1):
        if empty:
            dropped[number] = EMPTY_MASK
        else:
            kept.append(number)
        context.reporter.advance(done, len(pairs))
    return kept, dropped


def _listed(dropped: Mapping[int, str]) -> list[list[Any]]:
    """Dropped frames as plain JSON values."""
    return [[number, dropped[number]] for number in sorted(dropped)]


def _require_enough(context: StageContext, folder: Path, wanted: int, found: int) -> None:
    """Raise if most frames have no mask."""
    if found < 2 or found < wanted // 2:
        raise InputError(
            f"{folder}: {wanted - found} of {wanted} frames have no mask; expected one PNG or JPEG file per frame with "
            "the frame number in its name"
        )


def _report_dropped(context: StageContext, source: str, wanted: int, dropped: Mapping[int, str]) -> None:
    """Warn about frames that lack nothing but a mask; raise if only they are left, or with `--strict`."""
    before = {number for number, _ in context.results["evidence"]["dropped"]}
    dropped = {number: reason for number, reason in dropped.items() if number not in before}
    if not dropped:
        return
    counts = Counter(dropped.values())
    message = f"{source}: " + " and ".join(
        f"{counts[reason]} of {wanted} frames have {words}"
        for reason, words in ((NO_MASK, "no mask"), (EMPTY_MASK, "an empty mask"))
        if counts[reason]
    )
    if wanted - len(dropped) < 2:
        raise InputError(f"{message}; expected at least two frames that show the person, so record or mask more")
    if context.options.strict:
        raise GateError(f"{message} (--strict)")
    context.reporter.warn(f"{message} and are left out")


def _source_size(context: StageContext) -> tuple[int, int]:
    return int(context.results["frames"]["width"]), int(context.results["frames"]["height"])


def _alpha_masks(context: StageContext) -> Mapping[str, Any]:
    """Masks from the source's alpha channel."""
    source, numbers = str(context.options.input), list(context.results["frames"]["numbers"])
    context.reporter.note(f"{source}: its alpha channel is used as masks; --masks selfie computes them instead")
    kept, dropped = [], {}
    for done, (number, mask) in enumerate(alpha_masks(context), start=1):
        if is_empty(mask):
            dropped[number] = EMPTY_MASK
        else:
            kept.append(number)
        context.reporter.advance(done, len(numbers))
    _report_dropped(context, source, len(numbers), dropped)
    return {"numbers": kept, "dropped": _listed(dropped), "kind": ALPHA, "offset": 0, "name": ALPHA}


def _computed_masks(context: StageContext, wanted: str) -> Mapping[str, Any]:
    """Masks from a network or GrabCut, frame by frame."""
    from preprocess.masks.matting import open_matting

    numbers = list(context.results["evidence"]["numbers"])
    matting = open_matting(wanted, context.options.models, context.options.offline)
    for warning in matting.warnings:
        context.reporter.warn(warning)
    names = [f"{number:06d}.png" for number in numbers]
    masks = matting.masks(ordered_map(lambda name: read_rgb(context.folder / "images" / name), names))

    def write(each: tuple[str, np.ndarray]) -> bool:
        write_png(context.folder / "masks" / each[0], each[1])
        return is_empty(each[1])

    empty = []
    for done, (number, nobody) in enumerate(
        zip(numbers, ordered_map(write, zip(names, masks, strict=True)), strict=True), start=1
    ):
        empty += [number] if nobody else []
        context.reporter.advance(done, len(numbers))
    dropped = {} if context.options.keep_faceless else dict.fromkeys(empty, EMPTY_MASK)
    _report_dropped(context, str(context.options.input), len(numbers), dropped)
    kept = [number for number in numbers if number not in dropped]
    return {"numbers": kept, "dropped": _listed(dropped), "kind": matting.name, "offset": 0, "name": matting.name}


STAGE = Stage("masks", "Masks", inputs, run, outputs=("masks",), version=3)
