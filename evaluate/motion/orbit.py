"""Camera orbits: cameras rotated about the center of the head."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Drive
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.model import HeadModel


def head_center(head: HeadModel, drive: Drive) -> Float[Tensor, " 3"]:
    """Center of the posed head in the world, m: that of the box around face, scalp and ears, or around all vertices.

    Vertices of neck and shoulders, which some heads have, must not pull the center down.
    """
    vertices = head.vertices(drive)
    skull = [head.regions[name] for name in ("face", "scalp", "ears") if name in head.regions]
    chosen = vertices[torch.cat(skull)] if skull else vertices
    return (chosen.amin(dim=0) + chosen.amax(dim=0)) / 2


def orbit_camera(camera: Camera, center: Float[Tensor, " 3"], yaw: float, pitch: float) -> Camera:
    """The camera moved on a sphere about `center`, which stays fixed in the image.

    Args:
        camera: Starting camera.
        center: Point in the world, m.
        yaw: Rotation about the image's vertical axis, rad; positive moves the camera to its own right, so the cheek on
            the right of the image comes forward.
        pitch: Rotation about the image's horizontal axis, rad; positive moves the camera up, so the crown comes
            forward.
    """
    like = camera.world_to_camera
    about_y = axis_angle_to_matrix(like.new_tensor([0.0, yaw, 0.0]))
    about_x = axis_angle_to_matrix(like.new_tensor([pitch, 0.0, 0.0]))
    rotation = about_x @ about_y
    pivot = like[:3, :3] @ center + like[:3, 3]
    return Camera(camera.intrinsics, rigid(rotation, pivot - rotation @ pivot) @ like, camera.width, camera.height)


def orbit_angles(count: int, yaw: float, pitch: float) -> Iterator[tuple[float, float]]:
    """Yaw and pitch of a closed orbit: right and left, then up and down.

    Args:
        count: Number of views.
        yaw: Largest yaw to either side, in any unit.
        pitch: Largest pitch up and down, in the same unit.
    """
    for index in range(count):
        phase = index / count
        if phase < 0.5:
            yield yaw * math.sin(4 * math.pi * phase), 0.0
        else:
            yield 0.0, pitch * math.sin(4 * math.pi * (phase - 0.5))
