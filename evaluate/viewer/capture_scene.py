"""A capture on show: frame, person, mask, landmarks and mesh of every frame, as the doctor and a training see them."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from evaluate.viewer.orbit import Place
from evaluate.viewer.playback import Playback
from evaluate.viewer.tiles import side_by_side
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.head.files import load_head
from ggavatar.head.mesh_overlay import mesh_over

FRAME, PERSON, MASK, LANDMARKS, MESH, ALL = MODES = ("frame", "person", "mask", "landmarks", "mesh", "all")
PIVOT = np.array([0.0, 0.0, 1.0])
"""The browser's orbit; only nearer, farther and sideways have a meaning for pictures."""
FIELD_OF_VIEW = math.radians(75)
"""Of the browser's camera, which decides how far a picture moves with the mouse."""
GRAY = (72, 72, 72)
"""Around the pictures."""
POINT_COLOR = (255, 60, 60)


@dataclass(frozen=True)
class ShownFrame:
    """What is shown of a capture: where its clip stands, and which of `MODES`."""

    clip: Playback
    mode: str = ALL


class CaptureScene:
    """The scene of a capture. Its state is replaced as a whole, by any thread; pictures are drawn by one."""

    pivot = PIVOT

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        self.head = load_head(capture.head_path).to("cpu", torch.float32)
        self._drives, self._cameras = drives_and_cameras(capture, self.head, "cpu")
        self._lock = threading.Lock()
        self.shown = ShownFrame(Playback(capture.frames, capture.fps))
        self.changed: Callable[[], None] = lambda: None
        self._last: tuple[Hashable, UInt8[np.ndarray, "H W 3"]] | None = None

    def update(self, change: Callable[[ShownFrame], ShownFrame]) -> None:
        """Replace what is shown."""
        with self._lock:
            self.shown = change(self.shown)
        self.changed()

    def moment(self, now: float) -> Hashable:
        """What the picture depends on besides a browser's camera."""
        return self.shown.clip.index(now), self.shown.mode

    def plays(self) -> bool:
        """Whether the clip plays."""
        return self.shown.clip.is_playing

    def picture(self, place: Place, size: tuple[int, int], now: float) -> UInt8[np.ndarray, "H W 3"]:
        """The picture, nearer and moved as the browser's camera is."""
        shown = self.shown
        return zoomed(self._sheet(shown.clip.frame(now), shown.mode, size), place)

    def _sheet(self, number: int, mode: str, size: tuple[int, int]) -> UInt8[np.ndarray, "H W 3"]:
        """What is to be seen of a frame, in a picture of a size; the last one is kept."""
        key = (number, mode, size)
        if self._last is None or self._last[0] != key:
            self._last = key, self._composed(number, mode, size)
        return self._last[1]

    def _composed(self, number: int, mode: str, size: tuple[int, int]) -> UInt8[np.ndarray, "H W 3"]:
        if mode != ALL:
            return side_by_side([self.view(number, mode)], size, GRAY)
        width, height = size
        upper, lower = (
            side_by_side([self.view(number, one) for one in pair], (width, high), GRAY)
            for pair, high in (((FRAME, PERSON), height // 2), ((LANDMARKS, MESH), height - height // 2))
        )
        return np.concatenate((upper, lower))

    def view(self, number: int, mode: str) -> UInt8[np.ndarray, "H W 3"]:
        """One of `MODES` but `ALL` of a frame, at the capture's size."""
        if mode == MASK:
            return np.repeat(self.capture.mask(number)[..., None], 3, axis=2)
        image = self.capture.image(number)
        if mode == PERSON:
            alpha = self.capture.mask(number)[..., None].astype(np.float32) / 255
            return np.rint(image * alpha + 255 * (1 - alpha)).astype(np.uint8)
        if mode == LANDMARKS:
            return self._with_landmarks(image, number)
        return self._with_mesh(image, number) if mode == MESH else image

    def _with_landmarks(self, image: UInt8[np.ndarray, "H W 3"], number: int) -> UInt8[np.ndarray, "H W 3"]:
        stored = self.capture.tracking.landmarks
        if stored is None:
            return image
        points = stored[self.capture.row(number)]
        drawn = image.copy()
        radius = max(1, round(self.capture.height / 400))
        for x, y in points[np.isfinite(points).all(axis=1)]:
            if abs(x) < 1e5 and abs(y) < 1e5:
                cv2.circle(drawn, (int(x), int(y)), radius, POINT_COLOR, cv2.FILLED, cv2.LINE_AA)
        return drawn

    def _with_mesh(self, image: UInt8[np.ndarray, "H W 3"], number: int) -> UInt8[np.ndarray, "H W 3"]:
        row = self.capture.row(number)
        camera = self._cameras[row]
        with torch.no_grad():
            vertices = self.head.vertices(self._drives[row])
            seen = vertices @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            depth = seen[:, 2]
            pixels = (seen @ camera.intrinsics.T)[:, :2] / torch.where(depth.abs() > 1e-6, depth, 1e-6)[:, None]
        corners, where, distance = (one.numpy().astype(np.float64) for one in (vertices, pixels, depth))
        return mesh_over(image, corners, self.head.faces.numpy(), where, distance)


def zoomed(picture: UInt8[np.ndarray, "H W 3"], place: Place) -> UInt8[np.ndarray, "H W 3"]:
    """The picture as seen by a browser's camera that comes nearer or moves sideways; its turns are passed over."""
    height, width = picture.shape[:2]
    to_camera = Rotation.from_quat(np.roll(place.wxyz, -1)).as_matrix().T
    x, y, depth = to_camera @ -np.array(place.position)
    scale = float(PIVOT[2]) / max(depth, 1e-3)
    focal = height / 2 / math.tan(FIELD_OF_VIEW / 2)
    motion: Float[np.ndarray, "2 3"] = np.array(
        [
            [scale, 0, (1 - scale) * width / 2 + focal * x / max(depth, 1e-3)],
            [0, scale, (1 - scale) * height / 2 + focal * y / max(depth, 1e-3)],
        ]
    )
    if np.allclose(motion, [[1, 0, 0], [0, 1, 0]], atol=1e-3):
        return picture
    smooth = cv2.INTER_LINEAR if scale < 3 else cv2.INTER_NEAREST  # single pixels can be looked at
    moved: UInt8[np.ndarray, "H W 3"] = cv2.warpAffine(picture, motion, (width, height), flags=smooth, borderValue=GRAY)
    return moved


def at(shown: ShownFrame, clip: Playback) -> ShownFrame:
    """What is shown, with the clip at another place."""
    return dataclasses.replace(shown, clip=clip)
