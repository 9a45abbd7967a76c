"""Structural dissimilarity as a training loss: 1 − SSIM in the variant of 3D Gaussian Splatting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import conv2d

from ggavatar.acceleration import compiled_for

WINDOW, SIGMA = 11, 1.5
LUMINANCE, CONTRAST = 0.01**2, 0.03**2


@dataclass(frozen=True)
class DssimTarget:
    """A ground-truth image with the blurs that every comparison needs, so that each frame pays for them once.

    Attributes:
        image: The image, [0, 1].
        mean: Its Gaussian-weighted local mean.
        square_mean: The Gaussian-weighted local mean of its square.
    """

    image: Float[Tensor, "H W C"]
    mean: Float[Tensor, "H W C"]
    square_mean: Float[Tensor, "H W C"]

    @staticmethod
    def of(image: Float[Tensor, "H W C"]) -> DssimTarget:
        """Blur `image` and its square."""
        image = image.detach().contiguous()
        if image.shape[-1] == 3 and compiled_for(image):
            return _compiled_target(image)
        mean, square_mean = _blur(torch.cat((image, image.square()), dim=-1)).chunk(2, dim=-1)
        return DssimTarget(image, mean.contiguous(), square_mean.contiguous())


def dssim(image: Float[Tensor, "H W C"], target: DssimTarget | Float[Tensor, "H W C"]) -> Float[Tensor, ""]:
    """1 − mean SSIM over pixels and channels, in [0, 2].

    An 11×11 Gaussian window with σ = 1.5 px, zero padding, C1 = 0.01², C2 = 0.03² for a range of 1; not halved
    (docs/paper.md, A17).

    Args:
        image: The drawn image; the gradient flows here only.
        target: The ground truth, best as a `DssimTarget` kept from step to step.

    References:
        Wang et al. 2004; Kerbl et al. 2023 (zero padding, no sample covariance).
    """
    target = target if isinstance(target, DssimTarget) else DssimTarget.of(target)
    if image.shape[-1] == 3 and compiled_for(image, target.image):
        return cast(Tensor, _CompiledDssim.apply(image, target))
    return dssim_in_torch(image, target)


def dssim_in_torch(image: Float[Tensor, "H W C"], target: DssimTarget) -> Float[Tensor, ""]:
    """`dssim` in plain torch: any dtype and device."""
    mean, square_mean, cross_mean = _blur(torch.cat((image, image.square(), image * target.image), dim=-1)).chunk(
        3, dim=-1
    )
    variance, target_variance = square_mean - mean.square(), target.square_mean - target.mean.square()
    covariance = cross_mean - mean * target.mean
    luminance = (2 * mean * target.mean + LUMINANCE) / (mean.square() + target.mean.square() + LUMINANCE)
    structure = (2 * covariance + CONTRAST) / (variance + target_variance + CONTRAST)
    return 1 - (luminance * structure).mean()


def _blur(maps: Float[Tensor, "H W K"]) -> Float[Tensor, "H W K"]:
    """Gaussian-weighted local means with zeros beyond the border."""
    offsets = torch.arange(WINDOW, dtype=maps.dtype, device=maps.device) - WINDOW // 2
    line = torch.softmax(-offsets.square() / (2 * SIGMA**2), dim=0)
    count = maps.shape[-1]
    kernel = torch.outer(line, line).expand(count, 1, WINDOW, WINDOW)
    return conv2d(maps.permute(2, 0, 1)[None], kernel, padding=WINDOW // 2, groups=count)[0].permute(1, 2, 0)


class _CompiledDssim(torch.autograd.Function):
    """The compiled kernel; the gradient is found in the forward sweep, since only a factor is missing."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: DssimTarget) -> Tensor:
        from ggavatar import dssim_kernel

        wanted = ctx.needs_input_grad[0]
        gradient = torch.empty(image.shape if wanted else (0, *image.shape[1:]))
        total = dssim_kernel.compare(
            *(_matrix(a) for a in (image, target.image, target.mean, target.square_mean, gradient))
        )
        ctx.save_for_backward(gradient)
        return image.new_tensor(1 - total / image.numel())

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * upstream, None


def _compiled_target(image: Tensor) -> DssimTarget:
    from ggavatar import dssim_kernel

    target = DssimTarget(image, torch.empty_like(image), torch.empty_like(image))
    dssim_kernel.prepare(_matrix(image), _matrix(target.mean), _matrix(target.square_mean))
    return target


def _matrix(image: Tensor) -> Float32[ndarray, "H K"]:
    """An image as rows of W·C floats."""
    return image.detach().contiguous().flatten(1).numpy()
