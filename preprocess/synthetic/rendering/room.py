"""The camera of the room in which the generated person sits."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from ggavatar.geometry.transforms import look_at

_EYE = np.array([0.0, -0.010, 0.980])  # m, in the room
_TARGET = np.array([0.0, -0.022, 0.0])  # m, in the room
_FOCAL = 2.30  # focal length / image size


def intrinsics(size: int) -> Float[ndarray, "3 3"]:
    """Intrinsics of a square image of `size` px."""
    return np.array([[_FOCAL * size, 0.0, size / 2], [0.0, _FOCAL * size, size / 2], [0.0, 0.0, 1.0]])


def room_to_camera() -> Float[ndarray, "4 4"]:
    """The camera's fixed pose: from the room to OpenCV camera axes, m."""
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    return look_at(torch.from_numpy(_EYE), torch.from_numpy(_TARGET), up).numpy()


def camera_position() -> Float[ndarray, " 3"]:
    """The camera's position in the room, m."""
    return _EYE.copy()
