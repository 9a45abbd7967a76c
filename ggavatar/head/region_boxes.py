"""Image boxes of mouth and eyes, for crops and weighted losses."""

from __future__ import annotations

import torch

from ggavatar.core import Frame
from ggavatar.geometry.transforms import project
from ggavatar.head.model import HeadModel


@torch.no_grad()
def region_boxes(head: HeadModel, frame: Frame) -> list[tuple[float, float, float, float]]:
    """Bounding boxes (left, top, right, bottom) of the head's mouth and eye regions in the image, px."""
    names = [name for name in ("mouth", "lips", "eyes", "left_eye", "right_eye") if name in head.regions]
    if not names:
        return []
    seen = project(head.vertices(frame.drive), frame.camera.intrinsics, frame.camera.world_to_camera)
    boxes = [torch.cat((seen[head.regions[name]].amin(0), seen[head.regions[name]].amax(0))).tolist() for name in names]
    return [(left, top, right, bottom) for left, top, right, bottom in boxes]
