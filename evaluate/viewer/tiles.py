"""Pictures side by side in one of a given size."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

Size = tuple[int, int]


def tile_size(shape: Size, size: Size, count: int) -> Size:
    """Width and height of `count` tiles of one shape side by side in a picture, as large as possible, px."""
    scale = min(size[0] / (count * shape[0]), size[1] / shape[1])
    return max(1, int(shape[0] * scale)), max(1, int(shape[1] * scale))


def side_by_side(
    tiles: Sequence[UInt8[np.ndarray, "_ _ 3"]], size: Size, color: tuple[int, int, int]
) -> UInt8[np.ndarray, "H W 3"]:
    """Tiles of any size, each as large as fits its share of the width, in the middle of it, on a color."""
    width, height = size
    picture = np.full((height, width, 3), color, np.uint8)
    for index, tile in enumerate(tiles):
        left, right = width * index // len(tiles), width * (index + 1) // len(tiles)
        _put(picture[:, left:right], tile)
    return picture


def _put(place: UInt8[np.ndarray, "_ _ 3"], tile: UInt8[np.ndarray, "_ _ 3"]) -> None:
    high, wide = place.shape[:2]
    if not high or not wide:
        return
    scale = min(wide / tile.shape[1], high / tile.shape[0])
    inner = max(1, min(wide, round(tile.shape[1] * scale))), max(1, min(high, round(tile.shape[0] * scale)))
    if inner != (tile.shape[1], tile.shape[0]):
        tile = cv2.resize(tile, inner, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    top, left = (high - inner[1]) // 2, (wide - inner[0]) // 2
    place[top : top + inner[1], left : left + inner[0]] = tile
