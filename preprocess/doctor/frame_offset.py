"""Frame offset between tracking and video, estimated from brightness constancy under the mesh.

Trackers count frames from 0 or 1 and may drop leading frames, so the numbers alone are ambiguous (metrical-tracker's
`.frame` k is image k of its own `input` folder, but k + 1 of the frames that FlashAvatar extracts). Silhouettes hardly
change from one frame to the next, and hair and shoulders hide the change. A point of the face, however, keeps its
brightness while it moves: with the right offset the brightness under the projected vertices changes least.
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
"""How many pairs of frames are compared: those between which the head moves most."""

STEP = 4
"""Frames between the first and the second of a pair: enough for motion to outweigh the tracker's jitter."""

VERTICES = 1500
"""About how many vertices of the face are sampled."""

MIN_RELATIVE_LEAD, MIN_STANDARD_ERRORS = 0.02, 2.5
"""Lead (relative, and in standard errors) that an offset needs over the one that the numbers suggest."""


@dataclass(frozen=True)
class OffsetEstimate:
    """An estimated frame offset.

    Attributes:
        offset: Source frame number minus tracking frame number.
        scores: Mean brightness change (8-bit levels) under the mesh by offset, lower is better; empty if nothing
            could be compared.
        suggested: The offset that the numbers alone suggest.
    """

    offset: int
    scores: dict[int, float]
    suggested: int


def suggested_offset(numbers: Sequence[int], frames: Sequence[int]) -> int:
    """The offset that gives the most frames a tracking; among equals the smallest, so 0 wherever it loses nothing."""
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
    """Estimate the offset among −2 … +2 around the suggested one.

    Args:
        head: The head.
        tracking: Rows in the tracker's order, intrinsics in px of the capture.
        numbers: The tracker's frame number of each row.
        frames: Source frame numbers, ascending.
        image: Reads a source frame at the capture's size.

    Raises:
        InputError: The suggested offset gives no frame a tracking.
    """
    suggested = suggested_offset(numbers, frames)
    row_of = {number: row for row, number in enumerate(numbers)}
    if not any(frame - suggested in row_of for frame in frames):
        raise InputError(
            f"the tracking has frames {numbers[0]} … {numbers[-1]}, the video {frames[0]} … {frames[-1]}: no frame in "
            "common; check that they belong together, or give --frame-offset"
        )
    offsets = [suggested + step for step in (-2, -1, 0, 1, 2)]
    usable = [frame for frame in frames if all(frame - offset in row_of for offset in offsets)]
    pairs = _moving_pairs(usable, tracking, {frame: row_of[frame - suggested] for frame in usable})
    if len(pairs) < 4:
        return OffsetEstimate(suggested, {}, suggested)
    brightness = _VertexBrightness(head, tracking, image, pairs)
    changes = {
        offset: np.array(
            [
                brightness.change(first, second, row_of[first - offset], row_of[second - offset])
                for first, second in pairs
            ]
        )
        for offset in offsets
    }
    scores = {offset: mean_change(found) for offset, found in changes.items()}
    return OffsetEstimate(_decide(changes, suggested), scores, suggested)


def brightness_changes(
    head: HeadModel, tracking: Tracking, frames: Sequence[int], image: Callable[[int], UInt8[np.ndarray, "H W 3"]]
) -> Float[np.ndarray, " N"]:
    """Brightness change under the mesh (8-bit levels) for pairs of frames with motion; small if the tracking is right.

    NaN where the face is outside the image.
    """
    row_of = {frame: row for row, frame in enumerate(frames)}
    pairs = _moving_pairs(frames, tracking, row_of)[:: max(1, PAIRS // 40)]
    brightness = _VertexBrightness(head, tracking, image, pairs)
    return np.array([brightness.change(first, second, row_of[first], row_of[second]) for first, second in pairs])


def mean_change(changes: Float[np.ndarray, " N"]) -> float:
    """Mean brightness change over the pairs in which the face is inside the image; infinite if it never is."""
    seen = changes[np.isfinite(changes)]
    return float(seen.mean()) if len(seen) else np.inf


def _decide(changes: dict[int, Float[np.ndarray, " N"]], suggested: int) -> int:
    """The offset with the least change if it is clearly better than the suggested one, else that one."""
    best = min(changes, key=lambda offset: mean_change(changes[offset]))
    lead = changes[suggested] - changes[best]
    lead = lead[np.isfinite(lead)]
    if not len(lead) or best == suggested:
        return suggested
    error = float(lead.std() / np.sqrt(len(lead)))
    clear = lead.mean() > max(MIN_RELATIVE_LEAD * mean_change(changes[suggested]), MIN_STANDARD_ERRORS * error)
    return best if clear else suggested


def _moving_pairs(frames: Sequence[int], tracking: Tracking, row_of: dict[int, int]) -> list[tuple[int, int]]:
    """Pairs of frames, `STEP` apart, between which the head moves most."""
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
    """Brightness under the vertices of the face in pairs of frames; each image is read once."""

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
        self._images = dict(zip(frames, ordered_map(lambda frame: _smooth_gray(image(frame)), frames), strict=True))

    def change(self, first: int, second: int, first_row: int, second_row: int) -> float:
        """Mean absolute difference between two frames, each sampled under the mesh of a row of the tracking.

        NaN if the face is outside the image.
        """
        before, after = self._under(first, first_row), self._under(second, second_row)
        both = (before >= 0) & (after >= 0)
        return float(np.abs(before - after)[both].mean()) if both.any() else float("nan")

    def _under(self, frame: int, row: int) -> Float[np.ndarray, " N"]:
        """Brightness at the projected vertices; negative outside the image."""
        if row not in self._projected:
            vertices = posed_vertices(self._head, self._tracking, row)[self._vertices]
            pixels, _ = project(vertices, self._tracking.intrinsics[row], self._tracking.world_to_camera[row])
            self._projected[row] = np.clip(pixels, -1e4, 1e4).astype(np.float32) - np.float32(0.5)
        pixels = self._projected[row]
        image = self._images[frame].astype(np.float32)
        return cv2.remap(
            image, pixels[:, :1], pixels[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1e4
        ).ravel()


def _smooth_gray(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W"]:
    """Brightness, blurred to remove detail finer than a tracker's error."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.GaussianBlur(gray, (0, 0), max(gray.shape) / 170)
