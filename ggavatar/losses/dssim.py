"""The image loss (GGAvatar Eq. 13): L1 and D-SSIM, with SSIM as in 3D Gaussian Splatting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import conv2d, l1_loss

from ggavatar.jit import device_kernels
from ggavatar.jit.dispatch import compiled_for

WINDOW, SIGMA = 11, 1.5
LUMINANCE, CONTRAST = 0.01**2, 0.03**2


@dataclass(frozen=True)
class DssimTarget:
    """A ground-truth image with the local means that every comparison needs; computed once per frame.

    Attributes:
        image: The image, in [0, 1].
        mean: Its Gaussian-weighted local mean.
        square_mean: The Gaussian-weighted local mean of its square.
    """

    image: Float[Tensor, "H W C"]
    mean: Float[Tensor, "H W C"]
    square_mean: Float[Tensor, "H W C"]

    @staticmethod
    def of(image: Float[Tensor, "H W C"]) -> DssimTarget:
        """The target of an image in [0, 1]."""
        image = image.detach().contiguous()
        if image.shape[-1] == 3 and compiled_for(image):
            return _compiled_target(image)
        if image.shape[-1] == 3 and device_kernels.run_on(image):
            from ggavatar.losses import dssim_triton

            return DssimTarget(image, *dssim_triton.prepare(image))
        mean, square_mean = _blur(torch.cat((image, image.square()), dim=-1)).chunk(2, dim=-1)
        return DssimTarget(image, mean.contiguous(), square_mean.contiguous())


class ImageTerms(NamedTuple):
    """The two weighted terms of the image loss."""

    l1: Float[Tensor, ""]
    dssim: Float[Tensor, ""]


def image_terms(
    image: Float[Tensor, "H W C"], target: DssimTarget | Float[Tensor, "H W C"], dssim_share: float
) -> ImageTerms:
    """(1 − λ1) · mean |image − target| and λ1 · `dssim(image, target)`, computed in one pass.

    Args:
        image: The rendered image; gradients flow into it only.
        target: The ground truth; a `DssimTarget` saves time if it is compared with more than once.
        dssim_share: λ1, in [0, 1].

    References:
        GGAvatar (Li et al. 2024), Eq. 13.
    """
    return _image_terms(image, target, (1 - dssim_share, dssim_share))


def dssim(image: Float[Tensor, "H W C"], target: DssimTarget | Float[Tensor, "H W C"]) -> Float[Tensor, ""]:
    """1 − mean SSIM over pixels and channels, in [0, 2].

    The window is an 11×11 Gaussian with σ = 1.5 px and zero padding, C1 = 0.01² and C2 = 0.03² for a range of 1. The
    value is not halved (docs/paper.md, A17).

    Args:
        image: The rendered image; gradients flow into it only.
        target: The ground truth; a `DssimTarget` saves time if it is compared with more than once.

    References:
        Wang et al. 2004; Kerbl et al. 2023 (zero padding, no sample covariance).
    """
    return _image_terms(image, target, (0.0, 1.0)).dssim


def _image_terms(image: Tensor, target: DssimTarget | Tensor, weights: tuple[float, float]) -> ImageTerms:
    target = target if isinstance(target, DssimTarget) else DssimTarget.of(target)
    if image.shape[-1] == 3 and compiled_for(image, target.image):
        return ImageTerms(*_CompiledTerms.apply(image, target, weights))
    if image.shape[-1] == 3 and device_kernels.run_on(image, target.image):
        return ImageTerms(*_DeviceTerms.apply(image, target, weights).unbind())
    return image_terms_in_torch(image, target, weights)


def image_terms_in_torch(
    image: Float[Tensor, "H W C"], target: DssimTarget, weights: tuple[float, float]
) -> ImageTerms:
    """Both weighted terms in plain torch: any dtype and device."""
    return ImageTerms(weights[0] * l1_loss(image, target.image), weights[1] * dssim_in_torch(image, target))


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
    """Gaussian-weighted local means with zero padding."""
    offsets = torch.arange(WINDOW, dtype=maps.dtype, device=maps.device) - WINDOW // 2
    line = torch.softmax(-offsets.square() / (2 * SIGMA**2), dim=0)
    count = maps.shape[-1]
    kernel = torch.outer(line, line).expand(count, 1, WINDOW, WINDOW)
    return conv2d(maps.permute(2, 0, 1)[None], kernel, padding=WINDOW // 2, groups=count)[0].permute(1, 2, 0)


class _CompiledTerms(torch.autograd.Function):
    """The compiled kernel; forward also computes the gradient of the sum, which backward only scales."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: DssimTarget, weights: tuple[float, float]) -> tuple[Tensor, Tensor]:
        from ggavatar.losses import dssim_kernel

        wanted, size = ctx.needs_input_grad[0], image.numel()
        gradient = torch.empty(image.shape if wanted else (0, *image.shape[1:]))
        x, y = _matrix(image), _matrix(target.image)
        means = _matrix(target.mean), _matrix(target.square_mean)
        factors = weights[0] / size, -weights[1] / size
        difference, similarity = dssim_kernel.compare(x, y, *means, factors, _matrix(gradient))
        ctx.save_for_backward(image, gradient)
        ctx.target, ctx.weights = target, weights
        return image.new_tensor(weights[0] * difference / size), image.new_tensor(weights[1] * (1 - similarity / size))

    @staticmethod
    def backward(ctx: Any, to_l1: Tensor, to_dssim: Tensor) -> tuple[Tensor, None, None]:
        image, gradient = ctx.saved_tensors
        factor, more = to_dssim.item(), to_l1.item() - to_dssim.item()
        if more and ctx.weights[0]:  # the two terms have different upstream gradients
            signs = (image - ctx.target.image).sign() * (ctx.weights[0] / image.numel())
            return factor * gradient + more * signs, None, None
        return gradient if factor == 1 else factor * gradient, None, None


class _DeviceTerms(torch.autograd.Function):
    """The kernels of `ggavatar.losses.dssim_triton`; both terms in one tensor."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: DssimTarget, weights: tuple[float, float]) -> Tensor:
        from ggavatar.losses import dssim_triton

        image = image.contiguous()
        means = target.mean.contiguous(), target.square_mean.contiguous()
        terms, derivatives = dssim_triton.terms_of(image, target.image, means, weights)
        ctx.save_for_backward(image, target.image, derivatives)
        ctx.weights = weights
        return terms

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        from ggavatar.losses import dssim_triton

        image, target, derivatives = ctx.saved_tensors
        return dssim_triton.gradient_of(image, target, derivatives, upstream.contiguous(), ctx.weights), None, None


def _compiled_target(image: Tensor) -> DssimTarget:
    from ggavatar.losses import dssim_kernel

    target = DssimTarget(image, torch.empty_like(image), torch.empty_like(image))
    dssim_kernel.prepare(_matrix(image), _matrix(target.mean), _matrix(target.square_mean))
    return target


def _matrix(image: Tensor) -> Float32[ndarray, "H K"]:
    """An image as rows of W·C floats."""
    return image.detach().contiguous().flatten(1).numpy()
