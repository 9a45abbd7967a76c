"""The files of the LPIPS metrics: found by name in the model folders, never downloaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggavatar.pretrained.folders import MODELS_VARIABLE, first_file

NO_WEIGHTS = "no weights"
"""Beginning of the reason given for a metric whose weights are missing."""

BACKBONES = {
    "alex": ("alexnet_features.pth", "alexnet-owt-7be5be79.pth", "alexnet-owt-4df8aa71.pth", "alexnet.pth"),
    "vgg": ("vgg16_features.pth", "vgg16-397923af.pth", "vgg16.pth"),
    "squeeze": ("squeezenet1_1_features.pth", "squeezenet1_1-b8a52dc0.pth", "squeezenet1_1-f364aa15.pth"),
}
"""File names of ImageNet backbones with torchvision's keys (`features.N.weight`): our names, then torchvision's."""

HEADS = ("lpips_heads_v0.1/{net}.pth", "lpips/weights/v0.1/{net}.pth", "{net}.pth")
"""File names of the linear heads of LPIPS 0.1: our name, then those of the lpips package."""


@dataclass(frozen=True)
class LpipsFiles:
    """The two files of one LPIPS network."""

    backbone: Path
    head: Path


def find_lpips(net: str, folders: Sequence[Path]) -> LpipsFiles | str:
    """Find backbone and linear head of an LPIPS network (`alex`, `vgg`, `squeeze`), or return what is missing."""
    backbone = first_file(folders, BACKBONES[net])
    head = first_file(folders, tuple(name.format(net=net) for name in HEADS))
    wanted = [BACKBONES[net][0] if not backbone else "", HEADS[0].format(net=net) if not head else ""]
    if backbone and head:
        return LpipsFiles(backbone, head)
    missing = " and ".join(filter(None, wanted))
    return f"{NO_WEIGHTS}: {missing} not found; put it into ${MODELS_VARIABLE}, or pass its folder with --models"
