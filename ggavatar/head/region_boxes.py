"""Image boxes of mouth and eyes, for crops and weighted losses."""

from __future__ import annotations

import torch

from ggavatar.core import Drive, Frame
from ggavatar.geometry.transforms import project
from ggavatar.head.model import HeadModel

Box = tuple[float, float, float, float]
"""Left, top, right and bottom of an image region, px."""


class RegionBoxes:
    """The boxes of frames, computed at a frame's first visit: to know them, the host waits for the device."""

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._known: dict[tuple[int, int, int], tuple[Drive, list[Box]]] = {}

    def of(self, frame: Frame) -> list[Box]:
        """`region_boxes` of a frame, from an earlier visit if it had the same drive and size."""
        number, camera = frame.drive.frame, frame.camera
        if number is None:
            return region_boxes(self._head, frame)
        key = number, camera.width, camera.height
        drive, boxes = self._known.get(key, (None, []))
        if drive is not frame.drive:
            boxes = region_boxes(self._head, frame)
            self._known[key] = frame.drive, boxes
        return boxes


@torch.no_grad()
def region_boxes(head: HeadModel, frame: Frame) -> list[Box]:
    """Bounding boxes (left, top, right, bottom) of the head's mouth and eye regions in the image, px."""
    names = [name for name in ("mouth", "lips", "eyes", "left_eye", "right_eye") if name in head.regions]
    if not names:
        return []
    seen = project(head.vertices(frame.drive), frame.camera.intrinsics, frame.camera.world_to_camera)
    boxes = [torch.cat((seen[head.regions[name]].amin(0), seen[head.regions[name]].amax(0))) for name in names]
    return [(left, top, right, bottom) for left, top, right, bottom in torch.stack(boxes).tolist()]
