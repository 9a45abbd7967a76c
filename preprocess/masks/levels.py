"""What the values in the user's mask files mean: coverage, 0 and 1, class indices, colored classes, an alpha channel.

Decided once for a whole folder, from samples of it, because a single mask can be ambiguous: one that is black all over
says nothing. Values with one sensible meaning are mapped to coverage from 0 to 255; others are refused by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

from ggavatar.errors import InputError

MAX_CLASSES = 41
"""Highest number of distinct values, and 1 + highest index, of class-index masks; face parsing has 19."""
MAX_COLORS = 64
"""Highest number of distinct colors in masks that show classes in color; a photograph has thousands."""
GRAY_TOLERANCE = 8
"""Largest difference between color channels that still counts as gray; JPEG causes some."""
OPAQUE = 250
"""Alpha from which a pixel is opaque."""
MIN_PLATEAU = 0.01
"""Share of the picture in flat areas of intermediate values from which masks are labels; soft edges are not flat."""
MAX_BETWEEN = 0.5
"""Share of the picture that may be neither background nor person in masks; in photographs and depth maps it is more."""
STANDARD_LOW, STANDARD_HIGH = 8, 245
"""Background and person at or beyond these values are coverage from 0 to 255 as it is."""


@dataclass(frozen=True)
class MaskLevels:
    """How to read the masks of one folder.

    Attributes:
        plane: Where the values are: the alpha channel, the gray value, or the highest color channel.
        low: Value of the background.
        high: Value of the person.
        is_label: Values other than `low` are classes of the person; otherwise they are coverage between the two.
        note: The assumption in words; empty for coverage from 0 to 255.
    """

    plane: Literal["alpha", "gray", "color"] = "gray"
    low: int = 0
    high: int = 255
    is_label: bool = False
    note: str = ""

    def coverage(self, stored: np.ndarray) -> UInt8[np.ndarray, "H W"]:
        """One mask as coverage from 0 to 255; `stored` as `read_unchanged` gives it."""
        values = _plane(stored, self.plane)
        if self.is_label:
            return np.where(values > self.low, 255, 0).astype(np.uint8)
        if (self.low, self.high) == (0, 255) and values.dtype == np.uint8:
            return np.ascontiguousarray(values)
        scaled = (values.astype(np.float32) - self.low) * (255 / (self.high - self.low))
        return np.round(np.clip(scaled, 0, 255)).astype(np.uint8)


def find_levels(samples: Sequence[np.ndarray], source: object) -> MaskLevels:
    """The meaning of the values in masks, from samples of a folder as `read_unchanged` gives them.

    Args:
        samples: At least one mask; they may differ in size and channels.
        source: The folder, for messages.

    Raises:
        InputError: The values have no single sensible meaning, or the samples are of one value throughout.
    """
    plane = _choose_plane(samples, source)
    planes = [_plane(stored, plane) for stored in samples]
    if plane == "color":
        return _color_levels(samples, planes, source)
    counts = np.zeros(1 << 16, np.int64)
    for values in planes:
        counts += np.bincount(values.ravel(), minlength=1 << 16)
    values = np.flatnonzero(counts)
    low, high = int(values[0]), int(values[-1])
    note = "their alpha channel is the mask" if plane == "alpha" else ""
    if low == high:
        raise InputError(f"{source}: {_one_value(low, len(samples))}; {_ADVICE}")
    if len(values) == 2:
        return MaskLevels(plane, low, high, note=_joined(note, _scaled_note(low, high, {255, 65535})))
    if high < MAX_CLASSES:
        return _index_levels(plane, values, source, note)
    if len(values) <= MAX_CLASSES and _plateau(planes, low, high) > MIN_PLATEAU:
        return _gray_label_levels(plane, values, source, note)
    if high > 255:
        return MaskLevels(plane, 0, 65535, note=_joined(note, "16-bit levels are reduced to 8 bits"))
    return _soft_levels(plane, counts[:256], source, note)


_ADVICE = "give masks with 255 for the person and 0 elsewhere, or leave --masks out to have them computed"


def _one_value(value: int, count: int) -> str:
    """What is wrong with masks of one value, in words."""
    if value == 0:
        return f"the masks are empty: every pixel of {count} of them is 0 (black)"
    white = " (white)" if value in (255, 65535) else ""
    return f"the masks are {value}{white} everywhere in {count} of them, so they separate nothing"


def _choose_plane(samples: Sequence[np.ndarray], source: object) -> Literal["alpha", "gray", "color"]:
    """The channel that holds the masks: an alpha channel that is not opaque everywhere, else gray, else color."""
    alphas = [stored[..., 3] for stored in samples if _channels(stored) == 4]
    if len(alphas) == len(samples) and any(alpha.min() < _opaque(alpha) for alpha in alphas):
        return "alpha"
    if all(_is_gray(stored) for stored in samples):
        return "gray"
    colors = {color for stored in samples if not _is_gray(stored) for color in _distinct_colors(stored)}
    if len(colors) <= MAX_COLORS or all(_is_one_hue(stored) for stored in samples):
        return "color"
    opaque = " with an opaque alpha channel" if alphas else ""
    raise InputError(
        f"{source}: expected masks, found color images{opaque}; a cut-out on a plain background does not say where "
        "dark hair ends, so export the alpha channel itself as gray images, or leave --masks out to have masks computed"
    )


def _channels(stored: np.ndarray) -> int:
    return 1 if stored.ndim == 2 else stored.shape[2]


def _opaque(alpha: np.ndarray) -> int:
    """Alpha from which a pixel counts as opaque; an alpha channel of 0 and 1 has the 1."""
    highest = int(alpha.max())
    return max(1, highest if highest < OPAQUE else OPAQUE * (257 if alpha.dtype == np.uint16 else 1))


def _is_gray(stored: np.ndarray) -> bool:
    if stored.ndim == 2:
        return True
    color = stored[..., :3].astype(np.int32)
    tolerance = GRAY_TOLERANCE * (257 if stored.dtype == np.uint16 else 1)
    highest = int(color.max())
    # Among small values, such as class indices, every difference counts.
    return int(np.ptp(color, axis=2).max()) <= (tolerance if highest >= MAX_CLASSES else 0)


def _distinct_colors(stored: np.ndarray) -> list[int]:
    color = stored[..., :3].astype(np.int64)
    return [int(code) for code in np.unique((color[..., 0] << 32) | (color[..., 1] << 16) | color[..., 2])]


def _is_one_hue(stored: np.ndarray) -> bool:
    """Whether all colors are shades of one color from black on, as in coverage shown in red."""
    color = stored[..., :3].reshape(-1, 3).astype(np.float64)
    brightest = color[int(color.sum(axis=1).argmax())]
    if not brightest.any():
        return True
    direction = brightest / np.linalg.norm(brightest)
    rest = color - np.outer(color @ direction, direction)
    return bool(np.abs(rest).max() <= 2 * GRAY_TOLERANCE * (257 if stored.dtype == np.uint16 else 1))


def _plane(stored: np.ndarray, plane: str) -> np.ndarray:
    if stored.ndim == 2:
        return stored
    if plane == "alpha" and stored.shape[2] == 4:
        return stored[..., 3]
    return stored[..., 0] if plane == "gray" else stored[..., :3].max(axis=2)


def _color_levels(samples: Sequence[np.ndarray], planes: Sequence[np.ndarray], source: object) -> MaskLevels:
    """Classes shown in color, or coverage in shades of one color."""
    colors = sorted({color for stored in samples for color in _distinct_colors(stored)})
    if len(colors) > MAX_COLORS:
        high = max(int(values.max()) for values in planes)
        return MaskLevels("color", 0, high, note="shades of one color are taken as coverage")
    if colors[0] != 0:
        raise InputError(
            f"{source}: expected masks, found {len(colors)} colors and none of them black, so it cannot be told which "
            f"is the background; {_ADVICE}"
        )
    note = f"{len(colors)} colors, taken as classes: black is the background, the others are the person"
    return MaskLevels("color", 0, 255, is_label=True, note=note)


def _index_levels(plane: Literal["alpha", "gray"], values: np.ndarray, source: object, note: str) -> MaskLevels:
    """Class indices as in face parsing, where 0 is the background."""
    listed = _listed(values)
    if values[0] != 0:
        raise InputError(
            f"{source}: expected masks, found class indices {listed} without a 0, so it cannot be told which is the "
            f"background; {_ADVICE}"
        )
    return MaskLevels(
        plane, 0, int(values[-1]), is_label=True,
        note=_joined(note, f"class indices {listed}: 0 is taken as the background, the others as the person"),
    )  # fmt: skip


def _gray_label_levels(plane: Literal["alpha", "gray"], values: np.ndarray, source: object, note: str) -> MaskLevels:
    """Classes shown in gray; three levels may be a trimap, whose middle means "unknown"."""
    listed = _listed(values)
    if len(values) == 3:
        raise InputError(
            f"{source}: expected masks, found the three levels {listed}: a trimap, whose middle level means unknown, "
            f"or two classes, of which either may be the person; {_ADVICE}"
        )
    if values[0] != 0:
        raise InputError(
            f"{source}: expected masks, found the levels {listed} without a 0, so it cannot be told which is the "
            f"background; {_ADVICE}"
        )
    return MaskLevels(
        plane, 0, int(values[-1]), is_label=True,
        note=_joined(note, f"levels {listed}, taken as classes: 0 is the background, the others are the person"),
    )  # fmt: skip


def _plateau(planes: Sequence[np.ndarray], low: int, high: int) -> float:
    """Share of all pixels that are neither low nor high and whose neighborhood has the same value."""
    flat = total = 0
    disc = np.ones((5, 5), np.uint8)
    for values in planes:
        values = values.astype(np.float32)
        same = cv2.erode(values, disc) == cv2.dilate(values, disc)
        flat += int(np.count_nonzero(same & (values > low) & (values < high)))
        total += values.size
    return flat / total


def _soft_levels(plane: Literal["alpha", "gray"], counts: np.ndarray, source: object, note: str) -> MaskLevels:
    """Coverage; scaled if background and person, the commonest dark and bright values, are not near 0 and 255."""
    values = np.flatnonzero(counts)
    middle = (int(values[0]) + int(values[-1]) + 1) // 2
    low, high = int(counts[:middle].argmax()), middle + int(counts[middle:].argmax())
    span = int(values[-1]) - int(values[0])
    distance = np.minimum(np.abs(np.arange(256) - low), np.abs(np.arange(256) - high))
    if high - low < span / 2 or counts[distance > span // 10].sum() > MAX_BETWEEN * counts.sum():
        raise InputError(
            f"{source}: expected masks, found gray images: most of their values are neither background nor person; "
            f"{_ADVICE}"
        )
    if low <= STANDARD_LOW and (high >= STANDARD_HIGH or values[-1] >= OPAQUE):
        return MaskLevels(plane, note=note)
    return MaskLevels(plane, low, high, note=_joined(note, _scaled_note(low, high, {255})))


def _scaled_note(low: int, high: int, usual: set[int]) -> str:
    if low == 0 and high in usual:
        return ""
    return f"levels {low} (background) and {high} (person) are scaled to 0 and 255"


def _listed(values: np.ndarray) -> str:
    shown = ", ".join(str(int(value)) for value in values[:6])
    return shown if len(values) <= 6 else f"{shown}, … {int(values[-1])}"


def _joined(*notes: str) -> str:
    return "; ".join(note for note in notes if note)
