"""Every image of a clip reduced to what tells blank, faded, cut and repeated frames apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from ggavatar.io.npz import read_npz, write_npz
from preprocess.evidence.blank import thumbnail

MAX_REPEAT_DIFFERENCE = 0.15
"""Mean difference of neighboring frames, in 8-bit levels, below which the second counts as a repeat."""


@dataclass(frozen=True)
class ReducedImage:
    """One image.

    Attributes:
        thumbnail: 32 × 32 px.
        gray: In gray, at full size.
    """

    thumbnail: UInt8[np.ndarray, "32 32 3"]
    gray: UInt8[np.ndarray, "H W"]


@dataclass(frozen=True)
class Pictures:
    """All images of a clip, in order.

    Attributes:
        thumbnails: 32 × 32 px.
        repeated: Frames that repeat the one before.
    """

    thumbnails: UInt8[np.ndarray, "T 32 32 3"]
    repeated: Bool[np.ndarray, " T"]

    def write(self, path: Path) -> None:
        """Store as npz."""
        write_npz(path, {"thumbnails": self.thumbnails, "repeated": self.repeated})


def read_pictures(path: Path) -> Pictures:
    """What `Pictures.write` stored; `InputError` if it is damaged."""
    found = read_npz(path, ("thumbnails", "repeated"))
    return Pictures(found["thumbnails"], found["repeated"])


def reduce_image(image: UInt8[np.ndarray, "H W 3"]) -> ReducedImage:
    """The thumbnail of an image, and it in gray."""
    return ReducedImage(thumbnail(image), cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def join_pictures(images: Iterable[ReducedImage]) -> Pictures:
    """All reduced images of a clip, each compared with the one before; only two are held at a time."""
    thumbnails: list[np.ndarray] = []
    repeated: list[bool] = []
    before: np.ndarray | None = None
    for image in images:
        thumbnails.append(image.thumbnail)
        repeated.append(before is not None and _mean_difference(image.gray, before) < MAX_REPEAT_DIFFERENCE)
        before = image.gray
    return Pictures(np.array(thumbnails, np.uint8).reshape(-1, 32, 32, 3), np.array(repeated, bool))


def _mean_difference(gray: UInt8[np.ndarray, "H W"], other: UInt8[np.ndarray, "H W"]) -> float:
    """Mean absolute difference of two images, in 8-bit levels."""
    return cv2.norm(gray, other, cv2.NORM_L1) / gray.size
