"""The pictures that refinement compares with: small, on a background, all in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from ggavatar.data.capture import Tracking
from ggavatar.head.model import HeadModel
from ggavatar.io.ordered_map import ordered_map
from preprocess.refinement.objective import pixel_weights
from preprocess.tracking.geometry.projection import posed_vertices, project
from preprocess.tracking.torso.torso import FACE_DEPTH


@dataclass(frozen=True)
class Pictures:
    """Small pictures of some rows of a tracking.

    Attributes:
        rows: Rows of the tracking.
        colors: Composited on the background.
        coverage: Of the person, 255 = person.
        face: Pixels within the outline of the tracked face.
        full_size: Width and height of the images they were made from, px.
    """

    rows: tuple[int, ...]
    colors: UInt8[np.ndarray, "T H W 3"]
    coverage: UInt8[np.ndarray, "T H W"]
    face: Bool[np.ndarray, "T H W"]
    full_size: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.colors.shape[2], self.colors.shape[1]

    def picture(self, place: int) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W 1"], Float[Tensor, "H W 1"]]:
        """Colors and coverage in [0, 1], and the weights of the pixels."""
        colors, coverage = (torch.from_numpy(part[place]).float() / 255 for part in (self.colors, self.coverage))
        face = torch.from_numpy(self.face[place])[..., None]
        return colors, coverage[..., None], pixel_weights(coverage[..., None], face)


def read_pictures(
    rows: Sequence[int],
    read: Callable[[int], tuple[np.ndarray, np.ndarray]],
    side: int,
    face: Callable[[int], np.ndarray],
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Pictures:
    """Read and shrink pictures on several threads.

    Args:
        rows: Rows of the tracking, ascending.
        read: Gives the 8-bit image and mask of a row; thread-safe.
        side: Longer side of the small pictures, px; they are never enlarged.
        face: Gives points of the face of a row in the image, px [N, 2], whose convex hull is its outline.
        background: Color behind the person, sRGB in [0, 1].
    """
    behind = np.asarray(background, np.float32) * 255

    def small(row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, int]]:
        """Colors on the background, alpha and outline of the face of a row, reduced; and its size before."""
        image, mask = read(row)
        full = image.shape[1], image.shape[0]
        factor = min(1.0, side / max(full))
        coverage = mask.astype(np.float32)[..., None] / 255
        composed = image * coverage + behind * (1 - coverage)
        size = round(full[0] * factor), round(full[1] * factor)
        shrunk = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (composed, coverage[..., 0] * 255))
        colors, alpha = (np.rint(part).astype(np.uint8) for part in shrunk)
        outline = np.zeros(alpha.shape, np.uint8)
        hull = cv2.convexHull((face(row) * factor - 0.5).astype(np.float32))
        cv2.fillConvexPoly(outline, np.rint(hull).astype(np.int32), 1)
        return colors, alpha, outline > 0, full

    colors, coverage, faces, sizes = zip(*ordered_map(small, rows), strict=True)
    return Pictures(tuple(rows), np.stack(colors), np.stack(coverage), np.stack(faces), sizes[-1])


def face_points(head: HeadModel, tracking: Tracking, row: int) -> Float[np.ndarray, "N 2"]:
    """Front vertices of the head in the image, px: those within `FACE_DEPTH` of the foremost one, no torso among them.

    Points far outside the image, as of a head that a tracker has lost, are brought near to it.
    """
    root = head.skinning_weights[:, head.joint_index("root")].numpy() if "root" in head.joint_names else 0.0
    torso = root + (head.skinning_weights[:, head.joint_index("torso")].numpy() if "torso" in head.joint_names else 0.0)
    depth = np.where(torso + np.zeros(len(head.template)) < 0.01, head.template[:, 2].numpy(), -np.inf)
    front = np.flatnonzero(depth > depth.max() - FACE_DEPTH)
    vertices = posed_vertices(head, tracking, row)[front]
    seen, _ = project(vertices, tracking.intrinsics[row], tracking.world_to_camera[row])
    return np.clip(seen, -1e4, 1e4)
