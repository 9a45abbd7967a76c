"""Where the files of learned metrics lie, and what they are: found by name, identified by SHA-256, never fetched."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

VARIABLE = "GGAVATAR_MODELS"
NO_WEIGHTS = "no weights"
"""How the reason of a metric without weights begins."""

BACKBONES = {
    "alex": ("alexnet_features.pth", "alexnet-owt-7be5be79.pth", "alexnet-owt-4df8aa71.pth", "alexnet.pth"),
    "vgg": ("vgg16_features.pth", "vgg16-397923af.pth", "vgg16.pth"),
    "squeeze": ("squeezenet1_1_features.pth", "squeezenet1_1-b8a52dc0.pth", "squeezenet1_1-f364aa15.pth"),
}
"""File names of ImageNet backbones in torchvision's key layout (`features.N.weight`): ours, then torchvision's own."""

HEADS = ("lpips_heads_v0.1/{net}.pth", "lpips/weights/v0.1/{net}.pth", "{net}.pth")


@dataclass(frozen=True)
class LpipsFiles:
    """The two files of one LPIPS network."""

    backbone: Path
    head: Path


def find_lpips(net: str, folders: Sequence[Path]) -> LpipsFiles | str:
    """Backbone and linear head of an LPIPS network (`alex`, `vgg`, `squeeze`), or the reason why there is none."""
    backbone = first_file(folders, BACKBONES[net])
    head = first_file(folders, tuple(name.format(net=net) for name in HEADS))
    wanted = [BACKBONES[net][0] if not backbone else "", HEADS[0].format(net=net) if not head else ""]
    if backbone and head:
        return LpipsFiles(backbone, head)
    return (
        f"{NO_WEIGHTS}: {' and '.join(filter(None, wanted))} not found; put the file into ${VARIABLE} or name --models"
    )


def first_file(folders: Sequence[Path], names: Sequence[str]) -> Path | None:
    """The first file of one of the names in the first folder that has one."""
    candidates = (folder / name for folder in folders for name in names)
    return next((path for path in candidates if path.is_file()), None)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
