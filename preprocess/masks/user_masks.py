"""The user's folder of masks: how its files are read, brought to the capture's size, and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError
from ggavatar.io.images import image_header, read_unchanged
from preprocess.masks.checks import describe, find_fault, measure_mask
from preprocess.masks.levels import MaskLevels, find_levels
from preprocess.video.crop import Crop

SAMPLES = 16
"""How many masks decide what the values mean and whether they can be right."""
MAX_ASPECT_DIFFERENCE = 0.01
"""Relative difference in aspect ratio up to which masks of another size are taken for resized ones."""


@dataclass(frozen=True)
class UserMasks:
    """A folder of masks.

    Attributes:
        folder: The folder.
        levels: What the values mean.
        inverted: Whether `--invert-masks` is given.
        crop: From the video to the capture.
        source_size: Width and height of the video, px.
    """

    folder: Path
    levels: MaskLevels
    inverted: bool
    crop: Crop
    source_size: tuple[int, int]

    def fitted(self, path: Path) -> UInt8[np.ndarray, "H W"]:
        """One mask at the capture's size: cropped like the images unless it already has that size.

        Raises:
            InputError: The mask has neither the capture's size nor the video's aspect ratio.
        """
        header = image_header(path)
        found = (header.width, header.height)
        coverage = self.levels.coverage(read_unchanged(path))
        coverage = 255 - coverage if self.inverted else coverage
        if found == self.source_size:
            return self.crop.image(coverage)
        if found == (self.crop.out_width, self.crop.out_height):
            return coverage
        return self.crop.image(self._resized(path, coverage))

    def _resized(self, path: Path, coverage: np.ndarray) -> np.ndarray:
        """A mask of the video's shape at the video's size."""
        import cv2

        height, width = coverage.shape
        wanted = self.source_size
        if not _same_aspect((width, height), wanted):
            out = (self.crop.out_width, self.crop.out_height)
            turned = " (turned by 90°)" if _same_aspect((height, width), wanted) else ""
            raise InputError(
                f"{path}: expected {wanted[0]}×{wanted[1]} px like the video (or that resized) or {out[0]}×{out[1]} px "
                f"like the capture, found {width}×{height} px{turned}; the masks belong to other images: give those as "
                "INPUT, or leave --masks out to have masks computed"
            )
        return cv2.resize(coverage, wanted, interpolation=cv2.INTER_AREA if width > wanted[0] else cv2.INTER_LINEAR)

    def size_note(self, path: Path) -> str:
        """What is assumed about the size of a mask, in words; empty if it is the video's or the capture's."""
        header = image_header(path)
        found = (header.width, header.height)
        if found in (self.source_size, (self.crop.out_width, self.crop.out_height)):
            return ""
        width, height = self.source_size
        return f"masks of {found[0]}×{found[1]} px are resized to the video's {width}×{height} px"


def _same_aspect(size: tuple[int, int], other: tuple[int, int]) -> bool:
    return abs(size[0] * other[1] - size[1] * other[0]) <= MAX_ASPECT_DIFFERENCE * size[0] * other[1]


def some_of(items: Sequence[int]) -> list[int]:
    """At most `SAMPLES` of the items, evenly spaced."""
    places = np.unique(np.linspace(0, len(items) - 1, min(SAMPLES, len(items))).round().astype(int))
    return [items[place] for place in places]


def open_user_masks(
    folder: Path, files: Mapping[int, Path], inverted: bool, crop: Crop, source_size: tuple[int, int]
) -> UserMasks:
    """The masks of a folder, after deciding what their values mean.

    Raises:
        InputError: Their values have no single sensible meaning.
    """
    levels = find_levels([read_unchanged(files[number]) for number in some_of(list(files))], folder)
    return UserMasks(folder, levels, inverted, crop, source_size)


def require_credible(masks: UserMasks, pairs: Mapping[int, Path], faces: Mapping[int, np.ndarray]) -> None:
    """Check some masks against the picture's border and the faces.

    Args:
        masks: The masks.
        pairs: Mask files by frame.
        faces: Landmarks by frame, px, as far as they are known.

    Raises:
        InputError: They cannot be those of the person in the images.
    """
    chosen = some_of([number for number in pairs if number in faces] or list(pairs))
    measures = [measure_mask(masks.fitted(pairs[number]), faces.get(number)) for number in chosen]
    fault = find_fault(measures)
    if fault is None:
        return
    if fault == "inverted" and masks.inverted:
        what, advice = "with --invert-masks they cover the background", "add --resume and leave --invert-masks out"
    elif fault == "inverted":
        what, advice = describe(fault, measures), "add --resume --invert-masks"
    else:
        what = describe(fault, measures)
        advice = (
            "check that they were made from these images, with 255 for the person, or leave --masks out to have masks "
            "computed"
        )
    raise InputError(f"{masks.folder}: {what}; {advice}")
