"""Pixels inside a convex outline.

`skimage.draw.polygon2mask` on the hull's corners gives the same masks in twice the time; `cv2.fillConvexPoly` also
fills pixels that the outline merely touches, some 200 of them in an image of 256 px.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor


def hull_mask(points: Float[Tensor, "N 2"], height: int, width: int) -> Float[Tensor, "H W 1"]:
    """1 where a pixel's center lies in the convex hull of `points` (px), else 0; all 0 if the points are collinear."""
    return outline_mask(hull_outline(points), height, width, points.dtype)


def hull_outline(points: Float[Tensor, "N 2"]) -> Float64[Tensor, "K 3"]:
    """Half planes a·x + b·y + c ≤ 0 (px) that bound the convex hull; one without points if the points are collinear.

    They are computed on the CPU, for which the host waits, and returned on the device of the points.
    """
    try:
        half_planes = ConvexHull(points.detach().cpu().double().numpy()).equations
    except (QhullError, ValueError):
        half_planes = np.array([[0.0, 0.0, 1.0]])
    return torch.from_numpy(half_planes).to(points.device)


def outline_mask(
    half_planes: Float64[Tensor, "K 3"], height: int, width: int, dtype: torch.dtype = torch.float32
) -> Float[Tensor, "H W 1"]:
    """1 where a pixel's center lies in all half planes, else 0."""
    x, y = (torch.arange(size, dtype=torch.float64, device=half_planes.device) + 0.5 for size in (width, height))
    a, b, c = half_planes.unbind(1)
    outside = x[None, :, None] * a + y[:, None, None] * b + c > 0
    return outside.any(-1, keepdim=True).logical_not().to(dtype)
