"""Several drawings in one call."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rasterizer, Rendering
from ggavatar.errors import InputError


def rasterize_batch(
    rasterize: Rasterizer,
    gaussians: Sequence[Gaussians] | Gaussians,
    cameras: Sequence[Camera],
    background: Float[Tensor, " 3"],
) -> list[Rendering]:
    """Draw one set of Gaussians per camera, or the same set for all cameras; the results are those of single calls.

    Every drawing already uses all cores, so they are made one after the other and the memory is that of one.

    Raises:
        InputError: The numbers of sets and of cameras differ.
    """
    sets = [gaussians] * len(cameras) if isinstance(gaussians, Gaussians) else list(gaussians)
    if len(sets) != len(cameras):
        raise InputError(f"expected as many sets of Gaussians as cameras, found {len(sets)} and {len(cameras)}")
    return [rasterize(one, camera, background) for one, camera in zip(sets, cameras, strict=True)]
