"""The data that a method may use before its first step."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Drive, Frame, Rasterizer
from ggavatar.head.model import HeadModel


@dataclass(frozen=True)
class Scene:
    """The head, the drives and cameras of the training frames, and the training's settings; nothing of test frames.

    Attributes:
        head: The head model, on the training's device.
        drives: One drive per training frame.
        cameras: One camera per training frame, at the capture's resolution.
        background: Color behind the avatar, sRGB in [0, 1].
        steps: Length of the training; methods scale their schedules to it.
        seed: Seed of all random numbers.
        max_gaussians: Maximum number of Gaussians.
        samples: A few training frames, evenly spaced and small; empty when a trained avatar is opened.
        rasterize: The training's rasterizer, for `samples`; None when a trained avatar is opened.
    """

    head: HeadModel
    drives: tuple[Drive, ...]
    cameras: tuple[Camera, ...]
    background: Float[Tensor, "3"]
    steps: int
    seed: int = 42
    max_gaussians: int = 1_000_000
    samples: tuple[Frame, ...] = ()
    rasterize: Rasterizer | None = None
