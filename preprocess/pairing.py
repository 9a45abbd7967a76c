"""Which frame of the video a tracked frame belongs to, found by laying the projected mesh over the masks.

Trackers count from 0 or 1 and may drop leading frames, so the numbers alone do not tell (metrical-tracker's `.frame`
k is image k of its own `input` folder, but k + 1 of the frames FlashAvatar extracts).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from ggavatar.capture import Tracking
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from preprocess.posing import overlap, tracked_silhouette

SIDE = 160
"""Size of the pictures that are compared, px."""

FRAMES = 48
"""How many frames are compared."""

CLEAR_LEAD = 5e-4
"""By how much (IoU) a pairing must beat the one the numbers suggest."""


@dataclass(frozen=True)
class Pairing:
    """An offset and how sure it is.

    Attributes:
        offset: Source frame number minus tracking number.
        scores: Mean IoU around the head by offset; empty if nothing was compared.
        suggested: The offset that the numbers alone suggest.
    """

    offset: int
    scores: dict[int, float]
    suggested: int


def suggested_offset(numbers: Sequence[int], frames: Sequence[int]) -> int:
    """The smallest offset that gives the most frames a tracking; 0 wherever it loses nothing."""
    known = set(numbers)
    first = frames[0] - numbers[0]
    candidates = sorted({0, 1, -1, 2, -2, first}, key=abs)
    return max(candidates, key=lambda offset: sum(frame - offset in known for frame in frames))


def find_offset(
    head: HeadModel,
    tracking: Tracking,
    numbers: Sequence[int],
    frames: Sequence[int],
    mask: Callable[[int], Bool[np.ndarray, "H W"]],
) -> Pairing:
    """Compare silhouettes with masks at offsets −2 … +2 around the suggested one.

    Args:
        head: The head.
        tracking: Rows in the tracker's order, intrinsics in px of the capture.
        numbers: The tracker's frame numbers, one a row.
        frames: Source frame numbers that have masks.
        mask: Foreground of a source frame at the capture's size.

    Raises:
        InputError: No offset gives any frame a tracking.
    """
    suggested = suggested_offset(numbers, frames)
    row_of = {number: row for row, number in enumerate(numbers)}
    offsets = [suggested + step for step in (-2, -1, 0, 1, 2)]
    if not any(frame - suggested in row_of for frame in frames):
        raise InputError(
            f"the tracking has frames {numbers[0]} … {numbers[-1]}, the video {frames[0]} … {frames[-1]}: none in "
            "common"
        )
    usable = [frame for frame in frames if all(frame - offset in row_of for offset in offsets)]
    chosen = _moving([row_of[frame - suggested] for frame in usable], tracking)
    if not chosen:
        return Pairing(suggested, {}, suggested)
    scores = _scores(head, tracking, [usable[index] for index in chosen], offsets, row_of, mask)
    best = max(offsets, key=lambda offset: scores[offset])
    clear = scores[best] > scores[suggested] + CLEAR_LEAD
    return Pairing(best if clear else suggested, scores, suggested)


def _scores(
    head: HeadModel,
    tracking: Tracking,
    frames: Sequence[int],
    offsets: Sequence[int],
    row_of: dict[int, int],
    mask: Callable[[int], np.ndarray],
) -> dict[int, float]:
    """Mean overlap of every offset over the same frames."""
    drawn: dict[int, np.ndarray] = {}
    totals = dict.fromkeys(offsets, 0.0)
    for frame in frames:
        seen = mask(frame)
        scale = SIDE / max(seen.shape)
        size = (max(1, round(seen.shape[1] * scale)), max(1, round(seen.shape[0] * scale)))
        small = _shrunk(seen, size)
        for offset in offsets:
            row = row_of[frame - offset]
            if row not in drawn:
                drawn[row] = tracked_silhouette(head, tracking, row, size, scale)
            totals[offset] += _head_overlap(drawn[row], small)
    return {offset: total / len(frames) for offset, total in totals.items()}


def _shrunk(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    import cv2

    return cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127


def _head_overlap(drawn: np.ndarray, seen: np.ndarray) -> float:
    """Overlap within a box around the mesh; shoulders and arms farther off have no say."""
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    if not len(rows):
        return 0.0
    margin = max(2, (rows[-1] - rows[0]) // 8)
    box = np.s_[max(0, rows[0] - margin) : rows[-1] + 1, max(0, columns[0] - margin) : columns[-1] + margin]
    return overlap(drawn[box], seen[box])


def _moving(rows: Sequence[int], tracking: Tracking) -> list[int]:
    """Indices of the frames in which the head moves most, where a wrong pairing shows."""
    poses = tracking.world_to_camera
    ahead, behind = np.minimum(np.array(rows, int) + 1, len(poses) - 1), np.maximum(np.array(rows, int) - 1, 0)
    turned = np.abs(poses[ahead, :3, :3] - poses[behind, :3, :3]).sum(axis=(1, 2))
    depth = np.maximum(np.abs(poses[rows, 2, 3]), 1e-3)
    moved = np.abs(poses[ahead, :3, 3] - poses[behind, :3, 3]).sum(axis=1) / depth
    moved = moved + np.abs(tracking.translation[ahead] - tracking.translation[behind]).sum(axis=1) / depth
    turned = turned + np.abs(tracking.joint_rotations[ahead, :2] - tracking.joint_rotations[behind, :2]).sum(
        axis=(1, 2)
    )
    return sorted(int(index) for index in np.argsort(-(0.1 * turned + moved), kind="stable")[:FRAMES])
