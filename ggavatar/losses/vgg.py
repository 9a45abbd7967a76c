"""Perceptual loss on VGG16 features (Johnson et al. 2016).

The network is written out here: torchvision, which has VGG16, does not import beside the CPU build of torch 2.13.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import conv2d, max_pool2d, relu

from ggavatar.jit.constants import constant_like
from ggavatar.pretrained.resolve import ModelUnavailable, resolve
from ggavatar.pretrained.weights import load_weights
from ggavatar.text.terminal import write_err

BLOCKS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21))
"""Convolutions of VGG16's first four blocks, as torchvision numbers them; the loss compares the end of each block."""
WIDTHS = (64, 128, 256, 512)
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

Features = tuple[Tensor, ...]

FeatureChoice = Literal["best", "vgg16", "random"]
"""Choices of features; `best` is VGG16 if its weights can be had, else random features, with a warning."""


class PerceptualLoss(nn.Module):
    """Mean absolute difference of rectified VGG16 features, summed over the blocks (docs/paper.md, A18).

    The weights are not part of any checkpoint.

    Attributes:
        name: The features: "vgg16", or "random" for untrained weights. Report it with every number that depends on it;
            such a number is not LPIPS.

    References:
        Johnson et al. 2016; GGAvatar Eq. 16 (λ2); Liu et al. 2021 (arXiv 2103.10571) for untrained weights.
    """

    def __init__(self, name: str, state: dict[str, Tensor]) -> None:
        """Take the convolutions of the four blocks out of `state` (torchvision's keys)."""
        super().__init__()
        self.name = name
        for index in (index for block in BLOCKS for index in block):
            weight = state[f"features.{index}.weight"].float().contiguous(memory_format=torch.channels_last)
            self.register_buffer(f"weight_{index}", weight, persistent=False)
            self.register_buffer(f"bias_{index}", state[f"features.{index}.bias"].float(), persistent=False)

    def forward(self, image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"] | Features) -> Float[Tensor, ""]:
        """The loss of an image in [0, 1], at least 8 px a side, against a target or its `features`."""
        with torch.no_grad():
            wanted = self.features(target) if isinstance(target, Tensor) else target
        pairs = zip(self.features(image), wanted, strict=True)
        return torch.stack([(ours - theirs).abs().mean() for ours, theirs in pairs]).sum()

    def features(self, image: Float[Tensor, "H W 3"]) -> Features:
        """Rectified features at the end of every block, for an image in [0, 1]."""
        mean, deviation = constant_like(IMAGENET_MEAN, image), constant_like(IMAGENET_DEVIATION, image)
        maps = ((image - mean) / deviation).permute(2, 0, 1)[None]  # channels_last without a copy
        found: list[Tensor] = []
        for number, block in enumerate(BLOCKS):
            maps = max_pool2d(maps, 2) if number else maps
            for index in block:
                maps = relu(
                    conv2d(maps, self.get_buffer(f"weight_{index}"), self.get_buffer(f"bias_{index}"), padding=1)
                )
            found.append(maps)
        return tuple(found)


def perceptual_loss(
    features: FeatureChoice = "best", folder: Path | None = None, offline: bool = False, seed: int = 0
) -> PerceptualLoss:
    """The perceptual loss on VGG16's features, or on those of an untrained network of the same shape; see `.name`.

    Args:
        features: "best", "vgg16" or "random"; a warning on stderr says that and why "best" is not VGG16.
        folder: A folder to search for weights before $GGAVATAR_MODELS and the user's cache.
        offline: Never download weights.
        seed: Seed of the random weights.

    Raises:
        InputError: `features` is "vgg16" and its weights cannot be had, or a file is damaged.
    """
    if features != "random":
        try:
            return PerceptualLoss("vgg16", load_weights(resolve("vgg16", folder, offline)))
        except ModelUnavailable as missing:
            if features == "vgg16":
                raise
            write_err(f"warning: the perceptual loss compares random features in place of VGG16's: {missing}")
    return PerceptualLoss("random", random_weights(seed))


def random_weights(seed: int) -> dict[str, Tensor]:
    """Untrained weights for all blocks (He et al. 2015: rectifiers keep the variance), without biases."""
    generator = torch.Generator().manual_seed(seed)
    state: dict[str, Tensor] = {}
    inputs = 3
    for block, width in zip(BLOCKS, WIDTHS, strict=True):
        for index in block:
            deviation = (2 / (9 * inputs)) ** 0.5
            state[f"features.{index}.weight"] = torch.randn(width, inputs, 3, 3, generator=generator) * deviation
            state[f"features.{index}.bias"] = torch.zeros(width)
            inputs = width
    return state
