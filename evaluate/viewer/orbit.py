"""From the camera of a browser's view to ours.

The browser orbits in a space of its own: the point about which it turns is the origin, +y is up in the picture, and at
rest the camera is on +z and sees what ours saw. So the view that a browser adds is a rigid motion in the space of
our camera, whichever frame's camera that is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ggavatar.core import Camera

FLIP = np.diag([1.0, -1.0, -1.0])
"""From the browser's axes (y up, z towards the camera) to those of an OpenCV camera."""

Range = tuple[float, float]


@dataclass(frozen=True)
class Bounds:
    """How far the view may turn, rad.

    Attributes:
        yaw: Least and most rotation about the picture's vertical axis.
        pitch: The same about its horizontal axis.
    """

    yaw: Range
    pitch: Range


@dataclass(frozen=True)
class Place:
    """A browser's window and camera.

    Attributes:
        width: Of the window, px.
        height: Of the window, px.
        wxyz: Rotation of the camera in the browser's space: OpenCV camera to world.
        position: Of the camera in the browser's space, m.
    """

    width: int
    height: int
    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]


def resting_place(pivot: Float[np.ndarray, "3"], width: int, height: int) -> Place:
    """The place from which a browser sees what our camera sees."""
    return Place(width, height, (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, float(pivot[2])))


def added_view(place: Place, pivot: Float[np.ndarray, "3"], bounds: Bounds | None = None) -> Float[np.ndarray, "4 4"]:
    """The motion in our camera's space that a browser adds.

    Args:
        place: Of the browser's camera.
        pivot: The point about which it turns, in our camera's space at rest, m.
        bounds: How far it may turn; None is free.
    """
    to_camera = Rotation.from_quat(np.roll(place.wxyz, -1)).as_matrix().T
    shift = np.array([pivot[0], pivot[1], 0.0])
    center = shift - to_camera @ np.array(place.position)
    turn = to_camera @ FLIP
    if bounds is not None:
        turn = bounded(turn, bounds)
    added = np.eye(4)
    added[:3, :3], added[:3, 3] = turn, center - turn @ pivot
    return added


def bounded(turn: Float[np.ndarray, "3 3"], bounds: Bounds) -> Float[np.ndarray, "3 3"]:
    """A rotation Rx(pitch) Ry(yaw) with both angles within their bounds; a turn about the view axis is dropped."""
    yaw = np.clip(np.arctan2(turn[0, 2], turn[0, 0]), *bounds.yaw)
    pitch = np.clip(np.arctan2(turn[2, 1], turn[1, 1]), *bounds.pitch)
    kept: np.ndarray = (Rotation.from_rotvec([pitch, 0, 0]) * Rotation.from_rotvec([0, yaw, 0])).as_matrix()
    return kept


def moved_camera(camera: Camera, added: Float[np.ndarray, "4 4"]) -> Camera:
    """A camera with a motion added in its own space."""
    motion = torch.as_tensor(added).to(camera.world_to_camera)
    return Camera(camera.intrinsics, motion @ camera.world_to_camera, camera.width, camera.height)


def filling(camera: Camera, width: int, height: int) -> Camera:
    """A camera whose picture has another size, in which all that the camera sees is as large as possible."""
    scale = min(width / camera.width, height / camera.height)
    fitted = camera.intrinsics.clone()
    fitted[:2] *= scale
    fitted[0, 2] += (width - scale * camera.width) / 2
    fitted[1, 2] += (height - scale * camera.height) / 2
    return Camera(fitted, camera.world_to_camera, width, height)
