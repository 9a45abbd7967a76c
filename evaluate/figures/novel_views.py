"""The novel-view figure: one frame seen from several directions, a row of yaw and a row of pitch."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from evaluate.figures.contact_sheet import Row, contact_sheet, resize_to_width
from evaluate.motion.orbit import orbit_camera
from ggavatar.core import Avatar, Camera, Drive, Rasterizer
from ggavatar.data.background import Color
from ggavatar.pictures.quantization import to_8_bit

YAWS = (-40.0, -25.0, -12.0, 0.0, 12.0, 25.0, 40.0)
PITCHES = (-25.0, -16.0, -8.0, 0.0, 8.0, 16.0, 25.0)


@torch.no_grad()
def views_at(
    avatar: Avatar,
    rasterize: Rasterizer,
    view: tuple[Drive, Camera, Float[Tensor, " 3"]],
    angles: Sequence[tuple[float, float]],
    background: Color,
) -> list[UInt8[np.ndarray, "H W 3"]]:
    """The avatar with one drive, seen from several directions.

    Args:
        avatar: Poses the Gaussians, once for all views.
        rasterize: Renders the Gaussians.
        view: Drive, starting camera, and center of rotation, m.
        angles: Yaw and pitch of every view, degrees.
        background: sRGB in [0, 1].
    """
    drive, camera, center = view
    gaussians = avatar.gaussians(drive)
    color = center.new_tensor(background)
    cameras = [orbit_camera(camera, center, math.radians(yaw), math.radians(pitch)) for yaw, pitch in angles]
    return [to_8_bit(rasterize(gaussians, camera, color).image.float().cpu().numpy()) for camera in cameras]


def novel_views(
    avatar: Avatar,
    rasterize: Rasterizer,
    view: tuple[Drive, Camera, Float[Tensor, " 3"]],
    background: Color = (1.0, 1.0, 1.0),
    width: int = 256,
) -> UInt8[np.ndarray, "H W 3"]:
    """Seven views rotated about the vertical and seven about the horizontal image axis; the middle one is the frame.

    Args:
        avatar: Poses the Gaussians.
        rasterize: Renders the Gaussians.
        view: Drive, starting camera, and center of rotation, m.
        background: sRGB in [0, 1].
        width: Width of one image, px.
    """
    yawed = views_at(avatar, rasterize, view, [(yaw, 0.0) for yaw in YAWS], background)
    pitched = views_at(avatar, rasterize, view, [(0.0, pitch) for pitch in PITCHES], background)
    rows = [
        Row([resize_to_width(image, width) for image in yawed], "yaw", [_degrees(angle) for angle in YAWS]),
        Row([resize_to_width(image, width) for image in pitched], "pitch", [_degrees(angle) for angle in PITCHES]),
    ]
    return contact_sheet(rows, note="0° is the camera of the frame; the expression is fixed")


def _degrees(angle: float) -> str:
    return f"{angle:+.0f}°" if angle else "0°"
