"""The contact sheet `preview.jpg`: frames, the masked person on white, and the mesh overlaid on the frames."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from ggavatar.data.capture import Capture
from ggavatar.head.mesh_overlay import mesh_over
from ggavatar.head.model import HeadModel
from ggavatar.io.images import write_jpeg
from ggavatar.text.names import displayable
from preprocess.tracking.geometry.projection import posed_vertices, project

COLUMNS, SIDE, LINE = 8, 256, 24
MAX_LINES = 20
"""Most lines on dropped frames."""


def write_preview(capture: Capture, head: HeadModel) -> None:
    """Write preview.jpg: eight frames of the clip in three rows; below, the dropped frames."""
    count = min(COLUMNS, len(capture.frames))
    rows = [round(position) for position in np.linspace(0, len(capture.frames) - 1, count)]
    columns = [_column(capture, head, row) for row in rows]
    sheet = np.concatenate(columns, axis=1)
    if capture.dropped:
        sheet = np.concatenate((sheet, dropped_strip(capture.dropped, sheet.shape[1])))
    write_jpeg(capture.folder / "preview.jpg", sheet)


def dropped_strip(dropped: Sequence[Mapping[str, Any]], width: int) -> UInt8[np.ndarray, "h w 3"]:
    """A strip of text with the dropped frames, one line for each reason."""
    numbers: dict[str, list[int]] = {}
    for item in dropped:
        numbers.setdefault(str(item.get("reason", "dropped")), []).append(int(item.get("frame", -1)))
    lines = [f"left out: {len(found)} x {reason}: {_ranges(found)}" for reason, found in numbers.items()]
    if len(lines) > MAX_LINES:
        lines = [*lines[: MAX_LINES - 1], f"... {len(lines) - MAX_LINES + 1} more reasons in capture.json"]
    strip = np.zeros((LINE * len(lines) + 8, width, 3), np.uint8)
    for place, line in enumerate(lines):
        strip = cv2.putText(
            strip,
            drawable(line)[: width // 9],
            (6, LINE * place + 18),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.5,
            (255, 255, 0),
            1,
            cv2.LINE_AA,
        )
    return strip


def drawable(text: str) -> str:
    """The text in the characters of OpenCV's fonts, ASCII: letters without their accents, `?` for all others."""
    decomposed = unicodedata.normalize("NFKD", displayable(text))
    return "".join(c for c in decomposed if not unicodedata.combining(c)).encode("ascii", "replace").decode()


def _ranges(numbers: Sequence[int]) -> str:
    groups = np.split(np.asarray(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    return ", ".join(f"{group[0]}" if len(group) == 1 else f"{group[0]}-{group[-1]}" for group in groups)


def _column(capture: Capture, head: HeadModel, row: int) -> UInt8[np.ndarray, "h w 3"]:
    """One column: the frame, the person on white, the mesh over the frame."""
    number = capture.frames[row]
    image, mask = capture.image(number), capture.mask(number)
    alpha = mask[..., None].astype(np.float32) / 255
    cutout = np.round(image * alpha + 255 * (1 - alpha)).astype(np.uint8)
    scale = SIDE / max(image.shape[:2])
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small, cut = (cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (image, cutout))
    labeled = cv2.putText(
        small.copy(), str(number), (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 0), 1, cv2.LINE_AA
    )
    return np.concatenate((labeled, cut, mesh_of_row(small, capture, head, row, scale)))


def mesh_of_row(
    image: UInt8[np.ndarray, "h w 3"], capture: Capture, head: HeadModel, row: int, scale: float
) -> UInt8[np.ndarray, "h w 3"]:
    """The image, which is `scale` times the capture's size, overlaid with the mesh of one row of the tracking."""
    tracking = capture.tracking
    vertices = posed_vertices(head, tracking, row)
    pixels, depth = project(vertices, tracking.intrinsics[row], tracking.world_to_camera[row])
    return mesh_over(image, vertices, head.faces.numpy(), pixels * scale, depth)
