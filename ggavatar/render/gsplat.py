"""A yardstick on CUDA: the gsplat library behind our interface (Ye et al. 2025, arXiv 2409.06765; gsplat 1.5).

One constant cannot be set and differs from `ggavatar.render.constants`: gsplat 1.5.3 limits alpha to 0.999, not 0.99.
"""

from __future__ import annotations

import gsplat
import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.render.checks import camera_tensors, check_finite, check_shapes, gaussian_tensors
from ggavatar.render.constants import LOW_PASS, NEAR
from ggavatar.render.harmonics import used_degree


def rasterize(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
    """Render Gaussians on a constant background.

    Args:
        gaussians: On a CUDA device, float32.
        camera: Moved to the device of the Gaussians; differentiable in `world_to_camera`.
        background: sRGB color.

    Returns:
        The rendering; `radii` are gsplat's, in whole px.

    Raises:
        InputError: Shapes do not match, or a tensor holds NaN or infinity.
    """
    check_shapes(gaussians, camera, background)
    named = gaussian_tensors(gaussians) | camera_tensors(camera, background)
    if not _all_finite(list(named.values()), gaussians.means.device):
        check_finite(named)
    colors, harmonics = gaussians.colors, gaussians.colors.ndim == 3
    features, alpha, meta = gsplat.rasterization(
        means=gaussians.means,
        quats=gaussians.quats,
        scales=gaussians.scales,
        opacities=gaussians.opacities,
        colors=colors,
        viewmats=camera.world_to_camera.to(gaussians.means)[None],
        Ks=camera.intrinsics.to(gaussians.means)[None],
        width=camera.width,
        height=camera.height,
        near_plane=NEAR,
        eps2d=LOW_PASS,
        sh_degree=used_degree(colors.shape[1], gaussians.sh_degree) if harmonics else None,
        packed=False,
        backgrounds=background.to(gaussians.means)[None],
        render_mode="RGB+D",
        rasterize_mode="classic",
    )
    radii = meta["radii"][0].amax(-1)
    image, depth = features[0, ..., :3], features[0, ..., 3:]
    return Rendering(image, alpha[0], depth, _means2d_leaf(meta["means2d"], radii), radii)


def _all_finite(tensors: list[Tensor], device: torch.device) -> bool:
    """Whether all tensors are finite, with a single synchronization."""
    flags = [torch.isfinite(tensor.detach()).all().to(device) for tensor in tensors]
    return bool(torch.stack(flags).all())


def _means2d_leaf(means2d: Tensor, radii: Tensor) -> Tensor:
    """A leaf [N, 2] whose `.grad` receives the gradient of gsplat's [1, N, 2] during the backward pass."""
    leaf = torch.where(radii[:, None] > 0, means2d.detach()[0], 0)
    if means2d.requires_grad:
        leaf.requires_grad_()

        def receive(gradient: Tensor) -> None:
            leaf.grad = gradient[0].clone() if leaf.grad is None else leaf.grad + gradient[0]

        means2d.register_hook(receive)
    return leaf
