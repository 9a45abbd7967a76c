"""Which frame of the video a tracked frame belongs to, found by how well the mesh carries the picture along.

Trackers count from 0 or 1 and may drop leading frames, so the numbers alone do not tell (metrical-tracker's `.frame`
k is image k of its own `input` folder, but k + 1 of the frames FlashAvatar extracts). Silhouettes hardly change from
one frame to the next, and hair and shoulders hide what changes. A point of the face, however, keeps its brightness
while it moves: with the right pairing the brightness under the projected vertices changes least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ggavatar.data.capture import Tracking
from ggavatar.errors import InputError
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.tracking.geometry.projection import posed_vertices, project

PAIRS = 120
"""How many pairs of frames are compared, those between which the head moves most."""

STEP = 4
"""Frames from the first of a pair to the second; long enough for motion to outweigh a tracker's jitter."""

VERTICES = 1500
"""About how many vertices of the face are looked at."""

MIN_RELATIVE_LEAD, MIN_STANDARD_ERRORS = 0.02, 2.5
"""By how much (relative, and in standard errors) a pairing must beat the one that the numbers suggest."""


@dataclass(frozen=True)
class OffsetEstimate:
    """An offset and what speaks for it.

    Attributes:
        offset: Source frame number minus tracking number.
        scores: Mean change of brightness (8-bit steps) under the mesh by offset, the least is best; empty if nothing
            could be compared.
        suggested: The offset that the numbers alone suggest.
    """

    offset: int
    scores: dict[int, float]
    suggested: int


def suggested_offset(numbers: Sequence[int], frames: Sequence[int]) -> int:
    """The smallest offset that gives the most frames a tracking; 0 wherever it loses nothing."""
    known = set(numbers)
    candidates = sorted({0, 1, -1, 2, -2, frames[0] - numbers[0]}, key=abs)
    return max(candidates, key=lambda offset: sum(frame - offset in known for frame in frames))


def find_offset(
    head: HeadModel,
    tracking: Tracking,
    numbers: Sequence[int],
    frames: Sequence[int],
    image: Callable[[int], UInt8[np.ndarray, "H W 3"]],
) -> OffsetEstimate:
    """Compare offsets −2 … +2 around the suggested one.

    Args:
        head: The head.
        tracking: Rows in the tracker's order, intrinsics in px of the capture.
        numbers: The tracker's frame numbers, one a row.
        frames: Source frame numbers, ascending.
        image: Reads a source frame at the capture's size.

    Raises:
        InputError: No offset gives any frame a tracking.
    """
    suggested = suggested_offset(numbers, frames)
    row_of = {number: row for row, number in enumerate(numbers)}
    if not any(frame - suggested in row_of for frame in frames):
        raise InputError(
            f"the tracking has frames {numbers[0]} … {numbers[-1]}, the video {frames[0]} … {frames[-1]}: none in "
            "common"
        )
    offsets = [suggested + step for step in (-2, -1, 0, 1, 2)]
    usable = [frame for frame in frames if all(frame - offset in row_of for offset in offsets)]
    pairs = _moving_pairs(usable, tracking, {frame: row_of[frame - suggested] for frame in usable})
    if len(pairs) < 4:
        return OffsetEstimate(suggested, {}, suggested)
    carried = _VertexBrightness(head, tracking, image, pairs)
    changes = {
        offset: np.array(
            [carried.change(first, second, row_of[first - offset], row_of[second - offset]) for first, second in pairs]
        )
        for offset in offsets
    }
    return OffsetEstimate(
        _decide(changes, suggested), {offset: float(np.nanmean(found)) for offset, found in changes.items()}, suggested
    )


