"""The tracked head in the image: posed vertices, their projection and the silhouette they fill.

`project` returns depths beside the pixels and guards against points in the camera's plane, which
`ggavatar.geometry.transforms.project` (torch) does not; `rigid.project_to_pixels` takes camera-space points of many
frames and divides in another order, so that results would differ in the last bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from ggavatar.core import Drive
from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel

_SUBPIXEL_BITS = 4
LARGE_TRIANGLE = 24
"""Triangles sampled more finely than this along an edge are filled one by one, not by samples."""


def drive_of(tracking: Tracking, row: int) -> Drive:
    """The drive in one row of a tracking."""

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))

    return Drive(
        expression=tensor(tracking.expression[row]),
        joint_rotations=tensor(tracking.joint_rotations[row]),
        eyelids=tensor(tracking.eyelids[row]),
        translation=tensor(tracking.translation[row]),
        head_to_camera=tensor(tracking.world_to_camera[row]),
    )


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread: a head model is too small to gain from more, which wait for each other under load."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def posed_vertices(head: HeadModel, tracking: Tracking, row: int) -> Float[np.ndarray, "V 3"]:
    """World positions of the head's vertices in one frame, m."""
    with torch.no_grad():
        return head.vertices(drive_of(tracking, row)).numpy().astype(np.float64)


def project(
    points: Float[np.ndarray, "N 3"], intrinsics: Float[np.ndarray, "3 3"], world_to_camera: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"]]:
    """Pixel positions and camera depths (m) of world points; pixels of points behind the camera are meaningless."""
    in_camera = points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    depth = in_camera[:, 2]
    homogeneous = in_camera @ intrinsics.T
    return homogeneous[:, :2] / np.where(np.abs(depth) > 1e-6, depth, 1e-6)[:, None], depth


def silhouette(
    pixels: Float[np.ndarray, "V 2"],
    depth: Float[np.ndarray, " V"],
    faces: Int[np.ndarray, "F 3"],
    size: tuple[int, int],
) -> Bool[np.ndarray, "H W"]:
    """Pixels covered by a projected mesh.

    Args:
        pixels: Projected vertices, px.
        depth: Camera depths of the vertices, m; faces that reach behind the camera are left out.
        faces: Vertex indices.
        size: Width and height of the image, px.
    """
    width, height = size
    image = np.zeros((height, width), np.uint8)
    corners = pixels[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    kept = (depth[faces] > 1e-3).all(axis=1) & (np.abs(corners) < 4 * max(width, height)).all(axis=(1, 2))
    kept &= (high > 0).all(axis=1) & (low < [width, height]).all(axis=1)
    corners = corners[kept]
    samples = np.ceil(1.5 * (high - low)[kept].max(axis=1, initial=0)).astype(int).clip(1)
    for count in np.unique(samples).tolist():
        group = corners[samples == count]
        if count > LARGE_TRIANGLE:
            _fill(image, group)
        else:
            _sample(image, group, count)
    return image > 0


def _fill(image: np.ndarray, corners: Float[np.ndarray, "F 3 2"]) -> None:
    """Fill triangles one by one; OpenCV's pixel centers are at 0, ours at +0.5."""
    for triangle in np.round((corners - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32):
        cv2.fillConvexPoly(image, triangle, 255, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)


def _sample(image: np.ndarray, corners: Float[np.ndarray, "F 3 2"], count: int) -> None:
    """Fill small triangles all at once, by samples less than a pixel apart."""
    first, second = (axis.ravel() for axis in np.meshgrid(np.arange(count + 1), np.arange(count + 1)))
    inside = first + second <= count
    weights = np.stack((first, second, count - first - second))[:, inside].astype(np.float32) / np.float32(count)
    across, down = np.floor(corners.transpose(2, 0, 1).astype(np.float32) @ weights).astype(np.int32)
    within = (across >= 0) & (across < image.shape[1]) & (down >= 0) & (down < image.shape[0])
    image[down[within], across[within]] = 255


def mask_iou(left: Bool[np.ndarray, "H W"], right: Bool[np.ndarray, "H W"]) -> float:
    """Intersection over union of two masks; 0 if both are empty."""
    union = np.count_nonzero(left | right)
    return np.count_nonzero(left & right) / union if union else 0.0
