"""What a method may look at before its first step."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Drive, Frame, Rasterizer
from ggavatar.head.model import HeadModel


@dataclass(frozen=True)
class Scene:
    """A head, how it moves in training, and the plan of the training. Test frames are not in it.

    Attributes:
        head: The head model, on the device of the training.
        drives: What moves the head, one a training frame.
        cameras: Where each training frame is seen from, at the capture's resolution.
        background: Color behind the avatar, sRGB in [0, 1].
        steps: Length of the training; methods scale their schedules to it.
        seed: From which every random number derives.
        max_gaussians: Largest number of Gaussians allowed.
        samples: A few training frames, evenly spaced and small; empty when a trained avatar is opened.
        rasterize: The renderer of the training, to be used with `samples`; None when a trained avatar is opened.
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