def brightness_changes(
    head: HeadModel, tracking: Tracking, frames: Sequence[int], image: Callable[[int], UInt8[np.ndarray, "H W 3"]]
) -> Float[np.ndarray, " N"]:
    """Change of brightness under the mesh (8-bit steps) between moving pairs of a capture's frames.

    Small if the tracking is right.
    """
    row_of = {frame: row for row, frame in enumerate(frames)}
    pairs = _moving_pairs(frames, tracking, row_of)[:: max(1, PAIRS // 40)]
    carried = _VertexBrightness(head, tracking, image, pairs)
    return np.array([carried.change(first, second, row_of[first], row_of[second]) for first, second in pairs])


def _decide(changes: dict[int, Float[np.ndarray, " N"]], suggested: int) -> int:
    """The offset with the least change if it is clearly better than the suggested one."""
    best = min(changes, key=lambda offset: float(np.nanmean(changes[offset])))
    lead = changes[suggested] - changes[best]
    lead = lead[np.isfinite(lead)]
    if not len(lead) or best == suggested:
        return suggested
    error = float(lead.std() / np.sqrt(len(lead)))
    clear = lead.mean() > max(MIN_RELATIVE_LEAD * float(np.nanmean(changes[suggested])), MIN_STANDARD_ERRORS * error)
    return best if clear else suggested


def _moving_pairs(frames: Sequence[int], tracking: Tracking, row_of: dict[int, int]) -> list[tuple[int, int]]:
    """Pairs of frames, `STEP` apart, between which the head moves most in the picture."""
    known = set(frames)
    pairs = [(frame, frame + STEP) for frame in frames if frame + STEP in known]
    if not pairs:
        return []
    first, second = (np.array([row_of[pair[side]] for pair in pairs]) for side in (0, 1))
    poses = tracking.world_to_camera
    turned = np.abs(poses[second, :3, :3] - poses[first, :3, :3]).sum(axis=(1, 2))
    turned += np.abs(tracking.joint_rotations[second] - tracking.joint_rotations[first]).sum(axis=(1, 2))
    moved = np.abs(poses[second, :3, 3] - poses[first, :3, 3]).sum(axis=1)
    moved += np.abs(tracking.translation[second] - tracking.translation[first]).sum(axis=1)
    order = np.argsort(-(0.1 * turned + moved), kind="stable")[:PAIRS]
    return [pairs[index] for index in sorted(order.tolist())]


class _VertexBrightness:
    """Brightness under the vertices of the face in pairs of frames, each picture read once."""

    def __init__(
        self,
        head: HeadModel,
        tracking: Tracking,
        image: Callable[[int], np.ndarray],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        self._head, self._tracking = head, tracking
        depth = head.template[:, 2].numpy()
        front = np.flatnonzero(depth > depth.min() + 0.6 * (depth.max() - depth.min()))
        self._vertices = front[:: max(1, len(front) // VERTICES)]
        self._projected: dict[int, np.ndarray] = {}
        frames = sorted({frame for pair in pairs for frame in pair})
        self._pictures = dict(zip(frames, ordered_map(lambda frame: _smooth_gray(image(frame)), frames), strict=True))

    def change(self, first: int, second: int, first_row: int, second_row: int) -> float:
        """Mean absolute difference between two frames, each seen through a row of the tracking.

        NaN if the face is not in the picture.
        """
        before, after = self._under(first, first_row), self._under(second, second_row)
        both = (before >= 0) & (after >= 0)
        return float(np.abs(before - after)[both].mean()) if both.any() else float("nan")

    def _under(self, frame: int, row: int) -> Float[np.ndarray, " N"]:
        """Brightness at the projected vertices; negative outside the picture."""
        if row not in self._projected:
            vertices = posed_vertices(self._head, self._tracking, row)[self._vertices]
            pixels, _ = project(vertices, self._tracking.intrinsics[row], self._tracking.world_to_camera[row])
            self._projected[row] = np.clip(pixels, -1e4, 1e4).astype(np.float32) - np.float32(0.5)
        place = self._projected[row]
        picture = self._pictures[frame].astype(np.float32)
        return cv2.remap(
            picture, place[:, :1], place[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1e4
        ).ravel()


def _smooth_gray(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W"]:
    """Brightness without detail finer than a tracker's error."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.GaussianBlur(gray, (0, 0), max(gray.shape) / 170)
