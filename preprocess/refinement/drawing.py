"""A tracked frame as differentiable values: its drive and its camera, from the arrays of a tracking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ggavatar.core import Camera, Drive
from ggavatar.data.capture import Tracking
from ggavatar.data.frames import head_pose
from ggavatar.head.model import HeadModel
from preprocess.refinement.corrections import CHANGED


@dataclass(frozen=True)
class Leaves:
    """The arrays of one frame that refinement changes, as tensors of which gradients are wanted."""

    values: dict[str, Tensor]

    @staticmethod
    def of(tracking: Tracking, row: int, wanted: bool, dtype: torch.dtype = torch.float32) -> Leaves:
        """The arrays of a row; with gradients if `wanted`."""
        return Leaves(
            {
                name: torch.tensor(array[row], dtype=dtype).requires_grad_(wanted)
                for name, array in Leaves.arrays(tracking).items()
            }
        )

    @staticmethod
    def arrays(tracking: Tracking) -> dict[str, np.ndarray]:
        """The arrays of a tracking that refinement changes, by name."""
        return {name: array for name, array in tracking.arrays().items() if name in CHANGED}

    def gradients(self) -> dict[str, np.ndarray]:
        """Gradients by name after a backward pass; zero where none arrived."""
        return {
            name: np.zeros(value.shape) if value.grad is None else value.grad.double().numpy()
            for name, value in self.values.items()
        }


def drive_of(head: HeadModel, tracking: Tracking, row: int, leaves: Leaves) -> Drive:
    """The drive of one frame, differentiable in its leaves; what they do not hold is taken from the tracking."""
    values = leaves.values
    translation = torch.tensor(tracking.translation[row]).to(values["expression"])
    return Drive(
        expression=values["expression"],
        joint_rotations=values["joint_rotations"],
        eyelids=values["eyelids"],
        translation=translation,
        head_to_camera=values["world_to_camera"] @ head_pose(head, values["joint_rotations"], translation),
        torso_to_camera=values.get("torso_to_camera"),
    )


def camera_of(tracking: Tracking, row: int, leaves: Leaves, full: tuple[int, int], size: tuple[int, int]) -> Camera:
    """The camera of one frame for a picture of `size` (px) made from an image of `full` size (px)."""
    view = leaves.values["world_to_camera"]
    return Camera(torch.tensor(tracking.intrinsics[row]).to(view), view, *full).resized(*size)
